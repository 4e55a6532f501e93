"""Simulator behind a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import select
from pathlib import Path
from urllib.parse import urlencode

import serial

from fte_sniff.capture.pty import PseudoTerminal
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.simulation import PARAMETERS, SimulationParameters
from fte_sniff.errors import FileError
from fte_sniff.protocol import DEFAULT_BAUD

_MOST_AT_ONCE = 4096


class ControllerPty:
    """A pseudo-terminal whose other end is a simulated controller; `run` it, then `close` it.

    Feedback flows while a program has the device open; what nobody listens to is gone, as on a real
    line. Commands that the program writes are obeyed.
    """

    def __init__(
        self,
        parameters: SimulationParameters,
        baud: int = DEFAULT_BAUD,
        link: Path | None = None,
    ) -> None:
        """Make the device, and `link` to it where asked.

        Raises:
            PortError: the line cannot carry the parameters' rate.
            FileError: `link` is in the way of something, or cannot be made.
        """
        told = {parameter.name: getattr(parameters, parameter.name) for parameter in PARAMETERS}
        self._simulated = open_port(f"sim://?{urlencode(told)}", PortSettings(baud))
        try:
            self._terminal = PseudoTerminal(link)
        except FileError:
            self._simulated.close()
            raise
        self.device = self._terminal.device
        """The device file that programs open, as `/dev/pts/3`."""
        self._ours = self._terminal.descriptor
        self._stopping = False
        self._poll = select.poll()
        self._poll.register(self._ours, select.POLLIN)

    def __enter__(self) -> ControllerPty:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def run(self) -> None:
        """Serve until `stop`, or until the simulation ends by its `frames`."""
        while not self._stopping:
            try:
                feedback = self._simulated.read(self._simulated.in_waiting or 1)
                feedback += self._simulated.read(self._simulated.in_waiting)
            except serial.SerialException:
                return
            self._carry(feedback)

    def stop(self) -> None:
        """Make `run` return within 10 ms or so; may be called from threads and signal handlers."""
        self._stopping = True

    def close(self) -> None:
        """Take away the device and the link. Not while `run` runs."""
        self._simulated.close()
        self._terminal.close()

    def _carry(self, feedback: bytes) -> None:
        events = dict(self._poll.poll(0)).get(self._ours, 0)
        with contextlib.suppress(BlockingIOError):
            if events & select.POLLIN:
                self._simulated.write(os.read(self._ours, _MOST_AT_ONCE))
        with contextlib.suppress(BlockingIOError):
            if feedback and not events & select.POLLHUP:
                os.write(self._ours, feedback)
