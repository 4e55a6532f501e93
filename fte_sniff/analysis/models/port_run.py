"""Owns the numbers of one wire: how full it is, how long it is silent, what happened to its port.

It must not know a clock, a screen or other ports; it makes no difference where batches are cut.
Times are taken not to fall.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.accumulators.counts import OverTime
from fte_sniff.analysis.accumulators.durations import Durations
from fte_sniff.analysis.columns.fields import NO_TIME, Ints
from fte_sniff.protocol import HEADERS, Direction, PortEvent, PortEventKind, byte_time_ns


@dataclass(frozen=True, slots=True)
class EventNumbers:
    """One sort of thing that happened to a port: line errors, for one."""

    kind: PortEventKind
    count: int
    """How often."""
    total: int
    """Of what there was to count each time: errors on the line, bytes of an overrun."""
    first_ns: int
    """When it first did, nanoseconds since 1970 UTC."""
    last_ns: int
    """When it last did, nanoseconds since 1970 UTC."""


@dataclass(frozen=True, slots=True)
class PortNumbers:
    """One wire."""

    port: str
    rows: int
    bytes: int
    frames: Mapping[Direction, int]
    """Rows whose framing holds, by direction."""
    baud: int
    """Bits per second, at last."""
    first_ns: int | None
    """Time of its first row, nanoseconds since 1970 UTC; None where no row has one."""
    last_ns: int | None
    per_s: float | None
    """Rows, on the average from the first to the last; None where that cannot be told."""
    share: float | None
    """Of the time from the first row to the end of the last that bytes took; None without times."""
    silences: Durations
    """From the end of each row to the begin of the next, where there was anything between."""
    share_over_time: OverTime
    events: tuple[EventNumbers, ...]
    """What happened to the port, in the order in which it first did."""


class PortRun:
    """One wire as it runs."""

    def __init__(self, baud: int) -> None:
        """Nothing came yet, at so many bits per second."""
        self.baud = baud
        self.rows = self.bytes = self.timed = self.taken_ns = 0
        self.frames = dict.fromkeys(Direction, 0)
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.end_ns = 0
        self._runs = 0
        self._between_rows_ns = self._between_ends_ns = 0
        self._goes_on = False
        self.silences = Durations()
        self.events: dict[PortEventKind, EventNumbers] = {}

    @property
    def byte_ns(self) -> int:
        """Nanoseconds that a byte takes."""
        return byte_time_ns(self.baud)

    def add(self, lengths: Ints, t_ns: Ints) -> None:
        """Rows: lengths, and times or `NO_TIME`."""
        self.rows += len(lengths)
        self.bytes += int(lengths.sum())
        known = t_ns != NO_TIME
        self._add_timed(t_ns[known], t_ns[known] + lengths[known] * self.byte_ns)

    def add_frames(self, headers: npt.NDArray[np.uint8]) -> None:
        """Rows whose framing holds, with their first bytes."""
        for direction, header in HEADERS.items():
            self.frames[direction] += int(np.count_nonzero(headers == header))

    def _add_timed(self, t_ns: Ints, ends_ns: Ints) -> None:
        self.timed += len(t_ns)
        self.taken_ns += int((ends_ns - t_ns).sum())
        if not len(t_ns):
            return
        if not self._goes_on:
            self._begin_run(int(t_ns[0]))
        before = np.concatenate(([self.end_ns], ends_ns[:-1]))
        silent = t_ns - before
        self.silences.add(silent[silent > 0], t_ns[silent > 0])
        self.last_ns, self.end_ns = int(t_ns[-1]), int(ends_ns[-1])

    def _begin_run(self, t_ns: int) -> None:
        """What lies before this time was not silence, but rows that are not here."""
        if self.first_ns is None or self.last_ns is None:
            self.first_ns = t_ns
        else:
            self._between_rows_ns += t_ns - self.last_ns
            self._between_ends_ns += t_ns - self.end_ns
        self.end_ns, self._runs, self._goes_on = t_ns, self._runs + 1, True

    def interrupt(self) -> None:
        """Rows are missing here, so that the next one is measured against none before."""
        self._goes_on = False

    @property
    def per_s(self) -> float | None:
        """Rows, on the average from the first to the last; None where that cannot be told."""
        if self.first_ns is None or self.last_ns is None:
            return None
        span = self.last_ns - self.first_ns - self._between_rows_ns
        return (self.timed - self._runs) * 1e9 / span if span > 0 else None

    @property
    def share(self) -> float | None:
        """Of the time from the first row to the end of the last that bytes took."""
        if self.first_ns is None:
            return None
        span = self.end_ns - self.first_ns - self._between_ends_ns
        return self.taken_ns / span if span > 0 else None

    def happened(self, event: PortEvent) -> None:
        """This happened to it."""
        before = self.events.get(event.kind)
        self.events[event.kind] = EventNumbers(
            event.kind,
            1 if before is None else before.count + 1,
            event.count + (0 if before is None else before.total),
            event.t_ns if before is None else before.first_ns,
            event.t_ns,
        )

    def numbers(self, name: str, share_over_time: OverTime) -> PortNumbers:
        """All of it so far."""
        return PortNumbers(
            name,
            self.rows,
            self.bytes,
            self.frames,
            self.baud,
            self.first_ns,
            self.last_ns,
            self.per_s,
            self.share,
            self.silences,
            share_over_time,
            tuple(self.events.values()),
        )
