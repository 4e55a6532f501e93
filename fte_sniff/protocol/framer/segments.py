"""Decided segments, the health of the line, and rows made of segments."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.tables import AMBIGUOUS, FAULT_SETS, NOISE, TRUNCATED
from fte_sniff.protocol.framer.timestamps import ArrivalTime, ArrivalTimes
from fte_sniff.protocol.rows import Damage, Frame, Row
from fte_sniff.protocol.spec import Fault


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
        """The same segment with other faults."""
        return Segment(self.start, self.stop, self.framed, faults, self.probability)


LONGEST_ROW: Final[i64] = 1024
"""Bytes in a row of noise, at most."""

_NONE: Final[i64] = -1


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
        """Largest end of the first frame: a start within a frame is no damage of the line."""
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
class DecidedSpan:
    """The decided bytes of one port between two offsets."""

    def __init__(
        self,
        port: str,
        data: bytes,
        start: i64,
        segments: SegmentList,
        times: Sequence[ArrivalTime],
    ):
        self.port = port
        self.data = data
        """The bytes, and perhaps more after them."""
        self.start = start
        """The stream offset of the first one."""
        self.segments = segments
        self.times = times
        """The arrival times of all bytes."""

    def __len__(self) -> int:
        """The number of rows."""
        count: i64 = 0
        for own in self.segments.counts:
            count += own
        return int(count)

    def last(self) -> tuple[int, bool, tuple[Fault, ...]] | None:
        """Length of the last row, whether it is a frame, and its faults; None without rows."""
        segments = self.segments
        number = i64(len(segments.starts)) - 1
        if number < 0:
            return None
        code = segments.codes[number]
        length = (segments.end - segments.starts[number]) // segments.counts[number]
        return int(length), code & 1 == 1, FAULT_SETS[code >> 1]

    def rows(self) -> list[Row]:
        """The rows with their times."""
        rows: list[Row] = []
        segments = self.segments
        starts, counts, codes = segments.starts, segments.counts, segments.codes
        size: i64 = len(starts)
        times = ArrivalTimes(self.times)
        for number in range(size):
            at, code = starts[number], codes[number]
            stop = starts[number + 1] if number + 1 < size else segments.end
            length = (stop - at) // counts[number]
            make = Frame if code & 1 == 1 else Damage
            faults = FAULT_SETS[code >> 1]
            while at < stop:
                raw = self.data[at - self.start : at - self.start + length]
                t_ns, delay = times.at(at).time_and_delay(at)
                rows.append(make(self.port, int(at), raw, t_ns, faults, delay))
                at += length
        return rows

    def headers(self) -> Iterator[tuple[int, int]]:
        """The offset and the header of each frame."""
        segments = self.segments
        starts, counts, codes = segments.starts, segments.counts, segments.codes
        for number in range(i64(len(starts))):
            if codes[number] & 1 == 1:
                for count in range(counts[number]):
                    at = starts[number] + count * segments.frame_length
                    yield int(at), self.data[at - self.start]


@final
class PendingBytes:
    """The decided bytes of one port that were not drained yet."""

    def __init__(self, port: str, times: ArrivalTimes) -> None:
        self._port = port
        self._times = times
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

    def drain(self, segments: SegmentList) -> DecidedSpan:
        """The bytes of these segments."""
        start, size = self.start, segments.end - self.start
        if len(self._chunks) > 1:
            self._chunks[-1] = self._chunks[-1][: self._last_size]
            self._chunks = [b"".join(self._chunks)]
            self._last_size = len(self._chunks[0])
        data = self._chunks[0] if self._chunks else b""
        self._chunks = [data[size : self._last_size]] if size < self._last_size else []
        self._last_size = max(i64(0), self._last_size - size)
        self.start = segments.end
        return DecidedSpan(self._port, data, start, segments, self._times.before(segments.end))
