"""`sim://`: the simulation as a pyserial port, in real time.

    sim://?seed=1&rate=200&drop=0.01&flip=0.01&noise=0.01

A byte can be read when the last byte of its frame would have arrived on a real line. Written bytes
are commands to the simulated controller; with `host=off` it is a controller to develop against.
After `frames=N` frames the port is lost, as if it were unplugged.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from fte_sniff.capture.simulation import (
    Simulation,
    SimulationParameters,
    TimedBytes,
    parse_parameters,
)
from fte_sniff.errors import PortError
from fte_sniff.protocol import Chunk, Frame, Framer

if TYPE_CHECKING:
    from typing_extensions import Buffer

_SCHEME = "sim"

_SILENCE_NS = 100_000_000
"""How long after a write silence is fed to the framer, so that it holds back no command."""

_MOST_ARRIVED = 65_536
"""Bytes that wait at most: a simulation slower than its line falls behind, and stays readable."""

_NEVER_NS = 2**62
_NOTHING = TimedBytes(_NEVER_NS, _NEVER_NS, b"", b"")
"""The next item of a line that is silent for ever: the port is not unplugged."""


def parameters_of_url(url: str) -> SimulationParameters:
    """Parse a `sim://` URL; raises PortError if it is not legal."""
    parts = urlsplit(url)
    if parts.netloc or parts.path or parts.fragment:
        raise PortError(f"{url!r} cannot be read: parameters come after '?', as in sim://?seed=1")
    return parse_parameters(parts.query)


class SimSerial(SerialBase):
    """A port with a simulated host and controller, made by `serial_for_url`."""

    _simulation: Simulation | None = None
    _coming: TimedBytes | None = None
    """The next item; None when the port is unplugged."""

    def open(self) -> None:
        """Start the simulation; raises SerialException if the URL or the rate is not legal."""
        if self.port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        try:
            self._simulation = Simulation(parameters_of_url(self.port), self.baudrate)
        except PortError as error:
            raise SerialException(str(error)) from error
        self._changed = threading.Condition()
        self._arrived = bytearray()
        self._cancelled = False
        self._silence_until_ns = 0
        self._commands = Framer(_SCHEME, self.baudrate)
        self._started_ns = time.monotonic_ns()
        silent = self._simulation.parameters.is_silent
        self._coming = _NOTHING if silent else next(self._simulation, None)
        self.is_open = True

    def close(self) -> None:
        """End the simulation; a waiting read returns what it has."""
        if self.is_open:
            with self._changed:
                self.is_open = False
                self._changed.notify_all()

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once; raises SerialException when unplugged."""
        with self._opened():
            self._advance()
            if not self._arrived:
                self._raise_if_unplugged()
            return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Up to `size` bytes: fewer only after `timeout` seconds, `cancel_read` or `close`."""
        until_ns = None if self.timeout is None else self._elapsed_ns() + int(self.timeout * 1e9)
        with self._opened():
            while self.is_open and not self._cancelled:
                self._advance()
                if len(self._arrived) >= size or self._coming is None:
                    break
                next_ns = self._coming.t_ns
                if until_ns is not None:
                    if self._elapsed_ns() >= until_ns:
                        break
                    next_ns = min(next_ns, until_ns)
                self._changed.wait(max(next_ns - self._elapsed_ns(), 0) / 1e9)
            self._cancelled = False
            if size and not self._arrived:
                self._raise_if_unplugged()
            data = bytes(self._arrived[:size])
            del self._arrived[:size]
            return data

    def write(self, data: Buffer, /) -> int:
        """Send bytes to the simulated controller, which obeys the control frames in them."""
        commands = bytes(data)
        with self._opened():
            self._advance()
            now_ns = self._elapsed_ns()
            self._silence_until_ns = now_ns + _SILENCE_NS
            self._obey(now_ns, commands)
        return len(commands)

    def cancel_read(self) -> None:
        """Make a waiting read in another thread, or else the next one, return what it has."""
        with self._opened():
            self._cancelled = True
            self._changed.notify_all()

    def reset_input_buffer(self) -> None:
        """Discard what has arrived and was not read."""
        with self._opened():
            self._advance()
            self._arrived.clear()

    def cancel_write(self) -> None:
        """Do nothing: a write never blocks."""

    def flush(self) -> None:
        """Do nothing: a write is done when it returns."""

    def reset_output_buffer(self) -> None:
        """Check that the port is open: nothing waits to be sent."""
        self._opened()

    @property
    def out_waiting(self) -> int:
        """Always 0: nothing waits to be sent."""
        return 0

    @property
    def cts(self) -> bool:
        """Clear to send: always."""
        return True

    dsr = cd = cts

    @property
    def ri(self) -> bool:
        """Ring indicator: never."""
        return False

    # pyserial calls these when a setting changes.

    def _reconfigure_port(self) -> None:
        if self._simulation is not None:
            try:
                self._simulation.parameters.check_against(self.baudrate)
            except PortError as error:
                raise ValueError(str(error)) from error

    def _update_break_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...

    def _update_dtr_state(self) -> None: ...

    def _opened(self) -> threading.Condition:
        if not self.is_open:
            raise PortNotOpenError
        return self._changed

    def _elapsed_ns(self) -> int:
        return time.monotonic_ns() - self._started_ns

    def _advance(self) -> None:
        elapsed_ns = self._elapsed_ns()
        while (
            self._coming is not None
            and self._coming.t_ns <= elapsed_ns
            and len(self._arrived) < _MOST_ARRIVED
        ):
            self._arrived += self._coming.data
            self._coming = next(self._simulation, None) if self._simulation else None
        if elapsed_ns < self._silence_until_ns:
            self._obey(elapsed_ns, b"")

    def _obey(self, now_ns: int, written: bytes) -> None:
        for row in self._commands.feed(Chunk(_SCHEME, now_ns, written)):
            if self._simulation and isinstance(row, Frame) and row.kind and not row.faults:
                self._simulation.controller.obey(row.kind, row.values)

    def _raise_if_unplugged(self) -> None:
        if self.is_open and self._coming is None:
            raise SerialException("the simulated port is unplugged: all its frames were sent")


Serial = SimSerial
"""The name by which pyserial finds the class."""
