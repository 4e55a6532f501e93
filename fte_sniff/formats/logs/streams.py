"""The streams of a log: each direction or port with its own framer; their rows merged.

In a file with times, rows are merged by time: a row waits until every other stream has passed its
time. Without times, from a pipe, and after the clock was set back, they are merged by line: a row
waits while another stream has undecided bytes of an earlier line.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, Chunk, Direction, Fault, Framer
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.protocol.framer.timestamps import PAUSE_BYTES
from fte_sniff.protocol.spec import DIRECTION_OF_HEADER, TAIL, byte_time_ns

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from fte_sniff.formats.logs.reader import LogOptions
    from fte_sniff.formats.logs.text import TextBlock
    from fte_sniff.row_batch import RowBatch, Rows

    Array = npt.NDArray[np.int64]

LATEST_NS: Final = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
NO_TIME: Final = -(2**63)
FEW: Final = 20_000
"""Rows of a log that come as lists, so that few are written without polars."""
_FEW_AT_ONCE: Final = 100
_MOST_HELD: Final = 1_000_000
"""Rows that wait for another stream, about 50 MB."""
_FAR_NS: Final = 10**9
"""A fall of times where the clock was set back."""
_WAYS: Final = {"tx": ("sent", Direction.CONTROL), "rx": ("received", Direction.FEEDBACK)}
"""By label, what the host, which writes the log, does with the frames, and their direction."""


class StreamBytes(NamedTuple):
    """Bytes of consecutive lines of one stream of a log."""

    port: str
    data: bytes
    sizes: Sequence[int] | Array = ()
    """How many bytes are of each line."""
    lines: Sequence[int] | Array = ()
    """The numbers of the lines; none if the log is one stream without times."""
    times: Sequence[int] | Array | None = None
    """The times of the lines, nanoseconds since 1970 or `NO_TIME`; None if none has one."""
    gaps: Sequence[int] = ()
    """Offsets in the bytes where the log leaves out others, so that no frame goes on."""
    first: bool = False
    """Whether the first byte of a line began at its time; else the last one had arrived."""
    label: str | None = None
    """Of the stream: a direction, which its frames can contradict, or any other."""


class LogForm(ABC):
    """A kind of log: how blocks of lines become the bytes of streams."""

    resolution_ns: int | None = None
    """Of its times; None if it has none."""
    single: bool = False
    """Whether its rows have one port, whatever it says of directions."""
    frames: int = 0
    """Whole frames in its sample."""
    is_certain: bool = False
    """Whether its sample shows that no other kind of log is better."""

    def ports(self, name: str) -> list[str]:
        """The ports of its rows, as far as the sample shows."""
        return [name]

    @property
    def is_one_stream(self) -> bool:
        """Whether its bytes follow each other, in one stream without times."""
        return self.single and self.resolution_ns is None

    @abstractmethod
    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """The bytes of a block of the log of this name; raises InputTextError after the others."""

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        return []

    @abstractmethod
    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""


class _Piece(NamedTuple):
    """Rows of one stream, with their order in the log."""

    keys: Array
    """Rising: times, or the numbers of lines."""
    lines: Array
    rows: RowBatch


class LogStream:
    """The bytes of one wire, and the rows that they make.

    The framer gets chunks with the silence between them, but not their times: silence shorter than
    the resolution of the stamps is none. The times of rows come from the stamps.
    """

    def __init__(self, port: str, log: LogStreams) -> None:
        self.port, self._log, self._framer = port, log, Framer(port, log.baud)
        self._clock_ns, self._size, self._last_ns = 0, 0, NO_TIME
        self._columns: Any = None
        """Of each line: the offset after its bytes, its number, its time, and the earliest time
        at which one of its bytes can have begun; int64, shape (4, lines)."""
        self.label: str | None = None
        """The direction of the stream in the log, or another label."""
        self.frames = Counter[int]()
        """By header."""
        self.cut_frame: str | None = None
        """The note that it ends in a frame."""
        self.key = -1
        """Of its last row."""

    def append(self, new: StreamBytes) -> None:
        """Append the bytes of lines."""
        data, times, gaps = new.data, new.times, new.gaps
        self.label = new.label if not self.frames or self.label == new.label else None
        log = self._log
        log.size += len(data)
        if log.direct or not data:
            self._push(data, {}, gaps)
            return
        import numpy as np

        sizes = np.asarray(new.sizes, np.int64)
        t_ns = np.full(len(sizes), NO_TIME)
        took, stops = sizes * log.byte_ns, np.cumsum(sizes)
        silences, floors = np.zeros((2, len(sizes)), np.int64)
        if times is not None:
            t_ns = np.array(times, np.int64)
            if new.first:
                t_ns[t_ns != NO_TIME] += np.minimum(took, LATEST_NS - t_ns)[t_ns != NO_TIME]
            at_ns = np.maximum(t_ns, 0)
            before = np.append(max(self._last_ns, -_FAR_NS), at_ns[:-1])
            passed = at_ns - before
            log.set_back |= bool(passed.min() < -_FAR_NS)
            silences = passed - (took + log.resolution_ns)
            floors = floors if new.first else np.maximum(before, 0) * (passed >= 0)
            self._last_ns = int(at_ns[-1])
            text = np.frombuffer(data, np.uint8)
            whole = (sizes == FRAME_LENGTH) & (text[stops - 1] == TAIL)
            head = text[np.minimum(stops - sizes, len(text) - 1)]
            whole &= np.logical_or.reduce([head == header for header in HEADERS.values()])
            silences[1:][whole[1:] & whole[:-1]] = 0  # silence between two frames is no news
        at = np.flatnonzero(silences >= log.pause_ns)
        cuts = zip((stops - sizes)[at].tolist(), silences[at].tolist(), strict=True)
        columns = np.stack([stops + self._size, new.lines, t_ns, floors])
        self._columns = columns if self._columns is None else np.hstack([self._columns, columns])
        self._size += len(data)
        self._push(data, dict(cuts), gaps)

    def _push(self, data: bytes, silences: Mapping[int, int], gaps: Sequence[int]) -> None:
        for start, stop in pairwise([*sorted({0, *silences, *gaps}), len(data)]):
            if start in gaps:
                self._framer.finish()
            self._clock_ns += silences.get(start, 0) + (stop - start) * self._log.byte_ns
            began = self._log.start_ns if self._log.direct else 0
            t_ns = None if began is None else began + self._clock_ns
            self._framer.push(Chunk(self.port, t_ns, data[start:stop]))

    def drain(self, *, final: bool, few: int) -> Rows:
        """The rows that are decided since the last time."""
        if final:
            self._framer.finish()
        span = self._framer.drain()
        self.cut_frame = cut_frame_note(span) if final else None
        if self._log.direct and len(span) <= few:
            self.frames.update(header for _, header in span.headers())
            return span.rows()
        import numpy as np

        from fte_sniff.row_batch import RowBatch

        times = span.times if self._log.direct else []
        batch = RowBatch.from_span(
            DecidedSpan(span.port, span.data, span.start, span.segments, times)
        )
        found = np.bincount(batch.raw[batch.framed, 0])
        self.frames.update({header: int(count) for header, count in enumerate(found) if count})
        return batch

    def placed(self, batch: Any) -> _Piece:
        """Rows with their times and their order; the lines of earlier rows are forgotten."""
        import numpy as np

        own = np.searchsorted(self._columns[0], batch.offset, "right")
        stops, lines, times, floors = self._columns[:, own]
        t_ns = np.maximum(times - (stops - batch.offset) * self._log.byte_ns, floors)
        delay_ns = np.maximum(times - t_ns, 0)
        t_ns[times == NO_TIME] = delay_ns[times == NO_TIME] = NO_TIME
        end = batch.offset[-1] + batch.length[-1]
        self._columns = self._columns[:, np.searchsorted(self._columns[0], end, "right") :]
        keys = lines
        if self._log.by_time:
            keys = np.maximum.accumulate(np.append(self.key, t_ns))[1:]
        self.key = int(keys[-1])
        return _Piece(keys, lines, replace(batch, t_ns=t_ns, delay_ns=delay_ns))

    def pending_line(self) -> int:
        """The line of the first undecided byte; a large number without one."""
        return (
            LATEST_NS
            if self._columns is None or not self._columns.size
            else int(self._columns[1, 0])
        )


class LogStreams:
    """All streams of a log."""

    def __init__(self, name: str, form: LogForm, options: LogOptions, ports: Iterable[str]) -> None:
        """No stream of the log has bytes yet; those of `ports` are expected and merged by time."""
        self.name, self.resolution_ns = name, form.resolution_ns or 1
        self.start_ns = options.start_ns if form.resolution_ns is None else None
        """When the bytes of a log without times began; None to have no times."""
        self.baud, self.byte_ns = options.baud, byte_time_ns(options.baud)
        self.pause_ns = round(PAUSE_BYTES * self.byte_ns)
        self.size = self._count = 0
        """Bytes of all streams, and rows so far."""
        self.set_back = False
        """Whether times fell far within a stream."""
        self.direct = form.is_one_stream
        """Whether rows come as the framer makes them: bytes follow each other, in one stream."""
        self._streams = {port: LogStream(port, self) for port in ports}
        self.by_time = len(self._streams) > 1 and form.resolution_ns is not None
        self._held: list[_Piece] = []

    def append(self, new: StreamBytes) -> None:
        """Append bytes to their stream."""
        self._streams.setdefault(new.port, LogStream(new.port, self)).append(new)

    def notes(self, *, ends: bool) -> Iterator[str]:
        """Which directions frames contradict, and if `ends`, which streams end within a frame."""
        known = [(own, *_WAYS[own.label]) for own in self._streams.values() if own.label in _WAYS]
        against = [
            (own.frames[header], f"{word}, header {header:02X} says {says}")
            for own, word, way in known
            for header, says in DIRECTION_OF_HEADER.items()
            if says is not way and own.frames[header]
        ]
        if against:
            count = f"{sum(more for more, _ in against):,} of"
            count += f" {sum(own.frames.total() for own, *_ in known):,} frames"
            yield (
                f"{count} go the other way than the log says ({against[0][1]}): this is normal"
                " in the log of a tap; otherwise the wires are swapped"
            )
        for stream in self._streams.values() if ends else ():
            where = "" if len(self._streams) == 1 else f"{stream.port.rpartition(':')[2]} "
            if stream.cut_frame:
                yield where + stream.cut_frame

    def drain(self, *, final: bool = False) -> list[Rows]:
        """The rows that are decided and in order."""
        few, streams = max(FEW - self._count, _FEW_AT_ONCE), [*self._streams.values()]
        batches: list[RowBatch] = []
        if self.set_back and self.by_time:
            self.by_time, batches = False, self._ready(LATEST_NS + 1)
            for stream in streams:
                stream.key = -1
        rows = [stream.drain(final=final, few=few) for stream in streams]
        if not self.direct:
            found = zip(streams, rows, strict=True)
            self._held += [stream.placed(own) for stream, own in found if len(own)]
            limit = LATEST_NS + 1
            waiting = sum(len(piece.rows) for piece in self._held)
            if len(streams) > 1 and not final and waiting <= _MOST_HELD:
                limit = min(one.key if self.by_time else one.pending_line() for one in streams)
            batches += self._ready(limit)
            rows = [list(one) if len(one) <= few else one for one in batches]
        self._count += sum(map(len, rows))
        return [own for own in rows if len(own)]

    def _ready(self, limit: int) -> list[RowBatch]:
        """The rows before a time or line, in order; the others are held."""
        if not self._held or (len(self._held) == 1 and limit > LATEST_NS):
            ready, self._held = [piece.rows for piece in self._held], []
            return ready
        import numpy as np

        from fte_sniff.row_batch import RowBatch

        keys = np.concatenate([piece.keys for piece in self._held])
        lines = np.concatenate([piece.lines for piece in self._held])
        rows = RowBatch.concat([piece.rows for piece in self._held])
        order = np.lexsort((lines, keys))
        now, later = np.split(order, np.searchsorted(keys[order], [limit]))
        self._held = [_Piece(keys[later], lines[later], rows.select(later))] if len(later) else []
        return [rows.select(now)]


def cut_frame_note(last: DecidedSpan) -> str | None:
    """That a stream whose last rows these are ends within a frame."""
    row = last.last()
    if row is None or row[1] or Fault.TRUNCATED not in row[2]:
        return None
    return f"ends in the middle of a frame ({row[0]} of {FRAME_LENGTH} bytes)"
