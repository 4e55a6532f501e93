"""Terms, functions, error messages and help text of the filter language; filters of cells."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.errors import FilterError, TranslatableText, listed, printable
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    COLUMNS,
    KINDS,
    Column,
    Row,
    Value,
    iso_time,
    record,
)
from fte_sniff.protocol.columns import PREVIOUS, RANKED
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role

if TYPE_CHECKING:
    import polars as pl


class TermType(Enum):
    """Type of a term; the value is its name in messages."""

    NUMBER = "a number"
    TEXT = "a text"
    WORD = "a word"
    WORDS = "a list of words"
    TIME = "a time"
    HEX = "hex digits"
    TRUTH = "a condition"
    LITERAL = "a text in quotes"
    """Its type comes from what it is compared with."""
    NAME = "a name"
    """Not a field: a word of the contract, or a mistake."""
    NULL = "NULL"


@dataclass(frozen=True, slots=True)
class Term:
    """A part of a filter, with its type and position."""

    type: TermType
    start: int
    """Index of its first character in the filter."""
    label: str
    """The term in messages; of a LITERAL or NAME, its text."""
    expr: pl.Expr = field(compare=False)
    """The polars expression; of a LITERAL or NAME, that of its text."""
    column: Column | None = None
    """The column, if the term is just a field."""
    names: frozenset[str] = frozenset()
    """Columns that the expression reads."""
    constant: int | float | None = None
    """The value, if the term is just a number."""


UNTYPED: Final = (TermType.LITERAL, TermType.NAME)
"""Types of terms whose type comes from what they are compared with."""

COLUMN_OF_WORD: Final = {word: column for column in COLUMNS for word in column.words}


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the language: argument types, result type, and an example."""

    takes: tuple[TermType, ...]
    gives: TermType
    expression: Callable[..., Any]
    """Makes the polars expression from those of the arguments."""
    example: str
    meaning: str = "a function"
    of_field: bool = False
    """Whether its argument is the name of a field of a frame."""


def _column_expression(name: str) -> pl.Expr:
    import polars as pl

    return pl.col(name)


FUNCTIONS: Final = {
    "abs": Function(
        (TermType.NUMBER,),
        TermType.NUMBER,
        lambda number: number.abs(),
        "abs(rpm) > 500",
        "without the sign",
    ),
    "coalesce": Function(
        (TermType.NUMBER, TermType.NUMBER),
        TermType.NUMBER,
        lambda first, second: first.fill_null(second),
        "coalesce(rpm, 0) < 10",
        "the second value where the first is null",
    ),
    "lower": Function(
        (TermType.TEXT,),
        TermType.TEXT,
        lambda text: text.str.to_lowercase(),
        "lower(port) LIKE '%usb%'",
        "in lower case",
    ),
    "upper": Function(
        (TermType.TEXT,),
        TermType.TEXT,
        lambda text: text.str.to_uppercase(),
        "upper(port) LIKE '%USB%'",
        "in upper case",
    ),
    "previous": Function(
        (TermType.NUMBER,),
        TermType.NUMBER,
        lambda field: _column_expression(PREVIOUS[field.meta.output_name()].name),
        "abs(rpm - previous(rpm)) > 500",
        "value in the motor's frame before",
        of_field=True,
    ),
}
"""The functions of the language by name."""


def quoted(text: str) -> str:
    """The text as a literal of a filter."""
    return "'" + text.replace("'", "''") + "'"


_EXCERPT: Final = 24
_LONGEST: Final = 200


class MistakeError(Exception):
    """What is wrong at an index of a filter, and what to write instead; both can be translated."""

    def __init__(self, at: int, what: str, fix: str = "") -> None:
        super().__init__(at, what, fix)
        self.at, self.what, self.fix = at, what, fix

    def error(self, text: str) -> FilterError:
        """The error for the user, who typed this text."""
        where = TranslatableText(
            'filter: {what} at character {number} of "{excerpt}"',
            what=_short(self.what),
            number=self.at + 1,
            excerpt=excerpt(text, self.at),
        )
        if not self.fix:
            return FilterError(where)
        return FilterError("{where}; {fix}", where=where, fix=_short(self.fix))


