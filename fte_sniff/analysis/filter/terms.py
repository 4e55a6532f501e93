"""Owns what a part of a filter is: its type, its SQL, and by what name a message speaks of it.

It must not know how parts are joined or in what order they were written.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

from fte_sniff.protocol import COLUMNS, Column


class TermType(Enum):
    """What a part of a filter is; the value is how a message names it."""

    NUMBER = "a number"
    TEXT = "a text"
    WORD = "a word"
    WORDS = "a list of words"
    TIME = "a time"
    HEX = "hex digits"
    TRUTH = "a condition"
    LITERAL = "a text in quotes"
    """Takes the type of what it is compared with."""
    NAME = "a name"
    """No field; a word of the contract, or a mistake."""
    NULL = "NULL"


@dataclass(frozen=True, slots=True)
class Term:
    """A part of a filter as SQL that stands by itself, with its type and place."""

    type: TermType
    sql: str
    start: int
    """Place of its first character in the filter."""
    shown: str
    """How a message names it."""
    depth: int = 0
    """Brackets inside brackets in `sql`."""
    column: Column | None = None
    """The column, where the term is nothing but one."""
    names: frozenset[str] = frozenset()
    """The columns it reads."""


UNTYPED: Final = (TermType.LITERAL, TermType.NAME)
"""What has no type by itself."""

COLUMN_OF_WORD: Final = {word: column for column in COLUMNS for word in column.words}
"""The column that each word of the contract belongs to."""

INT64: Final = range(-(2**63) + 1, 2**63)
"""The whole numbers that polars reads as such; -2**63 it takes for a decimal fraction."""


@dataclass(frozen=True, slots=True)
class Function:
    """A function of a filter: the types it takes, the type it gives, and an example."""

    takes: tuple[TermType, ...]
    gives: TermType
    example: str


FUNCTIONS: Final = {
    "abs": Function((TermType.NUMBER,), TermType.NUMBER, "abs(rpm) > 500"),
    "coalesce": Function(
        (TermType.NUMBER, TermType.NUMBER), TermType.NUMBER, "coalesce(rpm, 0) < 10"
    ),
    "lower": Function((TermType.TEXT,), TermType.TEXT, "lower(port) LIKE '%usb%'"),
    "upper": Function((TermType.TEXT,), TermType.TEXT, "upper(port) LIKE '%USB%'"),
    "starts_with": Function(
        (TermType.TEXT, TermType.LITERAL), TermType.TRUTH, "starts_with(raw, 'AA 01')"
    ),
    "ends_with": Function(
        (TermType.TEXT, TermType.LITERAL), TermType.TRUTH, "ends_with(raw, 'EE')"
    ),
}
"""The functions that a filter may call, by name."""


def quoted(text: str) -> str:
    """The text as SQL writes it."""
    return "'" + text.replace("'", "''") + "'"
