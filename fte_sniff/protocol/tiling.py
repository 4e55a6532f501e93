"""Owns how decided bytes become rows: their times, runs of frames, and noise that goes on.

It must not decide anything: the framer says what each stretch of bytes is, in stream order and
without gaps.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from fte_sniff.protocol.rows import Damage, Fault, Frame, Row
from fte_sniff.protocol.table import FRAME_LENGTH
from fte_sniff.protocol.timeline import Mark, Timeline

LONGEST_ROW = 1024
"""Bytes in a row of noise."""

NOISE = (Fault.NOISE,)
"""The faults of a row of noise."""


class Run(NamedTuple):
    """Frames in step, nothing wrong with any of them, all of whose first bytes share a mark."""

    port: str
    offset: int
    """Of the first byte in that port's stream."""
    raw: bytes
    """The bytes of all the frames."""
    mark: Mark

    def frames(self) -> Iterator[Frame]:
        """The frames one by one."""
        port, first, raw, mark = self
        for place in range(0, len(raw), FRAME_LENGTH):
            offset = first + place
            t_ns = mark.time_of(offset)
            delay = None if t_ns is None else mark.delay_after(t_ns)
            yield Frame(port, offset, raw[place : place + FRAME_LENGTH], t_ns, (), delay)


class Tiler:
    """Makes the rows of one port."""

    def __init__(self, port: str, timeline: Timeline) -> None:
        self._port = port
        self._timeline = timeline
        self._noise = b""
        """Noise that has not become a row yet: more may follow."""
        self._noise_offset = 0
        self._out: list[Row | Run] = []

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
            self._append(self._noise_offset + at, noise[at : at + LONGEST_ROW], Damage, NOISE)
            at += LONGEST_ROW
        self._noise, self._noise_offset = noise[at:], self._noise_offset + at

    def end_noise(self) -> None:
        """Noise that follows is another row."""
        if self._noise:
            self._append(self._noise_offset, self._noise, Damage, NOISE)
            self._noise = b""

    def frame(self, offset: int, raw: bytes, faults: tuple[Fault, ...]) -> None:
        """One frame."""
        self.end_noise()
        self._append(offset, raw, Frame, faults)

    def damage(self, offset: int, raw: bytes, faults: tuple[Fault, ...]) -> None:
        """Damage other than noise."""
        self.end_noise()
        self._append(offset, raw, Damage, faults)

    def run(self, offset: int, raw: bytes) -> None:
        """Frames in step with nothing wrong."""
        self.end_noise()
        at = 0
        while at < len(raw):
            mark = self._timeline.mark(offset + at)
            frames = -(-(mark.stop - offset - at) // FRAME_LENGTH)
            end = min(len(raw), at + frames * FRAME_LENGTH)
            self._out.append(Run(self._port, offset + at, raw[at:end], mark))
            at = end

    def take(self) -> list[Row | Run]:
        """The rows made since the last time."""
        out, self._out = self._out, []
        return out

    def _append(
        self, offset: int, raw: bytes, make: type[Frame | Damage], faults: tuple[Fault, ...]
    ) -> None:
        mark = self._timeline.mark(offset)
        t_ns = mark.time_of(offset)
        delay = None if t_ns is None else mark.delay_after(t_ns)
        self._out.append(make(self._port, offset, raw, t_ns, faults, delay))


def rows_of(spans: list[Row | Run]) -> list[Row]:
    """The rows one by one."""
    rows: list[Row] = []
    for span in spans:
        if isinstance(span, Run):
            rows += span.frames()
        else:
            rows.append(span)
    return rows
