"""Owns how decided bytes become rows: their times, and noise that goes on.

It must not decide anything: the framer says what each stretch of bytes is, in stream order and
without gaps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from fte_sniff.protocol.framer.timeline import Marks
from fte_sniff.protocol.rows import Damage, Fault, Frame, Row
from fte_sniff.protocol.table import FRAME_LENGTH

LONGEST_ROW = 1024
"""Bytes in a row of noise."""

NOISE = (Fault.NOISE,)
"""The faults of a row of noise."""


class Tiles(ABC):
    """Takes what is decided, row by row; runs of frames with nothing wrong as a whole."""

    def __init__(self) -> None:
        self._noise = b""
        """Noise that has not become a row yet: more may follow."""
        self._noise_offset = 0

    @property
    def noise_offset(self) -> int | None:
        """Where the noise begins that is in no row yet; None where there is none."""
        return self._noise_offset if self._noise else None

    def noise(self, offset: int, raw: bytes) -> None:
        """Noise, which goes on what noise stood before; it may go on behind."""
        if not self._noise:
            self._noise_offset = offset
        noise, at = self._noise + raw, 0
        while len(noise) - at > LONGEST_ROW:
            self.row(self._noise_offset + at, noise[at : at + LONGEST_ROW], NOISE, framed=False)
            at += LONGEST_ROW
        self._noise, self._noise_offset = noise[at:], self._noise_offset + at

    def end_noise(self) -> None:
        """Noise that follows is another row, as anything else is."""
        if self._noise:
            self.row(self._noise_offset, self._noise, NOISE, framed=False)
            self._noise = b""

    @abstractmethod
    def row(self, offset: int, raw: bytes, faults: tuple[Fault, ...], *, framed: bool) -> None:
        """One row, behind whatever noise has been ended."""

    @abstractmethod
    def run(self, offset: int, data: bytes, start: int, stop: int) -> None:
        """Frames in step with nothing wrong, from `start` to `stop` in `data`."""


class Tiler(Tiles):
    """Makes the rows of one port."""

    def __init__(self, port: str, marks: Marks) -> None:
        super().__init__()
        self._port = port
        self._marks = marks
        self._out: list[Row] = []

    def row(self, offset: int, raw: bytes, faults: tuple[Fault, ...], *, framed: bool) -> None:
        """One row, with its time."""
        t_ns, delay = self._marks.mark(offset).time_and_delay(offset)
        make = Frame if framed else Damage
        self._out.append(make(self._port, offset, raw, t_ns, faults, delay))

    def run(self, offset: int, data: bytes, start: int, stop: int) -> None:
        """The frames one by one, each with its time."""
        port, append, mark_of = self._port, self._out.append, self._marks.mark
        mark = mark_of(offset)
        for place in range(start, stop, FRAME_LENGTH):
            if offset >= mark.stop:
                mark = mark_of(offset)
            t_ns, delay = mark.time_and_delay(offset)
            append(Frame(port, offset, data[place : place + FRAME_LENGTH], t_ns, (), delay))
            offset += FRAME_LENGTH

    def take(self) -> list[Row]:
        """The rows made since the last time."""
        out, self._out = self._out, []
        return out
