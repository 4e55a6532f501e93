"""Measures of rows, which rules compare with numbers.

A measure counts consecutive rows, and `merge` adds those of another measure that counted the rows
after them: the result is that of a single pass. Times are integers in nanoseconds.

A new measure is a class, for which `Measure` has the rules, and an entry of `MEASURES`, for which
`MeasureKind` has them. Each class below `Measure` stands alone. They count with:

    model.Ends           facts of the first and the last row, for measures of adjacent rows
    facts.Pairing        commands and their answers
    counters.Durations   percentiles of times
    findings.Findings    findings
"""

from __future__ import annotations

import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple, Self

import numpy as np

from fte_sniff.analysis.counters import Durations
from fte_sniff.analysis.facts import Pairing, motor_rows
from fte_sniff.analysis.findings import Finding, Findings
from fte_sniff.analysis.model import Ends, Model, RowCount
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    KINDS,
    MOTORS,
    Direction,
    Gap,
    PortEvent,
)
from fte_sniff.protocol.rows import NO_ROWS, NO_TIME, Array, Bools, Ints, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit

OPERATORS: Final[Mapping[str, Callable[[float, float], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}


class Argument(Enum):
    """What a measure takes first."""

    FILTER = "a filter"
    OPTIONAL_FILTER = "a filter, or nothing"
    PERCENTILE = "p50, p95, p99 or max"
    MOTOR = "a motor"
    FIELD = "a field"
    CAUSE = "a cause, a cause and a motor, or nothing"
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class MeasureKind:
    """A measure of the language: an entry of `MEASURES`, by its name."""

    make: Callable[[Rule], Measure]
    """The class."""
    takes: Argument
    """The first argument; PERCENTILE and FIELD may be followed by a filter."""
    example: str
    needs: str
    """What it needs to have a value: `a row`."""
    unit: str = ""
    """Of its value; empty for a field's own unit, and for shares."""
    is_timed: bool = False
    """Whether that includes rows with times."""
    covered_by_any_row: bool = False
    """Whether a rule fails, and is not uncovered, if there are rows and no value."""
    is_share: bool = False
    """Whether the value is 0 to 1."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One comparison of a measure with a number; made by `parse_rule`."""

    name: str
    """What the user calls it; text from outside."""
    expect: str
    """As written: `count(malformed) == 0`."""
    measure: str
    """A key of `MEASURES`."""
    argument: str
    """A percentile, a field, a motor, or `cause,motor`; empty if the measure takes none."""
    filter_text: str | None
    """The filter that selects rows, or commands; None for all."""
    operator: str
    """A key of `OPERATORS`."""
    number: float
    may_be_uncovered: bool = False
    """Whether the check may succeed without a value of the measure."""

    @property
    def unit(self) -> str:
        """Unit of the measured value and the number; empty without one."""
        column = COLUMN_BY_NAME.get(self.argument)
        return (column and column.unit) or self.kind.unit

    @property
    def kind(self) -> MeasureKind:
        """The measure."""
        return MEASURES[self.measure]

    def holds(self, value: float) -> bool:
        """Whether a measured value is as expected."""
        return OPERATORS[self.operator](value, self.number)

    @property
    def least_too_large(self) -> tuple[float, bool]:
        """The number above which values are too large, and whether it is itself too large."""
        upper = self.operator in ("<", "<=", "==")
        return (self.number if upper else math.inf), self.operator == "<"

    @property
    def greatest_too_small(self) -> tuple[float, bool]:
        """The number below which values are too small, and whether it is itself too small."""
        lower = self.operator in (">", ">=", "==")
        return (self.number if lower else -math.inf), self.operator == ">"


class RowPosition(NamedTuple):
    """Where a row is; sorts by time."""

    t_ns: int
    """Nanoseconds since 1970 UTC, or `NO_TIME`."""
    port: str
    """Text from outside."""
    offset: int
    """Of its first byte in the port's stream."""
    file: str = ""
    """The input's name, text from outside; empty during a capture."""
    motor: int | None = None
    """The motor that the row names."""
    raw: bytes = b""


class Measure(Model, ABC):
    """One measure of the rows so far.

    A class has to write `observe`, `merge` and `value`. Its attributes are copied (see `Model`) and
    pickled.
    """

    def __init__(self, rule: Rule) -> None:
        self._filter = rule.filter_text
        self._too_large = rule.least_too_large
        self._too_small = rule.greatest_too_small
        self._first = _FirstRows(self._least_violating())

    @abstractmethod
    def observe(self, rows: Rows, matches: Bools) -> None:
        """Add the next rows; `matches` is a mask of those that the rule's filter selects."""

    def merge(self, later: Self) -> None:
        """Add the rows that follow; a class that counts calls this too, and adds its counts."""
        self._first.merge(later._first)

    @abstractmethod
    def value(self, total: RowCount) -> float | None:
        """The measure, in its unit; None if it has no value. `total` counts all rows."""

    # For a measure that depends on adjacent rows, port events or findings

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here."""

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""

    def finding(self) -> Finding | None:
        """The best finding that the rule counts, if it counts findings."""
        return None

    # For a measure whose violation one row can show: `observe` adds its rows to `_first`

    def _least_violating(self) -> int:
        """The number of rows that violates the rule, the last of which is shown; 0 to show none."""
        return 0

    def conditions(self) -> list[str]:
        """Filters that the row that is shown passes, and others like it."""
        return [] if self._filter is None else [self._filter]

    @property
    def row(self) -> RowPosition | None:
        """The first row at which the rule was violated, if one row can show it."""
        return self._first.last

    # What the measures share

    def begin(self, name: str) -> None:
        """Start the next input."""
        self._first.file = name

    def _exceeds(self, values: Array) -> Bools:
        """Which values are too large for the rule."""
        number, inclusive = self._too_large
        found: Bools = values >= number if inclusive else values > number
        return found

    def _falls_below(self, values: Array) -> Bools:
        """Which values are too small for the rule."""
        number, inclusive = self._too_small
        found: Bools = values <= number if inclusive else values < number
        return found

    def _least_count_too_large(self) -> int:
        """The smallest number of rows that is too large; more than `MOST_KEPT` for none."""
        number, inclusive = self._too_large
        if number > MOST_KEPT:
            return MOST_KEPT + 1
        return max(1, math.ceil(number) if inclusive else math.floor(number) + 1)

    def _beyond(self, field: str, *, below: bool = False) -> str:
        """The filter for values of a field that violate the rule."""
        number, inclusive = self._too_small if below else self._too_large
        operator = f"{'<' if below else '>'}{'=' if inclusive else ''}"
        return f"{field} {operator} {number:.15g}" if math.isfinite(number) else ""


MOST_KEPT: Final = 1000
"""Most rows that a measure keeps to find the first one beyond its limit."""


class _FirstRows(Model):
    """The first rows by time, at most `most`."""

    def __init__(self, most: int) -> None:
        self.file = ""
        """The name of the input that the next rows come from."""
        self._most = most if most <= MOST_KEPT else 0
        self._rows: list[RowPosition] = []

    def observe(self, rows: Rows, found: Ints) -> None:
        """Add the rows of a batch at these indices."""
        if not self._most or not len(found):
            return
        t_ns = rows.t_ns[found]
        if len(self._rows) == self._most and t_ns.min() > self._rows[-1].t_ns:
            return
        if len(found) > self._most:
            earliest = np.partition(t_ns, self._most - 1)[self._most - 1]
            found = found[t_ns <= earliest]
        self.add([self.position(rows, at) for at in found.tolist()])

    def position(self, rows: Rows, at: int) -> RowPosition:
        """The position of a row of a batch."""
        row = rows[int(at)]
        motor = row.values.get(_MOTOR)
        t_ns = NO_TIME if row.t_ns is None else row.t_ns
        return RowPosition(t_ns, row.port, row.offset, self.file, motor, row.raw)

    def add(self, positions: Sequence[RowPosition]) -> None:
        """Add rows by their positions."""
        self._rows = sorted([*self._rows, *positions])[: self._most]

    def merge(self, other: _FirstRows) -> None:
        """Add the rows of another object with the same `most`."""
        self.add(other._rows)

    @property
    def last(self) -> RowPosition | None:
        """The last of them; None if there are fewer than `most`."""
        return self._rows[-1] if self._rows and len(self._rows) == self._most else None


# The measures

_SECOND: Final = 1e9
_MILLISECOND: Final = 1e6


class _Duration(Measure):
    """`duration()`."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._timed = 0

    def observe(self, rows: Rows, matches: Bools) -> None:
        self._timed += int(np.count_nonzero(rows.timed))

    def merge(self, later: Self) -> None:
        super().merge(later)
        self._timed += later._timed

    def value(self, total: RowCount) -> float | None:
        """Seconds from the first time to the last; None without two rows with times."""
        return (total.duration_ns or 0) / _SECOND if self._timed > 1 else None


class _MatchCount(Measure):
    """`count(FILTER)`."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self.count = 0

    def _least_violating(self) -> int:
        return self._least_count_too_large()

    def observe(self, rows: Rows, matches: Bools) -> None:
        found = np.flatnonzero(matches)
        self.count += len(found)
        self._first.observe(rows, found)

    def merge(self, later: Self) -> None:
        super().merge(later)
        self.count += later.count

    def value(self, total: RowCount) -> float | None:
        """The number of matching rows."""
        return self.count if total.rows else None


class _MatchShare(_MatchCount):
    """`share(FILTER)`."""

    def _least_violating(self) -> int:
        return int(self._too_large[0] < math.inf)

    def value(self, total: RowCount) -> float | None:
        """The share of matching rows, 0 to 1."""
        return self.count / total.rows if total.rows else None


class _MatchRate(_MatchShare):
    """`rate(FILTER)`."""

    def value(self, total: RowCount) -> float | None:
        """Matching rows per second; 0 without any, None if the duration is unknown or 0."""
        if not self.count:
            return 0 if total.rows else None
        return self.count * _SECOND / total.duration_ns if total.duration_ns else None


class _FieldValues(Measure):
    """`min`, `max` and `mean` of a field."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._which, self._field = rule.measure, rule.argument
        self._count = 0
        self._sum: float = 0
        self._least: float | None = None
        self._greatest: float | None = None

    def _least_violating(self) -> int:
        return 1

    def observe(self, rows: Rows, matches: Bools) -> None:
        values, known = _numbers(rows, self._field)
        found = np.flatnonzero(matches & known)
        if not len(found):
            return
        own = values[found]
        self._count += len(own)
        self._sum += own.sum().item()
        self._extend(own.min().item(), own.max().item())
        if self._which == "max":
            self._first.observe(rows, found[self._exceeds(own)])
        elif self._which == "min":
            self._first.observe(rows, found[self._falls_below(own)])

    def conditions(self) -> list[str]:
        """See `Measure`."""
        return [*super().conditions(), self._beyond(self._field, below=self._which == "min")]

    def _extend(self, least: float, greatest: float) -> None:
        self._least = least if self._least is None else min(least, self._least)
        self._greatest = greatest if self._greatest is None else max(greatest, self._greatest)

    def merge(self, later: Self) -> None:
        super().merge(later)
        self._count += later._count
        self._sum += later._sum
        if later._least is not None and later._greatest is not None:
            self._extend(later._least, later._greatest)

    def value(self, total: RowCount) -> float | None:
        """The smallest or greatest value, or the mean."""
        if self._which == "mean":
            return self._sum / self._count if self._count else None
        return self._least if self._which == "min" else self._greatest


def _numbers(rows: Rows, name: str) -> tuple[Array, Bools]:
    """A column of numbers, and a mask of the rows that have it."""
    of_rows = COLUMN_BY_NAME[name].of_rows
    if of_rows is None:
        raise ValueError(f"{name} is not a column of numbers")
    values, known, _ = of_rows(rows)
    if values.dtype.kind in "iu":
        values = values.astype(np.int64)  # sums do not fit the bits of a field
    return values, np.ones(len(rows), np.bool_) if known is None else known


@dataclass
class _GaplessRows(Model):
    """Rows with times without a gap between them."""

    start: RowPosition
    end: RowPosition
    first_match: RowPosition | None
    last_match: RowPosition | None
    port_lost: bool
    """Whether a port is lost, on which matching rows may have come."""

    def edges(self) -> Iterator[tuple[RowPosition, RowPosition]]:
        """The time without a matching row at the start and at the end, where it is known."""
        if self.port_lost:
            return
        if self.first_match is None or self.last_match is None:
            yield self.start, self.end
        else:
            yield self.start, self.first_match
            yield self.last_match, self.end


class _MaxGap(Measure):
    """`max_gap(FILTER)`.

    Of the runs between gaps, the first and the last are kept: rows before the first, and after the
    last, may continue them. While a port is lost, only the time between two matching rows counts:
    others may have been on that port.
    """

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._matches = 0
        self._longest_ns = 0
        self._runs: list[_GaplessRows] = []
        self._opens = True
        """Whether the first run would continue rows before it."""
        self._continues = False
        """Whether the next rows continue the last run."""
        self._port_lost = False

    def _least_violating(self) -> int:
        return 1

    def conditions(self) -> list[str]:
        """None: other rows show what came instead."""
        return []

    def observe(self, rows: Rows, matches: Bools) -> None:
        timed = np.flatnonzero(rows.timed)
        if not len(timed):
            return
        found = timed[matches[timed]]
        self._matches += len(found)
        first = last = None
        if len(found):
            first, last = (
                self._first.position(rows, found[0]),
                self._first.position(rows, found[-1]),
            )
            gaps_ns = np.diff(rows.t_ns[found])
            self._longest_ns = max(self._longest_ns, int(gaps_ns.max(initial=0)))
            for at in np.flatnonzero(self._exceeds(gaps_ns / _SECOND))[:1]:
                self._first.add([self._first.position(rows, found[at])])
        start, end = (self._first.position(rows, timed[at]) for at in (0, -1))
        run = _GaplessRows(start, end, first, last, self._port_lost)
        self._append(run, continues=self._continues)

    def _measure(self, start: RowPosition, end: RowPosition) -> None:
        gap_ns = end.t_ns - start.t_ns
        self._longest_ns = max(self._longest_ns, gap_ns)
        if self._exceeds(np.array([gap_ns / _SECOND]))[0]:
            self._first.add([start])

    def _append(self, run: _GaplessRows, *, continues: bool) -> None:
        self._continues = True
        if not continues or not self._runs:
            if len(self._runs) == 2:
                self._measure_edges(self._runs.pop())
            self._runs.append(run)
            return
        last = self._runs[-1]
        if run.first_match is not None and last.last_match is not None:
            self._measure(last.last_match, run.first_match)
        last.first_match = last.first_match or run.first_match
        last.last_match = run.last_match or last.last_match
        last.end = run.end

    def _measure_edges(self, run: _GaplessRows) -> None:
        for start, end in run.edges():
            self._measure(start, end)

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here: the time until the next one is not counted."""
        self._continues = False
        self._opens = self._opens and bool(self._runs)
        if gap is not None and gap.port_lost is not None:
            self._port_lost = gap.port_lost

    def merge(self, later: Self) -> None:
        super().merge(later)
        self._matches += later._matches
        self._longest_ns = max(self._longest_ns, later._longest_ns)
        if not later._opens:
            self.interrupt()
        for number, run in enumerate(later._runs):
            self._append(run.copy(), continues=self._continues and not number)
        if later._runs:
            self._continues = later._continues
        self._port_lost = later._port_lost

    def _whole(self) -> _MaxGap:
        """With the runs at both ends, as no rows precede and follow."""
        whole = self.copy()
        for run in self._runs:
            whole._measure_edges(run)
        return whole

    def value(self, total: RowCount) -> float | None:
        """Seconds; None without two matching rows that have times."""
        return self._whole()._longest_ns / _SECOND if self._matches > 1 else None

    @property
    def row(self) -> RowPosition | None:
        """The row after which no matching row came for too long."""
        return self._whole()._first.last


class _CommandAnswers(Measure):
    """`unanswered([FILTER])`, and the base of `delay`: the filter selects commands."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._pairings = {motor: Pairing() for motor in MOTORS}
        self._open: dict[int, tuple[RowPosition, bool]] = {}
        """By motor, the position of the last command, and whether it matches."""
        self.decided = self.unanswered = 0
        self.uncovered = 0
        """Commands without an answer before the first feedback of a recording."""
        self._early = _FirstRows(self._least_violating())
        """Those of them that are unanswered if feedback came before these rows."""
        self._early_count = 0
        self.delays = Durations()

    def _least_violating(self) -> int:
        return self._least_count_too_large()

    def observe(self, rows: Rows, matches: Bools) -> None:
        found = motor_rows(rows)
        for motor, pairing in self._pairings.items():
            commands = found.commands[motor]
            decided = pairing.observe(rows, found, motor)
            is_first = not pairing.has_start
            self._count_uncovered(rows, matches, decided.uncovered, motor, early=is_first)
            early = decided.indices < 0
            if early.any():
                position, matched = self._open[motor]
                if matched:
                    self._decide(
                        [position],
                        decided.answered[early],
                        decided.delays_ns[early],
                        decided.ends_ns[early],
                    )
            own = ~early
            own[own] = matches[decided.indices[own]]
            self._count(decided.answered[own], decided.delays_ns[own], decided.ends_ns[own])
            shown = self._shown(decided.answered[own], decided.delays_ns[own])
            self._first.observe(rows, decided.indices[own][shown])
            if not pairing.waiting:
                self._open.pop(motor, None)
            elif len(commands):
                at = int(commands[-1])
                self._open[motor] = self._first.position(rows, at), bool(matches[at])

    def _count_uncovered(
        self, rows: Rows, matches: Bools, found: Ints, motor: int, *, early: bool
    ) -> None:
        """Count commands without an answer before the first feedback.

        `early` is whether earlier rows of the same recording may have feedback.
        """
        before = [self._open[motor][0]] if (found < 0).any() and self._open[motor][1] else []
        own = found[found >= 0]
        own = own[matches[own]] if len(own) else own
        self.uncovered += len(before) + len(own)
        if early:
            self._early_count += len(before) + len(own)
            self._early.file = self._first.file
            self._early.observe(rows, own)
            self._early.add(before)

    def conditions(self) -> list[str]:
        """See `Measure`."""
        return [*super().conditions(), self._state()]

    def _state(self) -> str:
        """The filter for the commands that violate the rule."""
        return "unanswered"

    def _decide(
        self, positions: Sequence[RowPosition], answered: Bools, delays_ns: Ints, ends_ns: Ints
    ) -> None:
        """Count commands that match, by their positions."""
        self._count(answered, delays_ns, ends_ns)
        shown = np.flatnonzero(self._shown(answered, delays_ns))
        self._first.add([positions[at] for at in shown.tolist()])

    def _count(self, answered: Bools, delays_ns: Ints, ends_ns: Ints) -> None:
        known = delays_ns != NO_TIME
        self.delays.observe(delays_ns[known], ends_ns[known])
        self.decided += len(answered)
        self.unanswered += int(np.count_nonzero(~answered))

    def _shown(self, answered: Bools, delays_ns: Ints) -> Bools:
        """Which of the commands count towards the first violation."""
        return ~answered

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here: whether the last command was answered remains unknown."""
        self._open.clear()
        for pairing in self._pairings.values():
            pairing.interrupt(gap)

    def merge(self, later: Self) -> None:
        super().merge(later)
        one = self._pairings[MOTORS[0]]
        early = not one.has_start
        self.uncovered += later.uncovered
        if one.has_feedback:
            self.uncovered -= later._early_count
            self.decided += later._early_count
            self.unanswered += later._early_count
            self._first.merge(later._early)
        elif early:
            self._early_count += later._early_count
            self._early.merge(later._early)
        for motor, pairing in self._pairings.items():
            decided = pairing.merge(later._pairings[motor])
            self._count_uncovered(NO_ROWS, NO_ROWS.timed, decided.uncovered, motor, early=early)
            if len(decided.indices) and self._open[motor][1]:
                position = self._open[motor][0]
                self._decide([position], decided.answered, decided.delays_ns, decided.ends_ns)
            if not pairing.waiting:
                self._open.pop(motor, None)
        self._open |= later._open
        self.decided += later.decided
        self.unanswered += later.unanswered
        self.delays.merge(later.delays)

    def value(self, total: RowCount) -> float | None:
        """The number of commands without an answer before the next command.

        None where feedback never came: its wire may not be recorded.
        """
        covered = self.decided or not self.uncovered
        return self.unanswered if total.rows and covered else None


class _AnswerDelay(_CommandAnswers):
    """`delay(PERCENTILE [, FILTER])`."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._percentile = rule.argument
        self._early = _FirstRows(0)  # a command without an answer has no delay

    def _least_violating(self) -> int:
        return 1

    def _state(self) -> str:
        return self._beyond("answer_ms")

    def _shown(self, answered: Bools, delays_ns: Ints) -> Bools:
        shown: Bools = (delays_ns != NO_TIME) & self._exceeds(delays_ns / _MILLISECOND)
        return shown

    def value(self, total: RowCount) -> float | None:
        """Milliseconds; None without an answer time."""
        if self._percentile == "max":
            delay_ns: float | None = self.delays.longest_ns
        else:
            delay_ns = self.delays.percentile_ns(int(self._percentile[1:]))
        return None if delay_ns is None else delay_ns / _MILLISECOND


class _OnlineShare(Measure):
    """`online(MOTOR)`: each ONLINE byte holds until the next feedback of any motor."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._motor = int(rule.argument)
        self._own = self._frames = self._frames_on = 0
        self._known_ns = self._on_ns = 0
        self._ends = Ends[tuple[int, bool]]()
        """Time and bit of the first and the last feedback."""

    def _least_violating(self) -> int:
        return int(self._too_small[0] > -math.inf)

    def observe(self, rows: Rows, matches: Bools) -> None:
        found = motor_rows(rows)
        self._own += len(found.feedback[self._motor])
        feedback = found.any_feedback
        online = rows.values(Role.ONLINE, feedback)
        bits = (online >> motor_bit(self._motor) & 1).astype(np.bool_)
        self._frames += len(feedback)
        self._frames_on += int(np.count_nonzero(bits))
        self._first.observe(rows, feedback[~bits])
        timed = rows.t_ns[feedback] != NO_TIME
        t_ns, bits = rows.t_ns[feedback][timed], bits[timed]
        if not len(t_ns):
            return
        first, last = ((int(t_ns[at]), bool(bits[at])) for at in (0, -1))
        if (before := self._ends.append(first, last)) is not None:
            self._hold(before, first)
        held_ns = np.maximum(np.diff(t_ns), 0)
        self._known_ns += int(held_ns.sum())
        self._on_ns += int(held_ns[bits[:-1]].sum())

    def conditions(self) -> list[str]:
        """See `Measure`."""
        return [str(Direction.FEEDBACK)]

    def _hold(self, before: tuple[int, bool], after: tuple[int, bool]) -> None:
        """A bit held until the next feedback."""
        held_ns = max(after[0] - before[0], 0)
        self._known_ns += held_ns
        self._on_ns += held_ns * before[1]

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here: what the motor was until the next one is unknown."""
        self._ends.interrupt()

    def merge(self, later: Self) -> None:
        super().merge(later)
        if (adjacent := self._ends.merge(later._ends)) is not None:
            self._hold(*adjacent)
        self._own += later._own
        self._frames += later._frames
        self._frames_on += later._frames_on
        self._known_ns += later._known_ns
        self._on_ns += later._on_ns

    def value(self, total: RowCount) -> float | None:
        """The share of time, 0 to 1; of the frames if all have one time."""
        if not self._own:
            return None
        return self._on_ns / self._known_ns if self._known_ns else self._frames_on / self._frames


_MOTOR, _SPEED = NAME_OF_ROLE[Role.MOTOR], NAME_OF_ROLE[Role.SPEED]
_FEEDBACK: Final = next(kind.name for kind in KINDS if kind.direction is Direction.FEEDBACK)
_HAS_FIELD: Final = "a matching row with the field"


class _FindingCount(Measure):
    """`findings([CAUSE [, MOTOR]])`."""

    def __init__(self, rule: Rule) -> None:
        super().__init__(rule)
        self._cause, _, motor = rule.argument.partition(",")
        self._motor = int(motor) if motor else None
        self._findings = Findings()

    def observe(self, rows: Rows, matches: Bools) -> None:
        self._findings.observe(rows)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        self._findings.observe_events(events)

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here."""
        if gap is not None:
            self._findings.observe_change(gap)

    def merge(self, later: Self) -> None:
        super().merge(later)
        self._findings.merge(later._findings)

    def value(self, total: RowCount) -> float | None:
        """The findings of the cause and motor; None if they could not be examined."""
        missing = self._findings.not_covered()
        if self._cause in missing or len(missing) == len(Findings.CAUSES):
            return None
        return len(self._counted())

    def _counted(self) -> list[Finding]:
        return [
            one
            for one in self._findings.found()
            if self._cause in ("", one.cause) and self._motor in (None, one.motor or self._motor)
        ]

    def finding(self) -> Finding | None:
        """The best finding that the rule counts."""
        return next(iter(self._counted()), None)


MEASURES: Final[Mapping[str, MeasureKind]] = {
    "count": MeasureKind(_MatchCount, Argument.FILTER, "count(malformed) == 0", "a row", "rows"),
    "share": MeasureKind(
        _MatchShare, Argument.FILTER, "share(malformed) <= 0.001", "a row", is_share=True
    ),
    "rate": MeasureKind(
        _MatchRate,
        Argument.FILTER,
        f"rate(kind = '{_FEEDBACK}') >= 30",
        "two different times",
        "1/s",
        is_timed=True,
        covered_by_any_row=True,
    ),
    "max_gap": MeasureKind(
        _MaxGap,
        Argument.FILTER,
        f"max_gap({_MOTOR} = 1) < 0.5",
        "two matching rows with times",
        "s",
        is_timed=True,
    ),
    "delay": MeasureKind(
        _AnswerDelay,
        Argument.PERCENTILE,
        "delay(p95) < 20",
        "an answered command with times",
        "ms",
        is_timed=True,
    ),
    "unanswered": MeasureKind(
        _CommandAnswers,
        Argument.OPTIONAL_FILTER,
        "unanswered() == 0",
        "feedback before the commands",
        "commands",
    ),
    "online": MeasureKind(
        _OnlineShare, Argument.MOTOR, "online(1) >= 0.99", "feedback of the motor", is_share=True
    ),
    "findings": MeasureKind(
        _FindingCount,
        Argument.CAUSE,
        "findings(unanswered, 3) == 0",
        "rows with times that show the cause",
        "findings",
        is_timed=True,
    ),
    "min": MeasureKind(
        _FieldValues, Argument.FIELD, f"min({_SPEED}, {_MOTOR} = 1) >= -300", _HAS_FIELD
    ),
    "max": MeasureKind(_FieldValues, Argument.FIELD, f"max({_SPEED}) <= 300", _HAS_FIELD),
    "mean": MeasureKind(
        _FieldValues, Argument.FIELD, f"mean({_SPEED}, {_MOTOR} = 1) > 0", _HAS_FIELD
    ),
    "duration": MeasureKind(
        _Duration, Argument.NOTHING, "duration() >= 60", "two rows with times", "s", is_timed=True
    ),
}
"""The measures of the language."""
