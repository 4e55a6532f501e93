"""The latency of a port, from what the system knows about its driver."""

import os
import socket
import termios

import pytest
import serial

from fte_sniff.capture.port_errors import port_error
from fte_sniff.capture.serial_port import (
    FIFO_BYTES,
    HOST_NS,
    USB_FRAME_NS,
    USB_UNKNOWN_NS,
    PortSettings,
    device_of,
    max_latency_ns,
    open_port,
)
from fte_sniff.capture.url_handlers import protocol_socket
from fte_sniff.errors import PortError, ValueRangeError
from fte_sniff.protocol.spec import byte_time_ns
from tests.beside import Work, server_socket


def message_of(name, settings=PortSettings()):  # noqa: B008
    with pytest.raises(PortError) as refused:
        open_port(name, settings)
    message = str(refused.value)
    assert message.isprintable()
    return message


def test_a_terminal_is_opened_raw_8n1_at_the_baud_asked_for(pty):
    attributes = pty.attributes()
    attributes[0] |= termios.BRKINT | termios.IXON | termios.ICRNL | termios.ISTRIP
    attributes[1] |= termios.OPOST
    attributes[3] |= termios.ECHO | termios.ICANON | termios.ISIG
    termios.tcsetattr(pty.near, termios.TCSANOW, attributes)
    with open_port(pty.device, PortSettings(baud=921_600)) as port:
        iflag, oflag, cflag, lflag, ispeed, ospeed, _ = pty.attributes()
        discarding = termios.BRKINT | termios.IXON | termios.ICRNL | termios.ISTRIP | termios.IGNPAR
        assert iflag & discarding == 0
        assert oflag & termios.OPOST == 0
        assert cflag & (termios.CSIZE | termios.PARENB | termios.CSTOPB) == termios.CS8
        assert lflag & (termios.ECHO | termios.ICANON | termios.ISIG) == 0
        assert (ispeed, ospeed) == (termios.B921600, termios.B921600)
        assert device_of(port) == pty.device


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("/dev/no-such-port", ["/dev/no-such-port: no such port;"]),
        ("no-such-port", ["no-such-port: no such port;"]),
        ("", ["empty name"]),
        ("/tmp", ["/tmp is not a serial port; "]),
        (__file__, ["is not a serial port"]),
        (f"{__file__}/x", ["is not a serial port"]),
        ("/dev/null", ["/dev/null is not a serial port"]),
        ("/dev/\x1b[2J", [r"/dev/\x1b[2J: no such port"]),
        ("a\0b", [r"a\x00b cannot be opened"]),
        ("foo://bar", ["foo://bar: no such kind of port", "sim://", "socket://", "loop://"]),
        ("sim://?sed=1", ["it has seed, rate"]),
        ("sim://?rate=9999", ["at most 1152 frames/s"]),
        ("SIM://?drop=7", ["drop=7", "0<=x<=1"]),
        ("socket://localhost", ["no host and TCP port", "socket://192.168.0.7:4001"]),
        ("socket://localhost:99999", ["cannot be opened"]),
        ("rfc2217://:1", ["no host and TCP port", "rfc2217://192.168.0.7:4001"]),
        ("hwgrep://no-such-thing", ["no ports found"]),
        ("hwgrep://(", ["cannot be opened"]),
        ("loop://?x=1", ["options cannot be read"]),
        ("sim://[", ["sim://[ cannot be opened"]),
        ("loop://[", ["loop://[ cannot be opened"]),
        ("hwgrep://[", ["hwgrep://[ cannot be opened"]),
        ("socket://[", ["no host and TCP port"]),
    ],
)
def test_a_port_that_cannot_be_is_one_line_with_the_way_out(name, reported):
    message = message_of(name)
    for part in reported:
        assert part in message


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
def test_an_absent_server_is_reported_once(scheme):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        name = f"{scheme}://127.0.0.1:{unused.getsockname()[1]}"
        message = message_of(name)
    assert message.count(name) == 1
    assert message.endswith("Connection refused; does a server listen there?")


