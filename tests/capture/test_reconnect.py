"""Ports that are lost and come back: real pseudo-terminals behind a link, and real servers."""

import os
import threading

import pytest
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff.capture import reconnect
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import open_source
from fte_sniff.capture.reconnect import (
    FIRST_WAIT_S,
    LONGEST_WAIT_S,
    Reconnector,
    SameName,
    UsbIdentity,
    identity_of,
)
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.source import SourceEnd
from fte_sniff.errors import PortError
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind
from tests.beside import Work, held, server_socket
from tests.waiting import BOUND_S, condition_text, while_waiting

CLOCK = Clock.tied()
OTHER = ("tail", "-f", "/dev/null")


@pytest.fixture
def adapter(tmp_path):
    """A link such as udev keeps, and a way to point it at a terminal."""

    class Adapter:
        name = str(tmp_path / "usb-FTDI-if00-port0")

        def plug(self, pty):
            fresh = tmp_path / "new"
            fresh.symlink_to(pty.device)
            fresh.rename(self.name)

        def pull(self, pty):
            os.unlink(self.name)  # noqa: PTH108
            pty.unplug()

    return Adapter()


@pytest.fixture
def opened():
    sources = []

    def opens(name):
        sources.append(open_source(name, PortSettings(), CLOCK, reconnect=True))
        return sources[-1]

    yield opens
    for source in sources:
        source.close()


class Received:
    """What came from a source so far."""

    def __init__(self, source):
        self._items = iter(source)
        self.data = b""
        self.events = []
        self.times = []

    def until(self, holds):
        awaited = while_waiting(lambda: f"{condition_text(holds)} after {self.events}")
        while not holds(self):
            next(awaited)
            item = next(self._items)
            self.times.append(item.t_ns)
            if isinstance(item, Chunk):
                self.data += item.data
            else:
                self.events.append(item)

    def until_event(self, kind):
        self.until(lambda received: received.events and received.events[-1].kind is kind)
        return self.events[-1]

    def rest(self):
        return list(self._items)


def test_an_adapter_that_comes_back_under_another_name_goes_on(new_pty, adapter, opened):
    first, second = new_pty(), new_pty()
    adapter.plug(first)
    source = opened(adapter.name)
    received = Received(source)
    first.send(b"before")
    received.until(lambda h: h.data == b"before")
    adapter.pull(first)
    lost = received.until_event(PortEventKind.LOST)
    assert lost.detail.endswith("waiting for it to come back")
    assert source.end is None
    second.send(b"not yet")
    adapter.plug(second)
    found = received.until_event(PortEventKind.FOUND_AGAIN)
    assert found.detail.endswith(f" s as {second.device}")
    # The events are stamped a little before and after what is reported, which is rounded to 0.1 s.
    told_s = float(found.detail.split()[1])
    # Nobody waits for the times of a port that is away.
    assert any(lost.t_ns < t_ns < found.t_ns for t_ns in received.times)
    assert FIRST_WAIT_S - 0.06 <= told_s <= (found.t_ns - lost.t_ns) / 1e9 + 0.06
    second.send(b" and after")
    # What came before it was opened again is not the wire's any more.
    received.until(lambda h: h.data.endswith(b"after"))
    assert received.data == b"before and after"
    assert received.times == sorted(received.times)
    source.stop()
    assert received.rest()[-1].kind is PortEventKind.CLOSED
    assert source.end is SourceEnd.STOPPED


def test_it_comes_back_as_often_as_it_goes(new_pty, adapter, opened):
    pty = new_pty()
    adapter.plug(pty)
    source = opened(adapter.name)
    received = Received(source)
    for number in range(3):
        sent = b"%d" % number
        pty.send(sent)
        received.until(lambda h, sent=sent: h.data.endswith(sent))
        adapter.pull(pty)
        received.until_event(PortEventKind.LOST)
        pty = new_pty()
        adapter.plug(pty)
        received.until_event(PortEventKind.FOUND_AGAIN)
    assert received.data == b"012"
    assert source.bytes_read == 3


def test_time_goes_on_while_it_is_waited_for_and_stop_ends_it_at_once(new_pty, adapter, opened):
    pty = new_pty()
    adapter.plug(pty)
    source = opened(adapter.name)
    received = Received(source)
    adapter.pull(pty)
    lost = received.until_event(PortEventKind.LOST)
    received.until(lambda h: h.times[-1] > lost.t_ns + 200_000_000)
    beats = [t_ns for t_ns in received.times if t_ns > lost.t_ns]
    assert len(beats) < 20
    source.stop()
    *beats, closed = received.rest()
    assert len(beats) <= 1
    assert closed.kind is PortEventKind.CLOSED
    assert source.end is SourceEnd.STOPPED


