"""Rows that wait for facts or readings keep their order, and that of events and gaps among them."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.feed import StreamChange
from fte_sniff.protocol import Gap, PortEvent, PortEventKind, Row
from fte_sniff.protocol.dissect import Readings, is_doubtful
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.fact_stage import FactStage
from fte_sniff.session.inputs import InputBatch
from tests.analysis.pieces import Step, captures

Item = Row | PortEvent | Gap


def batch_of(steps: list[Step]) -> InputBatch:
    """Rows, the gaps among them, and an event before each gap."""
    rows, changes, events = list[Row](), list[StreamChange](), list[PortEvent]()
    for step in steps:
        if isinstance(step, Row):
            rows.append(step)
        elif isinstance(step, Gap):
            changes.append(StreamChange(len(rows), step))
            if rows and rows[-1].t_ns is not None:
                events.append(PortEvent(rows[-1].t_ns, "a", PortEventKind.OPENED, ""))
    found = Rows.from_rows(rows, events=events)
    return InputBatch(found, found.events, changes=changes)


def in_order(batch: InputBatch) -> list[Row | Gap]:
    """The rows and the gaps in the order of their places."""
    found, start = list[Row | Gap](), 0
    for change in batch.changes:
        found += batch.rows[start : change.index]
        assert isinstance(change.what, Gap)
        found.append(change.what)
        start = change.index
    return [*found, *batch.rows[start:]]


@pytest.mark.parametrize("has_facts", [False, True])
@pytest.mark.parametrize("has_readings", [False, True])
@given(captures(), st.lists(st.integers(0, 25), max_size=4))
def test_rows_gaps_and_events_stay_in_order(
    has_facts: bool, has_readings: bool, steps: list[Step], cuts: list[int]
) -> None:
    steps = [step for step in steps if isinstance(step, Row | Gap)]
    edges = [0, *sorted(min(cut, len(steps)) for cut in cuts), len(steps)]
    batches = [batch_of(steps[start:end]) for start, end in pairwise(edges)]
    stage = FactStage(Facts() if has_facts else None, Readings() if has_readings else None)
    found = [*chain.from_iterable(map(stage.feed, batches)), *stage.end()]
    ordered = [one for batch in found for one in in_order(batch)]
    assert [
        replace(one, readings=None) if isinstance(one, Row) else one for one in ordered
    ] == steps
    events = [event for batch in found for event in batch.events]
    assert sorted(events, key=lambda one: one.t_ns) == sorted(
        (event for batch in batches for event in batch.events), key=lambda one: one.t_ns
    )
    assert all(one.rows.has_facts is has_facts for one in found if len(one.rows))
    for row in ordered:
        if isinstance(row, Row):
            assert (row.readings is not None) is (has_readings and is_doubtful(row.faults))
