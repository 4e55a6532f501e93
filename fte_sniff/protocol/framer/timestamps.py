"""Arrival time and read delay for a byte offset.

A chunk of n bytes was read at t. Its byte i is taken to have begun n - i byte times before t, but
not before the read before it: `max(P, t - (n - i) * byte time)`, where P is the latest time at
which bytes of this port were read before, and 1970 for the first. So times never fall, and they are
the same however the bytes were cut into chunks, if a piece cut off earlier carries the
correspondingly earlier time.

Silence before a chunk is what is left between P and its first byte. An empty chunk says that
nothing came up to its time; it is silence too, but moves no byte.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import final

from mypy_extensions import i64

from fte_sniff.protocol.rows import Chunk
from fte_sniff.protocol.spec import byte_time_ns

PAUSE_BYTES = 3.5
"""Byte times of silence that count as a pause."""

SETTLING_NS = 20_000_000
"""Silence that settles what is pending."""


@final
class ArrivalTime:
    """The bytes of one chunk in their port's stream, and when they were read."""

    def __init__(
        self, start: i64, stop: i64, t_ns: int | None, floor_ns: int, byte_ns: int
    ) -> None:
        self.start = start
        """Offset of the first byte."""
        self.stop = stop
        """Offset behind the last byte."""
        self.t_ns = t_ns
        """When they were read, nanoseconds since 1970 UTC."""
        self.floor_ns = floor_ns
        """No byte of them began before this time."""
        self.byte_ns = byte_ns

    def time_and_delay(self, offset: i64) -> tuple[int | None, int | None]:
        """When the byte at `offset` began on the wire, and how long before its read that was."""
        t_ns, floor_ns = self.t_ns, self.floor_ns
        if t_ns is None:
            return None, None
        delay = int(self.stop - offset) * self.byte_ns
        if t_ns - delay >= floor_ns:
            return t_ns - delay, delay
        return floor_ns, t_ns - floor_ns if t_ns > floor_ns else 0


@final
class ArrivalTimes:
    """The marks of one port's latest bytes, asked for from left to right."""

    def __init__(self, marks: Iterable[ArrivalTime] = ()) -> None:
        self._marks = deque(marks)

    def append(self, mark: ArrivalTime) -> None:
        """The next bytes have this mark."""
        self._marks.append(mark)

    def mark(self, offset: i64) -> ArrivalTime:
        """The mark of the byte at `offset`; earlier offsets must not be asked for again."""
        while self._marks[0].stop <= offset:
            self._marks.popleft()
        return self._marks[0]

    def before(self, offset: i64) -> list[ArrivalTime]:
        """Those of all bytes before `offset`; they must not be asked for again."""
        found: list[ArrivalTime] = []
        while self._marks and self._marks[0].stop <= offset:
            found.append(self._marks.popleft())
        if self._marks and self._marks[0].start < offset:
            found.append(self._marks[0])
        return found


@final
class ArrivalTimeline:
    """How the times of one port's bytes go on, chunk by chunk."""

    def __init__(self, byte_ns: int) -> None:
        self._byte_ns = byte_ns
        self.marks = ArrivalTimes()
        self._size: i64 = 0
        self._floor = 0
        self._silent_since: int | None = None

    def pace(self, byte_ns: int) -> None:
        """Bytes of the chunks from now on take so long, nanoseconds."""
        self._byte_ns = byte_ns

    def add(self, chunk: Chunk) -> int:
        """Take a chunk with bytes; returns the silence before it, nanoseconds, 0 if unknown."""
        stop = self._size + len(chunk.data)
        self.marks.append(ArrivalTime(self._size, stop, chunk.t_ns, self._floor, self._byte_ns))
        self._size = stop
        before, self._silent_since = self._silent_since, chunk.t_ns
        if chunk.t_ns is None:
            return 0
        self._silent_since = self._floor = max(self._floor, chunk.t_ns)
        if before is None:
            return 0
        return max(0, chunk.t_ns - len(chunk.data) * self._byte_ns - before)

    def set_back(self) -> None:
        """The clock was set: the next bytes may have begun before those read by now."""
        self._floor, self._silent_since = 0, None

    def silence_at(self, t_ns: int | None) -> int:
        """How long the line has been silent at `t_ns`, nanoseconds, 0 if unknown."""
        if t_ns is None or self._silent_since is None:
            return 0
        return max(0, t_ns - self._silent_since)


@final
class IdleTimes:
    """Where the line paused, by the offset of the byte behind."""

    def __init__(self, baud: int) -> None:
        self._offsets: list[i64] = []
        self.least_ns = 0
        """Silence that counts as a pause, nanoseconds."""
        self.pace(baud)

    def pace(self, baud: int) -> None:
        """The line has `baud` bits per second from now on."""
        self.least_ns = min(SETTLING_NS, round(PAUSE_BYTES * byte_time_ns(baud)))

    def add(self, offset: i64) -> None:
        """The line paused before that byte."""
        self._offsets.append(offset)

    def behind(self, offset: i64) -> bool:
        """Whether there is a pause behind that byte."""
        return bool(self._offsets) and self._offsets[-1] > offset

    def within(self, start: i64, stop: i64) -> list[i64]:
        """The pauses between those offsets, counted from `start`."""
        return [offset - start for offset in self._offsets if start < offset < stop]

    def forget(self, offset: i64) -> None:
        """Pauses up to that byte are asked for no more."""
        while self._offsets and self._offsets[0] <= offset:
            del self._offsets[0]
