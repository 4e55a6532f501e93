"""The bridge between two real terminals: the test is the host program, and the controller."""

import fcntl
import os
import random
import select
import struct
import termios
import time
from collections import deque
from contextlib import closing
from dataclasses import dataclass, field

import pytest
import serial

from fte_sniff.capture.bridge import (
    DRIVER_BUFFER_BYTES,
    HOST,
    HOST_BUFFER_BYTES,
    Bridge,
    BridgeSource,
    HostEnd,
    PseudoTerminal,
    WireEvents,
    WireTimes,
    open_simulated,
    set_speed,
    speed_of,
)
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.simulation import SimulationParameters
from fte_sniff.capture.source import SourceEnd
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KIND_BY_NAME,
    MOTORS,
    Chunk,
    Frame,
    Framer,
    PortEvent,
    PortEventKind,
    byte_time_ns,
    encode,
)
from tests.beside import Work, held
from tests.waiting import BOUND_S, while_waiting

CLOCK = Clock.tied()
_TIOCGEXCL = 0x80045440


@dataclass
class Kept:
    """All that a bridge yields, taken by a thread of its own."""

    bridge: object
    items: list = field(default_factory=list)

    def __post_init__(self):
        self._work = Work(self._take)

    def _take(self):
        for item in self.bridge:
            self.items.append(item)

    def data(self, wire):
        return b"".join(i.data for i in list(self.items) if isinstance(i, Chunk) and i.port == wire)

    def events(self, wire):
        return [i for i in list(self.items) if isinstance(i, PortEvent) and i.port == wire]

    def kinds(self, wire):
        return [event.kind.value for event in self.events(wire)]

    def end(self):
        self.bridge.stop()
        self._work.ended()


@pytest.fixture
def bridges(pty, tmp_path):
    """Bridges in front of the pty, whose items are taken; all are closed in the end."""
    made = []

    def make(link=tmp_path / "link", **settings):
        kept = Kept(Bridge(pty.device, PortSettings(**settings), link, reconnect=False).open(CLOCK))
        made.append(kept)
        return kept

    yield make
    for kept in made:
        kept.end()


def opened(kept, baud=115200):
    return serial.Serial(kept.bridge.device, baud, timeout=BOUND_S)


def from_far(pty, count):
    """What has come to the controller's side, `count` bytes of it."""
    found = b""
    awaited = while_waiting(lambda: f"{count} bytes after {found!r}")
    while len(found) < count:
        next(awaited)
        found += pty.arrived(0.1)
    return found


def test_every_byte_is_passed_on_both_ways_and_kept_as_two_wires(bridges, pty, until):
    kept = bridges()
    there, back = random.Random(1).randbytes(50_000), random.Random(2).randbytes(50_000)
    with opened(kept) as host:
        until(lambda: kept.kinds(HOST) == ["opened"])
        received = []
        threads = [
            Work(host.write, there),
            Work(pty.send, back),
            Work(lambda: received.append(host.read(len(back)))),
        ]
        assert from_far(pty, len(there)) == there
        for thread in threads:
            thread.ended()
        assert received == [back]
    kept.end()
    assert kept.data(HOST) == there
    assert kept.data(pty.device) == back
    assert kept.kinds(pty.device) == ["opened", "closed"]
    assert kept.bridge.end is SourceEnd.STOPPED


def test_the_far_end_gets_nothing_but_what_the_host_program_writes(bridges, pty, until):
    kept = bridges()
    pty.send(b"echo me not\r\n" * 10)
    with opened(kept) as host:
        until(lambda: kept.kinds(HOST) == ["opened"])
        pty.send(b"nor me\r\n" * 10)
        until(lambda: kept.data(pty.device).endswith(b"nor me\r\n"))
        host.write(b"only this")
        assert from_far(pty, 9) == b"only this"
    kept.end()
    assert pty.arrived() == b""


