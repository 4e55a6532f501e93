"""The numbers over all rows, against the rows counted by hand."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.fields import Decoded
from fte_sniff.analysis.statistics import LineSetup, Statistics
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    MOTORS,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    byte_time_ns,
    encode,
)
from fte_sniff.row_batch import Codebook, pack

SECOND = 1_000_000_000
ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=15)
BENCH = LineSetup()


def statistics_of(rows: list[Row], cut: int = 0) -> Statistics:
    found, codebook = Statistics(BENCH), Codebook()
    for part in (rows[:cut], rows[cut:]):
        found.add(Decoded(pack(part, codebook)[0]), codebook)
    return found


@given(ROWS)
def test_counts_are_what_one_counts_by_hand(rows: list[Row]) -> None:
    found = statistics_of(rows)
    ports = {numbers.port: numbers for numbers in found.ports()}
    assert {name: numbers.rows for name, numbers in ports.items()} == Counter(
        row.port for row in rows
    )
    for name, numbers in ports.items():
        assert numbers.bytes == sum(len(row.raw) for row in rows if row.port == name)
    faults = Counter(fault for row in rows for fault in set(row.faults))
    assert {numbers.fault: numbers.count for numbers in found.faults()} == faults
    for numbers in found.faults():
        having = [row for row in rows if numbers.fault in row.faults and row.t_ns is not None]
        assert sum(numbers.over_time.values) == len(having)
    streams = Counter(
        (row.port, row.kind.name, row.values.get("motor"))
        for row in rows
        if isinstance(row, Frame)
        and row.kind
        and (not row.kind.names_motor or row.values["motor"] in MOTORS)
    )
    assert streams == {
        (one.port, one.kind.name, one.motor): one.count for one in found.streams(None)
    }


def _rising(steps: list[int]) -> list[Row]:
    rows: list[Row] = []
    t_ns = 0
    for number, step in enumerate(steps):
        t_ns += step
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 2, "rpm": 5})
        time = None if number % 7 == 3 else t_ns
        rows.append(Frame("pq"[number % 3 == 0], 10 * number, raw, time))
    return rows


@given(st.lists(st.integers(0, SECOND), max_size=30), st.integers(0, 30))
def test_it_makes_no_difference_where_batches_are_cut(steps: list[int], cut: int) -> None:
    rows = _rising(steps)
    once, parts = statistics_of(rows), statistics_of(rows, cut)
    now = sum(steps)
    for one, other in zip(once.streams(now), parts.streams(now), strict=True):
        assert (one.count, one.per_s, one.lately_per_s) == (
            other.count,
            other.per_s,
            other.lately_per_s,
        )
        assert vars(one.periods).keys() == vars(other.periods).keys()
        assert one.jitter_ns == other.jitter_ns
        assert one.periods.longest_at_ns == other.periods.longest_at_ns
    for own, theirs in zip(once.ports(), parts.ports(), strict=True):
        assert (own.share, own.share_over_time) == (theirs.share, theirs.share_over_time)
        assert own.silences.longest_ns == theirs.silences.longest_ns


def _periodic(count: int, step: int) -> list[Row]:
    raw = encode(KIND_BY_NAME["speed"], {"motor": 2, "rpm": 5})
    return [Frame("p", FRAME_LENGTH * number, raw, number * step) for number in range(count)]


def test_a_periodic_stream_has_its_rate_and_no_jitter() -> None:
    rows = _periodic(101, SECOND // 100)
    found = statistics_of(rows, 30)
    (stream,) = found.streams(SECOND)
    assert stream.motor == 2
    assert stream.per_s == pytest.approx(100)
    assert stream.lately_per_s == pytest.approx(100)
    assert stream.periods.percentile_ns(50) == pytest.approx(SECOND / 100, rel=0.0005)
    assert stream.jitter_ns == 0
    (port,) = found.ports()
    taken = FRAME_LENGTH * byte_time_ns(BENCH.baud)
    assert port.share == pytest.approx(101 * taken / (SECOND + taken))
    assert port.silences.longest_ns == SECOND // 100 - taken
    assert port.silences.count == 100


@pytest.mark.parametrize(("frames", "jitter_ns"), [(1, None), (2, None), (3, 0)])
def test_one_period_does_not_vary(frames: int, jitter_ns: float | None) -> None:
    (stream,) = statistics_of(_periodic(frames, SECOND)).streams(None)
    assert stream.jitter_ns == jitter_ns


def test_rows_back_to_back_fill_the_line() -> None:
    (port,) = statistics_of(_periodic(500, FRAME_LENGTH * byte_time_ns(BENCH.baud))).ports()
    assert port.share == pytest.approx(1)
    assert port.silences.count == 0


def test_without_times_there_is_no_rate_and_no_share() -> None:
    raw = encode(KIND_BY_NAME["reset"], {})
    found = statistics_of([Frame("p", 0, raw, None), Damage("p", 10, b"x", None, (Fault.NOISE,))])
    (stream,) = found.streams(None)
    assert (stream.motor, stream.count, stream.per_s, stream.jitter_ns) == (None, 1, None, None)
    assert found.ports()[0].share is None


def test_port_events_are_counted_also_before_the_first_row() -> None:
    found = Statistics(BENCH)
    found.add_events([PortEvent(1, "p", PortEventKind.OPENED, "")])
    found.add_events([PortEvent(2, "p", PortEventKind.LINE_ERROR, "parity")] * 2)
    (port,) = found.ports()
    assert [(event.kind, event.count, event.last_ns) for event in port.events] == [
        (PortEventKind.OPENED, 1, 1),
        (PortEventKind.LINE_ERROR, 2, 2),
    ]
    assert (port.rows, port.share, port.silences.longest_ns) == (0, None, None)


def test_a_bench_tells_turns() -> None:
    assert LineSetup().turns(500) is None
    assert LineSetup(resolution=500, gear_ratio=20).turns(-15_000) == -1.5
