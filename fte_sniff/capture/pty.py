"""Pseudo-terminals that other programs open: the bridge's host end."""

from __future__ import annotations

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

HOST_BUFFER_BYTES = 256 * 1024
"""Bytes that are kept for a host program that does not read, besides the system's buffer."""

_MAX_READ = 65_536
_UNUSED_POLL_S = READ_TIMEOUT_S / 2
_PTY_FOLDER = "/dev/pts/"


class PseudoTerminal:
    """A raw terminal device for other programs; `descriptor` is the non-blocking other end."""

    def __init__(self, baud: int, link: Path | None = None) -> None:
        """Create the device at `baud`, then a `link` to it.

        Raises FileError if the link cannot be created.
        """
        if link is not None:
            # First, because a new device often reuses the number that a stale link points to.
            _remove_stale(link)
        self.descriptor, theirs = os.openpty()
        os.set_blocking(self.descriptor, False)
        # Raw, so that nothing is echoed. Closed, so that POLLHUP shows whether a program uses it.
        tty.setraw(theirs)
        # Before the link: a program that waits for it may set its own speed at once.
        set_speed(self.descriptor, baud)
        self.device = os.ttyname(theirs)
        """The device file that programs open, as `/dev/pts/3`."""
        os.close(theirs)
        self._link: Path | None = None
        try:
            self._create(link)
        except FileError:
            os.close(self.descriptor)
            raise

    @property
    def name(self) -> str:
        """The path that users open: the link, or else the device."""
        return self.device if self._link is None else str(self._link)

    def close(self) -> None:
        """Remove the device and, if it still points there, the link."""
        if self._link is not None:
            with suppress(OSError):
                if str(self._link.readlink()) == self.device:
                    self._link.unlink()
        os.close(self.descriptor)

    def _create(self, link: Path | None) -> None:
        if link is None:
            return
        try:
            link.symlink_to(self.device)
        except FileExistsError:
            named = printable(str(link))
            raise FileError(f"{named} exists already: remove it, or name another") from None
        except (OSError, ValueError) as error:
            raise _link_error(link, error) from error
        self._link = link


def _remove_stale(link: Path) -> None:
    """Remove a link that a killed run left: it points to a pseudo-terminal that is gone."""
    try:
        if link.is_symlink() and str(link.readlink()).startswith(_PTY_FOLDER) and not link.exists():
            link.unlink()
    except (OSError, ValueError) as error:
        raise _link_error(link, error) from error


def _link_error(link: Path, error: OSError | ValueError) -> FileError:
    reason = error.strerror if isinstance(error, OSError) else error
    return FileError(f"{printable(str(link))} cannot be made: {reason}")


class HostEnd:
    """The pseudo-terminal that a host program opens instead of the port.

    While no program uses it, written bytes are dropped, as on a real line without a listener. The
    next program starts with an empty buffer and a raw terminal.
    """

    in_use = False
    """True if a host program had it open at the latest read."""

    def __init__(self, baud: int, link: Path | None = None) -> None:
        """Create the device, at `baud` until a host program sets it; raises as `PseudoTerminal`."""
        self._link = link
        self._terminal = PseudoTerminal(baud, link)
        self.name = self._terminal.name
        self._descriptor = self._terminal.descriptor
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._write_lock = threading.Lock()
        self._buffer = bytearray()

    def read(self) -> bytes:
        """Read what the host program has written; `b""` after READ_TIMEOUT_S at most."""
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        events = ready[0][1] if ready else 0
        if events & select.POLLIN:
            self.in_use = True
            # If the program just hung up, the next read sees POLLHUP.
            with suppress(BlockingIOError, OSError):
                return os.read(self._descriptor, _MAX_READ)
        elif events & select.POLLHUP:
            if self.in_use:
                self._reset()
            time.sleep(_UNUSED_POLL_S)
        else:
            self.in_use = True
        return b""

    @property
    def buffered(self) -> int:
        """Number of bytes that wait for the host program to read."""
        return len(self._buffer)

    def baud(self) -> int:
        """Bits per second as the host program has set them; 0 means that it hung up."""
        return speed_of(self._descriptor)

    def write(self, data: bytes) -> int:
        """Write as much as the pseudo-terminal accepts now, and buffer the rest; never blocks.

        Returns the number of bytes dropped because the buffer is full. Call it regularly, also with
        `b""`, to write buffered bytes.
        """
        with self._write_lock:
            if not self.in_use:
                return 0
            if not self._buffer:
                data = data[self._try_write(data) :]
            kept = data[: HOST_BUFFER_BYTES - len(self._buffer)]
            self._buffer += kept
            if self._buffer:
                del self._buffer[: self._try_write(self._buffer)]
            return len(data) - len(kept)

    def close(self) -> None:
        """Hang up like an unplugged port: the host program reads end of file."""
        self.in_use = False
        self._terminal.close()

    def reopen(self, baud: int) -> HostEnd:
        """Create another one with the same link, after this one was closed."""
        return HostEnd(baud, self._link)

    def _try_write(self, data: bytes | bytearray) -> int:
        if not data:
            return 0
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def _reset(self) -> None:
        with self._write_lock:
            self.in_use = False
            self._buffer.clear()
            with suppress(OSError, termios.error):
                theirs = os.open(self._terminal.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    tty.setraw(theirs, termios.TCSANOW)
                    while os.read(theirs, _MAX_READ):
                        pass
                finally:
                    os.close(theirs)


# Speed of a terminal. `struct termios2` takes any baud, where termios knows a fixed list.

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("IIIIB19sII")
_BOTHER = 0o010000
_CONTROL_FLAGS = 2

_BAUD_OF_CODE: dict[int, int] = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdecimal()
}
_CODE_OF_BAUD = {baud: code for code, baud in _BAUD_OF_CODE.items()}


def speed_of(descriptor: int) -> int:
    """The output speed of a terminal, bits per second; 0 means hung up."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        code: int = termios.tcgetattr(descriptor)[5]
        return _BAUD_OF_CODE.get(code, int(code))
    return int(_TERMIOS2.unpack(reply)[-1])


def set_speed(descriptor: int, baud: int) -> None:
    """Set both directions of a terminal to `baud` bits per second."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = _CODE_OF_BAUD.get(baud, baud)
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return
    fields = list(_TERMIOS2.unpack(reply))
    flags = fields[_CONTROL_FLAGS] & ~(termios.CBAUD | termios.CIBAUD)
    fields[_CONTROL_FLAGS] = flags | _BOTHER
    fields[-2:] = baud, baud
    fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))
