"""Merging ports by time."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.silence import SilenceWatch
from fte_sniff.capture.simulation import Simulation, SimulationParameters
from fte_sniff.protocol import Chunk, Framer, PortEvent, PortEventKind, Row
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.capture_process import (
    DRAIN_EVERY_NS,
    MOST_HELD_NS,
    REACH_NS,
    Wire,
    watermark_ns,
)
from fte_sniff.session.merge import Merge, MergeLane
from tests.examples import examples
from tests.support.columns import in_columns

MS = 1_000_000
FRAME = bytes.fromhex("AA0000000000000000EE")
START_NS = 10**18
Entry = Row | PortEvent


class PortLanes:
    """The lanes of some ports, fed with single rows and events."""

    def __init__(self, uncertainty_ns: dict[str, int]) -> None:
        self.merge = Merge(marks=True)
        self.lanes = {port: MergeLane(ns) for port, ns in uncertainty_ns.items()}
        self.merge.lanes += self.lanes.values()
        self._now_ns = 0

    def put(self, *entries: Entry) -> None:
        for entry in entries:
            self.lanes[entry.port].put(in_columns(entry))

    def advance(self, port: str, t_ns: int, waits_ns: int | None, *, data: bool) -> None:
        """Reads of a port up to a time; the last one had bytes or not."""
        self._now_ns, lane = max(self._now_ns, t_ns), self.lanes[port]
        reached = watermark_ns(t_ns if data else 0, t_ns, waits_ns) - lane.uncertainty_ns
        lane.reached = max(lane.reached, (reached,))

    def ready(self, *, final: bool = False) -> list[Entry]:
        taken = self.merge.take(least=self._now_ns - MOST_HELD_NS, final=final)
        return [] if taken is None else in_order(taken.rows)


def in_order(rows: Rows) -> list[Entry]:
    """Rows and events by time."""
    return sorted([*rows, *rows.events], key=lambda entry: entry.t_ns or 0)


def row(port: str, ms: float) -> Row:
    return Row(port, 0, FRAME, round(ms * MS))


def event(port: str, ms: float) -> PortEvent:
    return PortEvent(round(ms * MS), port, PortEventKind.LOST, "")


def test_one_port_waits_for_nothing() -> None:
    order = PortLanes({"a": 0})
    order.put(row("a", 1), event("a", 2), row("a", 3))
    assert order.ready() == [row("a", 1), event("a", 2), row("a", 3)]


def test_a_row_waits_until_the_other_port_is_past_it() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(row("a", 100))
    order.advance("a", 101 * MS, None, data=True)
    order.advance("b", 110 * MS, None, data=False)
    assert order.ready() == []
    order.advance("b", 101 * MS + REACH_NS, None, data=False)
    assert order.ready() == [row("a", 100)]


def test_a_read_with_bytes_is_past_all_that_came_before_it() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(row("a", 100))
    order.advance("b", 101 * MS, None, data=True)
    assert order.ready() == [row("a", 100)]


def test_a_port_with_undecided_bytes_is_waited_for_from_the_first_of_them() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(row("a", 100), row("a", 150))
    order.advance("b", 500 * MS, 120 * MS, data=True)
    assert order.ready() == [row("a", 100)]
    order.put(row("b", 120))
    order.advance("b", 510 * MS, None, data=False)
    assert order.ready() == [row("b", 120), row("a", 150)]


def test_no_port_holds_up_another_for_ever() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(row("a", 100))
    order.advance("b", 101 * MS, 50 * MS, data=True)
    order.advance("a", 100 * MS + MOST_HELD_NS - 1, None, data=False)
    assert order.ready() == []
    order.advance("a", 100 * MS + MOST_HELD_NS, None, data=False)
    assert order.ready() == [row("a", 100)]


def test_events_stand_where_they_happened() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(event("a", 5), row("b", 4), row("b", 6))
    assert order.ready(final=True) == [row("b", 4), event("a", 5), row("b", 6)]


def test_an_event_holds_up_no_row_behind_it() -> None:
    order = PortLanes({"a": 0, "b": 0})
    order.put(row("a", 10), event("a", 11), row("a", 12), row("b", 20))
    order.advance("a", 13 * MS, None, data=True)
    order.advance("b", 21 * MS, None, data=True)
    assert order.ready() == [row("a", 10), event("a", 11), row("a", 12)]


@pytest.mark.parametrize(
    ("uncertain", "times", "marked"),
    [
        # The later row may be the earlier one by as much as its own port is uncertain.
        ({"a": 0, "b": 2}, [("a", 10), ("b", 11)], [True, True]),
        ({"a": 2, "b": 0}, [("a", 10), ("b", 11)], [False, False]),
        ({"a": 0, "b": 2}, [("a", 10), ("b", 12.5)], [False, False]),
        ({"a": 1, "b": 1}, [("a", 10), ("a", 10.5), ("b", 11), ("b", 12.5)], [True] * 3 + [False]),
        ({"a": 0, "b": 0}, [("a", 10), ("b", 10)], [True, True]),
        ({"a": 16, "b": 1}, [("b", 10), ("a", 20), ("b", 22)], [True, True, False]),
        ({"a": 9, "b": 9}, [("a", 10), ("a", 11), ("a", 12)], [False] * 3),
    ],
)
def test_rows_of_two_ports_in_uncertain_order_are_marked(
    uncertain: dict[str, int], times: list[tuple[str, float]], marked: list[bool]
) -> None:
    order = PortLanes({port: ms * MS for port, ms in uncertain.items()})
    for port, ms in times:
        order.put(row(port, ms))
        order.advance(port, round(ms * MS) + MS, None, data=True)
    found = order.ready() + order.ready(final=True)
    assert [(r.port, (r.t_ns or 0) / MS) for r in found] == times
    assert [r.framed and r.unordered for r in found] == marked


FAULTS = st.sampled_from([0.0, 0.3])
LATENESS = st.lists(st.integers(0, 16 * MS), min_size=1, max_size=9)
SEEDS = st.integers(0, 99)


def wire(port: str, carries: str, seed: int, fault: float, rate: float, late: list[int]) -> list:
    """A wire as an adapter reads it: bytes late by up to 16 ms, and silence reported."""
    asked = SimulationParameters(
        seed=seed, rate=rate, frames=30, drop=fault, noise=fault, wire=carries
    )
    return list(_reads(port, list(Simulation(asked)), itertools.cycle(late)))


def _reads(port: str, coming: list, late: Iterator[int]) -> Iterator[Chunk]:
    """Reads of what comes, never later than 16 ms after it came, and a beat each 10 ms."""
    now, at = START_NS, 0
    while at < len(coming):
        due = START_NS + coming[at].t_ns + next(late)
        while now + 10 * MS < due:
            now += 10 * MS
            yield Chunk(port, now, b"")
        now = max(now, due)
        data = b""
        while at < len(coming) and START_NS + coming[at].t_ns <= now:
            data += coming[at].data
            at += 1
        yield Chunk(port, now, data)


@examples(25)
@given(
    st.tuples(SEEDS, FAULTS),
    st.tuples(SEEDS, FAULTS),
    st.sampled_from([20.0, 200.0, 1000.0]),
    LATENESS,
    LATENESS,
)
def test_rows_come_out_in_order_of_time_and_all_of_them(
    one: tuple[int, float], two: tuple[int, float], rate: float, late1: list[int], late2: list[int]
) -> None:
    read = {
        "a": wire("a", "control", *one, rate, late1),
        "b": wire("b", "feedback", *two, rate, late2),
    }
    until_ns = max(chunks[-1].t_ns or 0 for chunks in read.values())
    for port, chunks in read.items():
        beats = range((chunks[-1].t_ns or 0) + 10 * MS, until_ns, 10 * MS)
        chunks += [Chunk(port, t_ns, b"") for t_ns in beats]
    merge = Merge(marks=True)
    merge.lanes += [MergeLane(MS) for _ in read]
    lanes = zip(read, merge.lanes, strict=True)
    ports = {port: Wire(Framer(port), lane, SilenceWatch(port)) for port, lane in lanes}
    made: dict[str, list[Row]] = {port: [] for port in read}
    found: list[Row] = []
    drain_ns = 0
    for chunk in heapq.merge(*read.values(), key=lambda chunk: chunk.t_ns):
        ports[chunk.port].push(chunk)
        if chunk.t_ns >= drain_ns:
            drain_ns = chunk.t_ns + DRAIN_EVERY_NS
            for port, own in ports.items():
                made[port] += own.drain()
            if (taken := merge.take()) is not None:
                found += taken.rows
    for port, own in ports.items():
        own.framer.finish()
        made[port] += own.drain()
    if (taken := merge.take(final=True)) is not None:
        found += taken.rows
    for a, b in itertools.pairwise(found):
        assert (a.t_ns or 0) <= (b.t_ns or 0), (a, b)
    for port, rows in made.items():
        assert [row for row in found if row.port == port] == rows
