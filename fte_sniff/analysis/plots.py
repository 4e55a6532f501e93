"""The data of plots: targets and feedback of the motors over time, and their usual range.

`Traces` keeps envelopes in constant memory, for plots of rows that come. `Timeline` keeps points,
for the plots of a report. An outlier, such as a flipped bit, must not flatten either: the range of
a plot is that of a running median.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from fte_sniff.analysis.counters import EnvelopeColumns, Floats, Keep, Series
from fte_sniff.analysis.facts import motor_rows
from fte_sniff.analysis.model import Model, StreamChange
from fte_sniff.protocol import KINDS, MOTORS, Direction, Fault, FrameKind, Gap, Row
from fte_sniff.protocol.rows import Bools, Ints, Rows
from fte_sniff.protocol.spec import Role, motor_bit

# The usual range

MEDIAN_POINTS: Final = 5
"""Points of the running median whose range is the usual one."""

MARGIN: Final = 0.5
"""How far a value may be outside the range of the medians, as a share of it."""

LEAST_MARGIN: Final = 0.05
"""The least margin, as a share of the greatest median; it matters where the range is narrow."""

MOST_OUTLIERS: Final = 0.25
"""Share of the commands that are outliers at most; a target that often changes has none."""


def points_of_median(count: int) -> int:
    """Points of the running median over `count` single points.

    Four more for each tenfold above 200: among many points, some outliers are close together.
    """
    return MEDIAN_POINTS + 4 * max(0, int(np.log10(max(1, count / 200))))


def medians(values: Floats, points: int = MEDIAN_POINTS) -> Floats:
    """The running median of the values that are known; all of them where there are few."""
    known = values[~np.isnan(values)]
    if len(known) < points:
        return known
    windows = np.lib.stride_tricks.sliding_window_view(known, points)
    found: Floats = np.median(windows, axis=1)
    return found


def usual_targets(
    targets: Floats,
    lengths: Ints,
    *,
    points: int = MEDIAN_POINTS,
    begins: bool = True,
    holds: bool = True,
) -> Floats:
    """The running median of the commands, so that one with a flipped bit is an outlier.

    A command that is held longer than others counts more, since it may be sent only once; so do
    the first of all, if these are all (`begins`), and the one that holds at the end (`holds`),
    which have commands only at one side.

    Args:
        targets: What each command sets.
        lengths: How long each is held, in any unit.
    """
    if not len(targets):
        return targets
    repeats = np.clip(lengths // max(1, int(np.median(lengths))), 1, points).astype(np.int64)
    repeats[0] += points // 2 if begins else 0
    repeats[-1] += points // 2 if holds else 0
    found = medians(np.repeat(targets, repeats), points)
    low, high = limits(found)
    outliers = (targets < low) | (targets > high)
    return found if outliers.mean() <= MOST_OUTLIERS else targets


def limits(usual: Floats) -> tuple[float, float]:
    """The range outside which a value is an outlier; `usual` values must not be empty."""
    low, high = float(usual.min()), float(usual.max())
    margin = max(MARGIN * (high - low), LEAST_MARGIN * max(abs(low), abs(high)), 1.0)
    return low - margin, high + margin


def inside(values: Floats, usual: Floats) -> Floats:
    """The values that are not outliers; all of them where none is usual."""
    if not len(usual):
        return values
    low, high = limits(usual)
    found = values[(values >= low) & (values <= high)]
    return found if len(found) else values


def usual_range(values: Floats) -> tuple[float, float] | None:
    """The least and the greatest value without outliers; None without values."""
    known = inside(values[~np.isnan(values)], medians(values))
    return (float(known.min()), float(known.max())) if len(known) else None


# Envelopes of rows that come

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := kind.subject) is not None
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""Column names of what is traced: `rpm` and `pulses`."""

_Key: TypeAlias = tuple[int, Direction, str]

_TO_ALL: Final = (0, Direction.CONTROL, "")
_GROUPS: Final[dict[_Key, int]] = {
    key: group
    for group, key in enumerate(
        [
            *((motor, way, name) for way in Direction for name in QUANTITIES for motor in MOTORS),
            _TO_ALL,
        ]
    )
}
"""By motor, direction and quantity, the group in the series; the last is commands to all motors."""

_KINDS_TO_ALL: Final = [
    code
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.CONTROL and not kind.names_motor
]


