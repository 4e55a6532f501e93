"""Arrival time and read delay of every byte; pauses and silence on the line.

A chunk of n bytes was read at t. Its byte i began at `max(P, t - (n - i) * byte time)`, where P is
the latest time at which earlier bytes of this port were read, or 1970 for the first chunk. So times
never fall, and they do not depend on how the bytes were cut into chunks, if an earlier chunk has
the correspondingly earlier time. Bytes of a chunk `at_once` have no byte time: all began at t.

Silence is the time between P and the first byte of a chunk. An empty chunk reports that nothing
arrived until its time: it is silence too, but moves no byte.
"""

from __future__ import annotations

from collections import deque
from typing import final

from mypy_extensions import i64

from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import byte_time_ns

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
