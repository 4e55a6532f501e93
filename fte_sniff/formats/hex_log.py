"""Owns a log of hex text as chunks, with the times and directions that it tells.

It must not know how lines are read; `pastes` does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, BinaryIO, NamedTuple

from fte_sniff.errors import InputTextError, unreadable
from fte_sniff.formats.line_head import Mark
from fte_sniff.formats.log_clock import LogClock
from fte_sniff.formats.pastes import logged_bytes
from fte_sniff.formats.text_lines import Piece, text_pieces
from fte_sniff.protocol import Chunk, Frame, Row
from fte_sniff.protocol.table import Direction

MARK_OF_DIRECTION: dict[Direction, Mark] = {
    Direction.CONTROL: Mark.SENT,
    Direction.FEEDBACK: Mark.RECEIVED,
}
"""What a log of the host says of the frames of each direction."""


class _Marked(NamedTuple):
    stop: int
    """Offset behind the last byte of a line."""
    mark: Mark | None
    line: int


class HexLog:
    """The chunks of a log, one a line; once they are through, what is to be told of it."""

    def __init__(
        self, pieces: Iterable[Piece], name: str, clock: LogClock | None = None, where: str = ""
    ) -> None:
        """A log.

        Args:
            pieces: its lines.
            name: the port of its rows.
            clock: of its times.
            where: what stands before its errors.
        """
        self._pieces = pieces
        self.name = name
        self._clock = clock or LogClock()
        self._where = where
        self._marked: deque[_Marked] = deque()
        self._doubts: list[str] = []
        self._compared = 0
        self._against = 0
        self._first_against = ""

    @classmethod
    def of_stream(
        cls, stream: BinaryIO | IO[bytes], name: str, clock: LogClock | None = None
    ) -> HexLog:
        """The log that an open stream holds."""
        return cls(text_pieces(stream, name), name, clock, f"{name}: ")

    @classmethod
    def of_file(cls, path: Path, clock: LogClock | None = None) -> HexLog:
        """The log that a file holds; it is opened when the chunks are asked for."""
        return cls(_pieces_of_file(path), str(path), clock, f"{path}: ")

    def __iter__(self) -> Iterator[Chunk]:
        """The chunks.

        Raises:
            FileError: it cannot be read, or is no text.
            InputTextError: something in it is not hex.
        """
        stop = 0
        try:
            for logged in logged_bytes(self._pieces, self._doubts.append):
                stop += len(logged.data)
                self._marked.append(_Marked(stop, logged.mark, logged.line))
                t_ns = None if logged.stamp is None else self._clock.t_ns(logged.stamp)
                yield Chunk(self.name, t_ns, logged.data)
        except InputTextError as error:
            raise InputTextError(f"{self._where}{error}") from error

    def compare(self, rows: Iterable[Row]) -> None:
        """See whether the rows, which are those of the chunks in order, go as the log says."""
        for row in rows:
            while self._marked[0].stop <= row.offset:
                self._marked.popleft()
            _, mark, line = self._marked[0]
            if mark is None or not isinstance(row, Frame):
                continue
            self._compared += 1
            if mark is not MARK_OF_DIRECTION[row.direction]:
                self._against += 1
                self._first_against = self._first_against or (
                    f"line {line} says {mark}, header {row.raw[0]:02X} says {row.direction}"
                )

    @property
    def doubts(self) -> list[str]:
        """What is doubtful in what was read, one line each."""
        if not self._against:
            return self._doubts
        told = (
            f"{self._against:,} of {self._compared:,} frames go the other way than the log says"
            f" ({self._first_against}): a tap logs so, or the wires are swapped"
        )
        return [*self._doubts, told]

    @property
    def about_times(self) -> list[str]:
        """What became of its times, one line each, where that is not plain."""
        told = []
        if self._clock.undated:
            told.append("its times have no date, and are left out; --date 2026-01-31 says the day")
        if self._clock.zoneless:
            told.append("its times name no zone, and are taken as UTC; --zone +08:00 says another")
        return told


def _pieces_of_file(path: Path) -> Iterator[Piece]:
    try:
        with path.open("rb") as file:
            yield from text_pieces(file, str(path))
    except OSError as error:
        raise unreadable(path, error) from error
