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
from fte_sniff.protocol import FRAME_LENGTH, Row
from fte_sniff.protocol.spec import TAIL

if TYPE_CHECKING:
    from typing_extensions import Buffer

_MOST_ARRIVED = 65_536
"""Bytes that wait at most: a simulation slower than its line falls behind, and stays readable."""


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
        # A bridge reads and writes it from two threads.
        self._lock = threading.Lock()
        self._arrived = bytearray()
        self._written = bytearray()
        self._started_ns = time.monotonic_ns()
        self._slots = self._simulation.slots()
        self._coming = next(self._slots, None)
        self.is_open = True

    def close(self) -> None:
        """End the simulation."""
        self.is_open = False

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once; raises SerialException when unplugged."""
        with self._lock:
            self._advance()
            return len(self._arrived)

    def read(self, size: int = 1, /) -> bytes:
        """Up to `size` bytes, fewer after `timeout` seconds.

        Raises SerialException when unplugged, once all that came before was read.
        """
        until_ns = None if self.timeout is None else self._elapsed_ns() + int(self.timeout * 1e9)
        while next_ns := self._next_ns(size):
            now_ns = self._elapsed_ns()
            if until_ns is not None and now_ns >= until_ns:
                break
            end_ns = next_ns if until_ns is None else min(next_ns, until_ns)
            time.sleep(max(0, end_ns - now_ns) / 1e9)
        with self._lock:
            data = bytes(self._arrived[:size])
            del self._arrived[:size]
            return data

    def write(self, data: Buffer, /) -> int:
        """Send bytes to the simulated controller, which obeys the control frames in them."""
        with self._lock:
            self._advance()
            self._written += bytes(data)
            self._obey()
        return len(bytes(data))

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

    def _next_ns(self, size: int) -> int:
        """When more bytes come, nanoseconds since the start; 0 if there are enough, or all."""
        with self._lock:
            self._advance()
            if len(self._arrived) >= size or self._coming is None:
                return 0
            return self._coming.t_ns

    def _elapsed_ns(self) -> int:
        return time.monotonic_ns() - self._started_ns

    def _advance(self) -> None:
        """Move what has arrived by now; raises SerialException where nothing is left to come."""
        if not self.is_open:
            raise PortNotOpenError
        elapsed_ns = self._elapsed_ns()
        while (
            self._coming is not None
            and self._coming.t_ns <= elapsed_ns
            and len(self._arrived) < _MOST_ARRIVED
        ):
            self._arrived += self._coming.data
            self._coming = next(self._slots, None)
        if self._coming is None and not self._arrived:
            raise SerialException("the simulated port is unplugged: all its frames were sent")

    def _obey(self) -> None:
        """Execute the whole frames that were written; skip bytes before them."""
        while len(self._written) >= FRAME_LENGTH:
            row = Row("", 0, bytes(self._written[:FRAME_LENGTH]), None)
            is_frame = row.kind is not None and row.raw[-1] == TAIL
            if self._simulation and row.kind and is_frame:
                self._simulation.controller.obey(row.kind, row.values)
            del self._written[: FRAME_LENGTH if is_frame else 1]


Serial = SimSerial
"""The name by which pyserial finds the class."""
