"""Owns what the parts of a filter mean together: which may be joined, and to what SQL.

It must not know in what order the parts were written, nor any row. Joining terms checks that they
fit, so that a mistake is told where it stands instead of silently giving no rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.byte_patterns import whole_bytes
from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    FUNCTIONS,
    INT64,
    UNTYPED,
    Term,
    TermType,
    how_to_ask,
    quoted,
)
from fte_sniff.analysis.filter.tokens import complaint
from fte_sniff.analysis.filter.values import Values
from fte_sniff.errors import FilterError
from fte_sniff.protocol import Column, ColumnType
from fte_sniff.said import Said

MAX_DEPTH: Final = 18
"""Brackets inside brackets in the SQL; polars' parser gives up at 23."""

MAX_SQL: Final = 30_000
"""Characters of SQL; a list of many values asked of a long expression grows fast."""

_TERM_TYPE: Final = {
    ColumnType.TIME: TermType.TIME,
    ColumnType.TEXT: TermType.TEXT,
    ColumnType.WORD: TermType.WORD,
    ColumnType.WORDS: TermType.WORDS,
    ColumnType.INT: TermType.NUMBER,
    ColumnType.HEX: TermType.HEX,
}

_WIDTH: Final = 8
"""Conditions side by side before they are bracketed: polars' time grows with the square of more."""

_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}


