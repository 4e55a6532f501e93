"""Line errors on their way from a port's chunks to the recording and the view."""

from __future__ import annotations

from collections.abc import Iterator
from multiprocessing import Pipe
from pathlib import Path
from typing import Self

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import PortGroup
from fte_sniff.capture.serial_port import DEFAULT_SETTINGS
from fte_sniff.capture.source import Item, SourceEnd
from fte_sniff.protocol import Chunk, Fault, PortEvent, PortEventKind
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import Recorder
from fte_sniff.session.capture_process import CaptureLoop, Outbox
from fte_sniff.session.capture_state import CapturePlan, Ended, RowsMessage

FRAME = bytes.fromhex("AA010103E800000000EE")
NOW_NS = 1_795_000_000_000_000_000
MILLISECOND = 1_000_000


class Told:
    """A source that has these items to yield."""

    end = SourceEnd.STOPPED
    waiting = 0

    def __init__(self, items: list[Item]) -> None:
        self._items = items
        self.uncertainty_ns = {"tap": 0}
        self.capabilities = {"tap": "line errors counted and marked"}

    def __iter__(self) -> Iterator[Item]:
        return iter(self._items)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...


def test_errors_are_in_the_rows_and_beside_them_in_the_recording_and_the_view(
    tmp_path: Path,
) -> None:
    path = tmp_path / "x.mcap"
    event = PortEvent(NOW_NS + MILLISECOND, "tap", PortEventKind.LINE_ERROR, "1 framing", 1)
    source = Told(
        [
            Chunk("tap", NOW_NS, FRAME * 3),
            event,
            Chunk("tap", NOW_NS + MILLISECOND, FRAME * 3, ((12, 13),)),
            Chunk("tap", NOW_NS + 2 * MILLISECOND, FRAME * 3),
        ]
    )
    ours, theirs = Pipe()
    plan = CapturePlan(PortGroup(("tap",), DEFAULT_SETTINGS), path)
    outbox = Outbox(theirs, source.stop)
    clock = Clock.tied()
    recorder = Recorder(path, (PortFacts("tap", 115_200),))
    outbox.close(CaptureLoop(plan, clock, source, recorder, outbox).run())

    recorded = list(RecordingReader(path).entries())
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
