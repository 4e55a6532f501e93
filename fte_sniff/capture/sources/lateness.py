"""Owns how late a port hands on bytes at most: how much earlier than its reads they may have come.

It must not measure or change anything: it knows the kinds of ports, and what the system tells.

A byte's time is reckoned back from the return of its read, as if the last byte had just come. What
was held on the way came earlier: by the adapter until its latency timer ran out, by the UART until
its FIFO was full enough, by the network, or by a machine that was busy.
"""

from __future__ import annotations

from pathlib import Path

import serial

from fte_sniff.capture.ports.opening import device_of
from fte_sniff.protocol import byte_time_ns

_SYS_TTY = Path("/sys/class/tty")

HOST_NS = 1_000_000
"""Until this program runs once bytes have arrived, on a machine that is not overloaded."""

USB_FRAME_NS = 1_000_000
"""Between two questions of a full-speed USB host to an adapter."""

USB_UNKNOWN_NS = 16_000_000
"""For an adapter that does not tell its latency timer: the usual one."""

NETWORK_NS = 20_000_000
"""For a port server, on a local network that is well."""

FIFO_BYTES = 16
"""Byte times that a UART of the board holds bytes: until its FIFO is full, or four pass unused."""

_NETWORK_SCHEMES = ("socket", "rfc2217")


def lateness_ns(port: serial.Serial, sys_tty: Path = _SYS_TTY) -> int:
    """How late bytes of an open port can be, nanoseconds; a machine that stalls adds to it.

    Args:
        port: as `open_port` gives it.
        sys_tty: where the system tells of terminals.
    """
    device = device_of(port)
    if device is None:
        network = (port.port or "").partition("://")[0].lower() in _NETWORK_SCHEMES
        return HOST_NS + NETWORK_NS * network
    return HOST_NS + _device_ns(sys_tty / Path(device).resolve().name / "device", port.baudrate)


def _device_ns(facts: Path, baud: int) -> int:
    if not facts.exists():
        return 0  # a pseudo-terminal
    subsystem = (facts / "subsystem").resolve().name
    if not subsystem.startswith("usb"):
        return FIFO_BYTES * byte_time_ns(baud)
    try:
        timer_ms = int((facts / "latency_timer").read_text())
    except (OSError, ValueError):
        return USB_FRAME_NS + USB_UNKNOWN_NS
    return USB_FRAME_NS + timer_ms * 1_000_000
