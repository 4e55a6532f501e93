"""How late ports hand on bytes, by what the system tells of them."""

import socket

import pytest

from fte_sniff.capture.serial_port import (
    FIFO_BYTES,
    HOST_NS,
    NETWORK_NS,
    USB_FRAME_NS,
    USB_UNKNOWN_NS,
    PortSettings,
    max_latency_ns,
    open_port,
)
from fte_sniff.protocol import byte_time_ns

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


def test_a_simulated_line_is_as_late_as_this_machine():
    with open_port("sim://") as port:
        assert max_latency_ns(port) == HOST_NS


def test_a_server_is_as_late_as_a_network():
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with open_port(name) as port:
            assert max_latency_ns(port) == HOST_NS + NETWORK_NS