class Meaning:
    """Joins terms of one filter; each method checks its terms and points at the one at fault."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._values = Values(text)

    # Leaves

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
        term = Term(TermType.NUMBER, str(value), start, shown)
        if isinstance(value, int):
            if value not in INT64:
                raise self._values.error(
                    term,
                    Said("{shown} is too large", shown=shown),
                    Said("no field has more than 64 bits"),
                )
            return term
        if not math.isfinite(value):
            raise self._values.error(
                term,
                Said("{shown} is too large", shown=shown),
                Said("no field has more than 64 bits"),
            )
        return replace(term, sql=repr(value) if "e" in repr(value) else f"{value!r}e0")

    # Truth

    def truth(self, term: Term) -> Term:
        """The term as a condition: one itself, or a word such as `noise` or `malformed`."""
        if term.type is TermType.TRUTH:
            return term
        if term.type is TermType.NAME:
            return self._bare_word(term)
        raise self._values.error(
            term,
            Said("{term} is {type}, no condition", term=term.shown, type=Said(term.type.value)),
            how_to_ask(term),
        )

    def _bare_word(self, term: Term) -> Term:
        column = COLUMN_OF_WORD.get(term.shown.lower())
        if column is None:
            raise self._values.unknown(term)
        word = term.shown.lower()
        if column.type is ColumnType.WORDS:
            sql = f"array_contains(\"{column.name}\", '{word}')"
        else:
            sql = f"(\"{column.name}\" IS NOT DISTINCT FROM '{word}')"
        return self._made(sql, (term,), frozenset([column.name]))

    def negated(self, term: Term) -> Term:
        """NOT."""
        truth = self.truth(term)
        return self._made(f"(NOT {truth.sql})", (truth,))

    def chain(self, terms: Sequence[Term], joint: str) -> Term:
        """Conditions joined by AND or OR; many of them in groups of groups."""
        parts = [self.truth(term) for term in terms]
        while len(parts) > 1:
            groups = (parts[at : at + _WIDTH] for at in range(0, len(parts), _WIDTH))
            parts = [self._group(group, joint) for group in groups]
        return parts[0]

    def _group(self, terms: Sequence[Term], joint: str) -> Term:
        if len(terms) == 1:
            return terms[0]
        return self._made(f"({f' {joint} '.join(term.sql for term in terms)})", terms)

    # Numbers

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
        return self._made(f"({first.sql}{tail})", (first, *joined), of_type=TermType.NUMBER)

    def minus(self, term: Term, start: int) -> Term:
        """The negative of a number."""
        self._expect(term, TermType.NUMBER, Said("'-' stands before a number"))
        made = self._made(f"(- {term.sql})", (term,), of_type=TermType.NUMBER)
        return replace(made, start=start, shown=f"-{term.shown}")

    def _expect(self, term: Term, wanted: TermType, why: str) -> None:
        if term.type is TermType.NAME:
            raise self._values.unknown(term)
        if term.type is not wanted:
            raise self._of_another_type(term, why)

    def _of_another_type(self, term: Term, why: str) -> FilterError:
        told = Said(
            "{why}, and {term} is {type}",
            why=why,
            term=term.shown,
            type=Said(term.type.value),
        )
        return self._values.error(term, told, how_to_ask(term))

    # Comparisons

    def compared(self, left: Term, sign: str, right: Term) -> Term:
        """`left sign right`, one of = != < > <= >=."""
        if left.type in UNTYPED or (left.column is None and right.column is not None):
            left, right, sign = right, left, _MIRRORED.get(sign, sign)
        if TermType.NULL in (left.type, right.type):
            null = left if left.type is TermType.NULL else right
            raise self._values.error(
                null, Said("nothing equals NULL"), Said("write IS NULL or IS NOT NULL")
            )
        if left.type is TermType.WORDS:
            return self._has(left, sign, right)
        if left.type is TermType.TRUTH:
            right = self.truth(right)
        if left.type in (TermType.WORD, TermType.TRUTH) and sign not in ("=", "!="):
            raise self._values.error(
                left,
                Said("{left} has no order", left=left.shown),
                Said("ask with =, !=, IN or LIKE instead"),
            )
        asked, value = self._values.sides(left, right)
        return self._made(f"({asked} {sign} {value})", (left, right))

    def distinct(self, left: Term, right: Term, joint: str) -> Term:
        """`left IS [NOT] DISTINCT FROM right`: as != and =, but never null."""
        if left.type in (*UNTYPED, TermType.NULL):
            left, right = right, left
        if left.type is TermType.TRUTH:
            right = self.truth(right)
        if left.type is TermType.WORDS:
            return self._has(left, "=" if "NOT" in joint else "!=", right)
        asked, value = left.sql, "NULL"
        if right.type is not TermType.NULL:
            asked, value = self._values.sides(left, right)
        return self._made(f"({asked} {joint} {value})", (left, right))

    def among(self, left: Term, items: Sequence[Term]) -> Term:
        """`left IN (items)`; of faults: any of them."""
        equal = [self.compared(left, "=", item) for item in items]
        plain = left.column is not None and left.type not in (TermType.WORDS, TermType.TIME)
        if not plain or any(item.names for item in items):
            return self.chain(equal, "OR")
        values = ", ".join(self._values.fitted(left, item) for item in items)
        return self._made(f"({left.sql} IN ({values}))", (left, *items))

    def between(self, left: Term, low: Term, high: Term) -> Term:
        """`left BETWEEN low AND high`, both ends included."""
        first, last = self._values.clock(left, low), self._values.clock(left, high)
        if first is not None and last is not None and first > last:
            raise self._values.error(
                low,
                Said("'{low}' is later in the day than '{high}'", low=low.shown, high=high.shown),
                Said(
                    "over midnight write {left} >= '{low}' OR {left} <= '{high}'",
                    left=left.shown,
                    low=low.shown,
                    high=high.shown,
                ),
            )
        ends = [self.compared(left, ">=", low), self.compared(left, "<=", high)]
        return self.chain(ends, "AND")

    def is_null(self, left: Term) -> Term:
        """`left IS NULL`; of faults: there are none."""
        if left.type in UNTYPED:
            left = self.truth(left)
        if left.type is TermType.WORDS:
            return self._made(f"(array_length({left.sql}) = 0)", (left,))
        return self._made(f"({left.sql} IS NULL)", (left,))

    def is_truth(self, left: Term, word: str) -> Term:
        """`left IS TRUE` or `left IS FALSE`, never null."""
        truth = self.truth(left)
        other = "FALSE" if word == "TRUE" else "TRUE"
        found = self._made(f"coalesce({truth.sql}, {other})", (truth,))
        return found if word == "TRUE" else self.negated(found)

    def _has(self, faults: Term, sign: str, right: Term) -> Term:
        if sign not in ("=", "!="):
            raise self._values.error(
                faults,
                Said("{faults} has no order", faults=faults.shown),
                Said("ask for one, as in faults = 'noise'"),
            )
        if right.type is TermType.LITERAL and not right.shown:
            found = self.is_null(faults)
        else:
            word = self._values.word(faults, right)
            found = self._made(f"array_contains({faults.sql}, {word})", (faults,))
        return self.negated(found) if sign == "!=" else found

    # Texts

    def like(self, left: Term, sign: str, pattern: Term) -> Term:
        """`left LIKE pattern` (or ILIKE): % is any text, _ any one character.

        Of bytes % is any whole ones and _ any one hex digit.
        """
        text = self._as_text(left, sign)
        self._expect_pattern(pattern, sign)
        sql = pattern.sql
        if left.type is TermType.HEX:
            sign, found = whole_bytes(self._values.bytes_pattern(pattern))
            sql = quoted(found)
        return self._made(f"({text} {sign} {sql})", (left, pattern))

    def regexp(self, left: Term, pattern: Term) -> Term:
        """`left ~ pattern` (or REGEXP, RLIKE): a regular expression that matches anywhere."""
        text = self._as_text(left, "~")
        self._expect_pattern(pattern, "~")
        found = f"(?i){pattern.shown}" if left.type is TermType.HEX else pattern.shown
        try:
            pl.Series([""]).str.contains(found)
        except pl.exceptions.PolarsError as error:
            why = str(error).split("error: ")[-1].splitlines()[0]
            raise self._values.error(
                pattern,
                Said("no regular expression ({why})", why=why),
                Said("use LIKE, or escape signs with \\"),
            ) from None
        return self._made(f"({text} ~ {quoted(found)})", (left, pattern))

    def _expect_pattern(self, pattern: Term, sign: str) -> None:
        if pattern.type is not TermType.LITERAL:
            raise self._values.error(
                pattern,
                Said("{sign} wants a pattern in quotes", sign=sign),
                Said("as in port {sign} '%USB%'", sign=sign),
            )

    def _as_text(self, term: Term, sign: str) -> str:
        if term.type is TermType.NAME:
            raise self._values.unknown(term)
        if term.type is TermType.WORDS:
            return f"array_to_string({term.sql}, ',')"
        if term.type is TermType.WORD:
            return f"CAST({term.sql} AS VARCHAR)"
        if term.type in (TermType.TEXT, TermType.HEX):
            return term.sql
        raise self._of_another_type(term, Said("{sign} wants a text", sign=sign))

    def called(self, name: str, arguments: Sequence[Term], start: int) -> Term:
        """One of `FUNCTIONS` of its arguments."""
        function = FUNCTIONS[name]
        if len(arguments) != len(function.takes):
            count = len(function.takes)
            what = Said("{name} takes 1 value, here are {found}", name=name, found=len(arguments))
            if count > 1:
                what = Said(
                    "{name} takes {count} values, here are {found}",
                    name=name,
                    count=count,
                    found=len(arguments),
                )
            raise complaint(
                self._text, start, what, Said("write {example}", example=function.example)
            )
        sqls = []
        for wanted, term in zip(function.takes, arguments, strict=True):
            if wanted is TermType.TEXT:
                sqls.append(self._as_text(term, name))
            elif wanted is TermType.LITERAL and arguments[0].type is TermType.HEX:
                self._expect(term, wanted, Said("{name} wants a text in quotes", name=name))
                sqls.append(quoted(self._values.hex_digits(term)))
            else:
                self._expect(
                    term,
                    wanted,
                    Said("{name} wants {wanted}", name=name, wanted=Said(wanted.value)),
                )
                sqls.append(term.sql)
        made = self._made(f"{name}({', '.join(sqls)})", arguments, of_type=function.gives)
        return replace(made, start=start, shown=f"{name}(...)")

    def _made(
        self,
        sql: str,
        terms: Iterable[Term],
        names: frozenset[str] = frozenset(),
        of_type: TermType = TermType.TRUTH,
    ) -> Term:
        parts = tuple(terms)
        depth = 1 + max(term.depth for term in parts)
        first = min(parts, key=lambda term: term.start)
        if depth > MAX_DEPTH or len(sql) > MAX_SQL:
            raise self._values.error(
                first, Said("the filter is too deep or too large"), Said("take it apart")
            )
        return Term(
            of_type,
            sql,
            first.start,
            Said("this condition") if of_type is TermType.TRUTH else Said("this value"),
            depth,
            names=names.union(*(term.names for term in parts)),
        )


def _divisor(term: Term) -> Term:
    """The term, null where it is 0: polars' infinity and NaN are greater than any number."""
    return replace(term, sql=f"NULLIF({term.sql}, 0)", depth=term.depth + 1)
