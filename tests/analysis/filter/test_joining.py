"""However many conditions a filter joins, its SQL stays shallow, in order, and bounded."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.terms import MAX_DEPTH, MAX_SQL, BooleanTerms, Term, TermType
from fte_sniff.errors import FilterError

JOIN = BooleanTerms("")


def conditions(count: int) -> list[Term]:
    return [Term(TermType.TRUTH, f"c{n}", n, f"c{n}") for n in range(count)]


@given(count=st.integers(1, 2000), joint=st.sampled_from(["AND", "OR"]))
def test_a_chain_keeps_its_order_and_stays_shallow(count: int, joint: str) -> None:
    joined = JOIN.chained(conditions(count), joint)
    assert re.findall(r"c\d+", joined.sql) == [f"c{n}" for n in range(count)]
    assert len(re.findall(rf" {joint} ", joined.sql)) == count - 1
    assert 8**joined.depth < 8 * max(count, 2)


def test_a_term_reads_what_its_parts_read_and_stands_where_the_first_does() -> None:
    parts = [
        Term(TermType.NUMBER, "a", 7, "a", depth=2, names=frozenset(["rpm"])),
        Term(TermType.NUMBER, "b", 3, "b", names=frozenset(["pulses"])),
    ]
    made = JOIN.made("(a + b)", parts, frozenset(["motor"]), TermType.NUMBER)
    assert (made.start, made.depth, made.type) == (3, 3, TermType.NUMBER)
    assert made.names == {"rpm", "pulses", "motor"}


@pytest.mark.parametrize(
    ("sql", "depth"), [("(deep)", MAX_DEPTH), ("(" + "x" * MAX_SQL + ")", 0)], ids=["deep", "large"]
)
def test_what_polars_would_not_read_is_refused(sql: str, depth: int) -> None:
    with pytest.raises(FilterError, match=r"too deep or too large.*take it apart"):
        JOIN.made(sql, [Term(TermType.TRUTH, "c", 0, "c", depth=depth)])
