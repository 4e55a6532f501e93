"""Owns how bytes are put onto an open port, whatever kind of port it is.

It must not know whose bytes they are. Only the bridge puts any onto a line.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable
from typing import TypeAlias

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.ports.opening import READ_TIMEOUT_S

Put: TypeAlias = Callable[[bytes], int]
"""Puts the first of these bytes onto the line and tells how many: 0 when there is no room within
READ_TIMEOUT_S. Raises OSError when the port is lost."""


def outlet_of(port: serial.Serial) -> Put:
    """The quickest way to write to `port`."""
    if isinstance(port, protocol_socket.Serial) or type(port).write is serial.Serial.write:
        return _DescriptorOutlet(port.fileno()).put
    return _PortOutlet(port).put


class _DescriptorOutlet:
    """Writes what the system has room for; pyserial would not tell how much that was."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)

    def put(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            self._poll.poll(READ_TIMEOUT_S * 1000)
            return 0


class _PortOutlet:
    """Writes through pyserial's interface; for ports that have no descriptor of their own."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def put(self, data: bytes) -> int:
        return self._port.write(data) or 0
