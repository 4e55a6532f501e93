"""Merging ports by time, and wires that carry the wrong direction."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.simulation import SimulationParameters, simulate
from fte_sniff.protocol import Chunk, Damage, Fault, Frame, Framer, PortEvent, PortEventKind, Row
from fte_sniff.session.port_merge import (
    MOST_HELD_NS,
    REACH_NS,
    SETTLED,
    UNEXPECTED,
    Entry,
    PortMerge,
    WiringWatch,
)

MS = 1_000_000
FRAME = bytes.fromhex("AA0000000000000000EE")
START_NS = 10**18


def row(port: str, ms: float) -> Frame:
    return Frame(port, 0, FRAME, round(ms * MS))


def event(port: str, ms: float) -> PortEvent:
    return PortEvent(round(ms * MS), port, PortEventKind.LOST, "")


def put(order: PortMerge, *entries: Entry) -> None:
    for entry in entries:
        order.put(entry.port, [entry])


def test_one_port_waits_for_nothing() -> None:
    order = PortMerge({"a": 0})
    put(order, row("a", 1), event("a", 2), row("a", 3))
    assert order.ready() == [row("a", 1), event("a", 2), row("a", 3)]


def test_a_row_waits_until_the_other_port_is_past_it() -> None:
    order = PortMerge({"a": 0, "b": 0})
    put(order, row("a", 100))
    order.advance("a", 101 * MS, None, data=True)
    order.advance("b", 110 * MS, None, data=False)
    assert order.ready() == []
    order.advance("b", 101 * MS + REACH_NS, None, data=False)
    assert order.ready() == [row("a", 100)]


def test_a_read_with_bytes_is_past_all_that_came_before_it() -> None:
    order = PortMerge({"a": 0, "b": 0})
    put(order, row("a", 100))
    order.advance("b", 101 * MS, None, data=True)
    assert order.ready() == [row("a", 100)]


def test_a_port_with_undecided_bytes_is_waited_for_from_the_first_of_them() -> None:
    order = PortMerge({"a": 0, "b": 0})
    put(order, row("a", 100), row("a", 150))
    order.advance("b", 500 * MS, 120 * MS, data=True)
    assert order.ready() == [row("a", 100)]
    put(order, row("b", 120))
    order.advance("b", 510 * MS, None, data=False)
    assert order.ready() == [row("b", 120), row("a", 150)]


def test_no_port_holds_up_another_for_ever() -> None:
    order = PortMerge({"a": 0, "b": 0})
    put(order, row("a", 100))
    order.advance("b", 101 * MS, 50 * MS, data=True)
    order.advance("a", 100 * MS + MOST_HELD_NS - 1, None, data=False)
    assert order.ready() == []
    order.advance("a", 100 * MS + MOST_HELD_NS, None, data=False)
    assert order.ready() == [row("a", 100)]


def test_events_stand_where_they_happened() -> None:
    order = PortMerge({"a": 0, "b": 0})
    put(order, event("a", 5), row("b", 4), row("b", 6))
    assert order.drain() == [row("b", 4), event("a", 5), row("b", 6)]


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
def test_what_two_ports_cannot_tell_apart_is_marked(
    uncertain: dict[str, int], times: list[tuple[str, float]], marked: list[bool]
) -> None:
    order = PortMerge({port: ms * MS for port, ms in uncertain.items()})
    for port, ms in times:
        put(order, row(port, ms))
        order.advance(port, round(ms * MS) + MS, None, data=True)
    found = order.ready() + order.drain()
    assert [(r.port, (r.t_ns or 0) / MS) for r in found] == times
    assert [isinstance(r, Frame) and r.order_uncertain for r in found] == marked


FAULTS = st.sampled_from([0.0, 0.3])
LATENESS = st.lists(st.integers(0, 16 * MS), min_size=1, max_size=9)
SEEDS = st.integers(0, 99)


def wire(port: str, carries: str, seed: int, fault: float, rate: float, late: list[int]) -> list:
    """A wire as an adapter reads it: bytes late by up to 16 ms, and silence told."""
    asked = SimulationParameters(
        seed=seed, rate=rate, frames=60, drop=fault, noise=fault, wire=carries
    )
    return list(_reads(port, list(simulate(asked)), itertools.cycle(late)))


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


@given(
    st.tuples(SEEDS, FAULTS),
    st.tuples(SEEDS, FAULTS),
    st.sampled_from([5.0, 200.0, 1000.0]),
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
    framers = {port: Framer(port) for port in read}
    order = PortMerge(dict.fromkeys(read, MS))
    made: dict[str, list[Row]] = {port: [] for port in read}
    found: list[Entry] = []

    def take(port: str, rows: list[Row]) -> None:
        made[port] += rows
        order.put(port, rows)

    for chunk in heapq.merge(*read.values(), key=lambda chunk: chunk.t_ns):
        framer = framers[chunk.port]
        take(chunk.port, framer.feed(chunk))
        waits = framer.pending_since_ns
        order.advance(chunk.port, chunk.t_ns or 0, waits, data=bool(chunk.data))
        found += order.ready()
    for port, framer in framers.items():
        take(port, framer.flush())
    found += order.drain()
    for a, b in itertools.pairwise(found):
        assert (a.t_ns or 0) <= (b.t_ns or 0), (a, b)
    for port, rows in made.items():
        assert [entry for entry in found if entry.port == port] == rows


CONTROL = bytes.fromhex("AA0000000000000000EE")
FEEDBACK = bytes.fromhex("5501010000000000000FEE")[:9] + b"\xee"


def look(watch: WiringWatch, port: str, raw: bytes, count: int, **more: object) -> list[PortEvent]:
    return [
        told
        for number in range(count)
        for told in watch.observe(port, [Frame(port, 10 * number, raw, number, **more)])  # type: ignore[arg-type]
    ]


def test_a_wire_each_is_as_it_should_be() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", CONTROL, 1000) == []
    assert look(watch, "b", FEEDBACK, 1000) == []


def test_one_port_may_carry_both() -> None:
    watch = WiringWatch(["a"])
    assert look(watch, "a", CONTROL, 100) + look(watch, "a", FEEDBACK, 100) == []


def test_the_others_header_is_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", CONTROL, SETTLED)
    look(watch, "b", FEEDBACK, SETTLED)
    assert look(watch, "a", FEEDBACK, UNEXPECTED - 1) == []
    (told,) = look(watch, "a", FEEDBACK, 50)
    assert (told.port, told.kind) == ("a", PortEventKind.WIRING)
    assert told.detail.startswith("feedback frames on the wire that carries control frames")
    (told,) = look(watch, "b", CONTROL, 50)
    assert told.port == "b"
    assert look(watch, "a", FEEDBACK, 50) + look(watch, "b", CONTROL, 50) == []


def test_two_adapters_on_one_wire_are_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", FEEDBACK, SETTLED) == []
    (told,) = look(watch, "b", FEEDBACK, 100)
    assert "on a too" in told.detail
    assert look(watch, "a", FEEDBACK, 100) == []


def test_a_wire_like_another_that_carries_both_directions_is_pointed_out_as_mixed_too() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", FEEDBACK, SETTLED)
    assert len(look(watch, "b", FEEDBACK, SETTLED)) == 1
    (told,) = look(watch, "b", CONTROL, 50)
    assert "swapped or mixed wiring" in told.detail
    assert look(watch, "b", CONTROL, 50) + look(watch, "b", FEEDBACK, 50) == []


@pytest.mark.parametrize("faults", [(Fault.AMBIGUOUS,), (Fault.UNKNOWN_CMD,)])
def test_what_is_doubtful_is_no_cause(faults: tuple[Fault, ...]) -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", CONTROL, SETTLED)
    assert look(watch, "a", FEEDBACK, 100, faults=faults) == []
    assert watch.observe("a", [Damage("a", 0, FEEDBACK, 1, (Fault.TRUNCATED,))]) == []
