import termios
import threading

import pytest

from fte_sniff.capture.diagnostics import LineListener
from fte_sniff.capture.serial_port import LowLatency, PortCapabilities, PortSettings
from fte_sniff.capture.uart_errors import UartWatch
from fte_sniff.errors import PortError
from fte_sniff.protocol import LineErrorCounts

FOR_EVER_S = 60.0
SETTINGS = PortSettings()


def test_what_comes_is_heard_until_it_is_enough_and_nothing_is_written(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        pty.send(b"x" * 500)
        heard = listener.listen(FOR_EVER_S, 500)
    assert (heard.data, heard.line_errors) == (b"x" * 500, LineErrorCounts())
    assert pty.arrived() == b""


def test_silence_is_heard_for_as_long_as_was_asked(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        assert listener.listen(0.05, 1).data == b""


def test_line_errors_are_told_with_what_was_heard(pty):
    counted = [LineErrorCounts(framing=3), LineErrorCounts(framing=3), LineErrorCounts(framing=5)]
    counters = iter([*counted, *[counted[-1]] * 10_000])
    with LineListener(pty.device, SETTINGS) as listener:
        watch = UartWatch(lambda: next(counters))
        listener.granted = PortCapabilities(watch, LowLatency.ABSENT, None, False)
        pty.send(b"abc")
        heard = listener.listen(FOR_EVER_S, 3)
        heard_then = listener.listen(0.05, 1)
    assert heard.data == b"abc"
    assert (heard.line_errors + heard_then.line_errors) == LineErrorCounts(framing=2)


def test_a_sample_is_taken_at_another_baud_with_the_same_care(pty, until):
    with LineListener(pty.device, SETTINGS) as listener:
        found = []
        sampling = threading.Thread(
            target=lambda: found.append(listener.sample(57_600, FOR_EVER_S, 4))
        )
        sampling.start()
        until(lambda: pty.attributes()[4] == termios.B57600)
        # What comes at once may still be of the old baud, and is not taken.
        until(lambda: pty.send(b"\xff\x00\xff\xff") or found)
        sampling.join()
        iflag, oflag, _, lflag, *_ = pty.attributes()
    assert set(found[0]) == {0xFF, 0x00}
    assert not iflag & (termios.BRKINT | termios.PARMRK | termios.IGNPAR | termios.ICRNL)
    assert not oflag & termios.OPOST
    assert not lflag & (termios.ECHO | termios.ICANON)
    assert pty.arrived() == b""


def test_a_port_that_goes_while_it_is_heard_is_one_line(pty):
    with LineListener(pty.device, SETTINGS) as listener:
        threading.Timer(0.05, pty.unplug).start()
        with pytest.raises(PortError, match=r"was lost: .*; check cable and power"):
            listener.listen(FOR_EVER_S, 1)


def test_a_baud_that_a_port_cannot_have_is_passed_over():
    with LineListener("sim://?seed=1&rate=1000&wire=feedback", SETTINGS) as listener:
        assert len(listener.listen(FOR_EVER_S, 100).data) >= 100
        # A line of 9600 baud cannot carry what is simulated here.
        assert listener.sample(9600, FOR_EVER_S, 100) is None
        assert len(listener.sample(230_400, FOR_EVER_S, 100)) >= 100
