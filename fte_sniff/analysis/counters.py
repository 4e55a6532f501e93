"""Counters, rates, histograms over batches.

octave 0     1 ns                        one bin for each ns: exact, up to 1,024 ns
octave 10    1,024 ns ... 2,047 ns       the last for which that holds
octave 22    4.2 ms ... 8.4 ms           bins of 4,096 ns
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.fields import Ints, kind_codes
from fte_sniff.protocol import KINDS, Fault, Frame, Row, Status, status_of
from fte_sniff.row_batch import PackedRows, SideBySide

PER_OCTAVE: Final = 1024
"""Bins in an octave."""

_Floats: TypeAlias = npt.NDArray[np.float64]


class Durations:
    """Durations of 0 nanoseconds and more; one of 0 counts as one of 1."""

    def __init__(self) -> None:
        self.count = 0
        self.longest_ns: int | None = None
        self.longest_at_ns: int | None = None
        """When the longest of them ended, nanoseconds since 1970 UTC; of several, the first."""
        self._shortest_ns = 0
        self._bins: Ints = np.zeros(0, np.int64)
        self._first = 0
        """The bin that `_bins` begins with; the first of an octave."""

    def add(self, durations_ns: Ints, ends_ns: Ints) -> None:
        """These came, each with the time at which it ended."""
        if not len(durations_ns):
            return
        longest, shortest = int(durations_ns.argmax()), int(durations_ns.min())
        self._shortest_ns = min(self._shortest_ns, shortest) if self.count else shortest
        self.count += len(durations_ns)
        if self.longest_ns is None or durations_ns[longest] > self.longest_ns:
            self.longest_ns = int(durations_ns[longest])
            self.longest_at_ns = int(ends_ns[longest])
        bins = _bins_of(durations_ns)
        self._make_room(int(bins.min()), int(bins.max()))
        np.add.at(self._bins, bins - self._first, 1)

    def _make_room(self, low: int, high: int) -> None:
        """Let there be bins from one to another."""
        end = self._first + len(self._bins)
        first = min(low, self._first if len(self._bins) else low) // PER_OCTAVE * PER_OCTAVE
        last = max(high + 1, end)
        if first == self._first and last == end:
            return
        last += -last % PER_OCTAVE
        kept, at = self._bins, self._first - first
        self._bins = np.zeros(last - first, np.int64)
        if len(kept):
            self._bins[at : at + len(kept)] = kept
        self._first = first

    def percentile_ns(self, percent: float) -> float | None:
        """What so many percent (above 0, to 100) do not exceed, to 0.05 %; None without any."""
        if self.longest_ns is None:
            return None
        rank = np.ceil(self.count * percent / 100)
        place = int(np.searchsorted(np.cumsum(self._bins), rank))
        middle = float(_middles(np.array([self._first + place]))[0])
        return min(max(middle, float(self._shortest_ns)), float(self.longest_ns))

    def between(self, low_ns: float, high_ns: float) -> int:
        """How many lasted `low_ns` to `high_ns`, by the bins whose middle lies there."""
        middles = _middles(np.arange(self._first, self._first + len(self._bins)))
        return int(self._bins[(middles >= low_ns) & (middles < high_ns)].sum())


def _bins_of(durations_ns: Ints) -> Ints:
    fractions, exponents = np.frexp(np.maximum(durations_ns, 1).astype(np.float64))
    within = ((2 * fractions - 1) * PER_OCTAVE).astype(np.int64)
    return (exponents.astype(np.int64) - 1) * PER_OCTAVE + within


def _middles(bins: Ints) -> _Floats:
    """The middle of the whole nanoseconds that fall into each bin."""
    octaves, within = np.divmod(bins, PER_OCTAVE)
    low = np.ldexp(1 + within / PER_OCTAVE, octaves)
    wide = np.ldexp(1.0, octaves) / PER_OCTAVE
    return np.asarray(np.where(wide > 1, low + (wide - 1) / 2, np.ceil(low)), np.float64)


SLOTS: Final = 512
"""Slots at most; they cover at least half of what they could."""

SHORTEST_NS: Final = 1 << 24
"""Length of a slot at first, nanoseconds: about 17 ms."""


@dataclass(frozen=True, slots=True)
class OverTime:
    """A number in each of equally long slots of time."""

    start_ns: int
    """When the first slot begins, nanoseconds since 1970 UTC."""
    slot_ns: int
    values: tuple[float, ...]


class CountsOverTime:
    """Numbers by sort (0, 1, ...) and by slot."""

    def __init__(self, shortest_ns: int = SHORTEST_NS) -> None:
        """Nothing came yet; a slot is `shortest_ns` long as long as that is long enough."""
        self.slot_ns = shortest_ns
        """Length of a slot, nanoseconds."""
        self._first = 0
        self._table: Ints = np.zeros((0, 0), np.int64)

    @property
    def start_ns(self) -> int:
        """When the first slot begins, nanoseconds since 1970 UTC."""
        return self._first * self.slot_ns

    def add(self, sorts: npt.NDArray[np.integer], t_ns: Ints, counts: Ints | None = None) -> None:
        """So many (1 where nothing is said) of each sort came at these times."""
        if not len(t_ns):
            return
        self._make_room(int(sorts.max()), int(t_ns.min()), int(t_ns.max()))
        places = sorts * self._table.shape[1] + (t_ns // self.slot_ns - self._first)
        added = np.bincount(places, counts, self._table.size)
        self._table += added.astype(np.int64).reshape(self._table.shape)

    def _make_room(self, sort: int, low_ns: int, high_ns: int) -> None:
        if not self._table.shape[1]:
            self._first = low_ns // self.slot_ns
        slots = self._table.shape[1]
        while True:
            first = min(self._first, low_ns // self.slot_ns)
            last = max(self._first + slots - 1, high_ns // self.slot_ns)
            if last - first < SLOTS:
                break
            self._halve()
            slots = self._table.shape[1]
        before, behind = self._first - first, last + 1 - self._first - slots
        below = max(0, sort + 1 - len(self._table))
        self._table = np.pad(self._table, ((0, below), (before, behind)))
        self._first = first

    def _halve(self) -> None:
        """Make two slots one."""
        table, slots = self._table, self._table.shape[1]
        odd = self._first % 2
        table = np.pad(table, ((0, 0), (odd, (slots + odd) % 2)))
        self._table = table[:, ::2] + table[:, 1::2]
        self._first //= 2
        self.slot_ns *= 2

    def of(self, sort: int) -> Ints:
        """The numbers of one sort, slot by slot; as many as for every other."""
        if sort >= len(self._table):
            return np.zeros(self._table.shape[1], np.int64)
        row: Ints = self._table[sort]
        return row


MOST: Final = 256
"""Numbers kept where nobody says otherwise."""

RATE_OVER_NS: Final = 2_000_000_000
"""How far back a rate looks, nanoseconds."""


class Recent:
    """The latest `most` of the numbers added, in the order in which they came."""

    def __init__(self, most: int = MOST) -> None:
        """`most` is at least 1."""
        self._most = most
        self.values: npt.NDArray[np.int64] = np.empty(0, np.int64)
        """The numbers kept, the latest last; never written in place, so copies may share it."""

    def add(self, values: npt.NDArray[np.int64]) -> None:
        """These came."""
        if len(values):
            kept = np.concatenate((self.values, values[-self._most :]))
            self.values = kept[-self._most :]

    def percentile(self, percent: float) -> int | None:
        """The least number kept that so many percent (0 to 100) do not exceed; None without any."""
        if not len(self.values):
            return None
        return int(np.percentile(self.values, percent, method="inverted_cdf"))

    def per_second(self, now_ns: int) -> float | None:
        """Where the numbers are times: how many a second came lately; None where none ever came.

        It looks back two seconds from `now_ns`, or as far as the numbers kept reach; 0 says that
        what came before has stopped.
        """
        times = self.values
        if not len(times):
            return None
        late = times[times > now_ns - RATE_OVER_NS]
        if len(late) == len(times):
            # The window begins before the first of them: they alone say how far apart they come.
            span = int(late[-1] - late[0])
            return (len(late) - 1) * 1e9 / span if span > 0 else None
        return len(late) * 1e9 / RATE_OVER_NS


@dataclass(slots=True)
class Tally:
    """Counts over all rows added so far."""

    rows: int = 0
    """Frames and damage together."""
    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    bytes: int = 0
    """Bytes on the wire."""
    by_status: Counter[Status] = field(default_factory=Counter)
    by_kind: Counter[str] = field(default_factory=Counter)
    """Frames by kind; those whose CMD names none are in no count here."""
    by_fault: Counter[Fault] = field(default_factory=Counter)
    """Rows by fault; a row counts once for each of its faults."""
    by_port: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    """The earliest time of a row, nanoseconds since 1970 UTC; None while no row has one."""
    last_ns: int | None = None
    """The latest time of a row, nanoseconds since 1970 UTC; None while no row has one."""

    def add(self, rows: Sequence[Row]) -> None:
        """Count these rows too."""
        self.rows += len(rows)
        self.bytes += sum(len(row.raw) for row in rows)
        self.by_port.update(row.port for row in rows)
        for faults, count in Counter(row.faults for row in rows).items():
            self.by_status[status_of(faults)] += count
            for fault in set(faults):
                self.by_fault[fault] += count
        frames = [row for row in rows if isinstance(row, Frame)]
        self.frames += len(frames)
        self.by_kind.update(kind.name for frame in frames if (kind := frame.kind))
        self._stretch([row.t_ns for row in rows if row.t_ns is not None])

    def _stretch(self, times: Sequence[int]) -> None:
        if not times:
            return
        first, last = min(times), max(times)
        self.first_ns = first if self.first_ns is None else min(first, self.first_ns)
        self.last_ns = last if self.last_ns is None else max(last, self.last_ns)

    @property
    def malformed(self) -> int:
        """Rows that cannot be believed."""
        return self.by_status[Status.MALFORMED]

    @property
    def malformed_share(self) -> float:
        """Malformed rows of all, 0 to 1; 0 while there are none."""
        return self.malformed / self.rows if self.rows else 0.0

    @property
    def duration_ns(self) -> int | None:
        """From the first row's time to the last one's, nanoseconds; None without times."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return self.last_ns - self.first_ns


