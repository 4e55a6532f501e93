"""A bridge whose port is lost and comes back: real terminals behind a link such as udev keeps."""

import time

import pytest
import serial

from fte_sniff.capture.bridge import open_bridge
from fte_sniff.capture.bridge_io import HOST
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.pty import speed_of
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.capture.source import SourceEnd
from fte_sniff.protocol import Chunk, PortEvent

CLOCK = Clock.tied()
BOUND_S = 60.0


class Bridged:
    """A bridge in front of an adapter's link, and what it yields."""

    def __init__(self, folder):
        self.adapter, self.link = folder / "usb-FTDI-if00-port0", folder / "motors"
        self.kinds = {}
        self.data = {HOST: b""}
        self._folder = folder

    def start(self):
        name = str(self.adapter)
        self.kinds = {name: [], HOST: []}
        self.bridge = open_bridge(name, PortSettings(), CLOCK, self.link, reconnect=True)
        self._items = iter(self.bridge)

    def plug(self, pty):
        fresh = self._folder / "new"
        fresh.symlink_to(pty.device)
        fresh.rename(self.adapter)

    def pull(self, pty):
        self.adapter.unlink()
        pty.unplug()

    def until(self, wire, *kinds):
        """Take items until a wire's events are these."""
        deadline = time.monotonic() + BOUND_S
        while self.kinds[wire] != list(kinds):
            assert time.monotonic() < deadline, self.kinds
            self._take(next(self._items))

    def rest(self):
        for item in self._items:
            self._take(item)

    def _take(self, item):
        if isinstance(item, PortEvent):
            self.kinds[item.port].append(item.kind.value)
        elif isinstance(item, Chunk) and item.port == HOST:
            self.data[HOST] += item.data


@pytest.fixture
def bridged(tmp_path):
    made = Bridged(tmp_path)
    yield made
    made.bridge.close()


def talk(bridged, pty):
    with serial.Serial(str(bridged.link), 57600, timeout=BOUND_S) as host:
        host.write(b"there")
        heard = b""
        while len(heard) < 5:
            heard += pty.arrived(BOUND_S)
        assert heard == b"there"
        assert speed_of(pty.near) == 57600
        pty.send(b"back")
        assert host.read(4) == b"back"


def test_the_host_program_is_hung_up_and_comes_again_by_the_same_link(new_pty, bridged):
    first, second = new_pty(), new_pty()
    bridged.plug(first)
    bridged.start()
    port = str(bridged.adapter)
    with serial.Serial(str(bridged.link), 115200, timeout=BOUND_S) as host:
        bridged.until(HOST, "opened")
        bridged.pull(first)
        bridged.until(port, "opened", "lost")
        with pytest.raises(serial.SerialException):
            host.read(1)
        assert not bridged.link.is_symlink()
        bridged.plug(second)
        bridged.until(port, "opened", "lost", "found_again")
    talk(bridged, second)
    bridged.bridge.stop()
    bridged.rest()
    assert bridged.bridge.end is SourceEnd.STOPPED
    assert bridged.data[HOST] == b"there"
    assert bridged.kinds[HOST][:2] == ["opened", "closed"]
    assert not bridged.link.is_symlink()


def test_it_ends_while_it_waits(new_pty, bridged):
    pty = new_pty()
    bridged.plug(pty)
    bridged.start()
    port = str(bridged.adapter)
    bridged.pull(pty)
    bridged.until(port, "opened", "lost")
    bridged.bridge.stop()
    bridged.rest()
    assert bridged.kinds[port] == ["opened", "lost", "closed"]
    assert bridged.bridge.end is SourceEnd.STOPPED


def test_a_link_that_was_taken_meanwhile_ends_it(new_pty, bridged):
    first, second = new_pty(), new_pty()
    bridged.plug(first)
    bridged.start()
    bridged.pull(first)
    bridged.until(str(bridged.adapter), "opened", "lost")
    bridged.link.write_text("mine")
    bridged.plug(second)
    bridged.rest()
    assert bridged.kinds[str(bridged.adapter)] == ["opened", "lost", "lost"]
    assert bridged.bridge.end is SourceEnd.LOST
    assert bridged.link.read_text() == "mine"


def test_the_baud_begins_again_as_it_was_asked_for(new_pty, bridged):
    first, second = new_pty(), new_pty()
    bridged.plug(first)
    bridged.start()
    port = str(bridged.adapter)
    with serial.Serial(str(bridged.link), 9600):
        bridged.until(port, "opened", "baud_changed")
    bridged.pull(first)
    bridged.until(port, "opened", "baud_changed", "lost")
    bridged.plug(second)
    bridged.until(port, "opened", "baud_changed", "lost", "found_again", "baud_changed")
    assert speed_of(second.near) == 115200


def test_without_a_link_a_lost_port_is_the_end(new_pty, bridged, tmp_path):
    pty = new_pty()
    bridged.plug(pty)
    bridged.link = None
    bridged.start()
    bridged.pull(pty)
    bridged.rest()
    assert bridged.bridge.end is SourceEnd.LOST
    assert list(tmp_path.iterdir()) == []
