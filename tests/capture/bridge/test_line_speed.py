import os
import termios

import pytest
import serial

from fte_sniff.capture.pty import set_speed, speed_of


@pytest.mark.parametrize("baud", [50, 9600, 115200, 250_000, 921_600, 1_234_567, 3_000_000])
def test_either_end_shows_and_sets_any_speed(pty, baud):
    set_speed(pty.far, baud)
    assert speed_of(pty.far) == speed_of(pty.near) == baud
    set_speed(pty.near, 19200)
    assert speed_of(pty.far) == 19200


def test_what_a_program_sets_is_seen_and_nothing_else_is_changed(pty):
    with serial.Serial(pty.device, 57600):
        before = termios.tcgetattr(pty.near)
        assert speed_of(pty.far) == 57600
        set_speed(pty.far, 115200)
        after = termios.tcgetattr(pty.near)
    flags = slice(0, 4)
    speeds = termios.CBAUD | termios.CIBAUD
    before[2] &= ~speeds
    after[2] &= ~speeds
    assert before[flags] == after[flags]
    assert before[6] == after[6]


def test_a_hang_up_is_no_speed(pty):
    attributes = termios.tcgetattr(pty.near)
    attributes[4] = attributes[5] = termios.B0
    termios.tcsetattr(pty.near, termios.TCSANOW, attributes)
    assert speed_of(pty.far) == 0


def test_no_terminal_has_none(tmp_path):
    descriptor = os.open(tmp_path / "file", os.O_CREAT | os.O_RDWR)
    try:
        with pytest.raises(termios.error):
            speed_of(descriptor)
    finally:
        os.close(descriptor)
