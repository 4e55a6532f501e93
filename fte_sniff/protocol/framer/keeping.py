"""Owns decided bytes as tiles: kept as they come, for whoever makes of them what serves best.

It must not decide anything, nor know columns. Runs of frames stay in one piece, so that much can be
handed on at once; the rows that a tile stands for are those that the framer gives elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from fte_sniff.protocol.framer.tiling import Tiler, Tiles
from fte_sniff.protocol.framer.timeline import Mark, Marks
from fte_sniff.protocol.rows import Fault, Row
from fte_sniff.protocol.table import FRAME_LENGTH


class Tile(NamedTuple):
    """Decided bytes: one row, or frames in step with nothing wrong."""

    offset: int
    """Of the first byte in the stream."""
    data: bytes
    """Holds the bytes, from `start` to `stop`."""
    start: int
    stop: int
    faults: tuple[Fault, ...] | None
    """Of the one row; None where they are frames in step."""
    framed: bool
    """Whether the one row is a frame."""


@dataclass(frozen=True, slots=True)
class Decided:
    """What was decided of one port's stream, from one offset to another, as tiles."""

    port: str
    tiles: Sequence[Tile]
    marks: Sequence[Mark]
    """Of all of their bytes."""

    def __len__(self) -> int:
        """How many rows they are."""
        return sum(
            1 if tile.faults is not None else (tile.stop - tile.start) // FRAME_LENGTH
            for tile in self.tiles
        )

    def rows(self) -> list[Row]:
        """The rows, as the framer would have given them."""
        tiler = Tiler(self.port, Marks(self.marks))
        for offset, data, start, stop, faults, framed in self.tiles:
            if faults is None:
                tiler.run(offset, data, start, stop)
            else:
                tiler.row(offset, data, faults, framed=framed)
        return tiler.take()

    def headers(self) -> Iterator[tuple[int, int]]:
        """The offset of each frame, and its header."""
        for offset, data, start, stop, faults, framed in self.tiles:
            if faults is None:
                for place in range(start, stop, FRAME_LENGTH):
                    yield offset + place - start, data[place]
            elif framed:
                yield offset, data[start]


class Keeper(Tiles):
    """Keeps tiles as they come, for whoever makes of them what serves best."""

    def __init__(self, port: str, marks: Marks) -> None:
        super().__init__()
        self._port = port
        self._marks = marks
        self._tiles: list[Tile] = []

    def row(self, offset: int, raw: bytes, faults: tuple[Fault, ...], *, framed: bool) -> None:
        """One row."""
        self._tiles.append(Tile(offset, raw, 0, len(raw), faults, framed))

    def run(self, offset: int, data: bytes, start: int, stop: int) -> None:
        """Frames in step."""
        self._tiles.append(Tile(offset, data, start, stop, None, True))

    def take(self) -> Decided:
        """What was decided since the last time."""
        tiles, self._tiles = self._tiles, []
        if not tiles:
            return Decided(self._port, (), ())
        last = tiles[-1]
        end = last.offset + last.stop - last.start
        return Decided(self._port, tiles, self._marks.before(end))
