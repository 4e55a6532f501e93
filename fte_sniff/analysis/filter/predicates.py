"""Comparisons to polars expressions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import polars as pl

from fte_sniff.analysis.filter.operands import Values, whole_bytes
from fte_sniff.analysis.filter.terms import (
    COLUMN_OF_WORD,
    UNTYPED,
    BooleanTerms,
    FilterErrors,
    Term,
    TermType,
    how_to_ask,
    quoted,
)
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import ColumnType

_MIRRORED: Final = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}


class Predicates:
    """Makes the conditions of one filter; each method points at the term at fault.

    Raises:
        FilterError: from any method, with the place and the way out.
    """

    def __init__(self, text: str) -> None:
        self._complain = FilterErrors(text)
        self._join = BooleanTerms(text)
        self._values = Values(text)

    # Truth

    def truth(self, term: Term) -> Term:
        """The term as a condition: one itself, or a word such as `noise` or `malformed`."""
        if term.type is TermType.TRUTH:
            return term
        if term.type is TermType.NAME:
            return self._bare_word(term)
        raise self._complain.about(
            term,
            TranslatableText(
                "{term} is {type}, no condition",
                term=term.shown,
                type=TranslatableText(term.type.value),
            ),
            how_to_ask(term),
        )

    def _bare_word(self, term: Term) -> Term:
        column = COLUMN_OF_WORD.get(term.shown.lower())
        if column is None:
            raise self._complain.unknown(term)
        word = term.shown.lower()
        if column.type is ColumnType.WORDS:
            sql = f"array_contains(\"{column.name}\", '{word}')"
        else:
            sql = f"(\"{column.name}\" IS NOT DISTINCT FROM '{word}')"
        return self._join.made(sql, (term,), frozenset([column.name]))

    def negated(self, term: Term) -> Term:
        """NOT."""
        truth = self.truth(term)
        return self._join.made(f"(NOT {truth.sql})", (truth,))

    def chain(self, terms: Sequence[Term], joint: str) -> Term:
        """Conditions joined by AND or OR."""
        return self._join.chained([self.truth(term) for term in terms], joint)

    # Comparisons

    def compared(self, left: Term, sign: str, right: Term) -> Term:
        """`left sign right`, one of = != < > <= >=."""
        if left.type in UNTYPED or (left.column is None and right.column is not None):
            left, right, sign = right, left, _MIRRORED.get(sign, sign)
        if TermType.NULL in (left.type, right.type):
            null = left if left.type is TermType.NULL else right
            raise self._complain.about(
                null,
                TranslatableText("nothing equals NULL"),
                TranslatableText("write IS NULL or IS NOT NULL"),
            )
        if left.type is TermType.WORDS:
            return self._has(left, sign, right)
        if left.type is TermType.TRUTH:
            right = self.truth(right)
        if left.type in (TermType.WORD, TermType.TRUTH) and sign not in ("=", "!="):
            raise self._complain.about(
                left,
                TranslatableText("{left} has no order", left=left.shown),
                TranslatableText("ask with =, !=, IN or LIKE instead"),
            )
        asked, value = self._values.sides(left, right)
        return self._join.made(f"({asked} {sign} {value})", (left, right))

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
        return self._join.made(f"({asked} {joint} {value})", (left, right))

    def among(self, left: Term, items: Sequence[Term]) -> Term:
        """`left IN (items)`; of faults: any of them."""
        equal = [self.compared(left, "=", item) for item in items]
        plain = left.column is not None and left.type not in (TermType.WORDS, TermType.TIME)
        if not plain or any(item.names for item in items):
            return self.chain(equal, "OR")
        values = ", ".join(self._values.fitted(left, item) for item in items)
        return self._join.made(f"({left.sql} IN ({values}))", (left, *items))

    def between(self, left: Term, low: Term, high: Term) -> Term:
        """`left BETWEEN low AND high`, both ends included."""
        first, last = self._values.clock(left, low), self._values.clock(left, high)
        if first is not None and last is not None and first > last:
            raise self._complain.about(
                low,
                TranslatableText(
                    "'{low}' is later in the day than '{high}'", low=low.shown, high=high.shown
                ),
                TranslatableText(
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
            return self._join.made(f"(array_length({left.sql}) = 0)", (left,))
        return self._join.made(f"({left.sql} IS NULL)", (left,))

    def is_truth(self, left: Term, word: str) -> Term:
        """`left IS TRUE` or `left IS FALSE`, never null."""
        truth = self.truth(left)
        other = "FALSE" if word == "TRUE" else "TRUE"
        found = self._join.made(f"coalesce({truth.sql}, {other})", (truth,))
        return found if word == "TRUE" else self.negated(found)

    def _has(self, faults: Term, sign: str, right: Term) -> Term:
        if sign not in ("=", "!="):
            raise self._complain.about(
                faults,
                TranslatableText("{faults} has no order", faults=faults.shown),
                TranslatableText("ask for one, as in faults = 'noise'"),
            )
        if right.type is TermType.LITERAL and not right.shown:
            found = self.is_null(faults)
        else:
            word = self._values.word(faults, right)
            found = self._join.made(f"array_contains({faults.sql}, {word})", (faults,))
        return self.negated(found) if sign == "!=" else found

    # Patterns

    def like(self, left: Term, sign: str, pattern: Term) -> Term:
        """`left LIKE pattern` (or ILIKE): % is any text, _ any one character.

        Of bytes % is any whole ones and _ any one hex digit.
        """
        text = self._values.as_text(left, sign)
        self._expect_pattern(pattern, sign)
        sql = pattern.sql
        if left.type is TermType.HEX:
            sign, found = whole_bytes(self._values.bytes_pattern(pattern))
            sql = quoted(found)
        return self._join.made(f"({text} {sign} {sql})", (left, pattern))

    def regexp(self, left: Term, pattern: Term) -> Term:
        """`left ~ pattern` (or REGEXP, RLIKE): a regular expression that matches anywhere."""
        text = self._values.as_text(left, "~")
        self._expect_pattern(pattern, "~")
        found = f"(?i){pattern.shown}" if left.type is TermType.HEX else pattern.shown
        try:
            pl.Series([""]).str.contains(found)
        except pl.exceptions.PolarsError as error:
            why = str(error).split("error: ")[-1].splitlines()[0]
            raise self._complain.about(
                pattern,
                TranslatableText("no regular expression ({why})", why=why),
                TranslatableText("use LIKE, or escape signs with \\"),
            ) from None
        return self._join.made(f"({text} ~ {quoted(found)})", (left, pattern))

    def _expect_pattern(self, pattern: Term, sign: str) -> None:
        if pattern.type is not TermType.LITERAL:
            raise self._complain.about(
                pattern,
                TranslatableText("{sign} wants a pattern in quotes", sign=sign),
                TranslatableText("as in port {sign} '%USB%'", sign=sign),
            )
