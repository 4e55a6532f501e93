"""Completions at the cursor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from fte_sniff.analysis.filter.lexer import Token, TokenType, tokens
from fte_sniff.analysis.filter.parser import COMPARISONS, OPERATOR_WORDS, PATTERN_WORDS
from fte_sniff.analysis.filter.terms import COLUMN_OF_WORD, FUNCTIONS
from fte_sniff.errors import FilterError
from fte_sniff.protocol import COLUMN_BY_NAME, Column, ColumnType, iso_time

_BEGUN: Final = re.compile(r"(?P<quote>['\"]?)(?P<word>(?<=['\"])[\w:.-]*|\w*)$")
_JOINTS: Final = ("AND", "OR")
_OPENERS: Final = ("AND", "OR", "NOT", "WHERE")
_CONSTANTS: Final = ("NULL", "TRUE", "FALSE", "FROM", "WHERE")
_MILLISECONDS: Final = len("12:00:00.000")
_TEXTS: Final = (ColumnType.TEXT, ColumnType.HEX, ColumnType.WORDS)


@dataclass(frozen=True, slots=True)
class Completions:
    """What may replace the word before the cursor."""

    start: int
    """Place of the word's first character; the word ends at the cursor."""
    choices: tuple[str, ...]
    """Whole replacements, quotes included, the likeliest first."""


def completions(text: str, cursor: int | None = None, t_ns: int | None = None) -> Completions:
    """The ways in which the word that ends at the cursor can go on.

    Args:
        text: the filter so far.
        cursor: a place in it; by default its end.
        t_ns: a time to go by where one is asked for, nanoseconds since 1970 UTC.
    """
    cursor = len(text) if cursor is None else min(max(cursor, 0), len(text))
    begun = _BEGUN.search(text, 0, cursor)
    if begun is None:
        return Completions(cursor, ())
    try:
        before = tokens(text[: begun.start()])[:-1]
    except FilterError:
        return Completions(cursor, ())
    if not all(map(_is_known, before)):
        return Completions(cursor, ())
    word = begun["word"].lower()
    if begun["quote"]:
        choices: Sequence[str] = _quoted_values(_asked(before), t_ns)
    else:
        choices = _next(before, t_ns)
    return Completions(
        begun.start(),
        tuple(
            choice
            for choice in choices
            if choice.strip("'").lower().startswith(word) and choice.lower() != word
        ),
    )


def _is_known(token: Token) -> bool:
    """Whether the token, where it is a name, is one that a filter can have."""
    name = token.text.lower()
    return (
        token.type is not TokenType.NAME
        or token.word in OPERATOR_WORDS
        or token.word in _CONSTANTS
        or name in COLUMN_BY_NAME
        or name in COLUMN_OF_WORD
        or name in FUNCTIONS
    )


def _next(before: Sequence[Token], t_ns: int | None) -> Sequence[str]:
    """What may stand behind these tokens."""
    asked = _asked(before)
    if asked is not None:
        return _quoted_values(asked, t_ns) or _alike(asked)
    if not before or before[-1].word in _OPENERS or before[-1].text in ("(", "&&", "||", "!"):
        return [*COLUMN_BY_NAME, "NOT", *COLUMN_OF_WORD]
    last = before[-1]
    if last.type is TokenType.SYMBOL and last.text != ")":
        return list(COLUMN_BY_NAME)
    column = _column(last)
    compared = len(before) > 1 and before[-2].text in COMPARISONS
    return _JOINTS if column is None or compared else _signs(column)


def _alike(column: Column) -> Sequence[str]:
    """The other columns that hold the same type."""
    return [
        other.name
        for other in COLUMN_BY_NAME.values()
        if other.type is column.type and other is not column
    ]


def _signs(column: Column) -> Sequence[str]:
    """What a field may be asked."""
    signs = ["IN", "IS NULL", "IS NOT NULL", "NOT IN"]
    if column.type in (ColumnType.INT, ColumnType.TIME):
        return ["=", ">", "<", "BETWEEN", *signs]
    return ["=", "!=", *(["LIKE"] if column.type in _TEXTS else []), *signs]


def _asked(before: Sequence[Token]) -> Column | None:
    """The column whose value comes next, where one is asked for its value."""
    at = len(before) - 1
    if at >= 0 and before[at].text in ("(", ","):
        while at >= 0 and before[at].text != "(":
            at -= 1
        at -= 1
        if at < 0 or before[at].word != "IN":
            return None
    elif at < 0 or not _asks(before[at]):
        return None
    at -= 1
    if at >= 0 and before[at].word == "NOT":
        at -= 1
    return _column(before[at]) if at >= 0 else None


def _asks(token: Token) -> bool:
    return token.word in PATTERN_WORDS or (
        token.type is TokenType.SYMBOL and token.text in COMPARISONS
    )


def _column(token: Token) -> Column | None:
    if token.type not in (TokenType.NAME, TokenType.QUOTED):
        return None
    return COLUMN_BY_NAME.get(token.text.lower())


def _quoted_values(column: Column | None, t_ns: int | None) -> Sequence[str]:
    if column is None:
        return []
    if column.type is ColumnType.TIME and t_ns is not None:
        day, clock = iso_time(t_ns).split("T")
        return [f"'{clock[:_MILLISECONDS]}'", f"'{day}T{clock}'"]
    return [f"'{word}'" for word in column.words]
