"""Owns `rfc2217://` as fte-sniff opens it: pyserial's own, but with another way to read.

It must not negotiate: that pyserial does. Its reader takes a byte at a time, far too slow for a
quick line, and forgets what it has read when the connection dies.

What arrives is data in which commands stand:

    IAC IAC                     one data byte FF
    IAC SB ... IAC SE           about the port; IAC is doubled in it
    IAC WILL|WONT|DO|DONT x     about an option of the connection
    IAC x                       anything else
"""

from __future__ import annotations

import re
import socket
import threading
import time
import warnings
from collections.abc import Callable
from typing import Any

from serial import rfc2217
from serial.serialutil import PortNotOpenError, SerialException

_MOST_AT_ONCE = 65_536

_LONGEST_COMMAND = 4096
"""Bytes that a command has at most; behind more of them, it is none."""

_COMMAND = re.compile(
    rb"\xff(?:(?P<data>\xff)"
    rb"|\xfa(?P<about_port>(?:[^\xff]|\xff\xff)*)\xff[^\xff]"
    rb"|(?P<wish>[\xfb-\xfe])(?P<option>.)"
    rb"|(?P<other>[^\xfa-\xff]))",
    re.DOTALL,
)


class Serial(rfc2217.Serial):
    """pyserial's RFC 2217 port; all that came before the connection died can be read."""

    _socket: socket.socket | None
    _telnet_negotiate_option: Callable[[bytes, bytes], None]
    _telnet_process_command: Callable[[bytes], None]
    _telnet_process_subnegotiation: Callable[[bytes], None]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """As pyserial's."""
        self._changed = threading.Condition()
        self._arrived = bytearray()
        self._death: str | None = None
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Connect and set the port up; raises SerialException as pyserial does."""
        self._arrived.clear()
        self._death = None
        with warnings.catch_warnings():
            # pyserial sets up its thread in a way that Python 3.10 advises against.
            warnings.simplefilter("ignore", DeprecationWarning)
            super().open()

    def close(self) -> None:
        """Close the connection, also one that the server has closed before."""
        connection = self._socket
        super().close()
        if connection is not None:
            # pyserial does not come to it where there is nothing to shut down any more.
            connection.close()

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read at once."""
        if not self.is_open:
            raise PortNotOpenError
        return len(self._arrived)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes: fewer after `timeout` seconds, or when the connection has died.

        Raises:
            SerialException: it has died, and all that came before was read.
        """
        until_s = None if self.timeout is None else time.monotonic() + self.timeout
        with self._changed:
            while len(self._arrived) < size and self._death is None:
                left_s = None if until_s is None else until_s - time.monotonic()
                if left_s is not None and left_s <= 0:
                    break
                self._changed.wait(left_s)
            if not self.is_open:
                raise PortNotOpenError
            if size and not self._arrived and self._death is not None:
                raise SerialException(self._death)
            data = bytes(self._arrived[:size])
            del self._arrived[:size]
            return data

    def reset_input_buffer(self) -> None:
        """Forget what has arrived and was not read, here and at the server."""
        super().reset_input_buffer()
        with self._changed:
            self._arrived.clear()

    def _telnet_read_loop(self) -> None:
        """What pyserial runs in a thread of its own."""
        try:
            self._read_all()
        except (OSError, ValueError) as error:
            self._die(f"the connection failed: {error}")
        else:
            self._die("the server has hung up")

    def _read_all(self) -> None:
        held, connection = b"", self._socket
        while self.is_open and connection is not None:
            try:
                data = connection.recv(_MOST_AT_ONCE)
            except TimeoutError:
                continue
            if not data:
                return
            held = self._take(held + data)
            if len(held) > _LONGEST_COMMAND:
                raise ValueError("the server does not speak RFC 2217")

    def _take(self, data: bytes) -> bytes:
        """Take data and commands apart; returns the beginning of a command that goes on."""
        at = 0
        while (start := data.find(rfc2217.IAC, at)) >= 0:
            self._arrive(data[at:start])
            command = _COMMAND.match(data, start)
            if command is None:
                return data[start:]
            self._obey(command)
            at = command.end()
        self._arrive(data[at:])
        return b""

    def _obey(self, command: re.Match[bytes]) -> None:
        if command["data"]:
            self._arrive(rfc2217.IAC)
        elif command["wish"]:
            self._telnet_negotiate_option(command["wish"], command["option"])
        elif command["other"]:
            self._telnet_process_command(command["other"])
        else:
            about = command["about_port"].replace(rfc2217.IAC_DOUBLED, rfc2217.IAC)
            self._telnet_process_subnegotiation(about)

    def _arrive(self, data: bytes) -> None:
        if data:
            with self._changed:
                self._arrived += data
                self._changed.notify_all()

    def _die(self, reason: str) -> None:
        with self._changed:
            self._death = reason
            self._changed.notify_all()
