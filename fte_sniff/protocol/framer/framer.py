"""The `Framer`: chunks in, rows out; decides when enough bytes have arrived.

The stream is decided from left to right, and every decision is final. A decision depends on silence
and on the bytes up to an offset that these bytes determine, never on the chunks. States:

    in step   A certain frame ended here. Plain frames are taken as long as another one follows in
              step, on a calm line unsplit ones too. The last one is taken at once if the line is
              calm and the frame clear; else when it cannot be the start of an overlong frame.
    disputed  Anything else. Bytes are decoded as soon as there is: an unambiguous frame, for the
              bytes before it; two strict frames in step; three strict frames; three framed segments
              in step; a framed segment and `lookahead` bytes; `widest` bytes; or silence. Decided
              is all but the last frame if the last two are certain; else what has `lookahead` bytes
              after it. The forward probabilities at the boundary start the next decoding.
    lost      Long noise. Bytes are skipped up to `lead` bytes before the next anchor.

Silence of 20 ms decides all pending bytes, except the start of a frame that can still be completed:
the reading process may have been held up. Such a start is given up after 500 ms. Shorter pauses,
from 3.5 byte times, are evidence for a boundary between segments.

A chunk of n bytes was read at t. Its byte i began at `max(P, t - (n - i) * byte time)`, where P is
the latest time at which earlier bytes of this port were read, or 1970 for the first chunk. So times
never fall, and they do not depend on how the bytes were cut into chunks, if an earlier chunk has
the correspondingly earlier time. Bytes of a chunk `at_once` have no byte time: all began at t.

Silence is the time between P and the first byte of a chunk. An empty chunk reports that nothing
arrived until its time: it is silence too, but moves no byte.
"""

from __future__ import annotations

from array import array
from collections import deque
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i16, i32, i64, u8

from fte_sniff.protocol.framer.decoder import (
    BoundaryState,
    CandidateSet,
    ForwardBackward,
    PrefixScore,
    Segment,
    after_certain_frame,
    after_silence,
    at_stream_start,
    decode,
    in_long_noise,
    trust_calm_line,
)
from fte_sniff.protocol.framer.model import (
    AMBIGUOUS,
    BOUNDARY,
    CLOSED,
    EXTRA,
    FAULT_SETS,
    FTE_TABLES,
    LIKELY,
    NOISE,
    OPEN,
    RESERVED_NONZERO,
    TRUNCATED,
    FrameTables,
    ReserveLearner,
    end_of_run,
    find_anchor,
    find_framed,
    find_strict,
    find_unambiguous,
    is_clear,
    is_framed,
    is_isolated,
    is_strict,
)
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import NO_TIME, Buffer, Codebook, Row, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, FRAME_LENGTH, byte_time_ns

_NOWHERE: Final[i64] = -1
"""In place of an offset: there is none."""

# Times

PAUSE_BYTES = 3.5
"""Byte times of silence that count as a pause."""

SETTLING_NS = 20_000_000
"""Silence after which pending bytes are decided."""


@final
class ArrivalTime:
    """Arrival time of the bytes of one chunk."""

    def __init__(
        self, start: i64, stop: i64, t_ns: int | None, floor_ns: int, byte_ns: int
    ) -> None:
        self.start = start
        """Stream offset of the first byte."""
        self.stop = stop
        """Stream offset after the last byte."""
        self.t_ns = t_ns
        """Read time, nanoseconds since 1970 UTC."""
        self.floor_ns = floor_ns
        """Earliest time at which a byte can have begun."""
        self.byte_ns = byte_ns

    def time_and_delay(self, offset: i64) -> tuple[int | None, int | None]:
        """When the byte at `offset` began on the wire, and how long before it was read."""
        t_ns, floor_ns = self.t_ns, self.floor_ns
        if t_ns is None:
            return None, None
        delay = int(self.stop - offset) * self.byte_ns
        if t_ns - delay >= floor_ns:
            return t_ns - delay, delay
        return floor_ns, t_ns - floor_ns if t_ns > floor_ns else 0


