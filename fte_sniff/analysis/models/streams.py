"""Owns the numbers of streams: the frames of one kind, to or from one motor, on one port.

It must not know a clock, a screen or where rows are kept; it makes no difference where batches are
cut. A stream is what has a period, and quantities that lie in a range. Times of one port are taken
not to fall.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from fte_sniff.analysis.accumulators.durations import Durations
from fte_sniff.analysis.accumulators.recent import Recent
from fte_sniff.analysis.columns.fields import NO_KIND, NO_TIME, Decoded, Ints, read_place
from fte_sniff.protocol import KINDS, MOTORS, FrameKind

_NUMS: Final = 256


def _numbered() -> tuple[list[tuple[int, int | None]], Ints]:
    """Every kind and motor that there can be, and by kind and NUM the place among them."""
    places = np.full((NO_KIND + 1, _NUMS), -1, np.int64)
    found: list[tuple[int, int | None]] = []
    for code, kind in enumerate(KINDS):
        if kind.names_motor:
            for motor in MOTORS:
                places[code, motor] = len(found)
                found.append((code, motor))
        else:
            places[code, :] = len(found)
            found.append((code, None))
    places[places < 0] = len(found)
    return found, places


_STREAMS, _PLACES = _numbered()
_NO_STREAM: Final = len(_STREAMS)

_Place: TypeAlias = tuple[int, int, bool]
"""Where a field stands: start, size, and whether it is signed."""

_QUANTITIES: Final[list[dict[str, _Place]]] = [
    {field.name: (field.start, field.size, field.signed) for field in kind.fields if field.unit}
    for kind in KINDS
]
"""By kind code, the fields that have a unit, by row name."""

_QUANTITY_PLACES: Final = sorted({place for fields in _QUANTITIES for place in fields.values()})


@dataclass(frozen=True, slots=True)
class StreamNumbers:
    """The frames of one kind, to or from one motor that there can be, on one port."""

    port: str
    kind: FrameKind
    motor: int | None
    """None where frames of this kind name none."""
    count: int
    per_s: float | None
    """On the average from its first frame to its last; None where that cannot be told."""
    lately_per_s: float | None
    periods: Durations
    """From the begin of each frame to that of the next; its ends are those of silence too."""
    ranges: Mapping[str, tuple[int, int]]
    """The least and the greatest of each quantity in it, by row name."""

    @property
    def jitter_ns(self) -> float | None:
        """How much the period varies: between the 5 percent shortest and the 5 percent longest.

        None where there are no two periods.
        """
        if self.periods.count < 2:
            return None
        low, high = self.periods.percentile_ns(5), self.periods.percentile_ns(95)
        return None if low is None or high is None else high - low


class _Stream:
    """One stream as it runs."""

    def __init__(self) -> None:
        self.count = 0
        self.last_ns = 0
        self.goes_on = False
        """Whether the next frame is measured against the one before."""
        self._measured = self._measured_ns = 0
        self.periods = Durations()
        self.times = Recent()
        self.ranges: dict[str, tuple[int, int]] = {}

    def add(self, count: int, t_ns: Ints) -> None:
        """So many frames, and the times of those that have one."""
        self.count += count
        if not len(t_ns):
            return
        before = [self.last_ns] if self.goes_on else t_ns[:1]
        periods = np.diff(t_ns, prepend=before)[0 if self.goes_on else 1 :]
        ends = t_ns[len(t_ns) - len(periods) :]
        self.periods.add(periods[periods >= 0], ends[periods >= 0])
        self._measured += len(periods)
        self._measured_ns += int(periods.sum())
        self.last_ns, self.goes_on = int(t_ns[-1]), True
        self.times.add(t_ns)

    def stretch(self, name: str, low: int, high: int) -> None:
        """A quantity had values from `low` to `high`."""
        if name in self.ranges:
            low, high = min(low, self.ranges[name][0]), max(high, self.ranges[name][1])
        self.ranges[name] = low, high

    @property
    def per_s(self) -> float | None:
        return self._measured * 1e9 / self._measured_ns if self._measured_ns > 0 else None


def _ends(rows: Decoded, order: Ints, starts: Ints) -> dict[_Place, tuple[list[int], list[int]]]:
    """By place of a field, the least and the greatest in each stretch of the rows so ordered."""
    found = {}
    for place in _QUANTITY_PLACES:
        column = read_place(rows.raw, *place).astype(np.int64)[order]
        lows, highs = np.minimum.reduceat(column, starts), np.maximum.reduceat(column, starts)
        found[place] = lows.tolist(), highs.tolist()
    return found


class Streams:
    """Every stream so far."""

    def __init__(self) -> None:
        self._streams: dict[tuple[int, int], _Stream] = {}

    def add(self, rows: Decoded) -> None:
        """The next rows; their ports' numbers mean the same each time."""
        of_port = rows.packed["port"].astype(np.int64) * (_NO_STREAM + 1)
        keys = of_port + _PLACES[rows.kinds, rows.nums]
        # Small numbers are sorted by counting them.
        order = np.argsort(keys.astype(np.min_scalar_type(int(keys.max()))), kind="stable")
        ordered, t_ns = keys[order], rows.t_ns[order]
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        ends = _ends(rows, order, starts)
        stops = [*starts[1:].tolist(), len(order)]
        for number, (start, stop) in enumerate(zip(starts.tolist(), stops, strict=True)):
            port, place = divmod(int(ordered[start]), _NO_STREAM + 1)
            if place == _NO_STREAM:
                continue
            stream = self._streams.setdefault((port, place), _Stream())
            times = t_ns[start:stop]
            stream.add(stop - start, times[times != NO_TIME])
            for name, where in _QUANTITIES[_STREAMS[place][0]].items():
                lows, highs = ends[where]
                stream.stretch(name, lows[number], highs[number])

    def interrupt(self, wire: int | None) -> None:
        """Rows of a port, by its number, or of all are missing here: no period goes over this."""
        for (port, _), stream in self._streams.items():
            if wire in (None, port):
                stream.goes_on = False
                stream.times = Recent()

    def numbers(self, ports: Sequence[str], now_ns: int | None) -> list[StreamNumbers]:
        """Each, by port, kind and motor.

        Args:
            ports: what the numbers of ports stand for.
            now_ns: not before the last row; None where no time is present.
        """
        return [
            StreamNumbers(
                ports[port],
                KINDS[_STREAMS[place][0]],
                _STREAMS[place][1],
                stream.count,
                stream.per_s,
                None if now_ns is None else stream.times.per_second(now_ns),
                stream.periods,
                stream.ranges,
            )
            for (port, place), stream in sorted(self._streams.items(), key=lambda one: one[0])
        ]