@contextmanager
def mistakes_in(text: str) -> Iterator[None]:
    """Context that raises a mistake in a filter as FilterError."""
    try:
        yield
    except MistakeError as mistake:
        raise mistake.error(text) from None


def excerpt(text: str, at: int) -> str:
    """The text around an index, which an arrow marks."""
    before = text[max(0, at - _EXCERPT) : at]
    after = text[at : at + _EXCERPT]
    start = "..." if at > _EXCERPT else ""
    end = "..." if at + _EXCERPT < len(text) else ""
    return f"{start}{printable(before)}-->{printable(after)}{end}"


def _short(text: str) -> str:
    line = printable(text)
    if len(line) > _LONGEST:
        return f"{line[:_LONGEST]}..."
    return text if line == text else line


def unknown(term: Term) -> MistakeError:
    """The name is neither a field nor a word."""
    what = TranslatableText("unknown name '{term}'", term=term.label)
    fields = TranslatableText("the fields are {names}", names=listed(COLUMN_BY_NAME))
    return MistakeError(
        term.start, what, nearest(term.label, [*COLUMN_BY_NAME, *COLUMN_OF_WORD]) or fields
    )


def wrong_type(term: Term, why: str) -> MistakeError:
    """The term has the wrong type; `why` names the type that is needed, and where."""
    what = TranslatableText(
        "{why}, and {term} is {type}",
        why=why,
        term=term.label,
        type=TranslatableText(term.type.value),
    )
    return MistakeError(term.start, what, how_to_compare(term))


def mismatch(left: Term, right: Term) -> MistakeError:
    """The types of two terms cannot be compared."""
    if left.type in UNTYPED and right.type in UNTYPED:
        what = TranslatableText("two texts are compared")
        fix: str = TranslatableText("write a field's name without single quotes")
        return MistakeError(left.start, what, fix)
    if left.column is None and right.type is TermType.LITERAL:
        near = nearest(right.label, COLUMN_BY_NAME) or TranslatableText("name a field")
        what = TranslatableText("'{right}' is a text, not a field", right=right.label)
        return MistakeError(right.start, what, TranslatableText("{near} (no quotes)", near=near))
    what = TranslatableText(
        "{left} is {left_is}, {right} is {right_is}",
        left=left.label,
        left_is=TranslatableText(left.type.value),
        right=right.label,
        right_is=TranslatableText(right.type.value),
    )
    fix = how_to_compare(left)
    if left.column is None and right.type is TermType.NAME:
        meant = _FIELD_OF_ROLE.get(right.label.lower())
        fix = TranslatableText("a name is a condition: write {name} alone", name=right.label)
        if meant:
            fix = TranslatableText("did you mean {near}?", near=meant)
    elif left.type is TermType.NUMBER and right.type is TermType.LITERAL:
        fix = TranslatableText("write a number, without quotes")
    elif left.type is TermType.HEX and right.type is TermType.NUMBER:
        fix = TranslatableText("write the bytes as a text, as in raw LIKE 'AA01%'")
    return MistakeError(right.start, what, fix)


_FIELD_OF_ROLE: Final = {str(role): name for role, name in NAME_OF_ROLE.items()}
"""What people call a field: `speed` is a kind of frame, and its field is `rpm`."""


def nearest(word: str, choices: Iterable[str]) -> str:
    """`did you mean x?`, or an empty text if no choice is similar.

    A role, such as `speed`, means the field of that role.
    """
    names, typed = list(choices), word.lower()
    near = (
        [name for name in names if name == _FIELD_OF_ROLE.get(typed)]
        or [name for name in names if len(word) > 1 and name.startswith(typed)]
        or [name for name in names if _abbreviates(typed, name)]
        or difflib.get_close_matches(typed, names, n=1)
    )
    return TranslatableText("did you mean {near}?", near=near[0]) if near else ""


