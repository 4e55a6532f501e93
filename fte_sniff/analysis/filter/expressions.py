"""Owns what values in a filter are made of: fields, numbers, arithmetic, functions.

It must not know what is asked of a value (`predicates` does), nor in what order the parts were
written. Joining checks that the parts fit, so that a mistake is told where it stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from fte_sniff.analysis.filter.complaints import Complaints
from fte_sniff.analysis.filter.joining import Joining
from fte_sniff.analysis.filter.terms import FUNCTIONS, INT64, Term, TermType, quoted
from fte_sniff.analysis.filter.tokens import complaint
from fte_sniff.analysis.filter.values import Values
from fte_sniff.errors import FilterError, Said
from fte_sniff.protocol import Column, ColumnType

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
        self._complain = Complaints(text)
        self._join = Joining(text)
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
                Said("{shown} is too large", shown=shown),
                Said("no field has more than 64 bits"),
            )
        if isinstance(value, float) and "e" not in term.sql:
            return replace(term, sql=f"{term.sql}e0")
        return term

    def arithmetic(self, terms: Sequence[Term], signs: Sequence[str]) -> Term:
        """Numbers joined by + - * / % & |, all of one precedence, from the left.

        A quotient keeps its fraction; what is divided by 0 is null.
        """
        for term in terms:
            self._expect(term, TermType.NUMBER, Said("'{sign}' joins numbers", sign=signs[0]))
        first, *others = terms
        joined = [
            _divisor(term) if sign in ("/", "%") else term
            for sign, term in zip(signs, others, strict=True)
        ]
        tail = "".join(f" {sign} {term.sql}" for sign, term in zip(signs, joined, strict=True))
        return self._join.made(f"({first.sql}{tail})", (first, *joined), of_type=TermType.NUMBER)

    def minus(self, term: Term, start: int) -> Term:
        """The negative of a number."""
        self._expect(term, TermType.NUMBER, Said("'-' stands before a number"))
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
                self._expect(term, wanted, Said("{name} wants a text in quotes", name=name))
                sqls.append(quoted(self._values.hex_digits(term)))
            else:
                why = Said("{name} wants {wanted}", name=name, wanted=Said(wanted.value))
                self._expect(term, wanted, why)
                sqls.append(term.sql)
        made = self._join.made(f"{name}({', '.join(sqls)})", arguments, of_type=function.gives)
        return replace(made, start=start, shown=f"{name}(...)")

    def _miscounted(self, name: str, found: int, start: int) -> FilterError:
        function = FUNCTIONS[name]
        count = len(function.takes)
        what = Said("{name} takes 1 value, here are {found}", name=name, found=found)
        if count > 1:
            what = Said(
                "{name} takes {count} values, here are {found}",
                name=name,
                count=count,
                found=found,
            )
        return complaint(self._text, start, what, Said("write {example}", example=function.example))


def _divisor(term: Term) -> Term:
    """The term, null where it is 0: polars' infinity and NaN are greater than any number."""
    return replace(term, sql=f"NULLIF({term.sql}, 0)", depth=term.depth + 1)
