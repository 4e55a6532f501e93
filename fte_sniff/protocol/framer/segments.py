"""Segment list and LineHealth estimates; turning segments into rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.tables import AMBIGUOUS, FAULT_SETS, LENGTH, NOISE, TRUNCATED
from fte_sniff.protocol.framer.timestamps import ArrivalTime, ArrivalTimes
from fte_sniff.protocol.rows import Damage, Frame, Row
from fte_sniff.protocol.spec import Fault


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Segment:
    """A part of the chosen reading: what becomes one row (neighbouring noise becomes one)."""

    def __init__(
        self, start: i64, stop: i64, framed: bool, faults: i64, probability: float
    ) -> None:
        self.start = start
        self.stop = stop
        self.framed = framed
        self.faults = faults
        """A number of `fault_sets`."""
        self.probability = probability
        """That of a whole frame; 0 for anything else."""

    @property
    def certain(self) -> bool:
        """Whether it is a whole frame, and is to be believed."""
        return self.framed and self.faults == 0

    def called(self, faults: i64) -> Segment:
        """The same with other faults."""
        return Segment(self.start, self.stop, self.framed, faults, self.probability)


LONGEST_ROW: Final[i64] = 1024
"""Bytes in a row of noise."""

_NONE: Final[i64] = -1


@final
class SegmentList:
    """What was decided since the last time, side by side: a number in each list for every tile."""

    def __init__(self, start: i64 = 0) -> None:
        """Tiles of a stream from that offset on."""
        self.starts = vec[i64]()
        """Offsets of the first bytes."""
        self.counts = vec[i64]()
        """How many rows each one is."""
        self.codes = vec[i64]()
        """What each row of it is: twice a number of `fault_sets`, and one more for a frame."""
        self.end = start
        """Offset behind the last tile."""
        self.noise_from: i64 = _NONE
        """Where the noise begins that is in no tile yet: more may follow;
        -1 where there is none."""
        self._noise_to: i64 = _NONE

    def run(self, start: i64, stop: i64) -> None:
        """Frames in step with nothing wrong."""
        self._add(start, (stop - start) // LENGTH, 1)
        self.end = stop

    def row(self, start: i64, stop: i64, faults: i64, framed: bool) -> None:
        """One row, behind whatever noise has been ended."""
        self._add(start, 1, 2 * faults + (1 if framed else 0))
        self.end = stop

    def noise(self, start: i64, stop: i64) -> None:
        """Noise, which goes on what noise stood before; it may go on behind."""
        if self.noise_from == _NONE:
            self.noise_from = start
        self._noise_to = stop
        while stop - self.noise_from > LONGEST_ROW:
            cut = self.noise_from + LONGEST_ROW
            self.row(self.noise_from, cut, NOISE, False)
            self.noise_from = cut

    def end_noise(self) -> None:
        """Noise that follows is another row, as anything else is."""
        if self.noise_from != _NONE:
            self.row(self.noise_from, self._noise_to, NOISE, False)
            self.noise_from = _NONE

    def following(self) -> SegmentList:
        """Where the tiles behind these go to, and the noise that is in none."""
        behind = SegmentList(self.end)
        behind.noise_from, behind._noise_to = self.noise_from, self._noise_to
        return behind

    def _add(self, start: i64, count: i64, code: i64) -> None:
        self.starts = append(self.starts, start)
        self.counts = append(self.counts, count)
        self.codes = append(self.codes, code)


CALM_STREAK: Final[i64] = 100
"""Frames without damage after which a calm frame needs no further one to be believed."""

STUB: Final[i64] = LENGTH // 2
"""A truncated frame of fewer bytes tells little."""

MOST_STUBS: Final[i64] = 4
"""So many of them in a row are told one by one; more, with nothing better between, are noise."""


@final
class LineHealth:
    """Hands what is decided to the tiles, in stream order."""

    def __init__(self) -> None:
        self.tiles = SegmentList()
        """The rows since the last time."""
        self._first_frame_to = LENGTH
        """Offset behind the first frame, at most. A stream may begin within a frame: that is no
        damage of the line."""
        self._stubs: i64 = 0
        """Stubs since the last better row."""
        self._streak = CALM_STREAK
        """Frames since the last damage; a line that has shown none yet is calm."""

    def join(self, offset: i64) -> None:
        """The stream begins anew there: what comes joins nothing that came before."""
        self._first_frame_to = offset + LENGTH
        self._streak, self._stubs = CALM_STREAK, 0

    def calm(self, frames: i64 = 0) -> bool:
        """Whether the line has shown no damage for long, once so many more frames are taken."""
        return self._streak + frames >= CALM_STREAK

    def run(self, start: i64, stop: i64) -> None:
        """Frames in step, from one offset to another."""
        self.tiles.end_noise()
        self.tiles.run(start, stop)
        self._streak += (stop - start) // LENGTH
        self._stubs = 0

    def parts(self, offset: i64, reading: list[Segment]) -> None:
        """The parts of a reading, from left to right and without gaps; counted from `offset`."""
        for part in reading:
            start, stop = offset + part.start, offset + part.stop
            if part.faults == NOISE or self._one_stub_too_many(part):
                self.tiles.noise(start, stop)
            else:
                self.tiles.end_noise()
                self.tiles.row(start, stop, part.faults, part.framed)
            if part.certain or stop <= self._first_frame_to:
                self._streak += 1
            elif part.faults != AMBIGUOUS:
                self._streak = 0

    def take(self) -> SegmentList:
        """The tiles since the last time."""
        tiles, self.tiles = self.tiles, self.tiles.following()
        return tiles

    def _one_stub_too_many(self, part: Segment) -> bool:
        """Whether this is one more of the short truncated frames that really are noise."""
        if part.faults != TRUNCATED or part.stop - part.start >= STUB:
            self._stubs = 0
            return False
        self._stubs += 1
        return self._stubs > MOST_STUBS


@final
class DecidedSpan:
    """What was decided of one port's stream, from one offset to another."""

    def __init__(
        self, port: str, data: bytes, start: i64, tiles: SegmentList, marks: Sequence[ArrivalTime]
    ):
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
        marks = ArrivalTimes(self.marks)
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
class PendingBytes:
    """The decided bytes of one port that nobody has taken yet."""

    def __init__(self, port: str, marks: ArrivalTimes) -> None:
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

    def take(self, tiles: SegmentList) -> DecidedSpan:
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
        return DecidedSpan(self._port, data, start, tiles, self._marks.before(tiles.end))
