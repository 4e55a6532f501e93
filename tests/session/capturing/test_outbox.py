"""The way out of the capture process: in order, bounded, and never in the way."""

from __future__ import annotations

import threading
from multiprocessing import Pipe
from pathlib import Path

from fte_sniff.errors import FileError
from fte_sniff.protocol import Frame, PortEvent, PortEventKind
from fte_sniff.recording.recorder import Change
from fte_sniff.session.capture_process import MOST_WAITING, Outbox
from fte_sniff.session.capture_state import Ended, RowsMessage

FRAME = bytes.fromhex("AA0000000000000000EE")


def rows(start: int, count: int) -> list[Frame]:
    return [Frame("p", offset, FRAME, offset) for offset in range(start, start + count)]


def received(theirs) -> list:
    found = []
    while not found or not isinstance(found[-1], Ended):
        assert theirs.poll(20)
        found.append(theirs.recv())
    return found


def test_rows_events_and_the_end_arrive_in_order() -> None:
    ours, theirs = Pipe()
    outbox = Outbox(ours, lambda: None)
    event = PortEvent(1, "p", PortEventKind.OPENED, "")
    outbox.put_event(event)
    for start in range(0, 1000, 100):
        outbox.put_rows(rows(start, 100))
    outbox.put_recording([Change(None, FileError("full"))])
    outbox.put_recording([Change(Path("x_00002.mcap"))])
    outbox.close(Ended("over"))
    *batches, end = received(theirs)
    assert [row for batch in batches for row in batch.rows] == rows(0, 1000)
    assert [found for batch in batches for found in batch.events] == [event]
    changes = [change for batch in batches for change in batch.recording]
    assert [(change.path, str(change.failure)) for change in changes] == [
        (None, "full"),
        (Path("x_00002.mcap"), "None"),
    ]
    assert batches[-1].total_rows == 1000
    assert batches[-1].not_shown == 0
    assert end == Ended("over")


def test_a_view_that_does_not_look_loses_the_oldest_rows_and_is_told_how_many() -> None:
    ours, theirs = Pipe()
    outbox = Outbox(ours, lambda: None)
    # The first batch takes what waits then, at most all; it stays in the pipe.
    total = MOST_WAITING * 3
    for start in range(0, total, 1024):
        outbox.put_rows(rows(start, 1024))
    closing = threading.Thread(target=outbox.close, args=(Ended(),))
    closing.start()
    batches = [message for message in received(theirs) if isinstance(message, RowsMessage)]
    closing.join(60)
    seen = [row for batch in batches for row in batch.rows]
    assert batches[-1].total_rows == total
    assert len(seen) + batches[-1].not_shown == total
    assert batches[-1].not_shown > 0
    assert seen[-1] == rows(total - 1, 1)[0]


def test_a_view_that_is_gone_is_noticed() -> None:
    ours, theirs = Pipe()
    gone = threading.Event()
    outbox = Outbox(ours, gone.set)
    theirs.close()
    outbox.put_rows(rows(0, 1))
    assert gone.wait(60)
    outbox.close(Ended())
