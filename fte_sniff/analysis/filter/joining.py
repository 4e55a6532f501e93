"""Owns how parts of a filter become one, never too deep or too large for polars.

It must not know which parts may be joined.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from fte_sniff.analysis.filter.complaints import Complaints
from fte_sniff.analysis.filter.terms import Term, TermType
from fte_sniff.errors import Said

MAX_DEPTH: Final = 18
"""Brackets inside brackets in the SQL; polars' parser gives up at 23."""

MAX_SQL: Final = 30_000
"""Characters of SQL; a list of many values asked of a long expression grows fast."""

_WIDTH: Final = 8
"""Conditions side by side before they are bracketed: polars' time grows with the square of more."""


class Joining:
    """Makes the terms of one filter out of others."""

    def __init__(self, text: str) -> None:
        self._complain = Complaints(text)

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
