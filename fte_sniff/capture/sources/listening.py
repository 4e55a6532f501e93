"""Owns listening to a port for a while, at one baud or at several, to judge the line by.

It must not know what the bytes mean. Nothing is written, at any baud.
"""

from __future__ import annotations

import termios
import time
from dataclasses import dataclass
from typing import Self

from fte_sniff.capture.ports.granted import Granted, ask
from fte_sniff.capture.ports.opening import PortSettings, open_port
from fte_sniff.capture.ports.reading import Read, reader_of
from fte_sniff.capture.ports.wording import one_line
from fte_sniff.errors import PortError, shown
from fte_sniff.protocol import LineErrorCounts

_SETTLE_S = 0.05
"""After another baud was set, seconds until what still comes was heard at that baud."""

_NEVER_ENOUGH = 2**63


@dataclass(frozen=True, slots=True)
class Heard:
    """What came while a port was listened to."""

    data: bytes
    line_errors: LineErrorCounts


class Listener:
    """An open port that is listened to now and then."""

    def __init__(self, name: str, settings: PortSettings) -> None:
        """Open the port, and ask it for what a capture would ask it for.

        Raises:
            PortError: the port cannot be opened.
        """
        self._name = name
        self._port = open_port(name, settings)
        self.granted: Granted = ask(self._port)
        self._read: Read = reader_of(self._port)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._port.close()

    def listen(self, seconds: float, enough: int) -> Heard:
        """What comes within so many seconds, or until there are `enough` bytes.

        Raises:
            PortError: the port was lost.
        """
        data = bytearray()
        line = self.granted.line
        deadline = time.monotonic() + seconds
        while len(data) < enough and time.monotonic() < deadline:
            data += line.take(self._take())[0]
        return Heard(bytes(data), line.rest() or LineErrorCounts())

    def sample(self, baud: int, seconds: float, enough: int) -> bytes | None:
        """As `listen`, at another baud, without line errors; None where it cannot be set.

        The port stays at that baud.

        Raises:
            PortError: the port was lost.
        """
        try:
            # pyserial also takes back that errors are to be marked.
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error):
            return None
        self._collect(_SETTLE_S, _NEVER_ENOUGH)
        return self._collect(seconds, enough)

    def _collect(self, seconds: float, enough: int) -> bytes:
        data = bytearray()
        deadline = time.monotonic() + seconds
        while len(data) < enough and time.monotonic() < deadline:
            data += self._take()
        return bytes(data)

    def _take(self) -> bytes:
        try:
            return self._read()
        except OSError as error:
            told = one_line(error)
            raise PortError(
                f"{shown(self._name)} was lost: {told}; check cable and power"
            ) from error