def test_a_host_program_may_come_and_go_and_finds_nothing_old(bridges, pty, until):
    kept = bridges()
    for turn in range(3):
        pty.send(b"nobody hears this")
        until(lambda upto=turn: kept.data(pty.device).count(b"nobody") == upto + 1)
        with opened(kept) as host:
            until(lambda upto=turn: kept.kinds(HOST) == ["opened", "closed"] * upto + ["opened"])
            pty.send(b"%d" % turn)
            assert host.read(1) == b"%d" % turn
            host.write(b"!")
            assert from_far(pty, 1) == b"!"
            pty.send(b"unread")
            until(lambda upto=turn: kept.data(pty.device).count(b"unread") == upto + 1)
        until(lambda upto=turn: kept.kinds(HOST) == ["opened", "closed"] * (upto + 1))
    assert kept.data(HOST) == b"!!!"


def test_what_a_host_program_writes_before_it_leaves_is_passed_on(bridges, pty):
    kept = bridges()
    descriptor = os.open(kept.bridge.device, os.O_WRONLY | os.O_NOCTTY)
    os.write(descriptor, b"last words")
    os.close(descriptor)
    assert from_far(pty, 10) == b"last words"


def test_a_terminal_that_echoed_is_raw_again_for_the_next(bridges, pty, until):
    kept = bridges()
    with opened(kept) as host:
        attributes = termios.tcgetattr(host.fileno())
        attributes[3] |= termios.ECHO
        termios.tcsetattr(host.fileno(), termios.TCSANOW, attributes)
        until(lambda: kept.kinds(HOST) == ["opened"])
    until(lambda: kept.kinds(HOST) == ["opened", "closed"])
    descriptor = os.open(kept.bridge.device, os.O_RDWR | os.O_NOCTTY)
    try:
        assert not termios.tcgetattr(descriptor)[3] & termios.ECHO
    finally:
        os.close(descriptor)


@pytest.mark.parametrize("baud", [9600, 250_000, 3_000_000])
def test_the_baud_of_the_host_program_is_followed_and_reported(bridges, pty, until, baud):
    kept = bridges()
    assert speed_of(pty.near) == 115200
    with opened(kept, baud) as host:
        until(lambda: kept.kinds(HOST) == ["opened", "baud_changed"])
        assert speed_of(pty.near) == baud
        host.baudrate = 57600
        until(lambda: speed_of(pty.near) == 57600)
    kept.end()
    for wire in (HOST, pty.device):
        changes = [event for event in kept.events(wire) if event.kind is PortEventKind.BAUD_CHANGED]
        assert [change.count for change in changes] == [baud, 57600]
        assert f"{baud} baud" in changes[0].detail


def test_a_change_of_baud_comes_before_the_bytes_behind_it(bridges, pty, until):
    kept = bridges()
    with opened(kept) as host:
        host.write(b"slow")
        assert from_far(pty, 4) == b"slow"
        host.baudrate = 921_600
        host.write(b"quick")
        assert from_far(pty, 5) == b"quick"
    kept.end()
    reported = [
        item.data if isinstance(item, Chunk) else item.count
        for item in kept.items
        if item.port == HOST and (is_change(item) or (isinstance(item, Chunk) and item.data))
    ]
    assert reported == [b"slow", 921_600, b"quick"]


def is_change(item):
    return isinstance(item, PortEvent) and item.kind is PortEventKind.BAUD_CHANGED


def test_a_baud_that_the_port_refuses_is_reported_and_the_old_one_stays(tmp_path, until):
    wiring = Bridge("sim://?host=off&rate=1000", link=tmp_path / "link", reconnect=False)
    kept = Kept(wiring.open(CLOCK))
    with opened(kept, 300):
        until(lambda: kept.kinds(HOST) == ["opened", "not_passed_on"])
    kept.end()
    change = kept.events(HOST)[1]
    assert change.count == 0
    assert "300 baud is refused by the port" in change.detail