class Rate:
    """How many per second, over a window that slides with the times it is given."""

    def __init__(self, window_ns: int = 2_000_000_000) -> None:
        """`window_ns` is how far back it looks, nanoseconds, more than 0."""
        self._window_ns = window_ns
        self._counts: deque[tuple[int, int]] = deque()
        self._total = 0
        self._since_ns: int | None = None

    def add(self, count: int, t_ns: int) -> None:
        """So many came, up to `t_ns`; times must not fall."""
        if self._since_ns is None:
            self._since_ns = t_ns
        self._counts.append((t_ns, count))
        self._total += count
        self._forget(t_ns)

    def per_second(self, now_ns: int) -> float:
        """The rate over the window that ends now; while it fills, over the time since it began."""
        self._forget(now_ns)
        if self._since_ns is None:
            return 0.0
        span_ns = min(self._window_ns, now_ns - self._since_ns)
        return self._total * 1e9 / span_ns if span_ns > 0 else 0.0

    def _forget(self, now_ns: int) -> None:
        while self._counts and self._counts[0][0] <= now_ns - self._window_ns:
            self._total -= self._counts.popleft()[1]


def count_rows(tally: Tally, rows: Sequence[Row]) -> None:
    """Count rows, one by one or many at once, whichever they allow."""
    if isinstance(rows, PackedRows):
        count_columns(tally, rows)
    else:
        tally.add(rows)


def count_columns(tally: Tally, rows: SideBySide) -> None:
    """Count these rows too, as `tally.add` counts rows."""
    words = rows.codebook
    tally.rows += len(rows.t_ns)
    tally.bytes += int(rows.length.sum(dtype=np.int64))
    tally.frames += int(np.count_nonzero(rows.framed))
    for port, count in enumerate(np.bincount(rows.port).tolist()):
        if count:
            tally.by_port[words.ports[port]] += count
    for number, count in enumerate(np.bincount(rows.faults).tolist()):
        if count:
            faults = words.faults[number]
            tally.by_status[status_of(faults)] += count
            for fault in dict.fromkeys(faults):
                tally.by_fault[fault] += count
    for kind, count in zip(
        KINDS, np.bincount(kind_codes(rows.raw, rows.framed), minlength=len(KINDS)), strict=False
    ):
        if count:
            tally.by_kind[kind.name] += int(count)
    timed = rows.timed
    times = rows.t_ns if timed.all() else rows.t_ns[timed]
    if len(times):
        first, last = int(times.min()), int(times.max())
        tally.first_ns = first if tally.first_ns is None else min(first, tally.first_ns)
        tally.last_ns = last if tally.last_ns is None else max(last, tally.last_ns)