def _abbreviates(text: str, name: str) -> bool:
    """Whether every word of the text leaves out letters of the name's word, as in `speed fb`."""
    words, parts = re.split(r"[\s_.-]+", text), name.split("_")
    return len(words) == len(parts) > 1 and all(
        re.fullmatch(".*".join(map(re.escape, word)) + ".*", part)
        for word, part in zip(words, parts, strict=True)
    )


def how_to_compare(term: Term) -> str:
    """Advice how to compare a term of that type."""
    name = term.label if term.column else NAME_OF_ROLE[Role.MOTOR]
    word = term.column.words[0] if term.column and term.column.words else KINDS[0].name
    return {
        TermType.NUMBER: TranslatableText("compare it, as in {name} = 1", name=name),
        TermType.TIME: TranslatableText("compare it, as in time > '2026-01-31T12:00:00Z'"),
        TermType.TEXT: TranslatableText("compare it, as in port LIKE '%USB%'"),
        TermType.HEX: TranslatableText("compare it, as in raw LIKE 'AA01%'"),
        TermType.WORDS: TranslatableText(
            "name one, as in faults = 'noise', or for any: faults IS NOT NULL"
        ),
        TermType.WORD: TranslatableText(
            "compare it, as in {name} = '{word}'", name=name, word=word
        ),
        TermType.LITERAL: TranslatableText("compare a field with it, as in kind = 'speed'"),
        TermType.NULL: TranslatableText("write IS NULL or IS NOT NULL"),
        TermType.TRUTH: TranslatableText("join conditions with AND or OR"),
        TermType.NAME: TranslatableText("compare it with a field"),
    }[term.type]


def _help() -> Iterator[str]:
    yield "A filter selects rows with an SQL expression: motor = 1 AND rpm > 500"
    yield ""
    yield "Fields"
    for column in COLUMNS:
        yield from _wrapped(f"  {column.name:<10} ", column.meaning)
        yield from _wrapped(" " * 13, ", ".join(column.words))
    yield ""
    yield "Examples"
    for example, meaning in EXAMPLES:
        yield f"  {example:<34} {meaning}"


def _wrapped(start: str, text: str) -> list[str]:
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
    *((function.example, function.meaning) for function in FUNCTIONS.values()),
)
"""Working filters, each with its meaning."""

FILTER_HELP: Final = "\n".join(_help())
"""The language on one screen, for `--help` and the filter prompt."""


_LOOSE = re.compile(r"\bOR\b|\|\|", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CellFilter:
    """The filters of one cell."""

    column: str
    only: str
    """Keeps the rows with the same value."""
    without: str
    """Keeps all other rows, also those without a value."""


def cell_filters(row: Row) -> list[CellFilter]:
    """The filters of all cells of a row, in the order of the screen's columns."""
    values = record(row)
    return [found for column in RANKED for found in _of_cell(column.name, values[column.name])]


def _of_cell(name: str, value: Value) -> Iterator[CellFilter]:
    if isinstance(value, list):
        words = [f"'{word}'" for word in value]
        if not words:
            yield CellFilter(name, f"{name} IS NULL", f"{name} IS NOT NULL")
        for word in words:
            yield CellFilter(name, f"{name} = {word}", f"{name} != {word}")
    elif value is None:
        if name == "kind":
            yield CellFilter(name, f"{name} IS NULL", f"{name} IS NOT NULL")
    elif name == "time" and isinstance(value, int):
        time = iso_time(value)
        yield CellFilter(name, f"{name} >= '{time}'", f"{name} < '{time}'")
    elif not isinstance(value, str) or value.isprintable():
        # A device's name may have undecodable bytes, which no filter can contain.
        literal = quoted(value) if isinstance(value, str) else f"{value}".upper()
        yield CellFilter(name, f"{name} = {literal}", f"{name} IS DISTINCT FROM {literal}")


def both(current: str, added: str) -> str:
    """The conjunction of two filters; the current one may be empty."""
    if not current or current == added:
        return added
    if _LOOSE.search(current):
        return f"({current}) AND {added}"
    return current if added in current.split(" AND ") else f"{current} AND {added}"
