"""What stands between the rows that a view gets of a capture."""

from __future__ import annotations

from fte_sniff.analysis.feed import Missing, Pace
from fte_sniff.protocol import Damage, Fault, PortEvent, PortEventKind, Row
from fte_sniff.session.capture_state import Batch
from fte_sniff.session.live_session import BatchSeams


def rows(*times: int) -> list[Row]:
    return [Damage("p", t_ns, b"x", t_ns, (Fault.NOISE,)) for t_ns in times]


def test_rows_that_a_slow_view_missed_are_missing_before_the_next_it_gets() -> None:
    seams = BatchSeams(["p"], 115_200)
    assert seams.of(Batch(rows(1, 2), [], 2, 0)) == []
    assert seams.of(Batch(rows(8, 9), [], 9, 5)) == [Missing(0)]
    assert seams.of(Batch(rows(10), [], 10, 5)) == []


def test_a_port_that_was_lost_and_one_with_another_speed_are_seams() -> None:
    seams = BatchSeams(["p"], 115_200)
    lost = PortEvent(5, "p", PortEventKind.LOST, "gone")
    assert seams.of(Batch(rows(1, 2), [lost], 2, 0)) == [Missing(2, "p")]
    changed = PortEvent(8, "p", PortEventKind.BAUD_CHANGED, "9600 baud", 9600)
    assert seams.of(Batch(rows(7, 8), [changed], 4, 0)) == [Pace(1, "p", 9600)]
