"""Pseudo-terminals and line speed of their host end."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path

from fte_sniff.capture.serial_port import READ_TIMEOUT_S
from fte_sniff.errors import FileError, printable

_DEVICES = "/dev/pts/"


class PseudoTerminal:
    """A device for other programs, raw from the start, and its other end in `descriptor`."""

    def __init__(self, link: Path | None = None) -> None:
        """Make the device, and `link` to it where asked.

        Raises:
            FileError: something is in the way of `link`, or it cannot be made.
        """
        if link is not None:
            # Before there is a device: it would often get the number that a left link leads to.
            _remove_left_over(link)
        self.descriptor, theirs = os.openpty()
        """Our end; it does not block."""
        os.set_blocking(self.descriptor, False)
        # Raw, so that nothing is echoed; then let go, so that it shows whether anyone listens.
        tty.setraw(theirs)
        self.device = os.ttyname(theirs)
        """The device file that programs open, as `/dev/pts/3`."""
        os.close(theirs)
        self._link: Path | None = None
        try:
            self._make(link)
        except FileError:
            os.close(self.descriptor)
            raise

    @property
    def name(self) -> str:
        """What people are told to open: the link, or else the device."""
        return self.device if self._link is None else str(self._link)

    def close(self) -> None:
        """Take away the device and, if it still leads there, the link."""
        if self._link is not None:
            with contextlib.suppress(OSError):
                if str(self._link.readlink()) == self.device:
                    self._link.unlink()
        os.close(self.descriptor)

    def _make(self, link: Path | None) -> None:
        if link is None:
            return
        try:
            link.symlink_to(self.device)
        except FileExistsError:
            named = printable(str(link))
            raise FileError(f"{named} is in the way: remove it, or name another") from None
        except (OSError, ValueError) as error:
            raise _refusal(link, error) from error
        self._link = link


def _remove_left_over(link: Path) -> None:
    """Remove a link that a killed run left: one to a pseudo-terminal that is gone."""
    try:
        if link.is_symlink() and str(link.readlink()).startswith(_DEVICES) and not link.exists():
            link.unlink()
    except (OSError, ValueError) as error:
        raise _refusal(link, error) from error


def _refusal(link: Path, error: OSError | ValueError) -> FileError:
    told = error.strerror if isinstance(error, OSError) else error
    return FileError(f"{printable(str(link))} cannot be made: {told}")


_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("IIIIB19sII")
_BOTHER = 0o010000
_CONTROL_FLAGS = 2

_NUMBER_OF_CODE: dict[int, int] = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdecimal()
}
_CODE_OF_NUMBER = {number: code for code, number in _NUMBER_OF_CODE.items()}


def speed_of(descriptor: int) -> int:
    """Bits per second that bytes are written with; 0 means hung up."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        code: int = termios.tcgetattr(descriptor)[5]
        return _NUMBER_OF_CODE.get(code, int(code))
    return int(_TERMIOS2.unpack(reply)[-1])


def set_speed(descriptor: int, baud: int) -> None:
    """Set both directions to `baud` bits per second."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = _CODE_OF_NUMBER.get(baud, baud)
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return
    fields = list(_TERMIOS2.unpack(reply))
    flags = fields[_CONTROL_FLAGS] & ~(termios.CBAUD | termios.CIBAUD)
    fields[_CONTROL_FLAGS] = flags | _BOTHER
    fields[-2:] = baud, baud
    fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))


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
