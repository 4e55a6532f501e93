"""Owns what a value in a filter stands for beside a field: a word, a time, hex, a plain text.

It must not know any sign of the language. A value that fits no row is a mistake, told where it
stands.
"""

from __future__ import annotations

import re
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.byte_patterns import is_of_whole_bytes
from fte_sniff.analysis.filter.complaints import Complaints, nearest
from fte_sniff.analysis.filter.moments import DAY_NS, SECOND_NS, clock_time, time_ns
from fte_sniff.analysis.filter.terms import COLUMN_OF_WORD, INT64, UNTYPED, Term, TermType, quoted
from fte_sniff.errors import Said
from fte_sniff.protocol import ColumnType

HOW_TO_WRITE_TIMES: Final = Said(
    "write UTC as '2026-01-31T12:00:00.5Z' or '2026-01-31 12:00', or "
    "'12:00:05' for that time of any day"
)
"""The way out where a value is to be a time and is none."""

_YEAR_2000_NS: Final = 946_684_800 * SECOND_NS


class Values:
    """Reads the values of one filter by what they stand beside."""

    def __init__(self, text: str) -> None:
        self._complain = Complaints(text)

    def sides(self, left: Term, right: Term) -> tuple[str, str]:
        """The SQL of both where they stand beside each other.

        A time of day is asked of what is left of a time without its day.
        """
        clock = self.clock(left, right)
        if clock is not None:
            return f"({left.sql} % {DAY_NS})", str(clock)
        return left.sql, self.fitted(left, right)

    def clock(self, left: Term, right: Term) -> int | None:
        """The time of day that `right` says beside a time; None where it says none."""
        if left.type is not TermType.TIME or right.type is not TermType.LITERAL:
            return None
        clock = clock_time(right.shown)
        return None if clock is None else clock.since_midnight_ns

    def fitted(self, left: Term, right: Term) -> str:
        """The SQL of `right` where it stands beside `left`."""
        self._refuse_long_ago(left, right)
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
            raise self._complain.mismatch(left, right)
        if left.type is TermType.TIME:
            return self._time(right)
        if left.type is TermType.HEX:
            return quoted(self.hex_digits(right))
        if left.type is TermType.TEXT:
            return right.sql
        raise self._complain.mismatch(left, right)

    def _refuse_long_ago(self, left: Term, right: Term) -> None:
        """A number beside a time counts nanoseconds since 1970; a small one means something else.

        Who means such a time can still write it with its date.
        """
        for time, number in ((left, right), (right, left)):
            if time.type is not TermType.TIME or number.type is not TermType.NUMBER:
                continue
            value = None if number.names else _value(number.sql)
            if value is not None and value < _YEAR_2000_NS:
                raise self._complain.about(
                    number,
                    Said(
                        "{number} would be a time before the year 2000: "
                        "a number counts nanoseconds since 1970",
                        number=number.shown,
                    ),
                    HOW_TO_WRITE_TIMES,
                )

    def _refuse_name(self, left: Term, name: Term) -> None:
        if left.type in (TermType.TEXT, TermType.HEX):
            raise self._complain.about(
                name,
                Said("unknown name '{term}'", term=name.shown),
                Said("a text stands in quotes: '{name}'", name=name.shown),
            )
        if name.shown.lower() in COLUMN_OF_WORD:
            raise self._complain.mismatch(left, name)
        raise self._complain.unknown(name)

    def word(self, left: Term, right: Term) -> str:
        """The SQL of a word where it stands beside a column that has words."""
        column = left.column
        if column is None or right.type not in UNTYPED:
            raise self._complain.mismatch(left, right)
        word = right.shown.strip().lower()
        if word in column.words:
            return quoted(word)
        if column.type is ColumnType.WORDS and {*re.split(r"[\s,]+", word)} <= {*column.words}:
            raise self._complain.about(
                right,
                Said("several faults in one text"),
                Said("ask for each: {example}", example=_example_of_two(word)),
            )
        other = COLUMN_OF_WORD.get(word)
        hint = (
            Said("it is a word of {other}: {other} = '{word}'", other=other.name, word=word)
            if other
            else ""
        )
        raise self._complain.about(
            right,
            Said("{column} is never '{right}'", column=column.name, right=right.shown),
            (
                hint
                or nearest(word, column.words)
                or Said("it is one of {words}", words=", ".join(column.words))
            ),
        )

    def _time(self, literal: Term) -> str:
        found = time_ns(literal.shown)
        if found is None or found not in INT64:
            raise self._complain.about(
                literal,
                Said("'{literal}' is no time", literal=literal.shown),
                HOW_TO_WRITE_TIMES,
            )
        return f"({found})" if found < 0 else str(found)

    def as_text(self, term: Term, wanting: str) -> str:
        """The SQL of a term as a text; `wanting` is what wants one."""
        if term.type is TermType.NAME:
            raise self._complain.unknown(term)
        if term.type is TermType.WORDS:
            return f"array_to_string({term.sql}, ',')"
        if term.type is TermType.WORD:
            return f"CAST({term.sql} AS VARCHAR)"
        if term.type in (TermType.TEXT, TermType.HEX):
            return term.sql
        raise self._complain.other_type(term, Said("{sign} wants a text", sign=wanting))

    def hex_digits(self, literal: Term, wild: str = "") -> str:
        """A text as upper-case hex without spaces; `wild` are other signs that may stand in it."""
        digits = "".join(literal.shown.split()).upper()
        if not set(digits) <= set("0123456789ABCDEF" + wild):
            raise self._complain.about(
                literal,
                Said("'{literal}' is not hex", literal=literal.shown),
                Said("write the bytes as in raw LIKE 'AA01%'"),
            )
        return digits

    def bytes_pattern(self, literal: Term) -> str:
        """A text as a pattern of whole bytes."""
        pattern = self.hex_digits(literal, "%_")
        if not is_of_whole_bytes(pattern):
            raise self._complain.about(
                literal,
                Said("'{literal}' has half a byte", literal=literal.shown),
                Said("write two digits a byte, _ for any digit, % for any bytes: '%A_ 01%'"),
            )
        return pattern


def _value(sql: str) -> int | float | None:
    """What an expression without fields comes to; None where it is null."""
    found: int | float | None = pl.select(pl.sql_expr(sql)).item()
    return found


def _example_of_two(words: str) -> str:
    first, *rest = re.split(r"[\s,]+", words)
    return f"faults = '{first}' AND faults = '{rest[0] if rest else first}'"
