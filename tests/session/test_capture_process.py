"""The capture process: its loop over known items, and the queue of rows to the view."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from multiprocessing import Pipe
from pathlib import Path

import pytest

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import PortGroup
from fte_sniff.capture.source import Item, SourceEnd
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import Chunk, Fault, PortEvent, PortEventKind, Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.recorder import Change, Recorder
from fte_sniff.session.capture_process import (
    SETTLED,
    UNEXPECTED,
    CaptureLoop,
    CapturePlan,
    Ended,
    Outbox,
    RowsMessage,
    WiringWatch,
    WriteProgress,
)
from tests.beside import Work
from tests.recording.conftest import entries_in
from tests.support.columns import in_columns
from tests.waiting import BOUND_S

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
    return PortEvent(START_NS + round(ms * MS), port, kind, "reported", 7)


def run(source: Known, **limits: int) -> tuple[list[Row], list[PortEvent], Ended]:
    ours, theirs = Pipe()
    outbox = Outbox(ours, lambda: None)
    plan = CapturePlan(PortGroup(tuple(source.uncertainty_ns)), None, **limits)  # type: ignore[arg-type]
    ended = CaptureLoop(plan, Clock.tied(), source, None, outbox).run()
    closing = Work(outbox.close, ended)
    rows: list[Row] = []
    events: list[PortEvent] = []
    while isinstance(message := theirs.recv(), RowsMessage):
        rows += message.rows
        events += message.rows.events
    closing.ended()
    return rows, events, ended


@pytest.mark.parametrize("kind", [PortEventKind.LOST, PortEventKind.OVERRUN])
def test_bytes_do_not_join_across_a_gap_and_offsets_go_on(kind: PortEventKind) -> None:
    gap = event("p", 11, kind)
    items = [chunk("p", 10, FRAME * 3 + FRAME[:6]), gap, chunk("p", 12, FRAME[6:] + FRAME * 3)]
    rows, events, ended = run(Known(items))
    assert [row.raw for row in rows] == [FRAME] * 3 + [FRAME[:6], FRAME[6:]] + [FRAME] * 3
    assert [row.offset for row in rows] == [0, 10, 20, 30, 36, 40, 50, 60]
    assert events == [gap]
    assert ended == Ended(progress=WriteProgress(is_end=True, turns=len(items)))


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
    assert ended.reason == "b was lost: reported"
    assert isinstance(ended.error, PortError)


def test_errors_are_in_the_rows_and_beside_them_in_the_recording_and_the_view(
    tmp_path: Path,
) -> None:
    path = tmp_path / "x.mcap"
    event = PortEvent(START_NS + MS, "tap", PortEventKind.LINE_ERROR, "1 framing", 1)
    marked_chunk = Chunk("tap", START_NS + MS, FRAME * 3, ((12, 13),))
    items = [chunk("tap", 0, FRAME * 3), event, marked_chunk, chunk("tap", 2, FRAME * 3)]
    source = Known(items)
    ours, theirs = Pipe()
    plan = CapturePlan(PortGroup(("tap",)), path)
    outbox = Outbox(theirs, source.stop)
    clock = Clock.tied()
    recorder = Recorder(path, (PortFacts("tap", 115_200),))
    outbox.close(CaptureLoop(plan, clock, source, recorder, outbox).run())

    recorded = entries_in(path)
    events = [entry for entry in recorded if isinstance(entry, PortEvent)]
    assert [(e.kind, e.detail, e.count) for e in events if e.kind is event.kind] == [
        (PortEventKind.LINE_ERROR, "1 framing", 1)
    ]
    marked = [
        row.offset
        for row in recorded
        if not isinstance(row, PortEvent) and Fault.LINE_ERROR in row.faults
    ]
    assert marked == [40]
    shown = []
    while not isinstance(message := ours.recv(), Ended):
        assert isinstance(message, RowsMessage)
        shown += [row.offset for row in message.rows if Fault.LINE_ERROR in row.faults]
    assert shown == [40]


def rows(start: int, count: int) -> list[Row]:
    return [Row("p", offset, FRAME, offset) for offset in range(start, start + count)]


def received(theirs) -> list:
    found = []
    while not found or not isinstance(found[-1], Ended):
        assert theirs.poll(BOUND_S)
        found.append(theirs.recv())
    return found


def test_rows_events_and_the_end_arrive_in_order() -> None:
    ours, theirs = Pipe()
    outbox = Outbox(ours, lambda: None)
    event = PortEvent(1, "p", PortEventKind.OPENED, "")
    outbox.put(in_columns(event))
    for start in range(0, 1000, 100):
        outbox.put(in_columns(rows(start, 100)))
    outbox.put(changes=[Change(None, FileError("full"))])
    outbox.put(changes=[Change(Path("x_00002.mcap"))])
    outbox.close(Ended("over"))
    *batches, end = received(theirs)
    assert [row for batch in batches for row in batch.rows] == rows(0, 1000)
    assert [found for batch in batches for found in batch.rows.events] == [event]
    changes = [change for batch in batches for change in batch.recording]
    assert [(change.path, str(change.failure)) for change in changes] == [
        (None, "full"),
        (Path("x_00002.mcap"), "None"),
    ]
    assert batches[-1].total_rows == 1000
    assert batches[-1].not_shown == 0
    assert end == Ended("over")


def test_a_view_that_is_gone_is_noticed() -> None:
    ours, theirs = Pipe()
    gone = threading.Event()
    outbox = Outbox(ours, gone.set)
    theirs.close()
    outbox.put(in_columns(rows(0, 1)))
    assert gone.wait(BOUND_S)
    outbox.close(Ended())


COMMAND = bytes.fromhex("AA0000000000000000EE")
FEEDBACK = bytes.fromhex("550101000000000000EE")


def look(watch: WiringWatch, port: str, raw: bytes, count: int, **more: object) -> list[PortEvent]:
    return [
        reported
        for number in range(count)
        for reported in watch.observe(port, in_columns(Row(port, 10 * number, raw, number, **more)))  # type: ignore[arg-type]
    ]


def test_a_wire_each_is_as_it_should_be() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", COMMAND, 1000) == []
    assert look(watch, "b", FEEDBACK, 1000) == []


def test_one_port_may_carry_both() -> None:
    watch = WiringWatch(["a"])
    assert look(watch, "a", COMMAND, 100) + look(watch, "a", FEEDBACK, 100) == []


def test_the_others_header_is_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", COMMAND, SETTLED)
    look(watch, "b", FEEDBACK, SETTLED)
    assert look(watch, "a", FEEDBACK, UNEXPECTED - 1) == []
    (reported,) = look(watch, "a", FEEDBACK, 50)
    assert (reported.port, reported.kind) == ("a", PortEventKind.WIRING)
    assert reported.detail.startswith("feedback frames on the wire that carries control frames")
    (reported,) = look(watch, "b", COMMAND, 50)
    assert reported.port == "b"
    assert look(watch, "a", FEEDBACK, 50) + look(watch, "b", COMMAND, 50) == []


def test_two_adapters_on_one_wire_are_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", FEEDBACK, SETTLED) == []
    (reported,) = look(watch, "b", FEEDBACK, 100)
    assert "on a too" in reported.detail
    assert look(watch, "a", FEEDBACK, 100) == []


def test_a_wire_like_another_that_carries_both_directions_is_pointed_out_as_mixed_too() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", FEEDBACK, SETTLED)
    assert len(look(watch, "b", FEEDBACK, SETTLED)) == 1
    (reported,) = look(watch, "b", COMMAND, 50)
    assert "swapped or mixed wiring" in reported.detail
    assert look(watch, "b", COMMAND, 50) + look(watch, "b", FEEDBACK, 50) == []


@pytest.mark.parametrize("faults", [(Fault.AMBIGUOUS,), (Fault.UNKNOWN_CMD,)])
def test_what_is_doubtful_is_not_a_cause(faults: tuple[Fault, ...]) -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", COMMAND, SETTLED)
    assert look(watch, "a", FEEDBACK, 100, faults=faults) == []
    assert (
        watch.observe("a", in_columns(Row("a", 0, FEEDBACK, 1, (Fault.TRUNCATED,), framed=False)))
        == []
    )
