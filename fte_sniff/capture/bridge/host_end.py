"""Owns the pseudo-terminal that a host program opens: who is there, what they ask for, the bytes.

It must not know what the bytes are passed on to. Reading and writing may happen in two threads.
"""

from __future__ import annotations

import os
import select
import termios
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path

from fte_sniff.capture.bridge.line_speed import set_speed, speed_of
from fte_sniff.capture.ports.opening import READ_TIMEOUT_S
from fte_sniff.capture.pseudo_terminal import PseudoTerminal

ROOM = 256 * 1024
"""Bytes that wait for a host program that does not read, besides what the system itself keeps."""

_MOST_AT_ONCE = 65_536
_AWAY_S = READ_TIMEOUT_S / 2


class HostEnd:
    """What a host program opens instead of the port.

    While none has it open, what is written is gone, as on a real line that nobody listens to; the
    next one begins with nothing old to read, and with a raw terminal.
    """

    present = False
    """Whether a host program has it open, as of the latest read."""

    def __init__(self, baud: int, link: Path | None = None) -> None:
        """Make the device, at `baud` until a host program asks for another.

        Raises:
            FileError: something is in the way of `link`, or it cannot be made.
        """
        self._link = link
        self._terminal = PseudoTerminal(link)
        self.name = self._terminal.name
        """What a host program is to open."""
        self._descriptor = self._terminal.descriptor
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._writing = threading.Lock()
        self._waiting = bytearray()
        set_speed(self._descriptor, baud)

    def read(self) -> bytes:
        """What the host program has written; waits READ_TIMEOUT_S at most, `b""` for nothing."""
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        events = ready[0][1] if ready else 0
        if events & select.POLLIN:
            self.present = True
            # Hung up meanwhile: the next read meets it.
            with suppress(BlockingIOError, OSError):
                return os.read(self._descriptor, _MOST_AT_ONCE)
        elif events & select.POLLHUP:
            if self.present:
                self._be_left()
            time.sleep(_AWAY_S)
        else:
            self.present = True
        return b""

    @property
    def behind(self) -> int:
        """Bytes that wait for the host program to read."""
        return len(self._waiting)

    def baud(self) -> int:
        """Bits per second as the host program has set them; 0 means that it hung up."""
        return speed_of(self._descriptor)

    def write(self, data: bytes) -> int:
        """Give the host program what it can take now, and keep some for later; never blocks.

        Called with `b""` every now and then, it gives what was kept.

        Returns:
            How many bytes had to be dropped, because the host program does not read.
        """
        with self._writing:
            if not self.present:
                return 0
            if not self._waiting:
                data = data[self._written(data) :]
            kept = data[: ROOM - len(self._waiting)]
            self._waiting += kept
            if self._waiting:
                del self._waiting[: self._written(self._waiting)]
            return len(data) - len(kept)

    def close(self) -> None:
        """Hang up, as a port does that is unplugged: a host program meets the end of the file."""
        self.present = False
        self._terminal.close()

    def again(self, baud: int) -> HostEnd:
        """Another one after this was closed, by the same link if there was one."""
        return HostEnd(baud, self._link)

    def _written(self, data: bytes | bytearray) -> int:
        if not data:
            return 0
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def _be_left(self) -> None:
        with self._writing:
            self.present = False
            self._waiting.clear()
            with suppress(OSError, termios.error):
                theirs = os.open(self._terminal.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    tty.setraw(theirs, termios.TCSANOW)
                    while os.read(theirs, _MOST_AT_ONCE):
                        pass
                finally:
                    os.close(theirs)