class Traces(Model):
    """Commands and feedback of every motor over time; rows without a time are ignored."""

    def __init__(self) -> None:
        self._series = Series(Keep.LOW, Keep.HIGH, Keep.LAST)
        self._window: tuple[int, int] | None = None
        self._resampled: dict[tuple[_Key, int], EnvelopeColumns] = {}
        """Results for that window, since a command is the target of one curve and ends another."""
        self.last_ns: int | None = None
        """Latest time of a row, nanoseconds since 1970 UTC."""

    def observe(self, rows: Rows) -> None:
        """Add the next rows."""
        if (times := rows.replace(()).span_ns) is None:
            return
        self._window = None
        self.last_ns = times[1] if self.last_ns is None else max(self.last_ns, times[1])
        groups = np.full(len(rows), -1)
        values = np.zeros(len(rows), np.int64)
        for code, kind, name in _TRACED:
            at = np.flatnonzero(rows.kinds == code)
            at = at[np.isin(rows.nums[at], MOTORS)]
            groups[at] = _GROUPS[MOTORS[0], kind.direction, name] + rows.nums[at] - MOTORS[0]
            values[at] = rows.values(name, at)
        groups[np.isin(rows.kinds, _KINDS_TO_ALL)] = _GROUPS[_TO_ALL]
        traced = rows.timed & (groups >= 0)
        self._series.observe(rows.t_ns[traced], values[traced], groups[traced])

    def resample(
        self, motor: int, direction: Direction, name: str, window: tuple[int, int], columns: int
    ) -> EnvelopeColumns:
        """One quantity of a motor in a time window: its target (control) or feedback.

        The result is shared: never change it.
        """
        if window != self._window:
            self._window, self._resampled = window, {}
        key = motor, direction, name
        if (key, columns) not in self._resampled:
            self._resampled[key, columns] = self._series.envelope(_GROUPS[key], window, columns)
        return self._resampled[key, columns]

    def other_commands(self, motor: int, name: str, window: tuple[int, int], columns: int) -> Bools:
        """In which columns a motor got a command that does not set this quantity."""
        found = np.zeros(columns, np.bool_)
        for key in _other_commands(motor, name):
            found |= ~np.isnan(self.resample(*key, window, columns).last)
        return found

    def target_before(self, motor: int, name: str, t_ns: int) -> int | None:
        """The target of a quantity just before a time.

        None if it is unknown, or the last command does not set this quantity.
        """
        own = self._series.before(_GROUPS[motor, Direction.CONTROL, name], t_ns)
        others = [self._series.before(_GROUPS[key], t_ns) for key in _other_commands(motor, name)]
        if own is None or any(other is not None and other[0] > own[0] for other in others):
            return None
        return own[1]


def _other_commands(motor: int, name: str) -> list[_Key]:
    others = [other for other in QUANTITIES if other != name]
    return [*((motor, Direction.CONTROL, other) for other in others), _TO_ALL]


# Points of a report

MOST_POINTS: Final = 2_000_000
"""Rows with a time up to which every point is kept."""

BINS: Final = 5_000
"""Bins of each series after it was thinned; a bin keeps at most four of its points."""

MOST_DAMAGED: Final = 2_000
"""Rows of each fault that are kept with their bytes: the first ones."""

ALL_MOTORS: Final = 0
"""The motor number of commands to all motors."""


@dataclass(slots=True)
class Points:
    """One value over time."""

    _times: list[Ints] = field(default_factory=list)
    _values: list[Ints] = field(default_factory=list)

    def append(self, t_ns: Ints, values: Ints) -> None:
        """Append points: nanoseconds since 1970 UTC, and 32-bit integers."""
        if len(t_ns):
            self._times.append(t_ns)
            self._values.append(values.astype(np.int64))

    def points(self) -> tuple[Ints, Ints]:
        """Times and values, by rising time."""
        empty = [np.empty(0, np.int64)]
        t_ns, values = np.concatenate(self._times or empty), np.concatenate(self._values or empty)
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, values = t_ns[order], values[order]
        self._times, self._values = [t_ns], [values]
        return t_ns, values

    def thin(self, most: int = BINS) -> None:
        """Keep of each of `most` bins of time the first, last, lowest and highest point."""
        t_ns, values = self.points()
        if len(t_ns) <= 4 * most:
            return
        width = (int(t_ns[-1]) - int(t_ns[0])) // most + 1
        bins = (t_ns - t_ns[0]) // width
        starts = np.flatnonzero(np.diff(bins, prepend=-1))
        by_value = np.lexsort((values, bins))
        ends = np.append(starts[1:], len(bins)) - 1
        kept = np.unique(np.concatenate((starts, ends, by_value[starts], by_value[ends])))
        self._times, self._values = [t_ns[kept]], [values[kept]]

    def thin_changes(self) -> None:
        """Keep the points whose value is another than before."""
        t_ns, values = self.points()
        kept = np.flatnonzero(np.diff(values, prepend=-1))
        self._times, self._values = [t_ns[kept]], [values[kept]]


@dataclass(frozen=True, slots=True)
class Trace:
    """What a series shows: a field of one kind of frame, to or from one motor."""

    kind: FrameKind
    motor: int
    """`ALL_MOTORS` for kinds without a motor."""
    field: str
    """Column name; empty for a kind without a quantity."""


def _fields(kind: FrameKind) -> list[str]:
    """What is traced: the main value; of commands to all motors every quantity."""
    if kind.names_motor:
        return [kind.subject or ""]
    return [one.name for one in kind.fields if one.unit] or [""]


