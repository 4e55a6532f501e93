"""Owns how the bytes that have arrived are taken from an open port, whatever kind of port it is.

It must not know who wants them, or what time it is. A read waits at most READ_TIMEOUT_S, returns
everything that has arrived, `b""` for silence, and raises OSError when the port is lost: but never
before all that came earlier was returned.
"""

from __future__ import annotations

import os
import select
from collections.abc import Callable
from typing import TypeAlias

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.ports.opening import READ_TIMEOUT_S
from fte_sniff.errors import Said

Read: TypeAlias = Callable[[], bytes]

_MOST_AT_ONCE = 65_536
_GONE = select.POLLHUP | select.POLLERR | select.POLLNVAL


def reader_of(port: serial.Serial) -> Read:
    """The quickest safe way to read `port`."""
    if isinstance(port, protocol_socket.Serial):
        return _DescriptorReader(port.fileno(), empty_is_end=_GONE | select.POLLIN).read
    if type(port).read is serial.Serial.read:
        return _DescriptorReader(port.fileno(), empty_is_end=_GONE).read
    return _PortReader(port).read


class _DescriptorReader:
    """Reads what the system has: two calls a read, however few or many bytes there are.

    pyserial would need a call a byte here: it reads until it has the count it was asked for, and
    when the port is lost before that, the bytes it already took are lost with it.
    """

    def __init__(self, descriptor: int, empty_is_end: int) -> None:
        self._descriptor = descriptor
        self._empty_is_end = empty_is_end
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def read(self) -> bytes:
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        if not ready:
            return b""
        try:
            data = os.read(self._descriptor, _MOST_AT_ONCE)
        except BlockingIOError:
            return b""
        # A terminal is also readable without bytes where another program was quicker.
        if not data and ready[0][1] & self._empty_is_end:
            raise OSError(Said("the other end has hung up"))
        return data


class _PortReader:
    """Reads through pyserial's interface; for ports that have no descriptor of their own."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        data = self._port.read(self._port.in_waiting or 1)
        if not data:
            return data
        try:
            # The rest of what the first byte came with, or each frame would be two reads.
            return data + self._port.read(self._port.in_waiting)
        except OSError:
            # The next read meets it again; what has been read is not lost with the port.
            return data