def test_a_server_that_comes_back_is_found_again(opened):
    with server_socket() as server:
        host, number = server.getsockname()
        source = opened(f"socket://{host}:{number}")
        received = Received(source)
        connection, _ = server.accept()
        connection.sendall(b"one")
        connection.close()
        assert "hung up" in received.until_event(PortEventKind.LOST).detail
        # It connects again by itself.
        connection, _ = server.accept()
        found = received.until_event(PortEventKind.FOUND_AGAIN)
        assert " as " not in found.detail
        connection.sendall(b"two")
        received.until(lambda h: h.data == b"onetwo")
        connection.close()


def test_a_server_that_hangs_up_at_once_is_asked_slowly(opened):
    with server_socket() as server:

        def serve():
            for _ in range(3):
                server.accept()[0].close()

        serving = Work(serve)
        received = Received(opened(f"socket://127.0.0.1:{server.getsockname()[1]}"))
        kinds = [PortEventKind.LOST, PortEventKind.FOUND_AGAIN]
        received.until(lambda h: [e.kind for e in h.events[1:]] == kinds * 2)
        serving.ended()
    lost = [event.t_ns for event in received.events if event.kind is PortEventKind.LOST]
    found = [event.t_ns for event in received.events if event.kind is PortEventKind.FOUND_AGAIN]
    waits_s = [(after - before) / 1e9 for before, after in zip(lost, found, strict=True)]
    assert waits_s[0] > FIRST_WAIT_S - 0.01
    assert min(waits_s[1:]) > LONGEST_WAIT_S - 0.01


def test_a_server_that_takes_no_connection_does_not_hold_up_the_end(opened, monkeypatch):
    connecting, closed, held_up = threading.Event(), threading.Event(), threading.Event()

    def open_when_closed(name, settings):
        connecting.set()
        if not closed.wait(BOUND_S):
            held_up.set()
        raise PortError("{name} takes no connection", name=name)

    monkeypatch.setattr(reconnect, "open_port", open_when_closed)
    with server_socket() as server:
        source = opened(f"socket://127.0.0.1:{server.getsockname()[1]}")
        received = Received(source)
        connection, _ = server.accept()
        connection.close()
        received.until(lambda _: connecting.is_set())
        source.close()
        closed.set()
    assert not held_up.is_set()


def test_a_reconnector_that_waits_ends_when_it_is_cancelled():
    def reopen():
        raise AssertionError("it was cancelled before its first attempt")

    before = set(threading.enumerate())
    reconnector = Reconnector(reopen, first_wait_s=2 * BOUND_S)
    (waiting,) = set(threading.enumerate()) - before
    reconnector.cancel()
    waiting.join(BOUND_S)
    assert not waiting.is_alive()


def test_a_link_left_behind_does_not_open_somebodys_terminal(new_pty, adapter, opened):
    pty = new_pty()
    adapter.plug(pty)
    received = Received(opened(adapter.name))
    adapter.pull(pty)
    lost = received.until_event(PortEventKind.LOST)
    theirs = new_pty()
    with held(theirs.near) as user:
        before = theirs.attributes()
        adapter.plug(theirs)
        refused = received.until_event(PortEventKind.NOT_OPENED)
        assert refused.detail.startswith("it is back, but ")
        assert f"(pid {user.pid}) has it open; close that" in refused.detail
        # Once is enough.
        received.until(lambda h: h.times[-1] > lost.t_ns + 4_000_000_000)
        assert received.events[-1] is refused
        assert theirs.attributes() == before
        user.terminate()
    received.until_event(PortEventKind.FOUND_AGAIN)


@pytest.fixture
def lost(new_pty, adapter, opened):
    """What comes from a port that is lost, whose terminal a program had open."""
    pty = new_pty()
    adapter.plug(pty)
    with held(pty.near):
        received = Received(opened(adapter.name))
        adapter.pull(pty)
        received.until_event(PortEventKind.LOST)
    return received


def test_a_terminal_that_the_same_program_makes_again_is_opened(new_pty, adapter, lost):
    again = new_pty()
    with held(again.near):
        adapter.plug(again)
        lost.until_event(PortEventKind.FOUND_AGAIN)
        assert PortEventKind.NOT_OPENED not in [event.kind for event in lost.events]


def test_another_program_beside_the_known_one_is_named_alone(new_pty, adapter, lost):
    again = new_pty()
    with held(again.near), held(again.near, *OTHER) as other:
        adapter.plug(again)
        refused = lost.until_event(PortEventKind.NOT_OPENED)
        assert f"tail (pid {other.pid}) has it open; close that" in refused.detail
        other.terminate()
        lost.until_event(PortEventKind.FOUND_AGAIN)


def test_a_port_that_is_back_but_busy_is_reported(new_pty, adapter, opened):
    pty, again = new_pty(), new_pty()
    adapter.plug(pty)
    received = Received(opened(adapter.name))
    adapter.pull(pty)
    received.until_event(PortEventKind.LOST)
    holder = open_port(again.device)
    adapter.plug(again)
    assert " is busy: " in received.until_event(PortEventKind.NOT_OPENED).detail
    holder.close()
    received.until_event(PortEventKind.FOUND_AGAIN)