class Timeline:
    """The rows that have a time, by what they say.

    Above `most_points` rows each series keeps the minimum and maximum of bins of time.
    """

    def __init__(self, most_points: int = MOST_POINTS) -> None:
        self._most_points = most_points
        self.traces: dict[Trace, Points] = {}
        self.errors = {motor: Points() for motor in MOTORS}
        """By motor, its ERROR byte where it changes."""
        self.online = {motor: Points() for motor in MOTORS}
        """By motor, its bit of the ONLINE byte of any feedback, 0 or 1, where it changes."""
        self.faults: dict[Fault, Points] = {}
        """By fault, its rows; the value is the index in `damaged`, or -1."""
        self.damaged: list[Row] = []
        """The first rows of each fault."""
        self.breaks: list[int] = []
        """Times of the last row before each gap or lost port, nanoseconds since 1970 UTC."""
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.thinned = False
        """Whether not every point was kept."""
        self._points = 0
        self._kept_of: dict[Fault, int] = {}
        self._latest_ns: int | None = None

    def observe(self, rows: Rows, changes: Iterable[StreamChange] = ()) -> None:
        """Add the next rows; their times may be earlier than those before.

        `changes` are the gaps between them.
        """
        self._observe_gaps(rows, changes)
        timed = rows if rows.timed.all() else rows.select(rows.timed)
        if not len(timed):
            return
        first, last = int(timed.t_ns.min()), int(timed.t_ns.max())
        self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
        self.last_ns = last if self.last_ns is None else max(self.last_ns, last)
        self._observe_traces(timed)
        self._observe_flags(timed)
        self._observe_faults(timed)
        self._points += len(timed)
        if self._points > self._most_points:
            self._thin()

    def _observe_gaps(self, rows: Rows, changes: Iterable[StreamChange]) -> None:
        gaps = [change.index for change in changes if isinstance(change.what, Gap)]
        known = np.flatnonzero(rows.timed)
        for at in known.searchsorted(gaps).tolist():
            before_ns = int(rows.t_ns[known[at - 1]]) if at else self._latest_ns
            if before_ns is not None:
                self.breaks.append(before_ns)
        if len(known):
            self._latest_ns = int(rows.t_ns[known[-1]])

    def limits(
        self, feedback: Sequence[Trace], targets: Sequence[Trace], others: Sequence[Trace]
    ) -> tuple[float, float] | None:
        """The values of a quantity outside which one is an outlier; None without values.

        `others` are the commands that end a target.
        """
        reported = self._merged(feedback)[1].astype(np.float64)
        t_ns, values = self._merged(targets)
        ends = np.sort(np.concatenate((t_ns, self._merged(others)[0], [self.last_ns or 0])))
        lengths = ends[np.minimum(ends.searchsorted(t_ns, "right"), len(ends) - 1)] - t_ns
        usual = np.concatenate((
            medians(reported, points_of_median(len(reported))),
            usual_targets(values.astype(np.float64), lengths, points=points_of_median(len(values))),
        ))  # fmt: skip
        return limits(usual) if len(usual) else None

    def _merged(self, traces: Sequence[Trace]) -> tuple[Ints, Ints]:
        """Times and values of several traces, by rising time."""
        every = Points()
        for trace in traces:
            every.append(*self.traces[trace].points())
        return every.points()

    def _observe_traces(self, rows: Rows) -> None:
        for code, kind in enumerate(KINDS):
            own = np.flatnonzero(rows.kinds == code)
            if not len(own):
                continue
            for motor in MOTORS if kind.names_motor else [ALL_MOTORS]:
                at = own[rows.nums[own] == motor] if kind.names_motor else own
                for name in _fields(kind) if len(at) else ():
                    values = rows.values(name, at) if name else np.zeros(len(at), np.int64)
                    trace = Trace(kind, motor, name)
                    self.traces.setdefault(trace, Points()).append(rows.t_ns[at], values)

    def _observe_flags(self, rows: Rows) -> None:
        found = motor_rows(rows)
        anyone = found.any_feedback
        online, t_ns = rows.values(Role.ONLINE, anyone), rows.t_ns[anyone]
        for motor in MOTORS:
            own = found.feedback[motor]
            self.errors[motor].append(rows.t_ns[own], rows.values(Role.ERRORS, own))
            self.online[motor].append(t_ns, online >> motor_bit(motor) & 1)
            self.errors[motor].thin_changes()
            self.online[motor].thin_changes()

    def _observe_faults(self, rows: Rows) -> None:
        kept: dict[int, int] = {}
        for at, fault in self._faulty(rows):
            series = self.faults.setdefault(fault, Points())
            values = np.full(len(at), -1, np.int64)
            room = MOST_DAMAGED - self._kept_of.get(fault, 0)
            for place, row in enumerate(at[:room].tolist()):
                if row not in kept:
                    kept[row] = len(self.damaged)
                    self.damaged.append(rows[row])
                values[place] = kept[row]
            self._kept_of[fault] = MOST_DAMAGED - max(0, room - len(at))
            series.append(rows.t_ns[at], values)

    @staticmethod
    def _faulty(rows: Rows) -> Iterator[tuple[Ints, Fault]]:
        for fault in Fault:
            if len(at := np.flatnonzero(rows.has(fault))):
                yield at, fault

    def _thin(self) -> None:
        self.thinned = True
        every = [*self.traces.values(), *self.faults.values()]
        for series in every:
            series.thin()
        self._points = sum(len(series.points()[0]) for series in every)