def test_a_hang_up_of_the_host_program_is_reported(bridges, pty, until):
    kept = bridges(dtr="on")
    with opened(kept) as host:
        attributes = termios.tcgetattr(host.fileno())
        attributes[4] = attributes[5] = termios.B0
        termios.tcsetattr(host.fileno(), termios.TCSANOW, attributes)
        until(lambda: kept.kinds(HOST) == ["opened", "baud_changed"])
        assert speed_of(pty.near) == 115200


def test_a_host_program_that_does_not_read_holds_up_nothing_and_is_reported(bridges, pty, until):
    kept = bridges()
    with opened(kept) as host:
        until(lambda: kept.kinds(HOST) == ["opened"])
        sent = random.Random(3).randbytes(2 * HOST_BUFFER_BYTES)
        pty.send(sent)
        until(lambda: len(kept.data(pty.device)) == len(sent))
        assert kept.data(pty.device) == sent
        until(lambda: kept.kinds(HOST) == ["opened", "not_passed_on"])
        assert "does not read" in kept.events(HOST)[1].detail
        # What it reads at last is the beginning, whole; and then the present again.
        old = bytearray(host.read(HOST_BUFFER_BYTES))
        until(lambda: old.extend(host.read(host.in_waiting)) or len(kept.events(HOST)) == 3)
        dropped = kept.events(HOST)[2]
        assert dropped.kind is PortEventKind.NOT_PASSED_ON
        old += host.read(len(sent) - dropped.count - len(old))
        assert len(old) == len(sent) - dropped.count
        assert sent.startswith(old)
        pty.send(b"now")
        assert host.read(3) == b"now"


def test_a_port_that_takes_nothing_holds_up_the_host_program_and_no_end(bridges, pty, until):
    kept = bridges()
    with opened(kept) as host:
        host.write_timeout = 0.5
        with pytest.raises(serial.SerialTimeoutException):
            host.write(b"x" * 10**6)
        pty.send(b"still heard")
        assert host.read(11) == b"still heard"
        kept.end()
    assert kept.bridge.end is SourceEnd.STOPPED
    (event,) = [event for event in kept.events(HOST) if event.kind is PortEventKind.NOT_PASSED_ON]
    assert event.count > 0
    # What is kept is what was put onto the line, not what was meant to be.
    line = b""
    while found := pty.arrived():
        line += found
    assert kept.data(HOST).startswith(line)


def test_a_lost_port_is_reported_and_hangs_up_the_host_program(bridges, pty, until, tmp_path):
    kept = bridges()
    with opened(kept) as host:
        until(lambda: kept.kinds(HOST) == ["opened"])
        pty.send(b"last words")
        assert host.read(10) == b"last words"
        pty.unplug()
        with pytest.raises(serial.SerialException):
            host.read(1)
    kept.end()
    assert kept.kinds(pty.device) == ["opened", "lost"]
    assert kept.data(pty.device) == b"last words"
    assert kept.bridge.end is SourceEnd.LOST
    assert not (tmp_path / "link").is_symlink()


def test_the_port_is_the_bridges_alone_while_it_runs(bridges, pty):
    kept = bridges()
    assert struct.unpack("I", fcntl.ioctl(pty.near, _TIOCGEXCL, bytes(4))) == (1,)
    with pytest.raises(PortError, match="busy"):
        Bridge(pty.device).open(CLOCK)
    kept.end()
    assert struct.unpack("I", fcntl.ioctl(pty.near, _TIOCGEXCL, bytes(4))) == (0,)


def test_another_program_at_the_port_is_pointed_out(bridges, pty, until):
    with held(pty.near) as other:
        kept = bridges()
        until(lambda: kept.kinds(pty.device) == ["opened"])
    detail = kept.events(pty.device)[0].detail
    assert f"a host program can open {kept.bridge.device}; 115200 baud" in detail
    assert f"sleep (pid {other.pid}) has it open too" in detail


