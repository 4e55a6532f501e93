"""The bridge between two real terminals: the test is the host program, and the controller."""

from __future__ import annotations

import fcntl
import os
import random
import select
import struct
import termios
import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial

from fte_sniff.capture.bridge import DRIVER_BUFFER_BYTES, REPORT_NS, HostEnd
from fte_sniff.capture.serial_port import open_port
from fte_sniff.capture.source import HOST, Source
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import KIND_BY_NAME, MOTORS, byte_time_ns, encode
from tests.beside import Work
from tests.capture.seen import CLOCK, Adapter, Seen
from tests.pseudo_terminals import Pty
from tests.support.columns import fed
from tests.support.speeds import speed_of
from tests.waiting import BOUND_S, wait_until, while_waiting

_TIOCGEXCL = 0x80045440


def bridge_to(port: str, link: Path | None = None) -> Source:
    name = None if link is None else str(link)
    return Wiring([port], way="bridge", link=name, reconnect=False).open(CLOCK)


@pytest.fixture
def bridged(pty, tmp_path) -> Iterator[Seen]:
    """A bridge in front of the terminal, whose items are taken."""
    source = Wiring([pty.device], way="bridge", link=str(tmp_path / "link"), reconnect=False).open(
        CLOCK
    )
    with Seen(source) as seen:
        yield seen


def host_of(seen: Seen, baud: int = 115200) -> serial.Serial:
    return serial.Serial(seen.source.device, baud, timeout=BOUND_S)


def from_far(pty: Pty, count: int) -> bytes:
    """What has come to the controller's side, `count` bytes of it."""
    found = b""
    awaited = while_waiting(lambda: f"{count} bytes after {found!r}")
    while len(found) < count:
        next(awaited)
        found += pty.arrived(0.1)
    return found


def test_every_byte_is_forwarded_both_ways_and_kept_as_two_wires(bridged, pty) -> None:
    there, back = random.Random(1).randbytes(50_000), random.Random(2).randbytes(3000)
    with host_of(bridged) as host:
        bridged.wait_for("opened", wire=HOST)
        received = list[bytes]()
        threads = [
            Work(host.write, there),
            Work(lambda: received.append(host.read(len(back)))),
            Work(pty.send, back),
        ]
        assert from_far(pty, len(there)) == there
        for thread in threads:
            thread.ended()
        assert received == [back]
    bridged.end()
    assert bridged.data(HOST) == there
    assert bridged.data(pty.device) == back
    assert bridged.kinds(pty.device) == ["opened", "closed"]
    assert bridged.source.lost is None


def test_controller_gets_only_what_the_host_program_writes(bridged, pty) -> None:
    pty.send(b"echo me not\r\n" * 10)
    with host_of(bridged) as host:
        bridged.wait_for("opened", wire=HOST)
        pty.send(b"nor me\r\n" * 10)
        bridged.wait(lambda s: s.data(pty.device).endswith(b"nor me\r\n"))
        host.write(b"only this")
        assert from_far(pty, 9) == b"only this"
    bridged.end()
    assert pty.arrived() == b""


def test_host_program_may_come_and_go_and_finds_nothing_old(bridged, pty) -> None:
    for turn in range(3):
        pty.send(b"nobody listens")
        bridged.wait(lambda s, turn=turn: s.data(pty.device).count(b"nobody") == turn + 1)
        with host_of(bridged) as host:
            bridged.wait_for("opened", turn + 1, HOST)
            pty.send(b"%d" % turn)
            assert host.read(1) == b"%d" % turn
            host.write(b"!")
            assert from_far(pty, 1) == b"!"
            pty.send(b"unread")
            bridged.wait(lambda s, turn=turn: s.data(pty.device).count(b"unread") == turn + 1)
        bridged.wait_for("closed", turn + 1, HOST)
    assert bridged.data(HOST) == b"!!!"


