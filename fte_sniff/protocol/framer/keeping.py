"""Owns what was decided of a stream, with its bytes and times, until somebody takes it.

It must not decide anything, nor know columns. Runs of frames stay in one piece, so that much can be
handed on at once; whoever wants rows gets them one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import final

from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import FAULT_SETS
from fte_sniff.protocol.framer.places import LENGTH
from fte_sniff.protocol.framer.tiling import Tiles
from fte_sniff.protocol.framer.timeline import Mark, Marks
from fte_sniff.protocol.rows import Damage, Fault, Frame, Row


@final
class Decided:
    """What was decided of one port's stream, from one offset to another."""

    def __init__(self, port: str, data: bytes, start: i64, tiles: Tiles, marks: Sequence[Mark]):
        self.port = port
        self.data = data
        """All of its bytes, and perhaps more behind them."""
        self.start = start
        """Offset of the first of them in the stream."""
        self.tiles = tiles
        """What they are."""
        self.marks = marks
        """When they were read."""

    def __len__(self) -> int:
        """How many rows they are."""
        count: i64 = 0
        for own in self.tiles.counts:
            count += own
        return int(count)

    def last(self) -> tuple[int, bool, tuple[Fault, ...]] | None:
        """How long the last row is, whether it is a frame, and its faults; None without rows."""
        number = i64(len(self.tiles.starts)) - 1
        if number < 0:
            return None
        code = self.tiles.codes[number]
        length = (self.tiles.end - self.tiles.starts[number]) // self.tiles.counts[number]
        return int(length), code & 1 == 1, FAULT_SETS[code >> 1]

    def rows(self) -> list[Row]:
        """The rows one by one, each with its time."""
        rows: list[Row] = []
        starts, counts, codes = self.tiles.starts, self.tiles.counts, self.tiles.codes
        size: i64 = len(starts)
        marks = Marks(self.marks)
        for number in range(size):
            at, code = starts[number], codes[number]
            stop = starts[number + 1] if number + 1 < size else self.tiles.end
            length = (stop - at) // counts[number]
            make = Frame if code & 1 == 1 else Damage
            faults = FAULT_SETS[code >> 1]
            while at < stop:
                raw = self.data[at - self.start : at - self.start + length]
                t_ns, delay = marks.mark(at).time_and_delay(at)
                rows.append(make(self.port, int(at), raw, t_ns, faults, delay))
                at += length
        return rows

    def headers(self) -> Iterator[tuple[int, int]]:
        """The offset of each frame, and its header."""
        starts, counts, codes = self.tiles.starts, self.tiles.counts, self.tiles.codes
        for number in range(i64(len(starts))):
            if codes[number] & 1 == 1:
                for count in range(counts[number]):
                    at = starts[number] + count * LENGTH
                    yield int(at), self.data[at - self.start]


@final
class Kept:
    """The decided bytes of one port that nobody has taken yet."""

    def __init__(self, port: str, marks: Marks) -> None:
        self._port = port
        self._marks = marks
        self.start: i64 = 0
        """Offset of the first of them."""
        self._pieces: list[bytes] = []
        self._size: i64 = 0
        """Of the last piece."""

    def add(self, data: bytes, size: i64) -> None:
        """The next decided bytes: so many of these. (They are not copied if they stay alone.)"""
        if self._pieces:
            self._pieces[-1] = self._pieces[-1][: self._size]
        self._pieces.append(data)
        self._size = size

    def take(self, tiles: Tiles) -> Decided:
        """What stands in these tiles."""
        start, size = self.start, tiles.end - self.start
        if len(self._pieces) > 1:
            self._pieces[-1] = self._pieces[-1][: self._size]
            self._pieces = [b"".join(self._pieces)]
            self._size = len(self._pieces[0])
        data = self._pieces[0] if self._pieces else b""
        self._pieces = [data[size : self._size]] if size < self._size else []
        self._size = max(i64(0), self._size - size)
        self.start = tiles.end
        return Decided(self._port, data, start, tiles, self._marks.before(tiles.end))