@final
class ArrivalTimes:
    """Queue of the arrival times of one port's bytes, read from left to right."""

    def __init__(self) -> None:
        self._times: deque[ArrivalTime] = deque()

    def append(self, time: ArrivalTime) -> None:
        """Append the arrival time of the next bytes."""
        self._times.append(time)

    def at(self, offset: i64) -> ArrivalTime:
        """The arrival time of the byte at `offset`; drops those of earlier chunks."""
        while self._times[0].stop <= offset:
            self._times.popleft()
        return self._times[0]


@final
class ArrivalTimeline:
    """Computes the arrival times of one port, chunk by chunk."""

    def __init__(self, byte_ns: int) -> None:
        self._byte_ns = byte_ns
        self.times = ArrivalTimes()
        self._size: i64 = 0
        self._floor = 0
        self._silent_since: int | None = None

    def set_byte_time(self, byte_ns: int) -> None:
        """Set the byte time of the next chunks, nanoseconds."""
        self._byte_ns = byte_ns

    def append(self, chunk: Chunk) -> int:
        """Append a chunk with bytes; returns the silence before it, nanoseconds, 0 if unknown."""
        stop = self._size + len(chunk.data)
        byte_ns = 0 if chunk.at_once else self._byte_ns
        self.times.append(ArrivalTime(self._size, stop, chunk.t_ns, self._floor, byte_ns))
        self._size = stop
        before, self._silent_since = self._silent_since, chunk.t_ns
        if chunk.t_ns is None:
            return 0
        self._silent_since = self._floor = max(self._floor, chunk.t_ns)
        if before is None or chunk.is_late:
            return 0
        return max(0, chunk.t_ns - len(chunk.data) * self._byte_ns - before)

    def reset_clock(self) -> None:
        """Let the next times be earlier than those so far: the clock was set."""
        self._floor, self._silent_since = 0, None

    def silence_at(self, t_ns: int | None) -> int:
        """The silence up to `t_ns`, nanoseconds, 0 if unknown."""
        if t_ns is None or self._silent_since is None:
            return 0
        return max(0, t_ns - self._silent_since)


@final
class IdleTimes:
    """Pauses of the line, each as the offset of the byte after it."""

    def __init__(self, baud: int) -> None:
        self._offsets: list[i64] = []
        self.least_ns = 0
        """Silence that counts as a pause, nanoseconds."""
        self.set_baud(baud)

    def set_baud(self, baud: int) -> None:
        """Set the bits per second of the next bytes."""
        self.least_ns = min(SETTLING_NS, round(PAUSE_BYTES * byte_time_ns(baud)))

    def append(self, offset: i64) -> None:
        """Append a pause before the byte at `offset`."""
        self._offsets.append(offset)

    def any_after(self, offset: i64) -> bool:
        """Whether there is a pause after the byte at `offset`."""
        return bool(self._offsets) and self._offsets[-1] > offset

    def within(self, start: i64, stop: i64) -> list[i64]:
        """The pauses between two offsets, counted from `start`."""
        return [offset - start for offset in self._offsets if start < offset < stop]

    def forget(self, offset: i64) -> None:
        """Drop the pauses up to the byte at `offset`."""
        while self._offsets and self._offsets[0] <= offset:
            del self._offsets[0]


# Decided segments, and rows made of them

LONGEST_ROW: Final[i64] = 1024
"""Bytes in a row of noise, at most."""

_WIDTH: Final[i64] = FRAME_LENGTH
"""The number of first bytes of a row in `Rows.raw`."""