def test_a_port_that_cannot_return_ends(pty):
    source = open_source(pty.device, PortSettings(), CLOCK, reconnect=True)
    Work(pty.unplug)
    kinds = [item.kind for item in source if isinstance(item, PortEvent)]
    assert kinds == [PortEventKind.OPENED, PortEventKind.LOST]
    assert source.end is SourceEnd.LOST


def usb(device, serial_number="A1", location="1-1.2", vid=0x0403, pid=0x6001):
    port = ListPortInfo(device, skip_link_detection=True)
    port.vid, port.pid = vid, pid
    port.serial_number, port.location = serial_number, location
    return port


def uart(device):
    return ListPortInfo(device, skip_link_detection=True)


# What was plugged in when ttyUSB0 was opened, what is plugged in later, and what it is then.
USB_CASES = {
    "back under its name": ([usb("/dev/ttyUSB0")], [usb("/dev/ttyUSB0")], "/dev/ttyUSB0"),
    "another name": ([usb("/dev/ttyUSB0")], [usb("/dev/ttyUSB3")], "/dev/ttyUSB3"),
    "another socket": (
        [usb("/dev/ttyUSB0")],
        [usb("/dev/ttyUSB1", location="2-4")],
        "/dev/ttyUSB1",
    ),
    "another adapter under its name": (
        [usb("/dev/ttyUSB0")],
        [usb("/dev/ttyUSB0", "B2"), usb("/dev/ttyUSB1", "A1", "1-3")],
        "/dev/ttyUSB1",
    ),
    "only another adapter": ([usb("/dev/ttyUSB0")], [usb("/dev/ttyUSB0", "B2")], None),
    "another product of that serial": (
        [usb("/dev/ttyUSB0")],
        [usb("/dev/ttyUSB0", pid=0x6015)],
        None,
    ),
    "away": ([usb("/dev/ttyUSB0")], [uart("/dev/ttyS0")], None),
    "no serial, same socket": (
        [usb("/dev/ttyUSB0", None)],
        [usb("/dev/ttyUSB1", None, "1-3"), usb("/dev/ttyUSB2", None)],
        "/dev/ttyUSB2",
    ),
    "no serial, another socket": (
        [usb("/dev/ttyUSB0", None)],
        [usb("/dev/ttyUSB0", None, "1-3")],
        None,
    ),
    "a serial that two share": (
        [usb("/dev/ttyUSB0"), usb("/dev/ttyUSB1", location="1-3")],
        [usb("/dev/ttyUSB1", location="1-3")],
        None,
    ),
    "one of an adapter's ports": (
        [
            usb("/dev/ttyUSB0", location="1-1:1.0"),
            usb("/dev/ttyUSB1", location="1-1:1.1"),
        ],
        [
            usb("/dev/ttyUSB4", location="1-2:1.1"),
            usb("/dev/ttyUSB5", location="1-2:1.0"),
        ],
        "/dev/ttyUSB5",
    ),
}


@pytest.mark.parametrize(("before", "later", "found"), USB_CASES.values(), ids=USB_CASES)
def test_a_usb_adapter_is_known_by_serial_or_place_never_by_name(before, later, found):
    identity = identity_of("/dev/ttyUSB0", "/dev/ttyUSB0", before)
    assert isinstance(identity, UsbIdentity)
    assert identity.find(later) == found


def test_hwgrep_is_the_adapter_that_it_found():
    ports = [usb("/dev/ttyUSB0")]
    identity = identity_of("hwgrep://0403", "/dev/ttyUSB0", ports)
    assert identity.find([usb("/dev/ttyUSB7")]) == "/dev/ttyUSB7"


def test_a_link_is_followed_to_whatever_it_leads_to(tmp_path):
    link = tmp_path / "usb-FTDI-if00"
    link.symlink_to("/dev/ttyUSB0")
    identity = identity_of(str(link), "/dev/ttyUSB0", [usb("/dev/ttyUSB0")])
    assert identity == SameName(str(link))
    link.unlink()
    assert identity.find([]) is None
    link.symlink_to("/dev/null")
    assert identity.find([]) == str(link)


def test_a_uart_of_the_board_has_its_name():
    identity = identity_of("/dev/null", "/dev/null", [uart("/dev/null")])
    assert identity.find([]) == "/dev/null"


@pytest.mark.parametrize(
    ("name", "known"),
    [
        ("socket://host:1", True),
        ("RFC2217://host:1", True),
        ("sim://?frames=3", False),
        ("loop://", False),
    ],
)
def test_a_server_can_return_and_a_simulated_line_cannot(name, known):
    identity = identity_of(name, None, [])
    assert (identity is not None) is known
    if known:
        assert identity.find([]) == name


def test_a_bare_pseudo_terminal_cannot_its_number_is_given_away(pty):
    assert identity_of(pty.device, pty.device, []) is None
