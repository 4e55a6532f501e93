"""Fixtures: real pseudo-terminals, and waits with a timeout."""

import fcntl
import os
import select
import sys
import termios
import tty
from dataclasses import dataclass, field

import pytest

from tests.needs import needs
from tests.waiting import wait_until


@dataclass
class Pty:
    """A pseudo-terminal: the test writes to the `far` end, the program opens `device`."""

    far: int
    near: int
    device: str
    _open: set[int] = field(default_factory=set)

    def __post_init__(self):
        self._open = {self.far, self.near}

    def send(self, data):
        """Bytes onto the line, all of them."""
        view = memoryview(data)
        while view:
            view = view[os.write(self.far, view) :]

    def arrived(self, wait_s=0.0):
        """What the program wrote to the line."""
        ready, _, _ = select.select([self.far], [], [], wait_s)
        return os.read(self.far, 65536) if ready else b""

    @property
    def unread(self):
        """How many bytes of the line the program can read at once."""
        return int.from_bytes(fcntl.ioctl(self.near, termios.FIONREAD, bytes(4)), sys.byteorder)

    def attributes(self):
        """The terminal's settings as the program left them."""
        return termios.tcgetattr(self.near)

    def let_go(self):
        """Leave the program as the only one that has the near end."""
        self._close(self.near)

    def unplug(self):
        """Hang up the line, as a USB adapter does that is pulled out."""
        self.let_go()
        self._close(self.far)

    def _close(self, descriptor):
        if descriptor in self._open:
            self._open.remove(descriptor)
            os.close(descriptor)


@pytest.fixture
@needs("port")
def new_pty():
    """Make pseudo-terminals; all are unplugged in the end."""
    made = []

    def make():
        far, near = os.openpty()
        tty.setraw(near)
        made.append(Pty(far, near, os.ttyname(near)))
        return made[-1]

    yield make
    for pty in made:
        pty.unplug()


@pytest.fixture
def pty(new_pty):
    return new_pty()


@pytest.fixture
def until():
    """Wait until something holds, but not for ever."""
    return wait_until
