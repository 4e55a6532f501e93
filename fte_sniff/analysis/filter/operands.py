"""Literals, byte patterns, arithmetic."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.lexer import complaint
from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    FUNCTIONS,
    INT64,
    UNTYPED,
    BooleanTerms,
    FilterErrors,
    Term,
    TermType,
    nearest,
    quoted,
)
from fte_sniff.analysis.time_text import DAY_NS, SECOND_NS, clock_time, time_ns
from fte_sniff.errors import FilterError, TranslatableText
from fte_sniff.protocol import Column, ColumnType

_BYTES = re.compile(r"%*(?:[0-9A-F_]{2}%*)*")


def is_of_whole_bytes(pattern: str) -> bool:
    """Whether the digits of a pattern, which has no spaces, are two a byte."""
    return _BYTES.fullmatch(pattern) is not None


def whole_bytes(pattern: str) -> tuple[str, str]:
    """The sign and the text by which SQL asks for a pattern of whole bytes.

    Rows are of whole bytes too: where all stands at their ends, LIKE cannot slip by half a one.
    """
    parts = re.split("%+", pattern)
    if not any(parts[1:-1]):
        return "LIKE", pattern
    return "~", f"^{'(?:..)*'.join(parts).replace('_', '.')}$"


HOW_TO_WRITE_TIMES: Final = TranslatableText(
    "write UTC as '2026-01-31T12:00:00.5Z' or '2026-01-31 12:00', or "
    "'12:00:05' for that time of any day"
)
"""The way out where a value is to be a time and is none."""

_YEAR_2000_NS: Final = 946_684_800 * SECOND_NS


class Values:
    """Reads the values of one filter by what they stand beside."""

    def __init__(self, text: str) -> None:
        self._complain = FilterErrors(text)

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
                    TranslatableText(
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
                TranslatableText("unknown name '{term}'", term=name.shown),
                TranslatableText("a text stands in quotes: '{name}'", name=name.shown),
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
                TranslatableText("several faults in one text"),
                TranslatableText("ask for each: {example}", example=_example_of_two(word)),
            )
        other = COLUMN_OF_WORD.get(word)
        hint = (
            TranslatableText(
                "it is a word of {other}: {other} = '{word}'", other=other.name, word=word
            )
            if other
            else ""
        )
        raise self._complain.about(
            right,
            TranslatableText("{column} is never '{right}'", column=column.name, right=right.shown),
            (
                hint
                or nearest(word, column.words)
                or TranslatableText("it is one of {words}", words=", ".join(column.words))
            ),
        )

    def _time(self, literal: Term) -> str:
        found = time_ns(literal.shown)
        if found is None or found not in INT64:
            raise self._complain.about(
                literal,
                TranslatableText("'{literal}' is no time", literal=literal.shown),
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
        raise self._complain.other_type(term, TranslatableText("{sign} wants a text", sign=wanting))

    def hex_digits(self, literal: Term, wild: str = "") -> str:
        """A text as upper-case hex without spaces; `wild` are other signs that may stand in it."""
        digits = "".join(literal.shown.split()).upper()
        if not set(digits) <= set("0123456789ABCDEF" + wild):
            raise self._complain.about(
                literal,
                TranslatableText("'{literal}' is not hex", literal=literal.shown),
                TranslatableText("write the bytes as in raw LIKE 'AA01%'"),
            )
        return digits

    def bytes_pattern(self, literal: Term) -> str:
        """A text as a pattern of whole bytes."""
        pattern = self.hex_digits(literal, "%_")
        if not is_of_whole_bytes(pattern):
            raise self._complain.about(
                literal,
                TranslatableText("'{literal}' has half a byte", literal=literal.shown),
                TranslatableText(
                    "write two digits a byte, _ for any digit, % for any bytes: '%A_ 01%'"
                ),
            )
        return pattern


def _value(sql: str) -> int | float | None:
    """What an expression without fields comes to; None where it is null."""
    found: int | float | None = pl.select(pl.sql_expr(sql)).item()
    return found


def _example_of_two(words: str) -> str:
    first, *rest = re.split(r"[\s,]+", words)
    return f"faults = '{first}' AND faults = '{rest[0] if rest else first}'"


_TERM_TYPE: Final = {
    ColumnType.TIME: TermType.TIME,
    ColumnType.TEXT: TermType.TEXT,
    ColumnType.WORD: TermType.WORD,
    ColumnType.WORDS: TermType.WORDS,
    ColumnType.INT: TermType.NUMBER,
    ColumnType.HEX: TermType.HEX,
}


class Expressions:
    """Makes the values of one filter; each method checks its terms and points at the one at fault.

    Raises:
        FilterError: from any method, with the place and the way out.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._complain = FilterErrors(text)
        self._join = BooleanTerms(text)
        self._values = Values(text)

    def column(self, column: Column, start: int) -> Term:
        """A field of the row."""
        sql = f'"{column.name}"'
        if column.type is ColumnType.TIME:
            sql = f"CAST({sql} AS BIGINT)"
        return Term(
            _TERM_TYPE[column.type],
            sql,
            start,
            column.name,
            column=column,
            names=frozenset([column.name]),
        )

    def number(self, value: int | float, start: int, shown: str) -> Term:
        """A number as typed; whole numbers have 64 bits."""
        term = Term(TermType.NUMBER, repr(value), start, shown)
        fits = value in INT64 if isinstance(value, int) else math.isfinite(value)
        if not fits:
            raise self._complain.about(
                term,
                TranslatableText("{shown} is too large", shown=shown),
                TranslatableText("no field has more than 64 bits"),
            )
        if isinstance(value, float) and "e" not in term.sql:
            return replace(term, sql=f"{term.sql}e0")
        return term

    def arithmetic(self, terms: Sequence[Term], signs: Sequence[str]) -> Term:
        """Numbers joined by + - * / % & |, all of one precedence, from the left.

        A quotient keeps its fraction; what is divided by 0 is null.
        """
        for term in terms:
            self._expect(
                term, TermType.NUMBER, TranslatableText("'{sign}' joins numbers", sign=signs[0])
            )
        first, *others = terms
        joined = [
            _divisor(term) if sign in ("/", "%") else term
            for sign, term in zip(signs, others, strict=True)
        ]
        tail = "".join(f" {sign} {term.sql}" for sign, term in zip(signs, joined, strict=True))
        return self._join.made(f"({first.sql}{tail})", (first, *joined), of_type=TermType.NUMBER)

    def minus(self, term: Term, start: int) -> Term:
        """The negative of a number."""
        self._expect(term, TermType.NUMBER, TranslatableText("'-' stands before a number"))
        made = self._join.made(f"(- {term.sql})", (term,), of_type=TermType.NUMBER)
        return replace(made, start=start, shown=f"-{term.shown}")

    def _expect(self, term: Term, wanted: TermType, why: str) -> None:
        if term.type is TermType.NAME:
            raise self._complain.unknown(term)
        if term.type is not wanted:
            raise self._complain.other_type(term, why)

    def called(self, name: str, arguments: Sequence[Term], start: int) -> Term:
        """One of `FUNCTIONS` of its arguments."""
        function = FUNCTIONS[name]
        if len(arguments) != len(function.takes):
            raise self._miscounted(name, len(arguments), start)
        of_bytes = arguments[0].type is TermType.HEX
        sqls = []
        for wanted, term in zip(function.takes, arguments, strict=True):
            if wanted is TermType.TEXT:
                sqls.append(self._values.as_text(term, name))
            elif wanted is TermType.LITERAL and of_bytes:
                self._expect(
                    term, wanted, TranslatableText("{name} wants a text in quotes", name=name)
                )
                sqls.append(quoted(self._values.hex_digits(term)))
            else:
                why = TranslatableText(
                    "{name} wants {wanted}", name=name, wanted=TranslatableText(wanted.value)
                )
                self._expect(term, wanted, why)
                sqls.append(term.sql)
        made = self._join.made(f"{name}({', '.join(sqls)})", arguments, of_type=function.gives)
        return replace(made, start=start, shown=f"{name}(...)")

    def _miscounted(self, name: str, found: int, start: int) -> FilterError:
        function = FUNCTIONS[name]
        count = len(function.takes)
        what = TranslatableText("{name} takes 1 value, here are {found}", name=name, found=found)
        if count > 1:
            what = TranslatableText(
                "{name} takes {count} values, here are {found}",
                name=name,
                count=count,
                found=found,
            )
        return complaint(
            self._text, start, what, TranslatableText("write {example}", example=function.example)
        )


def _divisor(term: Term) -> Term:
    """The term, null where it is 0: polars' infinity and NaN are greater than any number."""
    return replace(term, sql=f"NULLIF({term.sql}, 0)", depth=term.depth + 1)
