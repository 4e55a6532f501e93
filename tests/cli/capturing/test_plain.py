"""What `live` without a screen says beside the rows: port events, failures, and what came."""

from __future__ import annotations

import pytest

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.cli.capture_command import PlainLines
from fte_sniff.errors import FileError
from fte_sniff.protocol import Frame, PortEvent, PortEventKind

FRAME = bytes.fromhex("AA0000000000000000EE")
PORT = "tty\x1b[31m"


def event(kind: PortEventKind, detail: str) -> PortEvent:
    return PortEvent(1, PORT, kind, detail)


def test_port_events_that_matter_are_told_as_they_come_and_counted_at_the_end(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = PlainLines(list)
    events = [
        event(PortEventKind.OPENED, "115200 baud"),
        event(PortEventKind.OVERRUN, "512 bytes were not kept"),
        event(PortEventKind.OVERRUN, "7 bytes were not kept\x1b[2J"),
        event(PortEventKind.LINE_ERROR, ""),
        event(PortEventKind.LOST, "hung up"),
        event(PortEventKind.CLOSED, "as asked"),
    ]
    lines.write(FeedUpdate(FeedState(PORT), events=events), None)
    assert capsys.readouterr().err.splitlines() == [
        r"tty\x1b[31m overrun: 512 bytes were not kept",
        r"tty\x1b[31m overrun: 7 bytes were not kept\x1b[2J",
        r"tty\x1b[31m line error",
        r"tty\x1b[31m lost: hung up",
    ]
    lines.close()
    assert "port events: overrun 2, line_error 1, lost 1" in capsys.readouterr().err.splitlines()


def test_a_failure_is_told_once_while_the_capture_goes_on(
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = PlainLines(list)
    for number in range(3):
        row = Frame("p", 10 * number, FRAME, number)
        lines.write(FeedUpdate(FeedState("p"), [row]), FileError("recording stopped: full"))
    told = capsys.readouterr()
    assert told.err == "recording stopped: full\n"
    assert told.out.count("\n") == 4


def test_a_failure_with_which_it_ends_is_left_to_whoever_ends_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    PlainLines(list).write(FeedUpdate(FeedState("p", running=False)), FileError("full"))
    assert capsys.readouterr().err == ""


def test_rows_that_were_too_fast_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    lines = PlainLines(list)
    lines.write(FeedUpdate(FeedState("p", rows=5000, not_shown=4999)), None)
    lines.close()
    assert "4,999 rows more came too fast to be printed" in capsys.readouterr().err
