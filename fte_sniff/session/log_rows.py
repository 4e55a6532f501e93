"""The rows of raw bytes and of logs, which are framed here.

Each direction or port of a log is a stream with its own framer; they are merged. In a file with
times, rows are merged by time: a row waits until every other stream has passed its time. Without
times, from a pipe, and after the clock was set back, they are merged by line: a row waits while
another stream has undecided bytes of an earlier line.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from fte_sniff.errors import FileError, FteSniffError, InputTextError, unreadable
from fte_sniff.formats.logs.text import LATEST_NS, NO_TIME, StreamBytes
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    HEADERS,
    Chunk,
    Direction,
    Fault,
    Framer,
)
from fte_sniff.protocol.framer import SETTLING_NS
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.protocol.spec import DIRECTION_OF_HEADER, TAIL, byte_time_ns

if TYPE_CHECKING:
    from fte_sniff.formats.logs.reader import LogReader
    from fte_sniff.session.merge import Merge, MergeLane

SPAN_BYTES: Final = 1 << 19
"""Bytes that are framed before their rows are yielded, unless a reader waits for them."""


_BLOCK: Final = 1 << 19
"""Bytes of one read at most; a pipe or terminal returns what is available."""


def raw_chunks(
    source: Path | BinaryIO, port: str, start_ns: int | None = None, baud: int = DEFAULT_BAUD
) -> Iterator[Chunk]:
    """Read a file of raw bytes, or an open stream such as standard input, as chunks.

    If the first byte began at `start_ns`, chunks have the times that the baud gives. Raises
    FileError if the file cannot be read.
    """
    size, byte_ns = 0, byte_time_ns(baud)
    try:
        with source.open("rb") if isinstance(source, Path) else nullcontext(source) as stream:
            read = getattr(stream, "read1", stream.read)
            while block := read(_BLOCK):
                size += len(block)
                yield Chunk(port, None if start_ns is None else start_ns + size * byte_ns, block)
    except OSError as error:
        raise unreadable(port, error) from error


def rows_of_chunks(
    chunks: Iterable[Chunk],
    name: str,
    note: Callable[[str], None],
    baud: int = DEFAULT_BAUD,
    *,
    waits: bool = False,
) -> Iterator[Rows]:
    """Frame all chunks, about `SPAN_BYTES` at a time.

    The chunks are of one port, and their times may fall. `note` is called if the input ends within
    a frame. If the next chunk has to be waited for (`waits`), rows are not held back. Raises
    FileError without a chunk, and what the chunks raise, after the rows before it.
    """
    framer = Framer(name, baud)
    size, empty = 0, True
    try:
        before_ns = None
        for chunk in chunks:
            if before_ns is not None and chunk.t_ns is not None and chunk.t_ns < before_ns:
                framer.reset_clock()
            before_ns = before_ns if chunk.t_ns is None else chunk.t_ns
            empty = False
            framer.push(chunk)
            size += len(chunk.data)
            if size >= SPAN_BYTES or waits:
                size = 0
                yield framer.drain()
    except FteSniffError:
        yield framer.finish()
        raise
    if empty:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    last = framer.finish()
    yield last
    if cut := cut_frame_note(last):
        note(f"{name}: {cut}")


def cut_frame_note(last: Rows) -> str | None:
    """That a stream whose last rows these are ends within a frame."""
    row = last[-1] if len(last) else None
    if row is None or Fault.TRUNCATED not in row.faults:
        return None
    return f"ends in the middle of a frame ({len(row.raw)} of {FRAME_LENGTH} bytes)"


_MOST_HELD: Final = 1_000_000
"""Rows that wait for another stream, about 50 MB."""
_FAR_NS: Final = 10**9
"""A fall of times where the clock was set back."""
_LOW: Final = 0.5
"""Share of the bytes of a log in frames, from which on it is not low."""
_FAR_BELOW: Final = 0.7
"""Part of the share in the sample from which on the share of the whole log is not far below it."""
_MANY_BYTES: Final = 100
_SWAPPED: Final = 0.9
"""Of the frames of both directions, how many go the other way if the wires are swapped."""
_WAYS: Final = {"tx": ("sent", Direction.CONTROL), "rx": ("received", Direction.FEEDBACK)}
"""By label, what the host, which writes the log, does with the frames, and their direction."""


def rows_of_log(log: LogReader, note: Callable[[str], None] = lambda _note: None) -> Iterator[Rows]:
    """Read the rows of a log once; note at the end how it was read, also if reading stops early.

    Raises:
        FileError: it cannot be read, or is empty.
        InputTextError: no bytes are found in it, or something in plain hex is not hex.
    """
    streams = _LogStreams(log)
    try:
        yield from _framed(log, streams)
    except GeneratorExit:
        # What depends on the rest of the log is not known.
        for text in log.notes():
            note(f"{log.where}{text}")
        raise
    notes = streams.notes(sampled=log.form.share, ends=log.options.whole)
    for text in (*notes, *log.notes()):
        note(f"{log.where}{text}")


def _framed(log: LogReader, streams: _LogStreams) -> Iterator[Rows]:
    """All rows of the log; raises as `rows_of_log` does."""
    failed = None
    try:
        for block in log.read():
            size = streams.size
            if block is None:
                streams.end_frames()
            else:
                streams.append(block)
            if streams.size > size:
                yield from streams.drain()
    except InputTextError as error:
        failed = InputTextError(f"{log.where}{error}")
    yield from streams.drain(final=True)
    if failed is not None:
        raise failed
    if not streams.size:
        raise log.nothing_read()


class _LogWire:
    """The bytes of one wire.

    The framer gets the silence between lines, but not their times: silence shorter than the
    resolution of the stamps is none. The times of rows come from the stamps.
    """

    def __init__(self, port: str, log: _LogStreams) -> None:
        self.port, self._log = port, log
        self._framer = Framer(port, log.baud)
        self._clock_ns, self._size, self._last_ns = log.start_ns or 0, 0, NO_TIME
        self._lines: Any = None
        """Of each line with undecided bytes: the offset after them, its number, its time, and when
        one of its bytes can have begun at the earliest; int64, shape (4, lines)."""
        self._first = False
        """Whether the first byte of each line began at its time."""
        self._ended = 0
        """Bytes up to the last gap of the log."""
        self.label: str | None = None
        """The direction of the stream in the log, or another label."""
        self.frames = Counter[int]()
        self.last_key_ns = -1
        """The latest time of its rows so far."""
        self.cut_frame: str | None = None
        """The note that it ends in a frame."""

    def append(self, new: StreamBytes) -> None:
        """Append the bytes of lines."""
        self.label = new.label if not self.frames or self.label == new.label else None
        log, size, silences = self._log, len(new.data), dict[int, int]()
        if not log.is_one and len(new.order):
            silences = self._append_lines(new)
        for start, stop in pairwise([*sorted({0, *silences, *new.gaps}), size]):
            if start in new.gaps:
                self._framer.end()
            self._clock_ns += silences.get(start, 0) + (stop - start) * log.byte_ns
            t_ns = None if log.start_ns is None else self._clock_ns
            self._framer.push(Chunk(self.port, t_ns, new.data[start:stop]))
        self._size += size

    def end_frame(self) -> None:
        """End the frame: the next bytes may not follow the last ones."""
        if self._size > self._ended:
            self._ended = self._size
            self._framer.end()

    def _append_lines(self, new: StreamBytes) -> dict[int, int]:
        """Append the columns of lines; returns the pauses before them, by offset in the data."""
        import numpy as np

        log, sizes = self._log, np.asarray(new.sizes, np.int64)
        stops, took = np.cumsum(sizes), sizes * log.byte_ns
        t_ns = np.full(len(sizes), NO_TIME) if new.times is None else np.array(new.times, np.int64)
        self._first = new.first
        if new.first:
            t_ns = np.where(t_ns == NO_TIME, t_ns, np.minimum(t_ns, LATEST_NS - took) + took)
        now = np.maximum(t_ns, 0)
        before = np.append(max(self._last_ns, -_FAR_NS), now[:-1])
        passed, self._last_ns = now - before, int(now[-1])
        log.by_time &= bool(passed.min() >= -_FAR_NS)
        floors = np.maximum(before, 0) * (not new.first) * (passed >= 0)
        columns = np.stack([self._size + stops, new.order, t_ns, floors])
        self._lines = columns if self._lines is None else np.hstack([self._lines, columns])
        text = np.frombuffer(new.data + b"\0", np.uint8)
        whole = (sizes == FRAME_LENGTH) & (text[stops - 1] == TAIL)
        whole &= np.isin(text[stops - sizes], [*HEADERS.values()])
        silences = passed - (took + log.resolution_ns)
        if not new.first:  # silence between two frames is not news, except for rows of our own
            silences[1:][whole[1:] & whole[:-1]] = 0
        at = np.flatnonzero(silences >= log.pause_ns)
        return dict(zip((stops - sizes)[at].tolist(), silences[at].tolist(), strict=True))

    def drain(self, *, final: bool) -> Rows:
        """The rows that are decided since the last time."""
        rows = self._framer.finish() if final else self._framer.drain()
        self.cut_frame = cut_frame_note(rows) if final else None
        self.frames.update(rows.raw[rows.framed, 0].tolist())
        return rows

    def put(self, batch: Rows, lane: MergeLane) -> None:
        """Put rows with their times into the lane; the keys are lines and rising times."""
        import numpy as np

        own = np.searchsorted(self._lines[0], batch.offset, "right")
        stops, lines, times, floors = self._lines[:, own]
        before = (stops - batch.offset) * self._log.byte_ns
        if not self._first:
            before -= before % self._log.resolution_ns  # no time is finer than the stamps
        t_ns = np.maximum(times - before, floors)
        delay_ns = np.maximum(times - t_ns, 0)
        t_ns[times == NO_TIME] = delay_ns[times == NO_TIME] = NO_TIME
        end = batch.offset[-1] + batch.length[-1]
        self._lines = self._lines[:, np.searchsorted(self._lines[0], end, "right") :]
        keys = np.maximum.accumulate(np.append(self.last_key_ns, t_ns))[1:]
        self.last_key_ns = int(keys[-1])
        both = [keys, lines] if self._log.by_time else [lines, keys]
        lane.put(batch.replace(t_ns=t_ns, delay_ns=delay_ns), np.stack(both))

    def reached(self) -> tuple[int, int]:
        """The key before which no row of the stream is to come."""
        has_lines = self._lines is not None and self._lines.size
        line = int(self._lines[1, 0]) if has_lines else LATEST_NS
        return (self.last_key_ns, line) if self._log.by_time else (line, 0)


class _LogStreams:
    """All streams of a log."""

    def __init__(self, log: LogReader) -> None:
        """No stream has bytes yet; those of a file are known, and merged by time."""
        form, options = log.form, log.options
        self.resolution_ns = form.resolution_ns or 1
        self.start_ns = options.start_ns if form.resolution_ns is None else 0
        """When the bytes of a log without times began; None to have no times."""
        self.baud, self.byte_ns = options.baud, byte_time_ns(options.baud)
        self.pause_ns = SETTLING_NS
        self.size = 0
        """Bytes of all streams."""
        self.is_one = form.is_one_stream
        ports = form.ports(log.name) if log.is_file else ()
        self._streams = {port: _LogWire(port, self) for port in ports}
        self.by_time = len(self._streams) > 1 and form.resolution_ns is not None
        """Whether rows are merged by time; else by line."""
        self._lanes: dict[str, MergeLane] = {}
        self._merge: Merge | None = None
        if not self.is_one:
            from fte_sniff.session.merge import Merge

            self._merge = Merge()

    def append(self, block: Iterable[StreamBytes]) -> None:
        """Append bytes to their streams."""
        by_time = self.by_time
        for new in block:
            self._streams.setdefault(new.port, _LogWire(new.port, self)).append(new)
            self.size += len(new.data)
        if by_time and not self.by_time:
            for lane in self._lanes.values():
                lane.swap_keys()

    def end_frames(self) -> None:
        """End each stream's frame: its next bytes may not follow the last ones."""
        for stream in self._streams.values():
            stream.end_frame()

    def notes(self, *, sampled: float | None, ends: bool) -> Iterator[str]:
        """Which directions frames contradict; if `ends`, which streams end within a frame.

        Also whether few bytes are in frames, other than in a sample of which a share was `sampled`.
        """
        known = [(own, *_WAYS[own.label]) for own in self._streams.values() if own.label in _WAYS]
        against = [
            (own.frames[header], f"{word}, header {header:02X} says {says}")
            for own, word, way in known
            for header, says in DIRECTION_OF_HEADER.items()
            if says is not way and own.frames[header]
        ]
        wrong, total = (
            sum(more for more, _ in against),
            sum(own.frames.total() for own, *_ in known),
        )
        if against:
            both = len({word for _, word, _ in known}) > 1 and wrong > _SWAPPED * total
            swapped = "otherwise the wires are swapped"
            otherwise = swapped if both else "or a label names no direction"
            yield (
                f"{wrong:,} of {total:,} frames go the other way than the log says"
                f" ({against[0][1]}): this is normal in the log of a tap; {otherwise}"
            )
        in_frames = FRAME_LENGTH * sum(own.frames.total() for own in self._streams.values())
        low = max(_LOW, _FAR_BELOW * (sampled or 0))
        if sampled is not None and self.size >= _MANY_BYTES and in_frames < low * self.size:
            yield (
                f"only {in_frames / self.size:.0%} of the bytes read are in frames"
                f" ({sampled:.0%} in its sample); another form may be right: --explain shows what"
                " is read, --form and --input-regex choose"
            )
        for stream in self._streams.values() if ends else ():
            where = "" if len(self._streams) == 1 else f"{stream.port.rpartition(':')[2]} "
            if stream.cut_frame:
                yield where + stream.cut_frame

    def drain(self, *, final: bool = False) -> Iterator[Rows]:
        """The rows that are decided and in order, if there are any."""
        rows, merge = NO_ROWS, self._merge
        for port, stream in self._streams.items():
            rows = stream.drain(final=final)
            if merge is not None:
                lane = self._lane(port, merge)
                if len(rows):
                    stream.put(rows, lane)
                lane.reached = stream.reached()
        if merge is not None and self._streams:
            taken = merge.take(final=final or merge.waiting > _MOST_HELD)
            rows = NO_ROWS if taken is None else taken.rows
        if len(rows):
            yield rows

    def _lane(self, port: str, merge: Merge) -> MergeLane:
        lane = self._lanes.get(port)
        if lane is None:
            from fte_sniff.session.merge import MergeLane

            lane = self._lanes[port] = MergeLane()
            merge.lanes.append(lane)
        return lane
