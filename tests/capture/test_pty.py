import os
import termios
import time
from collections import deque
from contextlib import closing

import pytest
import serial

from fte_sniff.capture.bridge import HOST, open_simulated
from fte_sniff.capture.pty import HostEnd, PseudoTerminal, set_speed, speed_of
from fte_sniff.capture.serial_port import open_port
from fte_sniff.capture.simulation import SimulationParameters
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KIND_BY_NAME,
    MOTORS,
    Chunk,
    Frame,
    Framer,
    encode,
)
from tests.beside import Work

ALONE = SimulationParameters(host="off", rate=1000)


@pytest.fixture
def device():
    """A simulated controller that runs in a thread."""
    with open_simulated(ALONE, DEFAULT_BAUD) as bridge:
        work = Work(lambda: deque(bridge, maxlen=0))
        yield bridge.device
        bridge.stop()
        work.ended()


class Listener:
    """What a host program knows of the motors."""

    def __init__(self, port):
        self.port, self.framer, self.speeds = port, Framer("host"), {}

    def hears(self, motor, rpm):
        data = self.port.read(self.port.in_waiting or 1)
        for row in self.framer.feed(Chunk("host", time.monotonic_ns(), data)):
            assert isinstance(row, Frame)
            self.speeds[row.values["motor"]] = row.values["rpm"]
        return set(self.speeds) == set(MOTORS) and abs(self.speeds[motor] - rpm) <= 1


def test_a_program_commands_it_through_the_device_and_hears_the_motors(device, until):
    with open_port(device) as port:
        listener = Listener(port)
        until(lambda: listener.hears(2, 0))
        port.write(encode(KIND_BY_NAME["speed"], {"motor": 2, "rpm": 700}))
        until(lambda: listener.hears(2, 700))
    assert listener.speeds[1] == 0


def test_a_program_may_come_and_go_and_find_what_is_then_true(device, until):
    for rpm in (300, -400):
        with open_port(device) as port:
            port.write(encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": rpm}))
            listener = Listener(port)
            until(lambda at=rpm, to=listener: to.hears(1, at))


def test_a_link_leads_to_the_device_while_it_is_there(tmp_path):
    link = tmp_path / "controller"
    with open_simulated(ALONE, DEFAULT_BAUD, link) as bridge:
        assert bridge.device == str(link)
        open_port(str(link)).close()
    assert not link.is_symlink()


def test_a_link_that_leads_nowhere_is_replaced_and_nothing_else_is(tmp_path):
    link = tmp_path / "controller"
    link.symlink_to("/dev/pts/no-such")
    with open_simulated(ALONE, DEFAULT_BAUD, link):
        assert link.exists()
    link.write_text("mine")
    with pytest.raises(FileError, match="exists already"):
        open_simulated(ALONE, DEFAULT_BAUD, link)
    assert link.read_text() == "mine"
    with pytest.raises(FileError, match="cannot be made"):
        open_simulated(ALONE, DEFAULT_BAUD, tmp_path / "no" / "such")
    link.unlink()
    link.symlink_to("/not/ours")
    with pytest.raises(FileError, match="exists already"):
        open_simulated(ALONE, DEFAULT_BAUD, link)
    assert str(link.readlink()) == "/not/ours"


def test_a_link_that_a_killed_run_left_is_replaced_though_its_number_is_given_again(
    tmp_path, until
):
    link = tmp_path / "controller"

    def is_replaced():
        link.unlink(missing_ok=True)
        with closing(PseudoTerminal(DEFAULT_BAUD)) as killed:
            link.symlink_to(killed.device)
        # What is made now gets the lowest free number: mostly the one that was just given back.
        try:
            with closing(PseudoTerminal(DEFAULT_BAUD, link)) as again:
                return str(link.readlink()) == again.device
        except FileError:  # another process of this machine was given the number meanwhile
            return False

    until(is_replaced)


def test_a_program_that_opens_the_link_as_soon_as_it_is_there_keeps_its_speed(tmp_path):
    class OpenedAtOnce(type(tmp_path)):
        def symlink_to(self, target, target_is_directory=False):
            super().symlink_to(target, target_is_directory)
            serial.Serial(target, 1200).close()

    with closing(HostEnd(DEFAULT_BAUD, OpenedAtOnce(tmp_path / "controller"))) as host:
        assert host.baud() == 1200


def test_a_link_that_was_taken_over_is_left_alone(tmp_path):
    link = tmp_path / "controller"
    with open_simulated(ALONE, DEFAULT_BAUD, link):
        link.unlink()
        link.symlink_to("/dev/null")
    assert str(link.readlink()) == "/dev/null"


def test_a_simulation_with_an_end_ends_it():
    with open_simulated(SimulationParameters(frames=5, rate=1000), DEFAULT_BAUD) as bridge:
        found = b"".join(one.data for one in bridge if isinstance(one, Chunk) and one.port != HOST)
    assert len(found) == 5 * FRAME_LENGTH


def test_a_rate_that_the_line_cannot_carry_is_refused():
    with pytest.raises(PortError, match="at most 96"):
        open_simulated(ALONE, 9600)


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
