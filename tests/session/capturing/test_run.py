"""One run of a plan over items that are known: what is handed on, and in which order."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from multiprocessing import Pipe

import pytest

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import PortGroup
from fte_sniff.capture.source import Item, SourceEnd
from fte_sniff.errors import PortError
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind, Row
from fte_sniff.session.capture_process import CaptureLoop, Outbox
from fte_sniff.session.capture_state import CapturePlan, Ended, RowsMessage

MS = 1_000_000
START_NS = 10**18
FRAME = bytes.fromhex("AA010103E800000000EE")


class Known:
    """A source whose items are known beforehand."""

    waiting = 0

    def __init__(self, items: Sequence[Item], end: SourceEnd = SourceEnd.STOPPED) -> None:
        self._items = items
        self.end = end
        self.uncertainty_ns = {item.port: 0 for item in items}

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)

    def __enter__(self) -> Known:
        return self

    def __exit__(self, *_error: object) -> None:
        pass

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


def chunk(port: str, ms: float, data: bytes) -> Chunk:
    return Chunk(port, START_NS + round(ms * MS), data)


def event(port: str, ms: float, kind: PortEventKind) -> PortEvent:
    return PortEvent(START_NS + round(ms * MS), port, kind, "told", 7)


def run(source: Known, **limits: int) -> tuple[list[Row], list[PortEvent], Ended]:
    ours, theirs = Pipe()
    outbox = Outbox(ours, lambda: None)
    plan = CapturePlan(PortGroup(tuple(source.uncertainty_ns)), None, **limits)  # type: ignore[arg-type]
    ended = CaptureLoop(plan, Clock.tied(), source, None, outbox).run()
    closing = threading.Thread(target=outbox.close, args=(ended,))
    closing.start()
    rows: list[Row] = []
    events: list[PortEvent] = []
    while isinstance(message := theirs.recv(), RowsMessage):
        rows += message.rows
        events += message.events
    closing.join(60)
    return rows, events, ended


@pytest.mark.parametrize("kind", [PortEventKind.LOST, PortEventKind.OVERRUN])
def test_bytes_do_not_join_across_a_gap_and_offsets_go_on(kind: PortEventKind) -> None:
    gap = event("p", 11, kind)
    items = [chunk("p", 10, FRAME * 3 + FRAME[:6]), gap, chunk("p", 12, FRAME[6:] + FRAME * 3)]
    rows, events, ended = run(Known(items))
    assert [row.raw for row in rows] == [FRAME] * 3 + [FRAME[:6], FRAME[6:]] + [FRAME] * 3
    assert [row.offset for row in rows] == [0, 10, 20, 30, 36, 40, 50, 60]
    assert events == [gap]
    assert ended == Ended()


def test_other_events_cut_nothing() -> None:
    gap = event("p", 11, PortEventKind.LINE_ERROR)
    rows, _, _ = run(Known([chunk("p", 10, FRAME * 3 + FRAME[:6]), gap, chunk("p", 12, FRAME[6:])]))
    assert [row.raw for row in rows] == [FRAME] * 4


def test_each_port_has_its_own_frames_offsets_and_place_in_time() -> None:
    items = [
        chunk("a", 10, FRAME[:5]),
        chunk("b", 10.1, FRAME[:5]),
        chunk("a", 10.5, FRAME[5:]),
        chunk("b", 20, FRAME[5:] + FRAME),
    ]
    rows, _, _ = run(Known(items))
    assert sorted((row.port, row.offset) for row in rows) == [("a", 0), ("b", 0), ("b", 10)]
    assert [row.t_ns for row in rows] == sorted(row.t_ns or 0 for row in rows)


def test_a_count_is_of_rows_of_all_ports() -> None:
    items = [chunk("a", 10, FRAME * 3), chunk("b", 20, FRAME * 3)]
    rows, _, _ = run(Known(items), count=4)
    assert [row.port for row in rows] == ["a", "a", "a", "b"]


def test_the_end_names_the_port_that_was_lost() -> None:
    items = [chunk("a", 1, b""), chunk("b", 2, b""), event("b", 3, PortEventKind.LOST)]
    _, _, ended = run(Known(items, SourceEnd.LOST))
    assert ended.reason == "b was lost: told"
    assert isinstance(ended.error, PortError)
