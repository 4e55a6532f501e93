"""Owns what a value in a filter stands for beside a field: a word, a time, hex, a plain text.

It must not know any sign of the language. A value that fits no row is a mistake, told where it
stands.
"""

from __future__ import annotations

import math
import re
from datetime import datetime
from typing import Final

from fte_sniff.analysis.filter_terms import (
    COLUMN_OF_WORD,
    INT64,
    UNTYPED,
    Term,
    TermType,
    how_to_ask,
    nearest,
    quoted,
)
from fte_sniff.analysis.filter_tokens import complaint
from fte_sniff.errors import FilterError
from fte_sniff.protocol import COLUMN_BY_NAME, ColumnType


class Values:
    """Reads the values of one filter by what they stand beside."""

    def __init__(self, text: str) -> None:
        self._text = text

    def error(self, term: Term, what: str, way_out: str = "") -> FilterError:
        """A complaint about a term."""
        return complaint(self._text, term.start, what, way_out)

    def unknown(self, term: Term) -> FilterError:
        """A complaint about a name that nothing has."""
        choices = [*COLUMN_BY_NAME, *COLUMN_OF_WORD]
        return self.error(
            term,
            f"unknown name '{term.shown}'",
            nearest(term.shown, choices) or f"the fields are {', '.join(COLUMN_BY_NAME)}",
        )

    def fitted(self, left: Term, right: Term) -> str:
        """The SQL of `right` where it stands beside `left`."""
        if left.type is TermType.WORD:
            return self.word(left, right)
        if right.type is TermType.NAME:
            self._refuse_name(left, right)
        if right.type is not TermType.LITERAL:
            if right.type is left.type or {left.type, right.type} == {
                TermType.TIME,
                TermType.NUMBER,
            }:
                return right.sql
            raise self._mismatch(left, right)
        if left.type is TermType.TIME:
            return self._time(right)
        if left.type is TermType.HEX:
            return quoted(self.hex_digits(right))
        if left.type is TermType.TEXT:
            return right.sql
        raise self._mismatch(left, right)

    def _refuse_name(self, left: Term, name: Term) -> None:
        if left.type in (TermType.TEXT, TermType.HEX):
            raise self.error(
                name, f"unknown name '{name.shown}'", f"a text stands in quotes: '{name.shown}'"
            )
        if name.shown.lower() in COLUMN_OF_WORD:
            raise self._mismatch(left, name)
        raise self.unknown(name)

    def _mismatch(self, left: Term, right: Term) -> FilterError:
        if left.type in UNTYPED and right.type in UNTYPED:
            return self.error(
                left, "two texts are compared", "a field's name stands without single quotes"
            )
        if left.column is None and right.type is TermType.LITERAL:
            near = nearest(right.shown, COLUMN_BY_NAME) or "name a field"
            return self.error(right, f"'{right.shown}' is a text, no field", f"{near} (no quotes)")
        what = f"{left.shown} is {left.type.value}, {right.shown} is {right.type.value}"
        if left.type is TermType.NUMBER and right.type is TermType.LITERAL:
            return self.error(right, what, "write a number, without quotes")
        if left.type is TermType.HEX and right.type is TermType.NUMBER:
            return self.error(right, what, "write the bytes as a text, as in raw LIKE 'AA01%'")
        return self.error(right, what, how_to_ask(left))

    def word(self, left: Term, right: Term) -> str:
        """The SQL of a word where it stands beside a column that has words."""
        column = left.column
        if column is None or right.type not in UNTYPED:
            raise self._mismatch(left, right)
        word = right.shown.strip().lower()
        if word in column.words:
            return quoted(word)
        if column.type is ColumnType.WORDS and {*re.split(r"[\s,]+", word)} <= {*column.words}:
            raise self.error(
                right, "several faults in one text", f"ask for each: {_example_of_two(word)}"
            )
        other = COLUMN_OF_WORD.get(word)
        hint = f"it is a word of {other.name}: {other.name} = '{word}'" if other else ""
        raise self.error(
            right,
            f"{column.name} is never '{right.shown}'",
            hint or nearest(word, column.words) or f"it is one of {', '.join(column.words)}",
        )

    def _time(self, literal: Term) -> str:
        found = time_ns(literal.shown)
        if found is None or found not in INT64:
            raise self.error(
                literal,
                f"'{literal.shown}' is no time",
                "write UTC as '2026-01-31', '2026-01-31 12:00' or '2026-01-31T12:00:00.5Z'",
            )
        return f"({found})" if found < 0 else str(found)

    def hex_digits(self, literal: Term, wild: str = "") -> str:
        """A text as upper-case hex without spaces; `wild` are other signs that may stand in it."""
        digits = "".join(literal.shown.split()).upper()
        if not set(digits) <= set("0123456789ABCDEF" + wild):
            raise self.error(
                literal, f"'{literal.shown}' is not hex", "write the bytes as in raw LIKE 'AA01%'"
            )
        return digits


_ISO_TIME: Final = re.compile(
    r"([0-9]{4}-[0-9]{2}-[0-9]{2})"
    r"(?:[T ]([0-9]{2}:[0-9]{2}(?::[0-9]{2})?)(?:\.([0-9]{1,9}))?\ ?(Z|[+-][0-9]{2}:?[0-9]{2})?)?"
)


def time_ns(text: str) -> int | None:
    """An ISO 8601 time as nanoseconds since 1970 UTC; without a zone it is UTC; None if it is none.

    A date alone is its midnight; up to nine digits of a second are read.
    """
    match = _ISO_TIME.fullmatch(text.strip())
    if match is None:
        return None
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone or 'Z'}")
    except ValueError:
        return None
    return math.floor(moment.timestamp()) * 1_000_000_000 + int((fraction or "0").ljust(9, "0"))


def _example_of_two(words: str) -> str:
    first, *rest = re.split(r"[\s,]+", words)
    return f"faults = '{first}' AND faults = '{rest[0] if rest else first}'"
