from __future__ import annotations

import termios
from dataclasses import replace

import pytest

from fte_sniff.analysis.line_condition import LineCondition, LineDiagnosis
from fte_sniff.capture.discovery import Holder, PortListing
from fte_sniff.capture.line_errors import LineErrors
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.errors import PortError
from fte_sniff.protocol import Direction, LineErrorCounts
from fte_sniff.session.doctor import (
    LineListener,
    probe_finding,
    verdict_finding,
)
from tests.beside import Work


@pytest.mark.parametrize("condition", LineCondition)
def test_every_condition_has_words_and_a_fix(condition: LineCondition) -> None:
    verdict = LineDiagnosis(condition, 100, 0.5, frozenset({Direction.CONTROL}))
    finding = verdict_finding("/dev/p", 115_200, verdict)
    assert finding.what
    assert (finding.fix is None) is (condition is LineCondition.SOUND)


def test_a_probe_names_the_baud_with_most_bytes_in_frames() -> None:
    found = {
        57_600: LineDiagnosis(LineCondition.DAMAGED, 400, 0.3),
        38_400: LineDiagnosis(LineCondition.DAMAGED, 400, 0.6),
    }
    assert probe_finding("/dev/p", found).fix == "fte-sniff live /dev/p --baud 38400"
    assert "no common baud gives frames" in probe_finding("/dev/p", {}).what


FREE = PortListing("/dev/x", None, None, None, None, None, "n/a", None, True, ())


def test_a_port_is_free_busy_or_forbidden():
    busy = replace(FREE, holders=(Holder(7, "picocom"),))
    assert [port.state for port in (FREE, busy, replace(busy, permitted=False))] == [
        "free",
        "busy",
        "forbidden",
    ]


FOR_EVER_S = 60.0
SETTINGS = PortSettings()


def test_what_comes_is_heard_until_it_is_enough_and_nothing_is_written(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        pty.send(b"x" * 500)
        heard = listener.listen(FOR_EVER_S, 500)
    assert (heard.data, heard.line_errors) == (b"x" * 500, "")
    assert pty.arrived() == b""


def test_silence_is_heard_for_as_long_as_was_asked(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        assert listener.listen(0.05, 1).data == b""


def test_line_errors_are_reported_with_the_received_bytes(pty):
    counters = iter([LineErrorCounts(framing=3), LineErrorCounts(framing=5)])
    with LineListener(pty.device, SETTINGS) as listener:
        listener.errors = LineErrors(pty.device, lambda: next(counters))
        pty.send(b"abc")
        heard = listener.listen(FOR_EVER_S, 3)
    assert (heard.data, heard.line_errors) == (b"abc", "2 framing")


def test_a_sample_is_taken_at_another_baud_with_the_same_care(pty, until):
    with LineListener(pty.device, SETTINGS) as listener:
        found = []
        sampling = Work(lambda: found.append(listener.sample(57_600, FOR_EVER_S, 4)))
        until(lambda: pty.attributes()[4] == termios.B57600)
        # What comes at once may still be of the old baud, and is not taken.
        until(lambda: pty.send(b"\xff\x00\xff\xff") or found)
        sampling.ended()
        iflag, oflag, _, lflag, *_ = pty.attributes()
    assert set(found[0]) == {0xFF, 0x00}
    assert not iflag & (termios.BRKINT | termios.PARMRK | termios.IGNPAR | termios.ICRNL)
    assert not oflag & termios.OPOST
    assert not lflag & (termios.ECHO | termios.ICANON)
    assert pty.arrived() == b""


def test_a_port_that_goes_while_it_is_heard_is_one_line(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        Work(pty.unplug)
        with pytest.raises(PortError, match=r"was lost: .*; check cable and power"):
            listener.listen(FOR_EVER_S, 1)


def test_a_baud_that_a_port_cannot_have_is_passed_over():
    with LineListener("sim://?seed=1&rate=1000&wire=feedback", SETTINGS) as listener:
        assert len(listener.listen(FOR_EVER_S, 100).data) >= 100
        # A line of 9600 baud cannot carry what is simulated here.
        assert listener.sample(9600, FOR_EVER_S, 100) is None
        assert len(listener.sample(230_400, FOR_EVER_S, 100)) >= 100