@pytest.mark.parametrize("baud", [-1, 0, 49, 12_000_001, 2**40])
def test_a_baud_out_of_range_is_refused_with_the_range(baud):
    with pytest.raises(ValueRangeError, match=rf"baud {baud} is out of range: 50\.\.12000000"):
        PortSettings(baud)


def test_settings_have_a_text():
    settings = PortSettings(dtr=True)
    assert str(settings) == "115200 baud 8N1, DTR on, RTS off"
    assert str(PortSettings(share=True)) == "shared, with the settings of the other program"


def test_a_port_can_be_open_once_only(pty):
    with open_port(pty.device):
        assert "is busy: this or another program has it open" in message_of(pty.device)
    open_port(pty.device).close()


@pytest.fixture
def somebody():
    """For the length of the test, no file belongs to us; only root can do that for real."""
    if os.geteuid() != 0:
        yield
        return
    os.setegid(65534)
    os.seteuid(65534)
    yield
    os.seteuid(0)
    os.setegid(0)


def test_a_forbidden_port_is_reported_with_the_fix(pty, request):
    os.chmod(pty.device, 0o000)  # noqa: PTH101
    request.getfixturevalue("somebody")
    message = message_of(pty.device)
    assert f"{pty.device}: no permission; " in message
    assert "ask the machine's administrator" in message or "sudo usermod -aG" in message


@pytest.mark.parametrize("number", ["EIO", "ENXIO", "ENODEV"])
def test_a_device_without_hardware_sends_one_to_the_plug(number):
    import errno

    error = serial.SerialException(getattr(errno, number), "Could not configure port")
    assert "check the plug" in str(port_error("/dev/ttyS9", "/dev/ttyS9", error))


def test_bytes_that_a_server_sends_at_once_are_there():
    with server_socket() as server:
        greeting = Work(greet, server)

        class SlowToOpen(protocol_socket.Serial):
            def _reconfigure_port(self):
                # pyserial comes here between connecting and throwing away what has arrived.
                greeting.ended()
                super()._reconfigure_port()

        with SlowToOpen(f"socket://127.0.0.1:{server.getsockname()[1]}", timeout=5) as port:
            assert port.read(3) == b"\xaa\x55\xee"
            port.reset_input_buffer()


def greet(server):
    connection, _ = server.accept()
    with connection:
        connection.sendall(b"\xaa\x55\xee")


MS = 1_000_000


@pytest.mark.parametrize(
    ("subsystem", "timer", "expected"),
    [
        (None, None, HOST_NS),
        ("usb-serial", "16\n", HOST_NS + USB_FRAME_NS + 16 * MS),
        ("usb-serial", "1\n", HOST_NS + USB_FRAME_NS + MS),
        ("usb-serial", None, HOST_NS + USB_FRAME_NS + USB_UNKNOWN_NS),
        ("usb-serial", "soon", HOST_NS + USB_FRAME_NS + USB_UNKNOWN_NS),
        ("usb", None, HOST_NS + USB_FRAME_NS + USB_UNKNOWN_NS),
        ("platform", None, HOST_NS + FIFO_BYTES * byte_time_ns(9600)),
    ],
)
def test_a_device_is_as_late_as_its_driver_holds_bytes(pty, tmp_path, subsystem, timer, expected):
    name = pty.device.rpartition("/")[2]
    if subsystem is not None:
        facts = tmp_path / "tty" / name / "device"
        facts.mkdir(parents=True)
        (tmp_path / "bus" / subsystem).mkdir(parents=True)
        (facts / "subsystem").symlink_to(tmp_path / "bus" / subsystem)
        if timer is not None:
            (facts / "latency_timer").write_text(timer)
    with open_port(pty.device, PortSettings(9600)) as port:
        assert max_latency_ns(port, tmp_path / "tty") == expected
