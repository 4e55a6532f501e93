"""Completions of a filter at the cursor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from fte_sniff.analysis.filter.row_filter import COLUMN_OF_WORD, FUNCTIONS
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.protocol import COLUMN_BY_NAME, Column, ColumnType, iso_time

_LAST_WORD: Final = re.compile(r"(?P<quote>['\"]?)(?P<word>(?<=['\"])[\w:.-]*|\w*)$")
_COMPARED: Final = re.compile(
    r"(\w+)\s*(?:(?:==?|!=|<>|<=?|>=?|!?~)|(?:\bNOT\s+)?\b(?:I?LIKE|R(?:EGEXP|LIKE)|BETWEEN"
    r"|IN\s*\((?:[^(),]*,)*))\s*$",
    re.IGNORECASE,
)
"""A field that the next word is compared with."""
_BEGINS: Final = re.compile(r"(?:^|[(!,]|&&|\|\||\b(?:AND|OR|NOT))\s*$", re.IGNORECASE)
"""Where a condition begins."""
_JOINED: Final = re.compile(r"[-+*/%&|=<>~]\s*$")
_NAMED: Final = re.compile(r"(?:^|[(!]|&&|\|\||\b(?:AND|OR|NOT)\s)\s*(\w+)\s+$", re.IGNORECASE)
"""A field alone, which an operator follows."""
_CALLS: Final = tuple(f"{name}(" for name in FUNCTIONS)
_MILLISECONDS: Final = len("12:00:00.000")


@dataclass(frozen=True, slots=True)
class Completions:
    """Replacements of the word before the cursor."""

    start: int
    """Index of the word's first character; the word ends at the cursor."""
    choices: tuple[str, ...]
    """Whole replacements, quotes included, the likeliest first."""


def completions(text: str, cursor: int | None = None, t_ns: int | None = None) -> Completions:
    """Completions of the word that ends at the cursor, by default at the end of the text.

    `t_ns` is the time to suggest, nanoseconds since 1970 UTC.
    """
    cursor = len(text) if cursor is None else min(max(cursor, 0), len(text))
    match = _LAST_WORD.search(text, 0, cursor)
    if match is None or text.count("'", 0, match.start()) % 2:
        return Completions(cursor, ())
    before, word = text[: match.start()], match["word"].lower()
    compared = _COMPARED.search(before)
    column = COLUMN_BY_NAME.get(compared[1].lower()) if compared else None
    other = _values(column, t_ns)
    if not match["quote"]:
        other = other or _choices(before, column)
    return Completions(
        match.start(),
        tuple(
            choice
            for choice in dict.fromkeys(other)
            if choice.strip("'").lower().startswith(word) and choice.lower() != word
        ),
    )


def _choices(before: str, compared: Column | None) -> Sequence[str]:
    """What may follow some text, after a comparison with a column or not."""
    if compared is not None:
        columns = COLUMN_BY_NAME.values()
        return [one.name for one in columns if one.type is compared.type and one is not compared]
    if _BEGINS.search(before):
        return [*COLUMN_BY_NAME, "NOT", *COLUMN_OF_WORD, *_CALLS]
    if _JOINED.search(before):
        return [*COLUMN_BY_NAME, *_CALLS]
    named = _NAMED.search(before)
    column = COLUMN_BY_NAME.get(named[1].lower()) if named else None
    return _operators(column) if column else ("AND", "OR")


def _operators(column: Column) -> Sequence[str]:
    words = ["IN", "IS NULL", "IS NOT NULL", "NOT IN"]
    if column.type is ColumnType.BOOL:
        return ["AND", "OR", "=", "IS NULL", "IS NOT NULL"]
    if column.type in (ColumnType.INT, ColumnType.REAL, ColumnType.TIME):
        return ["=", ">", "<", "BETWEEN", *words]
    return ["=", "!=", *(["LIKE"] if column.type is not ColumnType.WORD else []), *words]


def _values(column: Column | None, t_ns: int | None) -> Sequence[str]:
    if column is not None and column.type is ColumnType.TIME and t_ns is not None:
        day, clock = iso_time(t_ns).split("T")
        return [f"'{clock[:_MILLISECONDS]}'", f"'{day}T{clock}'"]
    return [quoted(word) for word in column.words] if column is not None else []
