"""Owns a log of hex text as chunks, with the times and directions that it tells.

It must not know how lines are read; `pastes` does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, BinaryIO, NamedTuple

from fte_sniff.errors import FteSniffError, InputTextError, UsageError, unreadable
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.log_clock import LATEST_NS, LogClock
from fte_sniff.formats.logs.pastes import Logged, logged_bytes
from fte_sniff.formats.logs.text_lines import Piece, TextPieces
from fte_sniff.protocol import Chunk, Framer, Row
from fte_sniff.protocol.spec import DEFAULT_BAUD, DIRECTION_OF_HEADER, Direction, byte_time_ns

MARK_OF_DIRECTION: dict[Direction, Mark] = {
    Direction.CONTROL: Mark.SENT,
    Direction.FEEDBACK: Mark.RECEIVED,
}
"""What a log of the host says of the frames of each direction."""


_UNITS = (
    (86_400 * 10**9, "day"),
    (3600 * 10**9, "h"),
    (60 * 10**9, "min"),
    (10**9, "s"),
    (10**6, "ms"),
    (10**3, "µs"),
    (1, "ns"),
)


class _Marked(NamedTuple):
    stop: int
    """Offset behind the last byte of a line."""
    mark: Mark | None
    line: int


@dataclass(slots=True)
class _Setbacks:
    """Where the times of a log go back, as they do where logs were joined or a clock was set."""

    _last_ns: int | None = None
    _line: int = 0
    _by_ns: int = 0
    _count: int = 0

    def see(self, t_ns: int | None, line: int) -> None:
        if t_ns is None:
            return
        if self._last_ns is not None and t_ns < self._last_ns:
            if not self._count:
                self._line, self._by_ns = line, self._last_ns - t_ns
            self._count += 1
        self._last_ns = t_ns

    @property
    def told(self) -> list[str]:
        if not self._count:
            return []
        more = f", and {self._count - 1:,} times more" if self._count > 2 else ""
        more = ", and once more" if self._count == 2 else more
        return [f"line {self._line}: the time goes back by {_length(self._by_ns)}{more}"]


def _length(ns: int) -> str:
    """A length of time in its largest unit, with what is left in the next."""
    for (size, unit), (smaller, small) in pairwise(_UNITS):
        if ns >= size:
            count, rest = divmod(ns, size)
            rest //= smaller
            text = f"{count:,} {unit}{'s' if unit == 'day' and count > 1 else ''}"
            return f"{text} {rest} {small}" if rest else text
    return f"{ns} ns"


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
        self._directed = False
        """Whether any line by now told a direction."""
        self._compared = 0
        self._against = 0
        self._first_against = ""
        self._setbacks = _Setbacks()
        self._read_ns: int | None = None
        """By when the latest row that tells when it began would have come."""
        self._again: Callable[[], HexLog] | None = None
        self.drained: Callable[[], bool] = lambda: False
        """Whether more has to come before there is another chunk; not asked of files."""

    @classmethod
    def of_stream(
        cls, stream: BinaryIO | IO[bytes], name: str, clock: LogClock | None = None
    ) -> HexLog:
        """The log that an open stream holds."""
        pieces = TextPieces(stream, name)
        log = cls(pieces, name, clock, f"{name}: ")
        log.drained = lambda: pieces.drained
        return log

    @classmethod
    def of_file(cls, path: Path, clock: LogClock | None = None) -> HexLog:
        """The log that a file holds; it is opened when the chunks are asked for."""
        log = cls(_pieces_of_file(path), str(path), clock, f"{path}: ")
        if path.is_file():
            anew = log._clock.anew()
            log._again = lambda: cls.of_file(path, anew)
        return log

    def __iter__(self) -> Iterator[Chunk]:
        """The chunks.

        Raises:
            FileError: it cannot be read, or is no text.
            InputTextError: something in it is not hex.
        """
        stop = 0
        try:
            lines = logged_bytes(self._pieces, self._doubts.append)
            for logged in self._clock.order.settled(lines):
                stop += len(logged.data)
                self._mark(stop, logged)
                yield from self._chunks_of(logged)
        except InputTextError as error:
            raise InputTextError(f"{self._where}{error}") from error

    def _chunks_of(self, logged: Logged) -> Iterator[Chunk]:
        """The bytes of a line at its time."""
        stamp, t_ns = logged.stamp, None
        if stamp is not None:
            t_ns = self._clock.t_ns(stamp, logged.line)
            self._setbacks.see(t_ns, logged.line)
        if t_ns is not None and stamp is not None and stamp.of_first_byte:
            if self._read_ns is not None and t_ns < self._read_ns:
                # Nothing had come by then, although those before would still be coming.
                yield Chunk(self.name, t_ns, b"")
            t_ns += len(logged.data) * byte_time_ns(DEFAULT_BAUD)
            t_ns = self._read_ns = min(t_ns, LATEST_NS)
        yield Chunk(self.name, t_ns, logged.data)

    def _mark(self, stop: int, logged: Logged) -> None:
        """The bytes up to `stop` are marked as their line says; nothing as long as nothing is."""
        marked = self._marked
        self._directed = self._directed or logged.mark is not None
        if marked and marked[-1].mark is logged.mark is None:
            marked.pop()
        marked.append(_Marked(stop, logged.mark, logged.line))

    @property
    def times(self) -> tuple[int, int] | None:
        """The earliest and latest time of its rows, for which it is read once more.

        None where it has no times; up to what cannot be read, which reading it will tell.

        Raises:
            UsageError: it can be read only once.
        """
        if self._again is None:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        log = self._again()
        first = last = None
        for rows in _readable(log):
            known = [row.t_ns for row in rows if row.t_ns is not None]
            first = min([*known, *([] if first is None else [first])], default=None)
            last = max([*known, *([] if last is None else [last])], default=None)
        if first is None and log._clock.undated:
            raise UsageError(f"{self.name}: its times have no date; add --date 2026-01-31")
        return None if first is None or last is None else (first, last)

    def compare(self, headers: Iterable[tuple[int, int]]) -> None:
        """See whether frames go as the log says.

        Args:
            headers: the offset of each frame in the chunks, which rises, and its header.
        """
        if not self._directed:
            return
        marked = self._marked
        for offset, header in headers:
            while marked[0].stop <= offset:
                marked.popleft()
            _, mark, line = marked[0]
            if mark is None:
                continue
            self._compared += 1
            direction = DIRECTION_OF_HEADER[header]
            if mark is not MARK_OF_DIRECTION[direction]:
                self._against += 1
                self._first_against = self._first_against or (
                    f"line {line} says {mark}, header {header:02X} says {direction}"
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
        told = [*self._clock.wrong, *self._setbacks.told]
        if self._clock.order.doubt is not None:
            told.append(self._clock.order.doubt)
        if self._clock.undated:
            told.append("its times have no date, and are left out; --date 2026-01-31 says the day")
        if self._clock.zoneless:
            told.append("its times name no zone, and are taken as UTC; --zone +08:00 says another")
        return told


def at_own_times(chunks: Iterable[Chunk], framer: Framer) -> Iterator[Chunk]:
    """The chunks of a log, which the framer is to take; it learns where their times fall."""
    before_ns = None
    for chunk in chunks:
        if before_ns is not None and chunk.t_ns is not None and chunk.t_ns < before_ns:
            framer.reset_clock()
        before_ns = before_ns if chunk.t_ns is None else chunk.t_ns
        yield chunk


def _readable(log: HexLog) -> Iterator[list[Row]]:
    """Its rows, up to what cannot be read."""
    framer = Framer(log.name)
    with suppress(FteSniffError):  # who reads it in earnest is told
        yield from map(framer.feed, at_own_times(log, framer))
    yield framer.flush()


def _pieces_of_file(path: Path) -> Iterator[Piece]:
    try:
        with path.open("rb") as file:
            yield from TextPieces(file, str(path))
    except OSError as error:
        raise unreadable(path, error) from error
