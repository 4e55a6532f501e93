from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import Rate, Tally
from fte_sniff.protocol import Damage, Fault, Frame, Row, Status

ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=12)
SECOND = 1_000_000_000


@given(ROWS)
def test_counts_are_what_one_counts_by_hand(rows: list[Row]) -> None:
    tally = Tally()
    tally.add(rows)
    times = [row.t_ns for row in rows if row.t_ns is not None]
    frames = [row for row in rows if isinstance(row, Frame)]
    assert tally.rows == len(rows)
    assert tally.frames == len(frames)
    assert tally.bytes == sum(len(row.raw) for row in rows)
    assert tally.malformed == sum(row.status is Status.MALFORMED for row in rows)
    for status in Status:
        assert tally.by_status[status] == sum(row.status is status for row in rows)
    for fault in Fault:
        assert tally.by_fault[fault] == sum(fault in row.faults for row in rows)
    for port in {row.port for row in rows}:
        assert tally.by_port[port] == sum(row.port == port for row in rows)
    assert sum(tally.by_kind.values()) == sum(frame.kind is not None for frame in frames)
    assert tally.first_ns == min(times, default=None)
    assert tally.last_ns == max(times, default=None)
    assert tally.duration_ns == (max(times) - min(times) if times else None)


@given(ROWS, st.data())
def test_adding_in_parts_is_adding_at_once(rows: list[Row], data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(rows)))
    once, parts = Tally(), Tally()
    once.add(rows)
    parts.add(rows[:cut])
    parts.add(rows[cut:])
    assert parts == once


def test_the_malformed_share_is_of_all_rows() -> None:
    tally = Tally()
    assert tally.malformed_share == 0
    noise = Damage("port", 0, b"\0", None, (Fault.NOISE,))
    suspect = Frame("port", 1, bytes.fromhex("AA000000000000000001EE")[:10], None)
    tally.add([noise, suspect, suspect, suspect])
    assert tally.malformed_share == 0.25


@pytest.mark.parametrize(
    ("fed", "now", "rate"),
    [
        ([], 5.0, 0.0),
        ([(10, 0.0)], 0.0, 0.0),
        ([(0, 0.0), (10, 1.0)], 1.0, 10.0),
        ([(0, 0.0), (10, 1.0), (10, 2.0)], 2.0, 10.0),
        ([(0, 0.0), (50, 1.0), (10, 2.0), (20, 3.0)], 3.0, 15.0),
        ([(0, 0.0), (10, 1.0)], 2.5, 5.0),
        ([(0, 0.0), (10, 1.0)], 3.0, 0.0),
        ([(0, 0.0), (10, 1.0)], 9.0, 0.0),
    ],
)
def test_a_rate_looks_back_two_seconds(
    fed: list[tuple[int, float]], now: float, rate: float
) -> None:
    meter = Rate(2 * SECOND)
    for count, at in fed:
        meter.add(count, int(at * SECOND))
    assert meter.per_second(int(now * SECOND)) == pytest.approx(rate)
