"""The streams of a log: each direction or port with its own framer; their rows merged.

In a file with times, rows are merged by time: a row waits until every other stream has passed its
time. Without times, from a pipe, and after the clock was set back, they are merged by line: a row
waits while another stream has undecided bytes of an earlier line.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias, Union

from fte_sniff.formats.logs.labels import RECEIVED, SENT
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, Chunk, Direction, Fault, Frame, Framer, Row
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.protocol.framer.timestamps import PAUSE_BYTES, ArrivalTime
from fte_sniff.protocol.spec import DEFAULT_BAUD, DIRECTION_OF_HEADER, TAIL, byte_time_ns

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from fte_sniff.formats.logs.text import TextBlock
    from fte_sniff.row_batch import RowBatch

    Array = npt.NDArray[np.int64]

Rows: TypeAlias = Union[list[Row], "RowBatch"]

LATEST_NS: Final = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
FEW: Final = 20_000
"""Rows of a log that come as lists, before numpy is loaded for the others."""
_FEW_AT_ONCE: Final = 100
_MOST_HELD: Final = 1_000_000
"""Rows that wait for another stream, about 50 MB."""
_NO_TIME: Final = -(2**63)
_FAR_NS: Final = 10**9
"""Silence where the log leaves out bytes; a fall of times where the clock was set back."""
_HEADER_OF_LABEL: Final = {
    SENT: HEADERS[Direction.CONTROL], RECEIVED: HEADERS[Direction.FEEDBACK]
}  # fmt: skip
"""The header of the frames that the host, which writes the log, sends or receives."""


class LogForm(ABC):
    """A kind of log: how blocks of lines become the bytes of streams."""

    resolution_ns: int | None = None
    """Of its times; None if it has none."""
    is_certain: bool = False
    """Whether its sample shows that no other kind of log is better."""

    def ports(self, name: str) -> list[str]:
        """The ports of its rows, as far as the sample shows."""
        return [name]

    @abstractmethod
    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """Append the bytes of a block to the streams; raises InputTextError."""

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        return []

    @abstractmethod
    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""


class _Piece(NamedTuple):
    """Rows of one stream, with their order in the log."""

    keys: Sequence[int] | Array
    """Rising: times, or the numbers of lines."""
    lines: Sequence[int] | Array
    rows: Rows


class LogStream:
    """The bytes of one wire, and the rows that they make.

    The framer gets chunks with the silence between them, but not their times: silence shorter than
    the resolution of the stamps is none. The times of rows come from the stamps.
    """

    def __init__(self, port: str, log: LogStreams) -> None:
        self.port, self._log, self._framer = port, log, Framer(port)
        self._clock_ns = self._size = 0
        self._last_ns: int | None = None
        self._stops, self._lines, self._times, self._floors = (array("q") for _ in range(4))
        """Of each line: the offset after its bytes, its number, its time, and the earliest time
        at which one of its bytes can have begun."""
        self.label: str | None = None
        """The direction of the stream in the log, or another label."""
        self.frames = Counter[int]()
        """By header."""
        self.first_line: dict[int, int] = {}
        """By header, the line of its first frame."""
        self.cut_frame: str | None = None
        """The note that it ends in a frame."""
        self.key = -1
        """Of its last row."""

    def append(self, data: bytes, line: int, t_ns: int | None, *, first: bool = False) -> None:
        """Append the bytes of a line.

        Args:
            data: the bytes.
            line: the number of the line.
            t_ns: its time.
            first: whether the first byte began then; else the last one had arrived.
        """
        log, before, floor, silence = self._log, self._last_ns, 0, 0
        log.size += len(data)
        if t_ns is None and log.start_ns is not None:
            t_ns = log.start_ns + log.size * log.byte_ns
        if t_ns is not None:
            duration = len(data) * log.byte_ns
            t_ns = min(t_ns + duration, LATEST_NS) if first else t_ns
            if before is not None:
                silence = t_ns - duration - before - log.resolution_ns
                floor = before if before <= t_ns and not first else 0
                log.set_back |= before - t_ns > _FAR_NS
            self._last_ns = t_ns
        self._push(data, silence)
        row = self._size, line, _NO_TIME if t_ns is None else t_ns, floor
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)

    def append_columns(self, data: bytes, sizes: Array, lines: Array, times: Array | None) -> None:
        """Append the bytes of many lines."""
        import numpy as np

        stops = np.cumsum(sizes)
        cuts, silent = np.zeros(0, np.int64), [0]
        floors = np.zeros(len(stops), np.int64)
        if times is not None:
            before = np.append(times[0] if self._last_ns is None else self._last_ns, times[:-1])
            silences = times - sizes * self._log.byte_ns - before - self._log.resolution_ns
            text = np.frombuffer(data, np.uint8)
            whole = (sizes == FRAME_LENGTH) & (text[stops - 1] == TAIL)
            whole &= np.isin(text[stops - sizes], list(HEADERS.values()))
            whole[1:] &= whole[:-1]  # silence between two frames is no news
            whole[0] = False
            at = np.flatnonzero((silences >= self._log.pause_ns) & ~whole)
            cuts, silent = (stops - sizes)[at], [0, *silences[at].tolist()]
            floors = np.where(before <= times, before, 0)
            floors[0] *= self._last_ns is not None
            self._log.set_back |= bool((before - times > _FAR_NS).any())
            self._last_ns = int(times[-1])
        self._log.size += len(data)
        stops += self._size
        bounds = [0, *cuts.tolist(), len(data)]
        for (start, stop), silence in zip(pairwise(bounds), silent, strict=True):
            if stop > start:
                self._push(data[start:stop], silence)
        times = np.full(len(stops), _NO_TIME) if times is None else times
        for own, column in zip(self._columns, (stops, lines, times, floors), strict=True):
            own.frombytes(column.astype(np.int64).tobytes())

    @property
    def _columns(self) -> tuple[array[int], ...]:
        return self._stops, self._lines, self._times, self._floors

    def cut(self) -> None:
        """The log leaves out bytes here: no frame goes on."""
        self._push(b"", _FAR_NS)

    def _push(self, data: bytes, silence: int) -> None:
        self._clock_ns += len(data) * self._log.byte_ns
        self._clock_ns += silence if silence >= self._log.pause_ns else 0
        self._size += len(data)
        self._framer.push(Chunk(self.port, self._clock_ns, data))

    def drain(self, *, final: bool, few: int) -> _Piece | None:
        """The rows that are decided since the last time; as a list if there are at most `few`."""
        if final:
            self._framer.finish()
        span = self._framer.drain()
        self.cut_frame = cut_frame_note(span) if final else None
        if not len(span):
            return None
        piece = self._few_rows(span) if len(span) <= few else self._batch(span)
        done = bisect_right(self._stops, span.segments.end)
        for column in self._columns:
            del column[:done]
        self.key = int(piece.keys[-1])
        return piece

    def pending_line(self) -> int:
        """The line of the first undecided byte; a large number without one."""
        return self._lines[0] if self._lines else LATEST_NS

    def _few_rows(self, span: DecidedSpan) -> _Piece:
        marks, start = list[ArrivalTime](), 0
        for stop, _, t_ns, floor in zip(*self._columns, strict=True):
            known = None if t_ns == _NO_TIME else t_ns
            marks.append(ArrivalTime(start, stop, known, floor, self._log.byte_ns))
            start = stop
        rows = DecidedSpan(span.port, span.data, span.start, span.segments, marks).rows()
        lines = [self._lines[bisect_right(self._stops, row.offset)] for row in rows]
        for row, line in zip(rows, lines, strict=True):
            if isinstance(row, Frame):
                self.frames[row.raw[0]] += 1
                self.first_line.setdefault(row.raw[0], line)
        keys = [row.t_ns or 0 for row in rows] if self._log.by_time else lines
        return _Piece(list(accumulate(keys, max, initial=self.key))[1:], lines, rows)

    def _batch(self, span: DecidedSpan) -> _Piece:
        import numpy as np

        from fte_sniff.row_batch import RowBatch

        span = DecidedSpan(span.port, span.data, span.start, span.segments, [])
        batch = RowBatch.from_span(span)
        columns = [np.frombuffer(column, np.int64) for column in self._columns]
        own = np.searchsorted(columns[0], batch.offset, "right")
        stops, lines, times, floors = (column[own] for column in columns)
        t_ns = np.maximum(times - (stops - batch.offset) * self._log.byte_ns, floors)
        delay_ns = np.maximum(times - t_ns, 0)
        t_ns[times == _NO_TIME] = delay_ns[times == _NO_TIME] = _NO_TIME
        for header in HEADERS.values():
            at = np.flatnonzero(batch.framed & (batch.raw[:, 0] == header))
            self.frames[header] += len(at)
            if len(at):
                self.first_line.setdefault(header, int(lines[at[0]]))
        keys = np.maximum.accumulate(np.append(self.key, t_ns))[1:] if self._log.by_time else lines
        return _Piece(keys, lines, replace(batch, t_ns=t_ns, delay_ns=delay_ns))


class LogStreams:
    """All streams of a log."""

    def __init__(
        self,
        resolution_ns: int | None = None,
        *,
        start_ns: int | None = None,
        baud: int = DEFAULT_BAUD,
        ports: Iterable[str] = (),
    ) -> None:
        """No stream has bytes yet.

        Args:
            resolution_ns: of the times of the log; None if it has none.
            start_ns: when the bytes of a log without times began; None to have no times.
            baud: bits per second, for the time that bytes take.
            ports: the streams that are expected, to merge by time; none to merge by line.
        """
        self.resolution_ns = resolution_ns or 1
        self.start_ns = start_ns if resolution_ns is None else None
        self.byte_ns = byte_time_ns(baud)
        self.pause_ns = round(PAUSE_BYTES * self.byte_ns)
        self.size = 0
        """Bytes of all streams."""
        self.set_back = False
        """Whether times fell far within a stream."""
        self._streams = {port: LogStream(port, self) for port in ports}
        self.by_time = len(self._streams) > 1 and resolution_ns is not None
        self._count = 0
        self._held: list[_Piece] = []

    def __getitem__(self, port: str) -> LogStream:
        """The stream of a port, which may be new."""
        if port not in self._streams:
            self._streams[port] = LogStream(port, self)
        return self._streams[port]

    def labelled(self, port: str, label: str | None) -> LogStream:
        """The stream of a port; its label may be a direction, which its frames can contradict."""
        stream = self[port]
        stream.label = label if not stream.frames or stream.label == label else None
        return stream

    def notes(self, *, ends: bool) -> list[str]:
        """Which directions frames contradict, and if `ends`, which streams end within a frame."""
        notes, against, count, frames = list[str](), list[tuple[int, str, int]](), 0, 0
        for stream in self._streams.values():
            expected = _HEADER_OF_LABEL.get(stream.label or "")
            for header, line in stream.first_line.items() if expected else ():
                frames += stream.frames[header]
                if header != expected:
                    count += stream.frames[header]
                    against.append((line, stream.label or "", header))
        if against:
            line, label, header = min(against)
            notes.append(
                f"{count:,} of {frames:,} frames go the other way than the log says"
                f" (line {line} says {'sent' if label == SENT else 'received'}, header"
                f" {header:02X} says {DIRECTION_OF_HEADER[header]}): a tap logs so, or the wires"
                " are swapped"
            )
        for stream in self._streams.values() if ends else ():
            where = "" if len(self._streams) == 1 else f"{stream.port.rpartition(':')[2]} "
            notes += [where + stream.cut_frame] if stream.cut_frame else []
        return notes

    def drain(self, *, final: bool = False) -> list[Rows]:
        """The rows that are decided and in order."""
        ready: list[_Piece] = []
        if self.set_back and self.by_time:
            self.by_time, ready, self._held = False, self._held, []
            for stream in self._streams.values():
                stream.key = -1
        few, streams = max(FEW - self._count, _FEW_AT_ONCE), self._streams.values()
        pieces = [stream.drain(final=final, few=few) for stream in streams]
        self._held += [piece for piece in pieces if piece is not None]
        self._count += sum(len(piece.rows) for piece in pieces if piece is not None)
        limit = LATEST_NS + 1
        waiting = sum(len(piece.rows) for piece in self._held)
        if len(streams) > 1 and not final and waiting <= _MOST_HELD:
            limit = min(one.key if self.by_time else one.pending_line() for one in streams)
        return [*_merged(ready), *_merged(self._take(limit))]

    def _take(self, limit: int) -> list[_Piece]:
        ready, held = list[_Piece](), list[_Piece]()
        for piece in self._held:
            stop = bisect_left(piece.keys, limit)
            for parts, part in ((ready, slice(stop)), (held, slice(stop, None))):
                if len(piece.rows[part]):
                    parts.append(_Piece(piece.keys[part], piece.lines[part], piece.rows[part]))
        self._held = held
        return ready


def _merged(pieces: Sequence[_Piece]) -> list[Rows]:
    if len(pieces) < 2:
        return [piece.rows for piece in pieces]
    if all(isinstance(piece.rows, list) for piece in pieces):
        entries = (entry for piece in pieces for entry in zip(*piece, strict=True))
        return [[row for _, _, row in sorted(entries, key=itemgetter(0, 1))]]
    import numpy as np

    from fte_sniff.row_batch import RowBatch

    keys, lines, rows = zip(*pieces, strict=True)
    order = np.lexsort((np.concatenate(lines), np.concatenate(keys)))
    return [RowBatch.concat([RowBatch.from_rows(some) for some in rows]).select(order)]


def cut_frame_note(last: DecidedSpan) -> str | None:
    """That a stream whose last rows these are ends within a frame."""
    row = last.last()
    if row is None or row[1] or Fault.TRUNCATED not in row[2]:
        return None
    return f"ends in the middle of a frame ({row[0]} of {FRAME_LENGTH} bytes)"