@final
class SegmentList:
    """Decided segments as columns; each entry is one row, or a run of equal rows."""

    def __init__(self, frame_length: i64, start: i64 = 0) -> None:
        """An empty list for the stream from the offset `start` on."""
        self.frame_length = frame_length
        self.starts = vec[i64]()
        """The offsets of the first bytes."""
        self.counts = vec[i64]()
        """The numbers of rows."""
        self.codes = vec[i64]()
        """Twice the index in `FAULT_SETS` of every row, plus 1 for frames."""
        self.end = start
        """The offset after the last segment."""
        self.noise_from: i64 = _NOWHERE
        """The offset of noise that is in no segment yet, because it may continue; -1 for none."""
        self._noise_to: i64 = _NOWHERE

    def append_run(self, start: i64, stop: i64) -> None:
        """Append frames without faults."""
        self._append(start, (stop - start) // self.frame_length, 1)
        self.end = stop

    def append_row(self, start: i64, stop: i64, faults: i64, framed: bool) -> None:
        """Append one row. Call `end_noise` first."""
        self._append(start, 1, 2 * faults + (1 if framed else 0))
        self.end = stop

    def append_noise(self, start: i64, stop: i64) -> None:
        """Append noise, which extends noise right before it and may continue."""
        if self.noise_from == _NOWHERE:
            self.noise_from = start
        self._noise_to = stop
        while stop - self.noise_from > LONGEST_ROW:
            cut = self.noise_from + LONGEST_ROW
            self.append_row(self.noise_from, cut, NOISE, False)
            self.noise_from = cut

    def end_noise(self) -> None:
        """Turn pending noise into a row: what follows is another one."""
        if self.noise_from != _NOWHERE:
            self.append_row(self.noise_from, self._noise_to, NOISE, False)
            self.noise_from = _NOWHERE

    def next_list(self) -> SegmentList:
        """An empty list that continues after this one and takes over its pending noise."""
        following = SegmentList(self.frame_length, self.end)
        following.noise_from, following._noise_to = self.noise_from, self._noise_to
        return following

    def _append(self, start: i64, count: i64, code: i64) -> None:
        self.starts = append(self.starts, start)
        self.counts = append(self.counts, count)
        self.codes = append(self.codes, code)


CALM_STREAK: Final[i64] = 100
"""Frames without damage after which a line is calm."""

MOST_STUBS: Final[i64] = 4
"""Truncated frames of less than half the length that are reported in a row; more are noise."""


@final
class LineHealth:
    """Collects decided segments in stream order and estimates how healthy the line is."""

    def __init__(self, frame_length: i64) -> None:
        self.segments = SegmentList(frame_length)
        """The segments since the last `drain`."""
        self._frame_length = frame_length
        self._first_frame_to = frame_length
        """Largest end of the first frame: a start within a frame does not count as damage."""
        self._stubs: i64 = 0
        """Stubs since the last better segment."""
        self._streak = CALM_STREAK
        """Frames since the last damage; a line without damage so far is calm."""

    def reset(self, offset: i64) -> None:
        """Start a new stream at that offset."""
        self._first_frame_to = offset + self._frame_length
        self._streak, self._stubs = CALM_STREAK, 0

    def is_calm(self, frames: i64 = 0) -> bool:
        """Whether the line has shown no damage for long, with `frames` more frames."""
        return self._streak + frames >= CALM_STREAK

    def append_run(self, start: i64, stop: i64) -> None:
        """Append frames without faults."""
        self.segments.end_noise()
        self.segments.append_run(start, stop)
        self._streak += (stop - start) // self._frame_length
        self._stubs = 0

    def append(self, offset: i64, segments: list[Segment]) -> None:
        """Append adjacent segments, whose offsets count from `offset`."""
        for segment in segments:
            start, stop = offset + segment.start, offset + segment.stop
            if segment.faults == NOISE or self._is_stub_noise(segment):
                self.segments.append_noise(start, stop)
            else:
                self.segments.end_noise()
                self.segments.append_row(start, stop, segment.faults, segment.framed)
            if segment.certain or stop <= self._first_frame_to:
                self._streak += 1
            elif segment.faults != AMBIGUOUS:
                self._streak = 0

    def drain(self) -> SegmentList:
        """The segments since the last time."""
        segments, self.segments = self.segments, self.segments.next_list()
        return segments

    def _is_stub_noise(self, segment: Segment) -> bool:
        """Count a stub; True if there are too many of them in a row."""
        size = segment.stop - segment.start
        if segment.faults != TRUNCATED or size >= self._frame_length // 2:
            self._stubs = 0
            return False
        self._stubs += 1
        return self._stubs > MOST_STUBS


@final
class PendingBytes:
    """The decided bytes of one port that were not drained yet."""

    def __init__(self, port: str, times: ArrivalTimes, codebook: Codebook) -> None:
        self._times = times
        self._codebook = codebook
        self._port_code = codebook.port_code(port)
        self.start: i64 = 0
        """The stream offset of the first one."""
        self._chunks: list[bytes] = []
        self._last_size: i64 = 0
        """The number of bytes used of the last chunk."""

    def append(self, data: bytes, size: i64) -> None:
        """Append the first `size` bytes of `data`. (A single chunk is never copied.)"""
        if self._chunks:
            self._chunks[-1] = self._chunks[-1][: self._last_size]
        self._chunks.append(data)
        self._last_size = size

    def drain(self, segments: SegmentList) -> Rows:
        """The rows of these segments."""
        start, size = self.start, segments.end - self.start
        if len(self._chunks) > 1:
            self._chunks[-1] = self._chunks[-1][: self._last_size]
            self._chunks = [b"".join(self._chunks)]
            self._last_size = len(self._chunks[0])
        data = self._chunks[0] if self._chunks else b""
        self._chunks = [data[size : self._last_size]] if size < self._last_size else []
        self._last_size = max(i64(0), self._last_size - size)
        self.start = segments.end
        columns = ColumnFiller(data, start, self._times, self._codebook)
        columns.append(segments)
        return columns.rows(self._port_code)


@final
class ColumnFiller:
    """Fills the columns of `Rows` with decided segments."""

    def __init__(self, data: bytes, start: i64, times: ArrivalTimes, codebook: Codebook) -> None:
        """`data` holds the segments' bytes from the stream offset `start` on."""
        self._data = data
        self._start = start
        self._times = times
        self._codebook = codebook
        self._t_ns = vec[i64]()
        self._offsets = vec[i64]()
        self._delays = vec[i64]()
        self._lengths = vec[i32]()
        self._faults = vec[i16]()
        self._framed = vec[u8]()
        self._raw = vec[u8]()
        """The first bytes of each row; empty while all rows have as many bytes as `data` shows."""
        self._is_even = True
        self._long: dict[int, bytes] = {}

    def append(self, segments: SegmentList) -> None:
        """Append the rows of the segments."""
        starts, counts, codes = segments.starts, segments.counts, segments.codes
        size: i64 = len(starts)
        for number in range(size):
            at = starts[number]
            stop = starts[number + 1] if number + 1 < size else segments.end
            length = (stop - at) // counts[number]
            if length != _WIDTH and self._is_even:
                self._end_even_rows()
            self._append_rows(at, stop, length, codes[number])

    def _append_rows(self, at: i64, stop: i64, length: i64, code: i64) -> None:
        """Append rows of equal length and code."""
        faults = i16(self._codebook.fault_code(FAULT_SETS[code >> 1])) if code > 1 else i16(0)
        framed = u8(code & 1)
        while at < stop:
            time = self._times.at(at)
            # All rows that begin in the same chunk.
            end = min(stop, time.stop)
            known = time.t_ns is not None
            read_ns: i64 = NO_TIME if time.t_ns is None else time.t_ns
            floor_ns: i64 = time.floor_ns
            byte_ns: i64 = time.byte_ns
            while at < end:
                t_ns, delay_ns = read_ns, read_ns
                if known:
                    delay_ns = (time.stop - at) * byte_ns
                    t_ns = read_ns - delay_ns
                    if t_ns < floor_ns:
                        t_ns, delay_ns = floor_ns, max(i64(0), read_ns - floor_ns)
                self._t_ns = append(self._t_ns, t_ns)
                self._delays = append(self._delays, delay_ns)
                self._offsets = append(self._offsets, at)
                self._lengths = append(self._lengths, i32(length))
                self._faults = append(self._faults, faults)
                self._framed = append(self._framed, framed)
                if not self._is_even:
                    self._append_raw(at, length)
                at += length

    def _append_raw(self, at: i64, length: i64) -> None:
        raw, data = self._raw, self._data
        begin = at - self._start
        for own in range(begin, begin + min(length, _WIDTH)):
            raw = append(raw, u8(data[own]))
        for _ in range(length, _WIDTH):
            raw = append(raw, u8(0))
        self._raw = raw
        if length > _WIDTH:
            self._long[len(self._offsets) - 1] = data[begin : begin + length]

    def _end_even_rows(self) -> None:
        """Copy the bytes of the rows so far: those that follow have another length."""
        self._is_even = False
        raw, data = self._raw, self._data
        for at in range(_WIDTH * len(self._offsets)):
            raw = append(raw, u8(data[at]))
        self._raw = raw

    def rows(self, port_code: int) -> Rows:
        """The rows of all segments."""
        count = len(self._offsets)
        columns: dict[str, Buffer] = {
            "t_ns": memoryview(self._t_ns),
            "offset": memoryview(self._offsets),
            "delay_ns": memoryview(self._delays),
            "length": memoryview(self._lengths).cast("B").cast("I"),
            "port": array("H", [port_code]) * count,
            "faults": memoryview(self._faults).cast("B").cast("H"),
            "framed": memoryview(self._framed).cast("?"),
            "unordered": memoryview(bytes(count)).cast("?"),
        }
        whole = memoryview(self._data)[: _WIDTH * count]
        raw = whole if self._is_even else memoryview(self._raw)
        return Rows(self._codebook, columns, raw, self._long)


# Scheduling: how many bytes to wait for

_ENOUGH: Final[i64] = 3
"""Strict frames, or framed segments in step, that are worth decoding."""


def next_decoding(
    tables: FrameTables, data: bytes, start: i64, not_before: i64, decoded_to: i64
) -> tuple[i64, i64]:
    """The number of bytes to wait for and the offset to decode to, from `start`; -1 if unknown.

    Nothing new is learnt before `not_before`, except deadlines after `decoded_to`.
    """
    limit = min(i64(len(data)), start + tables.widest)
    known = limit - EXTRA
    if known < start + 2 * tables.length:
        return _NOWHERE, _NOWHERE
    end = _end_of_pair(tables, data, max(start, not_before - 2 * tables.length), known)
    end = _earlier(end, _end_of_framed_run(tables, data, start, known), not_before)
    end = _earlier(end, _end_of_third(tables, data, start, known), not_before)
    wait, to = (end + EXTRA, end) if end >= 0 else (_NOWHERE, _NOWHERE)
    if limit == start + tables.widest and (wait < 0 or limit < wait):
        wait = to = limit
    deadline = next_deadline(tables, data, start, decoded_to, limit)
    if deadline >= 0 and (wait < 0 or deadline < wait or (deadline == wait and deadline < to)):
        wait = to = deadline
    return wait, to


def _earlier(first: i64, second: i64, not_before: i64) -> i64:
    """The smaller offset of those that are not before `not_before`; -1 if there is none."""
    if first < not_before or (not_before <= second < first):
        first = second
    return first if first >= not_before else _NOWHERE


def _end_of_pair(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    length = tables.length
    at = find_strict(tables, data, start, known - length)
    while at >= 0 and not is_strict(tables, data, at + length):
        at = find_strict(tables, data, at + 1, known - length)
    return _NOWHERE if at < 0 else at + 2 * length


def _end_of_framed_run(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    end = start
    for _ in range(_ENOUGH):
        if end + tables.length > known or not is_framed(tables, data, end):
            return _NOWHERE
        end += tables.length
    return end


def _end_of_third(tables: FrameTables, data: bytes, start: i64, known: i64) -> i64:
    end = start
    for _ in range(_ENOUGH):
        at = find_strict(tables, data, end, known)
        if at < 0:
            return _NOWHERE
        end = at + tables.length
    return end


def next_deadline(tables: FrameTables, data: bytes, start: i64, decoded_to: i64, limit: i64) -> i64:
    """The offset where the next framed segment must be decided; -1 if it is after `limit`."""
    first = max(start, decoded_to + 1 - tables.deadline)
    at = find_framed(tables, data, first, limit - tables.lookahead)
    return _NOWHERE if at < 0 else at + tables.deadline


def settled_segments(
    tables: FrameTables, segments: list[Segment], data: bytes, start: i64, end: i64
) -> list[Segment]:
    """The segments from `start` to `end` that are decided although more bytes may follow."""
    size, deadline = end - start, tables.deadline
    if size >= tables.widest or (size >= deadline and is_framed(tables, data, end - deadline)):
        return _segments_to(tables, segments, size - tables.lookahead)
    number: i64 = len(segments)
    while number > 0:
        last = segments[number - 1]
        if last.framed and last.stop <= size - tables.lookahead:
            break
        number -= 1
    return segments[:number]


def _segments_to(tables: FrameTables, segments: list[Segment], limit: i64) -> list[Segment]:
    """The segments up to `limit`: noise is cut there, an overlong frame is taken as a whole."""
    settled = [segment for segment in segments if segment.stop <= limit]
    following = segments[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(Segment(following.start, limit, False, NOISE, 0.0))
    elif following.start <= limit - tables.length:
        settled.append(following)
    return settled


def lead_start(tables: FrameTables, data: bytes, start: i64, anchor: i64) -> i64:
    """Where decoding starts after long noise, for an anchor, but not before `start`.

    A framed segment whose deadline has passed is noise.
    """
    begin = max(start, anchor - tables.lead)
    while True:
        late = find_framed(tables, data, begin, max(begin, anchor - 1))
        if late < 0:
            return begin
        begin = late + 1


# The framer

GIVING_UP_NS: Final = 500_000_000
"""Silence that ends the wait for the rest of a frame."""

_CERTAIN: Final = after_certain_frame()


@final
class Framer:
    """Turns the chunks of one port into rows that cover its stream without gap or overlap."""

    def __init__(
        self,
        port: str,
        baud: int = DEFAULT_BAUD,
        tables: FrameTables = FTE_TABLES,
        codebook: Codebook | None = None,
    ) -> None:
        """Frame the bytes of a port, which is named in every row, at `baud` bits per second.

        The rows of framers with the same `codebook` have the same codes; by default each has
        another one.

        Raises:
            ValueRangeError: `baud` is less than 1.
        """
        self._tables = tables
        """For the reserve as it is known so far."""
        self._reserve = ReserveLearner(tables)
        self._timeline = ArrivalTimeline(byte_time_ns(baud))
        self._line = LineHealth(tables.length)
        self._decided = PendingBytes(port, self._timeline.times, codebook or Codebook())
        self._data = b""
        self._base: i64 = 0
        """Stream offset of the first byte of `_data`."""
        self._at: i64 = 0
        """Offset in `_data` up to which all is decided."""
        self._state: BoundaryState | None = at_stream_start()
        """The forward probabilities from `_at` on; None while the stream is in step."""
        self._lost_from = _NOWHERE
        """Stream offset where long noise continues; `_NOWHERE` if there is none."""
        self._skipping = False
        """Whether the long noise is already being skipped."""
        self._not_before: i64 = 0
        """Offset in `_data` before which decoding again would learn nothing new."""
        self._decoded_to: i64 = 0
        """Offset in `_data` up to which candidates have been decoded."""
        self._unambiguous_from: i64 = 0
        """Offset in `_data` before which frames turned out to be ambiguous."""
        self._pauses = IdleTimes(baud)
        self._settled = False

    def set_baud(self, baud: int) -> None:
        """Set the bits per second of the line from the next chunk on.

        Raises:
            ValueRangeError: `baud` is less than 1.
        """
        self._timeline.set_byte_time(byte_time_ns(baud))
        self._pauses.set_baud(baud)

    def feed(self, chunk: Chunk) -> list[Row]:
        """Process a chunk and return the rows it completes; never raises on wire data."""
        self.push(chunk)
        return self._rows()

    def flush(self) -> list[Row]:
        """Decide all pending bytes and return their rows; the stream ends here."""
        self.finish()
        return self._rows()

    def _rows(self) -> list[Row]:
        if self._line.segments.end == self._decided.start:
            return []
        return list(self.drain())

    def drain(self) -> Rows:
        """All rows that were decided since the last call."""
        return self._decided.drain(self._line.drain())

    def restart(self) -> list[Row]:
        """Flush, and start a new stream whose offsets and times continue."""
        rows = self.flush()
        self._state = at_stream_start()
        self._line.reset(self._base)
        self._reserve.reset()
        self._tables = self._reserve.tables
        return rows

    def reset_clock(self) -> None:
        """Let the next times be earlier than those so far, for logs whose clock was set."""
        self._timeline.reset_clock()

    @property
    def pending_since_ns(self) -> int | None:
        """When the first byte that is in no row yet began; None without such a byte."""
        offset = self._line.segments.noise_from
        if offset < 0:
            offset = self._base + self._at
            if self._at == len(self._data):
                return None
        return self._timeline.times.at(offset).time_and_delay(offset)[0]

    def push(self, chunk: Chunk) -> None:
        """Process a chunk without making rows; see `drain`."""
        if chunk.data:
            silence = self._timeline.append(chunk)
            if silence >= self._pauses.least_ns:
                self._on_silence(silence)
                self._pauses.append(self._base + len(self._data))
            self._data += chunk.data
            self._settled = False
            self._advance()
        else:
            self._on_silence(self._timeline.silence_at(chunk.t_ns))
        if self._at:
            self._drop_decided()

    def finish(self) -> None:
        """Decide all pending bytes without making rows; see `drain`."""
        self._settle(hold=False)
        self._drop_decided()

    # The three states

    def _advance(self) -> None:
        while True:
            if self._lost_from >= 0:
                moved = self._skip_noise()
            elif self._state is None:
                moved = self._follow_run()
            else:
                moved = self._decode_if_ready()
            if not moved:
                return

    def _follow_run(self) -> bool:
        """In step: take the certain frames; False if more bytes are needed."""
        tables, data, at, end = self._tables, self._data, self._at, i64(len(self._data))
        length = tables.length
        if end - at < length:
            return False
        run, taught = end_of_run(
            tables, self._reserve.marks, data, at, end, calm=self._line.is_calm()
        )
        sure = run - length
        if run > at:
            calm = self._line.is_calm((sure - at) // length)
            if is_clear(tables, data, sure) if calm else is_isolated(tables, data, sure, end):
                sure = run
        if taught >= 0 and sure >= taught:
            self._line.append_run(self._base + at, self._base + taught)
            self._at = taught
            self._reserve.observe(data, taught - length)
            self._tables = self._reserve.tables
            return True
        if sure > at:
            self._line.append_run(self._base + at, self._base + sure)
            self._at = sure
        waiting = 2 * length if sure < run else length
        if end - self._at < waiting:
            return False
        self._state = _CERTAIN
        self._not_before = 0
        return True

    def _decode_if_ready(self) -> bool:
        """Disputed: decide what comes before an unambiguous frame, or decode once enough bytes have
        arrived; False before that."""
        tables, data, at = self._tables, self._data, self._at
        if len(data) - at < tables.longest:
            return False
        frame = _NOWHERE
        if not self._pauses.any_after(self._base + at):
            frame = find_unambiguous(
                tables, data, max(at, self._unambiguous_from), at + tables.widest
            )
        wait, end = _NOWHERE, _NOWHERE
        if frame < 0 or frame - at >= tables.length:
            wait, end = next_decoding(tables, data, at, self._not_before, self._decoded_to)
        if frame >= 0 and (wait < 0 or frame + tables.longest <= wait):
            if not self._decode_before(frame):
                self._unambiguous_from = frame + tables.length
            return True
        if wait < 0:
            return False
        self._decode_to(end)
        return True

    def _decode_to(self, end: i64) -> None:
        """Decode all bytes up to `end`, and decide what is settled."""
        tables = self._tables
        posterior = self._posterior(end, OPEN)
        segments = self._decode(posterior)
        self._decoded_to = end
        if len(segments) > 1 and segments[-1].certain and segments[-2].certain:
            self._decide(segments[:-1])
            self._state = None
            return
        settled = settled_segments(tables, segments, self._data, self._at, end)
        if not settled:
            self._not_before = min(end + tables.length, self._at + tables.widest)
            return
        last = settled[-1]
        noise = last.faults == NOISE
        lost = noise and end - self._at >= tables.widest
        if last.certain:
            self._state = _CERTAIN
        else:
            self._state = posterior.boundary_state(last.stop, ends_frame=not noise)
        self._decide(settled)
        self._not_before = 0
        if lost:
            self._lost_from, self._skipping = self._base + self._at, False

    def _decode_before(self, frame: i64) -> bool:
        """Decide all before an unambiguous frame; False if that is ambiguous after all."""
        segments = self._decode(self._posterior(frame + self._tables.length, BOUNDARY))
        if not segments.pop().certain:
            return False
        self._decide(segments)
        self._state = None
        self._not_before = 0
        return True

    def _posterior(self, end: i64, ending: i64) -> ForwardBackward:
        pauses = self._pauses.within(self._base + self._at, self._base + end)
        candidates = CandidateSet(self._tables, self._data[self._at : end], pauses)
        return ForwardBackward(candidates, self._state or _CERTAIN, ending)

    def _decode(self, posterior: ForwardBackward) -> list[Segment]:
        segments = decode(posterior)
        return trust_calm_line(posterior, segments) if self._line.is_calm() else segments

    def _skip_noise(self) -> bool:
        """Lost: skip the noise up to the next anchor; False if none has arrived yet."""
        tables, data = self._tables, self._data
        anchor = find_anchor(tables, data, self._at)
        reach = 2 * tables.length - 1  # Bytes that an incomplete anchor has at most.
        known = anchor if anchor >= 0 else len(data) - reach
        enough = self._lost_from - self._base + tables.widest
        if not self._skipping:
            limit = min(i64(len(data)), enough + reach)
            deadline = next_deadline(tables, data, self._at, self._decoded_to, limit)
            if deadline >= 0 and (anchor < 0 or deadline <= anchor + 2 * tables.length):
                self._lost_from = _NOWHERE
                return True
        if self._skipping or known >= enough:
            self._skipping = True
            self._state = in_long_noise()
            self._decide_noise(lead_start(tables, data, self._at, known))
        if anchor >= 0:
            self._lost_from = _NOWHERE
            self._not_before = 0
        return anchor >= 0

    # Silence

    def _on_silence(self, silence_ns: int) -> None:
        if silence_ns >= SETTLING_NS and not self._settled:
            self._settle(hold=True)
            self._settled = True
        if silence_ns >= GIVING_UP_NS:
            self._settle(hold=False)

    def _settle(self, *, hold: bool) -> None:
        """Decide all bytes so far; `hold` keeps the start of a frame that may continue."""
        if self._at < len(self._data):
            segments = self._decode(self._posterior(len(self._data), CLOSED))
            last = segments[-1]
            held = hold and not last.framed and self._can_continue(last)
            self._decide(segments[:-1] if held else segments)
            self._state = None if held or last.certain else after_silence()
            self._lost_from = _NOWHERE
            self._not_before = 0
        self._line.segments.end_noise()

    def _can_continue(self, last: Segment) -> bool:
        if last.faults & TRUNCATED == 0:
            return False
        start = self._at + last.start
        end = min(i64(len(self._data)), start + self._tables.length)
        prefix = PrefixScore(self._tables, self._data, start, end)
        return prefix.fit >= last.stop - last.start

    # Decided bytes

    def _decide(self, segments: list[Segment]) -> None:
        if segments:
            self._line.append(self._base + self._at, segments)
            for segment in segments:
                if segment.faults == RESERVED_NONZERO or segment.probability >= LIKELY:
                    self._reserve.observe(self._data, self._at + segment.start)
            self._tables = self._reserve.tables
            self._at += segments[-1].stop
        self._unambiguous_from = 0

    def _decide_noise(self, stop: i64) -> None:
        """Decide that the bytes up to `stop` are noise, which may continue."""
        if stop > self._at:
            self._line.segments.append_noise(self._base + self._at, self._base + stop)
            self._at = stop

    def _drop_decided(self) -> None:
        done = self._at
        self._decided.append(self._data, done)
        self._data = self._data[done:]
        self._base += done
        self._at = 0
        self._not_before = max(i64(0), self._not_before - done)
        self._decoded_to = max(i64(0), self._decoded_to - done)
        self._unambiguous_from = max(i64(0), self._unambiguous_from - done)
        self._pauses.forget(self._base)
