"""What stands between the rows that a view gets of a capture."""

from __future__ import annotations

from fte_sniff.analysis.feed import BaudChange, MissingRows
from fte_sniff.protocol import Damage, Fault, PortEvent, PortEventKind, Row
from fte_sniff.session.capture_state import RowsMessage
from fte_sniff.session.live_session import BatchGaps


def rows(*times: int) -> list[Row]:
    return [Damage("p", t_ns, b"x", t_ns, (Fault.NOISE,)) for t_ns in times]


def test_rows_that_a_slow_view_missed_are_missing_before_the_next_it_gets() -> None:
    seams = BatchGaps(["p"], 115_200)
    assert seams.of(RowsMessage(rows(1, 2), [], 2, 0)) == []
    assert seams.of(RowsMessage(rows(8, 9), [], 9, 5)) == [MissingRows(0)]
    assert seams.of(RowsMessage(rows(10), [], 10, 5)) == []


def test_a_port_that_was_lost_and_one_with_another_speed_are_seams() -> None:
    seams = BatchGaps(["p"], 115_200)
    lost = PortEvent(5, "p", PortEventKind.LOST, "gone")
    assert seams.of(RowsMessage(rows(1, 2), [lost], 2, 0)) == [MissingRows(2, "p")]
    changed = PortEvent(8, "p", PortEventKind.BAUD_CHANGED, "9600 baud", 9600)
    assert seams.of(RowsMessage(rows(7, 8), [changed], 4, 0)) == [BaudChange(1, "p", 9600)]
