"""`sim://`: the simulation as a pyserial port, in real time.

    sim://?seed=1&rate=200&drop=0.01&flip=0.01&noise=0.01

    thread: simulation --socket--> port      each frame when its last byte would have arrived
            controller <--socket-- port      written bytes are commands

With `host=off` it is a controller to develop against. After `frames=N` frames the port is lost, as
if it were unplugged.
"""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from serial.serialutil import SerialException
from serial.urlhandler import protocol_socket

from fte_sniff.capture.simulation import Simulation, SimulationParameters, parse_parameters
from fte_sniff.errors import PortError
from fte_sniff.protocol.spec import FRAME_LENGTH

if TYPE_CHECKING:
    from fte_sniff.capture.simulation import Controller

_MOST_READ = 65_536


def parameters_of_url(url: str) -> SimulationParameters:
    """Parse a `sim://` URL; raises PortError if it is not legal."""
    parts = urlsplit(url)
    if parts.netloc or parts.path or parts.fragment:
        raise PortError(f"{url!r} cannot be read: parameters come after '?', as in sim://?seed=1")
    return parse_parameters(parts.query)


class SimSerial(protocol_socket.Serial):
    """pyserial's socket port, whose server is a simulation in a thread."""

    def open(self) -> None:
        """Start the simulation; raises SerialException if the URL or the rate is not legal."""
        try:
            simulation = Simulation(parameters_of_url(self.port or ""), self.baudrate)
        except PortError as error:
            raise SerialException(str(error)) from error
        self.logger = None
        self._socket, far = socket.socketpair()
        self._socket.setblocking(False)
        threading.Thread(target=_serve, args=(simulation, far), daemon=True).start()
        self.is_open = True

    def close(self) -> None:
        """End the simulation."""
        if self.is_open:
            self._socket.close()
        self.is_open = False


def _serve(simulation: Simulation, line: socket.socket) -> None:
    """Send each item at its time, and obey what was written, until the other end is closed."""
    written, start_s = bytearray(), time.monotonic()
    with line, suppress(OSError):
        for item in simulation:
            time.sleep(max(0, start_s + item.t_ns / 1e9 - time.monotonic()))
            line.sendall(item.data)
            line.setblocking(False)
            with suppress(BlockingIOError):
                received = line.recv(_MOST_READ)
                if not received:
                    return
                written += received
                _obey(simulation.controller, written)
            line.setblocking(True)


def _obey(controller: Controller, written: bytearray) -> None:
    """Execute the whole frames that were written; skip bytes before them."""
    while len(written) >= FRAME_LENGTH:
        is_frame = controller.obey(bytes(written[:FRAME_LENGTH]))
        del written[: FRAME_LENGTH if is_frame else 1]


Serial = SimSerial
"""The name by which pyserial finds the class."""
