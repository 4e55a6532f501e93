"""Names, types, functions, help and error messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from textwrap import wrap
from typing import Final

from fte_sniff.analysis.filter.lexer import complaint
from fte_sniff.errors import FilterError, TranslatableText
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, Column


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


@dataclass(frozen=True, slots=True)
class FilterErrors:
    """What is said of the terms of one filter; each points at the term's place in the text."""

    text: str

    def about(self, term: Term, what: str, way_out: str = "") -> FilterError:
        """That something is wrong with a term."""
        return complaint(self.text, term.start, what, way_out)

    def unknown(self, term: Term) -> FilterError:
        """That nothing has that name."""
        choices = [*COLUMN_BY_NAME, *COLUMN_OF_WORD]
        return self.about(
            term,
            TranslatableText("unknown name '{term}'", term=term.shown),
            (
                nearest(term.shown, choices)
                or TranslatableText("the fields are {names}", names=", ".join(COLUMN_BY_NAME))
            ),
        )

    def other_type(self, term: Term, why: str) -> FilterError:
        """That a term has another type than is wanted; `why` says what wants which."""
        told = TranslatableText(
            "{why}, and {term} is {type}",
            why=why,
            term=term.shown,
            type=TranslatableText(term.type.value),
        )
        return self.about(term, told, how_to_ask(term))

    def mismatch(self, left: Term, right: Term) -> FilterError:
        """That two terms are of types that cannot stand beside each other."""
        if left.type in UNTYPED and right.type in UNTYPED:
            return self.about(
                left,
                TranslatableText("two texts are compared"),
                TranslatableText("a field's name stands without single quotes"),
            )
        if left.column is None and right.type is TermType.LITERAL:
            near = nearest(right.shown, COLUMN_BY_NAME) or "name a field"
            return self.about(
                right,
                TranslatableText("'{right}' is a text, no field", right=right.shown),
                TranslatableText("{near} (no quotes)", near=near),
            )
        what = TranslatableText(
            "{left} is {left_is}, {right} is {right_is}",
            left=left.shown,
            left_is=TranslatableText(left.type.value),
            right=right.shown,
            right_is=TranslatableText(right.type.value),
        )
        if left.type is TermType.NUMBER and right.type is TermType.LITERAL:
            return self.about(right, what, TranslatableText("write a number, without quotes"))
        if left.type is TermType.HEX and right.type is TermType.NUMBER:
            return self.about(
                right, what, TranslatableText("write the bytes as a text, as in raw LIKE 'AA01%'")
            )
        return self.about(right, what, how_to_ask(left))


def nearest(word: str, choices: Iterable[str]) -> str:
    """`did you mean x?`, or nothing where the word is short for no choice, nor like one."""
    names, asked = list(choices), word.lower()
    begun = [name for name in names if len(word) > 1 and name.startswith(asked)]
    near = (
        begun
        or [name for name in names if _is_short_for(asked, name)]
        or difflib.get_close_matches(asked, names, n=1)
    )
    return TranslatableText("did you mean {near}?", near=near[0]) if near else ""


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
        TermType.NUMBER: TranslatableText("compare it, as in {name} = 1", name=name),
        TermType.TIME: TranslatableText("compare it, as in time > '2026-01-31T12:00:00Z'"),
        TermType.TEXT: TranslatableText("compare it, as in port LIKE '%USB%'"),
        TermType.HEX: TranslatableText("compare it, as in raw LIKE 'AA01%'"),
        TermType.WORDS: TranslatableText(
            "ask for one, as in faults = 'noise', or for any: faults IS NOT NULL"
        ),
        TermType.WORD: TranslatableText(
            "compare it, as in {name} = '{word}'", name=name, word=_first_word(term)
        ),
        TermType.LITERAL: TranslatableText("compare a field with it, as in kind = 'speed'"),
        TermType.NULL: TranslatableText("write IS NULL or IS NOT NULL"),
        TermType.TRUTH: TranslatableText("join conditions with AND or OR"),
        TermType.NAME: TranslatableText("compare it with a field"),
    }[term.type]