@pytest.mark.parametrize("openings", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_bytes_at_the_opening_of_a_host_reach_it(bridged, pty, openings: int) -> None:
    """Both ends write at once, whether or not the bridge has seen the program yet."""
    turns = random.Random(4)
    for turn in range(openings):
        there, back = b"there %d!" % turn, b"back %d!" % turn
        host = os.open(bridged.source.device, os.O_RDWR | os.O_NOCTTY)
        writes = [partial(pty.send, back), partial(os.write, host, there)]
        for write in turns.sample(writes, 2):
            write()
        assert from_far(pty, len(there)) == there
        received = b""
        for _ in while_waiting(lambda back=back: back):
            if select.select([host], [], [], 0.1)[0]:
                received += os.read(host, 100)
            if len(received) == len(back):
                break
        os.close(host)
        assert received == back
        if turns.random() < 0.5:
            bridged.wait(lambda s: s.kinds(HOST)[-1:] == ["closed"])
    bridged.end()
    assert bridged.data(HOST) == b"".join(b"there %d!" % turn for turn in range(openings))
    assert bridged.data(pty.device) == b"".join(b"back %d!" % turn for turn in range(openings))
    assert not any(event.count for event in bridged.events())


def test_terminal_that_echoed_is_raw_again_for_the_next(bridged) -> None:
    with host_of(bridged) as host:
        attributes = termios.tcgetattr(host.fileno())
        attributes[3] |= termios.ECHO
        termios.tcsetattr(host.fileno(), termios.TCSANOW, attributes)
        bridged.wait_for("opened", wire=HOST)
    bridged.wait_for("closed", wire=HOST)
    descriptor = os.open(bridged.source.device, os.O_RDWR | os.O_NOCTTY)
    try:
        assert not termios.tcgetattr(descriptor)[3] & termios.ECHO
    finally:
        os.close(descriptor)


def test_port_keeps_its_baud_whatever_the_host_program_sets(bridged, pty) -> None:
    with host_of(bridged, 9600) as host:
        host.write(b"there")
        assert from_far(pty, 5) == b"there"
        assert speed_of(pty.near) == 115200


def test_bytes_that_a_host_program_does_not_read_are_counted(bridged, pty) -> None:
    with host_of(bridged) as host:
        bridged.wait_for("opened", wire=HOST)
        sent = random.Random(3).randbytes(100_000)
        Work(pty.send, sent)
        bridged.wait(lambda s: len(s.data(pty.device)) == len(sent))
        assert bridged.data(pty.device) == sent
        old = b""
        while select.select([host.fileno()], [], [], 0)[0]:
            old += host.read(host.in_waiting)
        bridged.end()
    reports = [one for one in bridged.events(HOST) if one.kind == "not_passed_on"]
    assert len(old) + sum(one.count for one in reports) == len(sent)
    # What it reads at last is the beginning, whole, and what came when there was room again.
    first = next((n for n, (a, b) in enumerate(zip(old, sent, strict=False)) if a != b), len(old))
    assert first >= 1024
    assert old[first:] in sent[first:]
    # One a second, from the first byte on, and one at the end.
    lasted_ns = reports[-1].t_ns - bridged.chunks(pty.device)[0].t_ns
    assert len(reports) <= 2 + lasted_ns // REPORT_NS


def test_port_that_accepts_nothing_holds_up_only_the_host_program(bridged, pty) -> None:
    with host_of(bridged) as host:
        host.write_timeout = 0.5
        with pytest.raises(serial.SerialTimeoutException):
            host.write(b"x" * 10**6)
        pty.send(b"still received")
        assert host.read(14) == b"still received"
        bridged.end()
    assert bridged.source.lost is None
    (event,) = [one for one in bridged.events(HOST) if one.kind == "not_passed_on"]
    assert event.count > 0
    line = b""
    while found := pty.arrived():
        line += found
    # What is recorded is what is on the line, not what was meant to be.
    assert bridged.data(HOST).startswith(line)


def test_port_is_the_bridges_alone_while_it_runs(bridged, pty) -> None:
    assert struct.unpack("I", fcntl.ioctl(pty.near, _TIOCGEXCL, bytes(4))) == (1,)
    with pytest.raises(PortError, match="busy"):
        Wiring([pty.device], way="bridge").open(CLOCK)
    bridged.end()
    assert struct.unpack("I", fcntl.ioctl(pty.near, _TIOCGEXCL, bytes(4))) == (0,)


def test_what_is_written_at_stop_is_still_forwarded(bridged, pty) -> None:
    with host_of(bridged) as host:
        bridged.wait_for("opened", wire=HOST)
        host.write(b"just in time")
        bridged.end()
    assert from_far(pty, 12) == b"just in time"
    assert bridged.data(HOST) == b"just in time"


def test_written_bytes_have_the_time_at_which_they_leave_the_line(bridged, pty) -> None:
    byte_ns = byte_time_ns(115200)
    with host_of(bridged) as host:
        before_ns = CLOCK.now_ns()
        for _ in range(5):
            host.write(b"0123456789")
        from_far(pty, 50)
        bridged.wait(lambda s: len(s.data(HOST)) == 50)
        after_ns = CLOCK.now_ns()
    chunks = bridged.chunks(HOST)
    # One after the other at the pace of the line, and no further ahead than a driver holds.
    ends = [chunk.t_ns or 0 for chunk in chunks]
    for before, after, chunk in zip(ends, ends[1:], chunks[1:], strict=False):
        assert after - before >= len(chunk.data) * byte_ns
    assert ends[0] - len(chunks[0].data) * byte_ns >= before_ns
    assert ends[-1] <= after_ns + DRIVER_BUFFER_BYTES * byte_ns


def test_nothing_is_forwarded_before_it_can_be_recorded(pty, tmp_path) -> None:
    bridge = Wiring([pty.device], way="bridge", link=str(tmp_path / "link"), reconnect=False).open(
        CLOCK
    )
    with serial.Serial(bridge.device, 115200, timeout=BOUND_S) as host:
        host.write(b"early")
        assert pty.arrived(0.1) == b""
        with Seen(bridge) as seen:
            assert from_far(pty, 5) == b"early"
    assert seen.data(HOST) == b"early"


# A bridge whose port is lost


@pytest.fixture
def adapter(tmp_path) -> Adapter:
    return Adapter(tmp_path)


def bridge_at(adapter: Adapter) -> Seen:
    return Seen(Wiring([adapter.name], way="bridge", link=str(adapter.link)).open(CLOCK))


def test_host_program_is_hung_up_and_comes_again_by_the_same_link(new_pty, adapter) -> None:
    first, second = new_pty(), new_pty()
    adapter.plug(first)
    with bridge_at(adapter) as seen:
        with host_of(seen) as host:
            seen.wait_for("opened", wire=HOST)
            adapter.pull(first)
            seen.wait_for("lost")
            with pytest.raises(serial.SerialException):
                host.read(1)
            assert not adapter.link.is_symlink()
            adapter.plug(second)
            seen.wait_for("found_again")
        with host_of(seen) as host:
            host.write(b"there")
            assert from_far(second, 5) == b"there"
            second.send(b"back")
            assert host.read(4) == b"back"
    assert seen.kinds(adapter.name) == ["opened", "lost", "found_again", "closed"]
    assert seen.kinds(HOST)[:3] == ["opened", "closed", "opened"]
    assert not adapter.link.is_symlink()


def test_link_that_was_taken_meanwhile_ends_the_bridge(new_pty, adapter) -> None:
    first, second = new_pty(), new_pty()
    adapter.plug(first)
    seen = bridge_at(adapter)
    adapter.pull(first)
    seen.wait_for("lost")
    adapter.link.write_text("mine")
    adapter.plug(second)
    seen.ended()
    assert seen.kinds(adapter.name) == ["opened", "lost", "lost"]
    assert seen.source.lost is not None
    assert adapter.link.read_text() == "mine"


# The simulated controller, and the link

ALONE = "sim://?host=off&rate=1000"


def test_program_commands_the_controller_and_receives_its_feedback() -> None:
    framer, speeds = Framer("host"), dict[int, int]()

    def turns(port: serial.Serial, motor: int, rpm: int) -> bool:
        data = port.read(port.in_waiting or 1)
        for row in fed(framer, Chunk("host", time.monotonic_ns(), data)):
            assert row.framed
            speeds[row.values["motor"]] = row.values["rpm"]
        return set(speeds) == set(MOTORS) and abs(speeds[motor] - rpm) <= 1

    with bridge_to(ALONE) as bridge:
        work = Work(lambda: deque(bridge, maxlen=0))
        with open_port(bridge.device) as port:
            wait_until(lambda: turns(port, 2, 0))
            port.write(encode(KIND_BY_NAME["speed"], {"motor": 2, "rpm": 700}))
            wait_until(lambda: turns(port, 2, 700))
        bridge.stop()
        work.ended()
    assert speeds[1] == 0


def identity(link: Path) -> tuple[int, ...]:
    """What differs after a change, and not after a look."""
    found = os.lstat(link)
    return found.st_ino, found.st_size, found.st_mtime_ns


def test_only_a_link_to_a_terminal_that_is_gone_is_replaced(tmp_path) -> None:
    link = tmp_path / "controller"
    link.symlink_to("/dev/pts/no-such")
    with bridge_to(ALONE, link):
        assert link.exists()
    with pytest.raises(FileError, match="cannot be made"):
        bridge_to(ALONE, tmp_path / "no" / "such")
    for make in (lambda: link.write_text("mine"), lambda: link.symlink_to("/not/ours")):
        make()
        before = identity(link)
        with pytest.raises(FileError, match="exists already"):
            bridge_to(ALONE, link)
        assert identity(link) == before
        link.unlink()


def test_stale_link_is_replaced_though_its_number_is_given_again(tmp_path) -> None:
    link = tmp_path / "controller"

    def is_replaced() -> bool:
        link.unlink(missing_ok=True)
        killed = HostEnd()
        link.symlink_to(killed.name)
        killed.close()
        # What is made now gets the lowest free number: mostly the one that was just given back.
        try:
            again = HostEnd(link)
        except FileError:  # another process of this machine was given the number meanwhile
            return False
        again.close()
        return not link.is_symlink()

    wait_until(is_replaced)


def test_link_that_was_taken_over_is_left_alone(tmp_path) -> None:
    link = tmp_path / "controller"
    with bridge_to(ALONE, link):
        link.unlink()
        link.symlink_to("/dev/null")
    assert str(link.readlink()) == "/dev/null"
