"""Decided segments, their times, the health of the line, and rows made of them.

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
from mypy_extensions import i16, i32, i64, mypyc_attr, u8

from fte_sniff.protocol.framer.model import AMBIGUOUS, FAULT_SETS, NOISE, TRUNCATED
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import NO_TIME, Buffer, Codebook, Rows
from fte_sniff.protocol.spec import FRAME_LENGTH, byte_time_ns

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


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Segment:
    """A segment of a decoded span: one row, except that adjacent noise becomes one row."""

    def __init__(
        self, start: i64, stop: i64, framed: bool, faults: i64, probability: float
    ) -> None:
        self.start = start
        self.stop = stop
        self.framed = framed
        self.faults = faults
        """An index of `FAULT_SETS`."""
        self.probability = probability
        """Of a frame that is legal but for an unusual reserve (0-1); 0 for any other segment."""

    @property
    def certain(self) -> bool:
        """Whether it is a frame without any fault, `ambiguous` included."""
        return self.framed and self.faults == 0

    def with_faults(self, faults: i64) -> Segment:
        """This segment with other faults."""
        return Segment(self.start, self.stop, self.framed, faults, self.probability)


LONGEST_ROW: Final[i64] = 1024
"""Bytes in a row of noise, at most."""

_NONE: Final[i64] = -1
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
        self.noise_from: i64 = _NONE
        """The offset of noise that is in no segment yet, because it may continue; -1 for none."""
        self._noise_to: i64 = _NONE

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
        if self.noise_from == _NONE:
            self.noise_from = start
        self._noise_to = stop
        while stop - self.noise_from > LONGEST_ROW:
            cut = self.noise_from + LONGEST_ROW
            self.append_row(self.noise_from, cut, NOISE, False)
            self.noise_from = cut

    def end_noise(self) -> None:
        """Turn pending noise into a row: what follows is another one."""
        if self.noise_from != _NONE:
            self.append_row(self.noise_from, self._noise_to, NOISE, False)
            self.noise_from = _NONE

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