def _first_word(term: Term) -> str:
    return term.column.words[0] if term.column and term.column.words else "speed"


MAX_DEPTH: Final = 18
"""Brackets inside brackets in the SQL; polars' parser gives up at 23."""

MAX_SQL: Final = 30_000
"""Characters of SQL; a list of many values asked of a long expression grows fast."""

_WIDTH: Final = 8
"""Conditions side by side before they are bracketed: polars' time grows with the square of more."""


class BooleanTerms:
    """Makes the terms of one filter out of others."""

    def __init__(self, text: str) -> None:
        self._complain = FilterErrors(text)

    def made(
        self,
        sql: str,
        terms: Iterable[Term],
        names: frozenset[str] = frozenset(),
        of_type: TermType = TermType.TRUTH,
    ) -> Term:
        """The term that SQL of other terms is, and by what name a message speaks of it.

        Args:
            sql: stands by itself, in brackets of its own or as a call.
            terms: what it is made of, at least one.
            names: columns that it reads and none of them does.
            of_type: what it is.

        Raises:
            FilterError: polars would not read it, or take too long.
        """
        parts = tuple(terms)
        depth = 1 + max(term.depth for term in parts)
        first = min(parts, key=lambda term: term.start)
        if depth > MAX_DEPTH or len(sql) > MAX_SQL:
            raise self._complain.about(
                first,
                TranslatableText("the filter is too deep or too large"),
                TranslatableText("take it apart"),
            )
        return Term(
            of_type,
            sql,
            first.start,
            TranslatableText("this condition")
            if of_type is TermType.TRUTH
            else TranslatableText("this value"),
            depth,
            names=names.union(*(term.names for term in parts)),
        )

    def chained(self, conditions: Sequence[Term], joint: str) -> Term:
        """Conditions joined by AND or OR; many of them in groups of groups."""
        parts = list(conditions)
        while len(parts) > 1:
            groups = (parts[at : at + _WIDTH] for at in range(0, len(parts), _WIDTH))
            parts = [self._group(group, joint) for group in groups]
        return parts[0]

    def _group(self, terms: Sequence[Term], joint: str) -> Term:
        if len(terms) == 1:
            return terms[0]
        return self.made(f"({f' {joint} '.join(term.sql for term in terms)})", terms)


def _help() -> Iterator[str]:
    yield "A filter says which rows are wanted, in SQL's words: motor = 1 AND rpm > 500"
    yield ""
    yield "Fields"
    for column in COLUMNS:
        yield from _beside(f"  {column.name:<10} ", column.meaning)
        yield from _beside(" " * 13, ", ".join(column.words))
    yield ""
    yield "Examples"
    for example, meaning in EXAMPLES:
        yield f"  {example:<34} {meaning}"


def _beside(start: str, text: str) -> list[str]:
    return wrap(text, 79, initial_indent=start, subsequent_indent=" " * len(start))


EXAMPLES: Final = (
    ("motor = 1 AND rpm > 500", "AND OR NOT, also && || !"),
    ("kind IN ('speed', 'position')", "one of these words"),
    ("malformed OR noise", "a word alone: a kind, status or fault"),
    ("faults = 'noise'", "among the row's faults; IN: any of them"),
    ("faults IS NULL", "no fault at all"),
    ("error = 0x0F OR online & 0x01 = 0", "hex and single bits"),
    ("raw LIKE 'AA 01%'", "% any bytes, _ any digit; spaces are free"),
    ("time >= '2026-01-31T12:00:00Z'", "UTC, or with a zone as +08:00"),
    ("time > '12:00:05'", "a time of day, UTC, on any day"),
    ("rpm BETWEEN -10 AND 10", "both ends included; never rows without rpm"),
    ("kind IS DISTINCT FROM 'speed'", "any other, also rows that have no kind"),
)
"""Filters that work, and what each shows."""

FILTER_HELP: Final = "\n".join(_help())
"""The language on one screen, for `--help` and the filter field."""