def test_a_link_in_the_way_leaves_the_port_free(bridges, pty, tmp_path):
    (tmp_path / "link").write_text("mine")
    with pytest.raises(FileError, match="exists already"):
        bridges()
    bridges(link=tmp_path / "other")
    assert (tmp_path / "link").read_text() == "mine"


def test_what_is_written_at_stop_is_still_passed_on(bridges, pty, until):
    kept = bridges()
    with opened(kept) as host:
        until(lambda: kept.kinds(HOST) == ["opened"])
        host.write(b"just in time")
        kept.end()
    assert from_far(pty, 12) == b"just in time"
    assert kept.data(HOST) == b"just in time"


def test_bytes_leave_one_after_the_other_at_the_lines_pace():
    times, byte_ns = WireTimes(115200), byte_time_ns(115200)
    assert times.write(10, 0) == 10 * byte_ns
    assert times.write(10, 0) == 20 * byte_ns
    assert times.write(1, 10**9) == 10**9 + byte_ns
    times.set_baud(9600)
    assert times.write(1, 2 * 10**9) == 2 * 10**9 + byte_time_ns(9600)


def test_no_byte_is_timed_further_ahead_than_a_driver_holds():
    times = WireTimes(115200)
    for _ in range(100):
        latest = times.write(1000, 0)
    assert latest == DRIVER_BUFFER_BYTES * byte_time_ns(115200)


def test_control_is_timed_no_earlier_than_it_was_written(bridges, pty):
    kept = bridges()
    with opened(kept) as host:
        before_ns = CLOCK.now_ns()
        host.write(b"0123456789")
        from_far(pty, 10)
    kept.end()
    (chunk,) = [i for i in kept.items if isinstance(i, Chunk) and i.port == HOST and i.data]
    assert chunk.t_ns - 10 * byte_time_ns(115200) >= before_ns


def test_silence_is_reported_on_both_wires(bridges, pty, until):
    kept = bridges()
    until(lambda: {i.port for i in list(kept.items) if isinstance(i, Chunk)} == {HOST, pty.device})


def test_nothing_is_passed_on_before_somebody_is_ready_to_record_it(pty, tmp_path):
    bridge = Bridge(pty.device, link=tmp_path / "link", reconnect=False).open(CLOCK)
    with serial.Serial(bridge.device, 115200, timeout=BOUND_S) as host:
        host.write(b"early")
        assert pty.arrived(0.1) == b""
        with bridge:
            assert from_far(pty, 5) == b"early"
    items = list(bridge)
    assert b"".join(i.data for i in items if isinstance(i, Chunk) and i.port == HOST) == b"early"


def test_what_the_consumer_cannot_take_is_passed_on_all_the_same(pty, tmp_path, until):
    port = open_port(pty.device)
    bridge = BridgeSource(port, HostEnd(115200), WireEvents("port", 115200, CLOCK, 3000))
    with bridge, serial.Serial(bridge.device, 115200, timeout=BOUND_S) as host:
        host.write(b"x")
        from_far(pty, 1)
        for number in range(100):
            pty.send(bytes([number]) * 100)
            assert host.read(100) == bytes([number]) * 100
        bridge.close()
    items = list(bridge)
    kept = sum(len(i.data) for i in items if isinstance(i, Chunk) and i.port == "port")
    overruns = [
        i.count
        for i in items
        if isinstance(i, PortEvent) and i.kind is PortEventKind.OVERRUN and i.port == "port"
    ]
    assert kept + sum(overruns) == 10_000
    assert overruns
    assert not select.select([pty.far], [], [], 0)[0]


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
        self.bridge = Bridge(name, link=self.link).open(CLOCK)
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
        awaited = while_waiting(lambda: f"{kinds} of {wire}; there are {self.kinds}")
        while self.kinds[wire] != list(kinds):
            next(awaited)
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
        received = b""
        while len(received) < 5:
            received += pty.arrived(BOUND_S)
        assert received == b"there"
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


def test_a_hang_up_is_not_a_speed(pty):
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
