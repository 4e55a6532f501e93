"""Owns what a part of a filter is: its type, its SQL, and how a message speaks of it.

It must not know how parts are joined or in what order they were written.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from fte_sniff.protocol import COLUMNS, Column
from fte_sniff.said import Said


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


def nearest(word: str, choices: Iterable[str]) -> str:
    """`did you mean x?`, or nothing where the word is short for no choice, nor like one."""
    names, asked = list(choices), word.lower()
    begun = [name for name in names if len(word) > 1 and name.startswith(asked)]
    near = (
        begun
        or [name for name in names if _is_short_for(asked, name)]
        or difflib.get_close_matches(asked, names, n=1)
    )
    return Said("did you mean {near}?", near=near[0]) if near else ""


def _is_short_for(text: str, name: str) -> bool:
    """Whether each of a text's words leaves letters out of the name's one, as in `speed fb`."""
    words, parts = re.split(r"[\s_.-]+", text), name.split("_")
    return len(words) == len(parts) > 1 and all(
        re.fullmatch(".*".join(map(re.escape, word)) + ".*", part)
        for word, part in zip(words, parts, strict=True)
    )


def how_to_ask(term: Term) -> str:
    """How a term of that type is asked about."""
    name = term.shown if term.column else "motor"
    return {
        TermType.NUMBER: Said("compare it, as in {name} = 1", name=name),
        TermType.TIME: Said("compare it, as in time > '2026-01-31T12:00:00Z'"),
        TermType.TEXT: Said("compare it, as in port LIKE '%USB%'"),
        TermType.HEX: Said("compare it, as in raw LIKE 'AA01%'"),
        TermType.WORDS: Said("ask for one, as in faults = 'noise', or for any: faults IS NOT NULL"),
        TermType.WORD: Said(
            "compare it, as in {name} = '{word}'", name=name, word=_first_word(term)
        ),
        TermType.LITERAL: Said("compare a field with it, as in kind = 'speed'"),
        TermType.NULL: Said("write IS NULL or IS NOT NULL"),
        TermType.TRUTH: Said("join conditions with AND or OR"),
        TermType.NAME: Said("compare it with a field"),
    }[term.type]


def _first_word(term: Term) -> str:
    return term.column.words[0] if term.column and term.column.words else "speed"


def quoted(text: str) -> str:
    """The text as SQL writes it."""
    return "'" + text.replace("'", "''") + "'"
