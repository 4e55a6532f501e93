"""`rfc2217://`: pyserial's own, but with a faster reader that loses no bytes.

pyserial negotiates. Its reader processes one byte at a time, too slow for a fast line, and loses
what it has read when the connection fails.

Received data contains telnet commands:

    IAC IAC                     one data byte FF
    IAC SB ... IAC SE           subnegotiation about the port; IAC is doubled in it
    IAC WILL|WONT|DO|DONT x     negotiation of an option
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

_MAX_READ = 65_536

_LONGEST_COMMAND = 4096
"""Largest size of a command, bytes; more means that this is not RFC 2217."""

_COMMAND = re.compile(
    rb"\xff(?:(?P<data>\xff)"
    rb"|\xfa(?P<subnegotiation>(?:[^\xff]|\xff\xff)*)\xff[^\xff]"
    rb"|(?P<verb>[\xfb-\xfe])(?P<option>.)"
    rb"|(?P<other>[^\xfa-\xff]))",
    re.DOTALL,
)


class Rfc2217Serial(rfc2217.Serial):
    """pyserial's RFC 2217 port; bytes that came before the connection failed can be read."""

    _socket: socket.socket | None
    _rfc2217_options: dict[str, Any]
    _telnet_negotiate_option: Callable[[bytes, bytes], None]
    _telnet_process_command: Callable[[bytes], None]
    _telnet_process_subnegotiation: Callable[[bytes], None]

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._changed = threading.Condition()
        self._arrived = bytearray()
        self._failure: str | None = None
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """Connect and configure the port; raises SerialException as pyserial does."""
        self._arrived.clear()
        self._failure = None
        with warnings.catch_warnings():
            # pyserial starts its thread with a method that Python 3.10 deprecates.
            warnings.simplefilter("ignore", DeprecationWarning)
            super().open()

    def close(self) -> None:
        """Close the connection, also one that the server has closed already."""
        connection = self._socket
        super().close()
        if connection is not None:
            # pyserial does not close the socket if its shutdown fails.
            connection.close()

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once."""
        if not self.is_open:
            raise PortNotOpenError
        return len(self._arrived)

    def read(self, size: int = 1) -> bytes:
        """Up to `size` bytes, fewer after `timeout` seconds.

        After a failed connection, raises SerialException once all that came before was read.
        """
        until_s = None if self.timeout is None else time.monotonic() + self.timeout
        with self._changed:
            while len(self._arrived) < size and self._failure is None:
                left_s = None if until_s is None else until_s - time.monotonic()
                if left_s is not None and left_s <= 0:
                    break
                self._changed.wait(left_s)
            if not self.is_open:
                raise PortNotOpenError
            if size and not self._arrived and self._failure is not None:
                raise SerialException(self._failure)
            data = bytes(self._arrived[:size])
            del self._arrived[:size]
            return data

    def reset_input_buffer(self) -> None:
        """Discard what has arrived and was not read, here and at the server."""
        super().reset_input_buffer()
        with self._changed:
            self._arrived.clear()

    def _telnet_read_loop(self) -> None:
        try:
            self._read_all()
        except (OSError, ValueError) as error:
            self._fail(f"the connection failed: {error}")
        else:
            self._fail("the server has hung up")

    def _read_all(self) -> None:
        pending, connection = b"", self._socket
        while self.is_open and connection is not None:
            try:
                data = connection.recv(_MAX_READ)
            except TimeoutError:
                continue
            if not data:
                return
            pending = self._parse(pending + data)
            if len(pending) > _LONGEST_COMMAND:
                raise ValueError("the server does not speak RFC 2217")

    def _parse(self, data: bytes) -> bytes:
        """Separate data and commands; return the start of an incomplete command."""
        at = 0
        while (start := data.find(rfc2217.IAC, at)) >= 0:
            self._append(data[at:start])
            command = _COMMAND.match(data, start)
            if command is None:
                return data[start:]
            self._process(command)
            at = command.end()
        self._append(data[at:])
        return b""

    def _process(self, command: re.Match[bytes]) -> None:
        if command["data"]:
            self._append(rfc2217.IAC)
        elif command["verb"]:
            self._telnet_negotiate_option(command["verb"], command["option"])
        elif command["other"]:
            self._telnet_process_command(command["other"])
        else:
            content = command["subnegotiation"].replace(rfc2217.IAC_DOUBLED, rfc2217.IAC)
            # pyserial fails on an answer to an option that it did not set.
            if content[1:2] not in self._unrequested():
                self._telnet_process_subnegotiation(content)

    def _unrequested(self) -> set[bytes]:
        options = self._rfc2217_options.values()
        return {option.ack_option for option in options if option.state != rfc2217.REQUESTED}

    def _append(self, data: bytes) -> None:
        if data:
            with self._changed:
                self._arrived += data
                self._changed.notify_all()

    def _fail(self, reason: str) -> None:
        with self._changed:
            self._failure = reason
            self._changed.notify_all()


Serial = Rfc2217Serial
"""The name by which pyserial finds the class."""
