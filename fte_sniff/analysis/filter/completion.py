"""Completions of a filter at the cursor."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from fte_sniff.analysis.filter.row_filter import (
    COLUMN_OF_WORD,
    COMPARISONS,
    FUNCTIONS,
    KEYWORDS,
    PATTERNS,
    Token,
    tokens,
)
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.errors import FilterError
from fte_sniff.protocol import COLUMN_BY_NAME, Column, ColumnType, iso_time

_LAST_WORD: Final = re.compile(r"(?P<quote>['\"]?)(?P<word>(?<=['\"])[\w:.-]*|\w*)$")
_OPENERS: Final = ("AND", "OR", "NOT", "(")
_KNOWN: Final = frozenset([*COLUMN_BY_NAME, *COLUMN_OF_WORD, *FUNCTIONS])
_CALLS: Final = tuple(f"{name}(" for name in FUNCTIONS)
_COMPARED_BY: Final = frozenset([*COMPARISONS, *PATTERNS])
_MILLISECONDS: Final = len("12:00:00.000")


@dataclass(frozen=True, slots=True)
class Completions:
    """Replacements of the word before the cursor."""

    start: int
    """Index of the word's first character; the word ends at the cursor."""
    choices: tuple[str, ...]
    """Whole replacements, quotes included, the likeliest first."""
    counts: Mapping[str, int] = field(default_factory=dict)
    """Rows that have a value, by choice."""


Observed: TypeAlias = Callable[[str], Mapping[str, int]]
"""Values of a column by name, each with its number of rows."""


def completions(
    text: str,
    cursor: int | None = None,
    t_ns: int | None = None,
    observed: Observed = lambda _column: {},
) -> Completions:
    """Completions of the word that ends at the cursor, by default at the end of the text.

    `t_ns` is the time to suggest, nanoseconds since 1970 UTC. `observed` returns the values that
    are suggested, the most frequent first; it is called for one column at most.
    """
    cursor = len(text) if cursor is None else min(max(cursor, 0), len(text))
    match = _LAST_WORD.search(text, 0, cursor)
    if match is None:
        return Completions(cursor, ())
    try:
        before = tokens(text[: match.start()])[:-1]
    except FilterError:
        return Completions(cursor, ())
    if not all(map(_is_known, before)):
        return Completions(cursor, ())
    word, column = match["word"].lower(), _compared_column(before)
    values = {} if column is None or column.type is ColumnType.TIME else observed(column.name)
    counts = {_literal(column, value): values[value] for value in values if column is not None}
    other = _quoted_values(column, t_ns) if match["quote"] else _choices_after(before, t_ns)
    ranked = sorted(counts, key=lambda value: (-counts[value], len(value), value))
    return Completions(
        match.start(),
        tuple(
            choice
            for choice in dict.fromkeys((*ranked, *other))
            if choice.strip("'").lower().startswith(word) and choice.lower() != word
        ),
        counts,
    )


def _literal(column: Column | None, value: str) -> str:
    is_number = column is not None and column.type in (ColumnType.INT, ColumnType.REAL)
    return value if is_number else quoted(value)


def _is_known(token: Token) -> bool:
    return token.kind != "name" or token.word in KEYWORDS or token.text.lower() in _KNOWN


def _choices_after(before: Sequence[Token], t_ns: int | None) -> Sequence[str]:
    compared = _compared_column(before)
    if compared is not None:
        same_type = [
            other.name
            for other in COLUMN_BY_NAME.values()
            if other.type is compared.type and other is not compared
        ]
        return _quoted_values(compared, t_ns) or same_type
    last = before[-1] if before else None
    if last is None or last.word in _OPENERS:
        return [*COLUMN_BY_NAME, "NOT", *COLUMN_OF_WORD, *_CALLS]
    if last.kind == "sign" and last.text != ")":
        return [*COLUMN_BY_NAME, *_CALLS]
    column = _column(last)
    is_value = len(before) > 1 and before[-2].word in COMPARISONS
    return ("AND", "OR") if column is None or is_value else _operators(column)


def _operators(column: Column) -> Sequence[str]:
    words = ["IN", "IS NULL", "IS NOT NULL", "NOT IN"]
    if column.type is ColumnType.BOOL:
        return ["AND", "OR", "=", "IS NULL", "IS NOT NULL"]
    if column.type in (ColumnType.INT, ColumnType.REAL, ColumnType.TIME):
        return ["=", ">", "<", "BETWEEN", *words]
    return ["=", "!=", *(["LIKE"] if column.type is not ColumnType.WORD else []), *words]


def _compared_column(before: Sequence[Token]) -> Column | None:
    """The column that the next value is compared with."""
    at = len(before) - 1
    if at >= 0 and before[at].text in ("(", ","):
        while at >= 0 and before[at].text != "(":
            at -= 1
        at -= 1
        if at < 0 or before[at].word != "IN":
            return None
    elif at < 0 or before[at].word not in _COMPARED_BY:
        return None
    at -= 1
    if at >= 0 and before[at].word == "NOT":
        at -= 1
    return _column(before[at]) if at >= 0 else None


def _column(token: Token) -> Column | None:
    return COLUMN_BY_NAME.get(token.text.lower()) if token.kind == "name" else None


def _quoted_values(column: Column | None, t_ns: int | None) -> Sequence[str]:
    if column is None:
        return []
    if column.type is ColumnType.TIME and t_ns is not None:
        day, clock = iso_time(t_ns).split("T")
        return [f"'{clock[:_MILLISECONDS]}'", f"'{day}T{clock}'"]
    return [f"'{word}'" for word in column.words]
