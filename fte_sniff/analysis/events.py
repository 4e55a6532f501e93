"""Events of trouble, counted by window of time: what `findings` looks for spans in.

A window has 2^30 ns. Its counts are sums, its ranges are lowest and highest values, so the counts
of two parts of a recording merge by addition. With more than `MOST_WINDOWS` windows, pairs are
merged: a column of counts then needs no more memory, whatever the length of the recording.

    windows    1 column a count      commands of a motor, those without answer, answers by octave
               1 column a range      targets and present values of a motor; times of its events
    streams    first and last values of a flag, a period, a value

Some events depend on the values beside them, such as a flag that is set in three frames in a row.
Two parts of a stream join by the values on both sides of the cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from fte_sniff.analysis.counters import Keep
from fte_sniff.analysis.facts import ANSWERABLE, NAMES_MOTOR, motor_rows
from fte_sniff.analysis.model import Model
from fte_sniff.protocol import (
    KINDS,
    MOTORS,
    Direction,
    Gap,
    PortEvent,
    PortEventKind,
)
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import NO_FACT, Bools, Codes, Ints, Rows, faults_in
from fte_sniff.protocol.spec import FrameKind, Role, motor_bit

SHIFT: Final = 30
"""A window has 2 to this power of nanoseconds at first, about a second."""

MOST_WINDOWS: Final = 1 << 14

RUNNING: Final = 3
"""Frames in a row with a flag from which on it is not a flipped bit."""

GRADES: Final = 24
"""Grades of a value: half octaves."""

_MOST_WAITING: Final = 8192
"""Rows that wait to be counted together: a few rows at a time would cost more."""

COUNTED_EVENTS: Final = frozenset(
    {
        PortEventKind.LINE_ERROR,
        PortEventKind.OVERRUN,
        PortEventKind.SILENT,
        PortEventKind.SHARED,
    }
)
"""Port events that are counted by window."""

_MOST_ADDED: Final = 128
"""Batches whose windows wait to be merged."""

_Columns: TypeAlias = dict[tuple[Keep, str], Ints]
"""Counts, lowest or highest values by window."""


class Windows(Model):
    """Counts and ranges by window, in named columns; only windows with rows take memory."""

    def __init__(self) -> None:
        self.shift = SHIFT
        self._keys: Ints = np.zeros(0, np.int64)
        self._columns: _Columns = {}
        self._added: list[tuple[Ints, _Columns]] = []
        """Keys and columns of batches that are not merged yet."""

    def __len__(self) -> int:
        self._settle()
        return len(self._keys)

    @property
    def starts_ns(self) -> Ints:
        """The start of each window, rising."""
        self._settle()
        return self._keys << self.shift

    @property
    def width_ns(self) -> int:
        """Nanoseconds of a window."""
        return 1 << self.shift

    def _column(self, keep: Keep, name: str) -> Ints:
        self._settle()
        found = self._columns.get((keep, name))
        return keep.empty(len(self)) if found is None else found

    def count(self, name: str) -> Ints:
        """A column of counts."""
        return self._column(Keep.TOTAL, name)

    def names(self) -> list[str]:
        """The columns of counts."""
        self._settle()
        return [name for keep, name in self._columns if keep is Keep.TOTAL]

    def range_of(self, name: str) -> tuple[Ints, Ints, Bools]:
        """The lowest and the highest value by window, and which windows have one."""
        low, high = self._column(Keep.LOW, name), self._column(Keep.HIGH, name)
        return low, high, high != Keep.HIGH.value

    def add(self, batch: EventBatch) -> None:
        """Add what a batch counted."""
        self._added.append((batch.keys, batch.columns))
        if len(self._added) >= _MOST_ADDED:
            self._settle()

    def _settle(self) -> None:
        """Merge the batches, which is slow one by one: each merge copies all columns."""
        if not self._added:
            return
        added, self._added = self._added, []
        ends = np.cumsum([len(keys) for keys, _ in added]).tolist()
        together: _Columns = {}
        for (keys, columns), end in zip(added, ends, strict=True):
            for (keep, name), column in columns.items():
                if (keep, name) not in together:
                    together[keep, name] = keep.empty(ends[-1])
                together[keep, name][end - len(keys) : end] = column
        self._merge(np.concatenate([keys for keys, _ in added]), together)

    def merge(self, other: Windows) -> None:
        """Add the windows of other rows."""
        self._settle()
        other._settle()
        while self.shift < other.shift:
            self._halve()
        self._merge(other._keys >> (self.shift - other.shift), other._columns)

    def _merge(self, keys: Ints, columns: _Columns) -> None:
        if not len(keys):
            return
        # Windows before all new ones stay as they are: most rows come in the order of time.
        same = int(np.searchsorted(self._keys, keys.min()))
        merged, at = np.unique(np.concatenate((self._keys[same:], keys)), return_inverse=True)
        old, new = at[: len(self._keys) - same], at[len(self._keys) - same :]
        own, self._columns = self._columns, {}
        for keep, name in {**own, **columns}:
            before = own.get((keep, name))
            column = keep.empty(same + len(merged))
            if before is not None:
                column[:same] = before[:same]
                keep.add(column[same:], old, before[same:])
            if (keep, name) in columns:
                keep.add(column[same:], new, columns[keep, name])
            self._columns[keep, name] = column
        self._keys = np.concatenate((self._keys[:same], merged))
        while len(self._keys) > MOST_WINDOWS:
            self._halve()

    def _halve(self) -> None:
        keys, columns = self._keys >> 1, self._columns
        self.shift += 1
        self._keys, self._columns = np.zeros(0, np.int64), {}
        self._merge(keys, columns)

    def since(self, first_ns: int) -> Windows:
        """The windows from a time on."""
        own = self.starts_ns + self.width_ns > first_ns
        found = Windows()
        found.shift, found._keys = self.shift, self._keys[own]
        found._columns = {name: column[own] for name, column in self._columns.items()}
        return found


class EventBatch:
    """Counts of one batch by its windows."""

    def __init__(self, t_ns: Ints, shift: int) -> None:
        self.t_ns = t_ns
        self.keys, self._at = np.unique(t_ns >> shift, return_inverse=True)
        self.columns: _Columns = {}

    def _column(self, keep: Keep, name: str) -> Ints:
        return self.columns.setdefault((keep, name), keep.empty(len(self.keys)))

    def count(self, name: str, rows: Ints) -> None:
        """Count rows, by indices."""
        at, starts = self._runs(rows)
        if len(starts):
            counts = np.diff(starts, append=len(rows))
            Keep.TOTAL.add(self._column(Keep.TOTAL, name), at, counts)

    def count_each(self, name: str, groups: Ints, last: int) -> None:
        """Count all rows by their groups, which are numbers from 1 to `last`; 0 is not counted."""
        width = last + 1
        counts = np.bincount(self._at * width + groups, minlength=len(self.keys) * width)
        for group, column in enumerate(counts.reshape(-1, width).T[1:], 1):
            if column.any():
                self.columns[Keep.TOTAL, f"{name} {group}"] = column

    def range(self, name: str, rows: Ints, values: Ints) -> None:
        """Extend a range by the values of rows, by indices."""
        at, starts = self._runs(rows)
        if len(starts):
            low, high = (one.reduceat(values, starts) for one in (np.minimum, np.maximum))
            Keep.LOW.add(self._column(Keep.LOW, name), at, low)
            Keep.HIGH.add(self._column(Keep.HIGH, name), at, high)

    def events(self, name: str, rows: Ints) -> None:
        """Count rows, by indices, and extend the range of their times."""
        self.count(name, rows)
        self.range(name, rows, self.t_ns[rows])

    def _runs(self, rows: Ints) -> tuple[Ints, Ints]:
        """The windows of runs of rows in one window, and where in `rows` the runs begin."""
        at = self._at[rows]
        is_first = np.ones(len(at), np.bool_)
        np.not_equal(at[1:], at[:-1], out=is_first[1:])
        starts = np.flatnonzero(is_first)
        return at[starts], starts


def grade_of(values: Ints) -> Ints:
    """Half octaves of values from 1 on."""
    grades = (2 * np.log2(np.maximum(values, 1))).astype(np.int64)
    return np.minimum(grades, GRADES - 1)


def least_of(grade: int) -> int:
    """The least whole value of a grade."""
    return int(np.ceil(2 ** (grade / 2)))


DELAY_UNIT_NS: Final = 250_000
"""Answer times are graded in this unit, nanoseconds."""

RATIO_UNIT: Final = 4
"""Grades of the ratio of two periods: quarters of an octave."""


def by_role(role: Role, *, target: bool) -> list[FrameKind]:
    """The kinds that name a motor and have a target, or a present value, of that role."""
    direction = Direction.CONTROL if target else Direction.FEEDBACK
    return [
        kind
        for kind in KINDS
        if kind.direction is direction
        and kind.names_motor
        and kind.subject is not None
        and any(one.role is role and one.name == kind.subject for one in kind.fields)
    ]


_NO_EVENT: Final = -1

_LEAST_JUMP: Final = 64


def _running(_t_ns: Ints, values: Ints) -> Ints:
    """Values in which a bit is set that at least `RUNNING` values in a row have; one grade."""
    grades = np.full(len(values), _NO_EVENT)
    if len(values) >= RUNNING and values.any():
        beside = np.lib.stride_tricks.sliding_window_view(values, RUNNING)
        runs = np.bitwise_and.reduce(beside, axis=1) != 0
        for by in range(RUNNING):
            grades[by : by + len(runs)][runs] = 0
    return grades


def _after_another(_t_ns: Ints, values: Ints) -> Ints:
    """Values other than 0 directly after another such; one grade."""
    grades = np.full(len(values), _NO_EVENT)
    if values.any():
        raised = values != 0
        grades[1:][raised[1:] & raised[:-1]] = 0
    return grades


def _period_changes(t_ns: Ints, _values: Ints) -> Ints:
    """How much the period before each time differs from the one before it."""
    grades = np.full(len(t_ns), _NO_EVENT)
    if len(t_ns) > 2:
        periods = np.maximum(np.diff(t_ns), 1).astype(np.float64)
        ratios = np.abs(np.log2(periods[1:] / periods[:-1]))
        grades[2:] = np.minimum(ratios * RATIO_UNIT, GRADES - 1)
    return grades


def _jumps(_t_ns: Ints, values: Ints) -> Ints:
    """How far each value is from both neighbours, where these are near each other."""
    grades = np.full(len(values), _NO_EVENT)
    if len(values) > 2:
        first, middle, last = values[:-2], values[1:-1], values[2:]
        off = np.minimum(np.abs(middle - first), np.abs(middle - last))
        is_far = (off > _LEAST_JUMP) & (np.abs(last - first) <= off // 4)
        grades[1:-1][is_far] = grade_of(off[is_far])
    return grades


_Grades: TypeAlias = Callable[[Ints, Ints], Ints]
"""Grades of the events of a stream, by its times and values; `_NO_EVENT` where there is none.

An event depends on at most two values before it and two after it, and stays one if values are added
at either end.
"""

_GRADES: Final[dict[str, _Grades]] = {
    "raised": _running,
    "offline": _running,
    "burst": _after_another,
    "ratio": _period_changes,
    "jump": _jumps,
}
"""By the first word of a stream's name."""

_GRADED: Final = frozenset({"ratio", "jump"})
"""Those with a column for each grade."""

_ENDS: Final = 4
"""Values at both ends of a stream by which another part joins: two depend on two more."""

_NO_VALUES: Final[Ints] = np.zeros((2, 0), np.int64)


class _StreamEnds(NamedTuple):
    """The first and the last times and values of a stream; shape (2, up to `_ENDS`)."""

    first: Ints = _NO_VALUES
    last: Ints = _NO_VALUES
    interrupted: bool = False
    """Whether values are missing somewhere."""

    @classmethod
    def of(cls, t_ns: Ints, values: Ints) -> _StreamEnds:
        """All values of a part without a gap."""
        return cls(
            np.array((t_ns[:_ENDS], values[:_ENDS]), np.int64),
            np.array((t_ns[-_ENDS:], values[-_ENDS:]), np.int64),
        )

    def followed_by(self, later: _StreamEnds) -> _StreamEnds:
        """Both, one after the other."""
        first, last = self.first, later.last
        if not self.interrupted:
            first = np.concatenate((first, later.first), axis=1)[:, :_ENDS]
        if not later.interrupted:
            last = np.concatenate((self.last, last), axis=1)[:, -_ENDS:]
        return _StreamEnds(first, last, self.interrupted or later.interrupted)

    def interrupt(self) -> _StreamEnds:
        """The stream with a gap after it."""
        return _StreamEnds(self.first, _NO_VALUES, interrupted=True)


def _events_between(name: str, before: _StreamEnds, after: _StreamEnds) -> tuple[Ints, Ints, Ints]:
    """Times, values and grades of the events that neither of two adjacent parts has alone."""
    grades = _GRADES[name.split(" ", 1)[0]]
    joint = np.concatenate((before.last, after.first), axis=1)
    found = grades(*joint)
    known = np.concatenate((grades(*before.last), grades(*after.first)))
    new = found != known
    return joint[0, new], joint[1, new], found[new]


def _occurring(codes: Ints | Codes) -> list[int]:
    """The codes that occur, which are small."""
    found: list[int] = np.flatnonzero(np.bincount(codes)).tolist()
    return found


def _count_hits(batch: EventBatch, name: str, rows: Ints, values: Ints, grades: Ints) -> None:
    """Count the events of a stream, which are these rows of the batch."""
    kind = name.split(" ", 1)[0]
    if kind in _GRADED:
        for grade in _occurring(grades):
            batch.events(f"{name} {grade}", rows[grades == grade])
        return
    batch.events(name, rows)
    if kind == "raised":
        raised = int(np.bitwise_or.reduce(values)) if len(values) else 0
        for bit in range(raised.bit_length()):
            if raised >> bit & 1:
                batch.count(f"{name} bit {bit}", rows[values >> bit & 1 == 1])


class Events(Model):
    """Counts the events of all causes; rows must have facts."""

    def __init__(self) -> None:
        self._windows = Windows()
        self._ports: dict[str, Windows] = {}
        self._port_events: list[PortEvent] = []
        """Ports that were lost, and found again."""
        self._streams: dict[str, _StreamEnds] = {}
        self._interrupted = False
        """Whether rows are missing somewhere."""
        self._waiting: list[Rows] = []

    @property
    def windows(self) -> Windows:
        """What is about motors."""
        self._count_waiting()
        return self._windows

    @property
    def ports(self) -> dict[str, Windows]:
        """What is about each port."""
        self._count_waiting()
        return self._ports

    @property
    def lost(self) -> list[tuple[str, int, int | None]]:
        """Ports that were lost: from when, and until when."""
        found: list[tuple[str, int, int | None]] = []
        open_at: dict[str, int] = {}
        for event in self._port_events:
            if event.kind is PortEventKind.LOST:
                open_at.setdefault(event.port, len(found))
                found.append((event.port, event.t_ns, None))
            elif event.port in open_at:
                at = open_at.pop(event.port)
                found[at] = (*found[at][:2], event.t_ns)
        return found

    def since(self, first_ns: int) -> Events:
        """The events from a time on."""
        found = Events()
        found._windows = self.windows.since(first_ns)
        found._ports = {port: one.since(first_ns) for port, one in self.ports.items()}
        lost = {port for port, _, end in self.lost if end is None or end >= first_ns}
        found._port_events = [one for one in self._port_events if one.port in lost]
        return found

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._count_waiting()
        self._interrupted = True
        self._streams = {name: one.interrupt() for name, one in self._streams.items()}

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap):
            self.interrupt()

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        for event in events:
            if event.kind in (PortEventKind.LOST, PortEventKind.FOUND_AGAIN):
                self._port_events.append(event)
            elif event.kind in COUNTED_EVENTS:
                windows = self._ports.setdefault(event.port, Windows())
                batch = EventBatch(np.array([event.t_ns]), windows.shift)
                batch.events(event.kind, np.array([0]))
                windows.add(batch)

    def merge(self, later: Events) -> None:
        """Add the rows that follow."""
        self._count_waiting()
        later._count_waiting()
        self._windows.merge(later._windows)
        for port, windows in later._ports.items():
            self._ports.setdefault(port, Windows()).merge(windows)
        self._port_events += later._port_events
        names = dict.fromkeys((*self._streams, *later._streams))
        missing = _StreamEnds(interrupted=later._interrupted)
        self._join({name: later._streams.get(name, missing) for name in names})
        self._interrupted |= later._interrupted

    def _join(self, streams: dict[str, _StreamEnds]) -> None:
        """Add the values of streams that follow."""
        for name, later in streams.items():
            before = self._streams.get(name, _StreamEnds(interrupted=self._interrupted))
            self._streams[name] = before.followed_by(later)
            t_ns, values, grades = _events_between(name, before, later)
            if len(t_ns):
                kind, port = name.split(" ", 1)
                windows = self._ports[port] if kind == "burst" else self._windows
                batch = EventBatch(t_ns, windows.shift)
                _count_hits(batch, name, np.arange(len(t_ns)), values, grades)
                windows.add(batch)

    def observe(self, rows: Rows) -> None:
        """Add the next rows, which have facts."""
        if len(rows):
            self._waiting.append(rows)
        if sum(map(len, self._waiting)) >= _MOST_WAITING:
            self._count_waiting()

    def _count_waiting(self) -> None:
        if self._waiting:
            rows = Rows.concat(self._waiting) if len(self._waiting) > 1 else self._waiting[0]
            self._waiting = []
            timed = rows.timed
            self._count(rows if timed.all() else rows.select(timed))

    def _count(self, rows: Rows) -> None:
        if not len(rows):
            return
        streams = dict[str, _StreamEnds]()
        for code in np.unique(rows.port).tolist():
            port = rows.ports[code]
            streams |= self._count_damage(port, rows, np.flatnonzero(rows.port == code))
        batch = EventBatch(rows.t_ns, self._windows.shift)
        for name, own, values in _counted_motors(batch, rows):
            streams[name] = _followed(batch, name, own, values)
        self._windows.add(batch)
        self._join(streams)

    def _count_damage(self, port: str, rows: Rows, own: Ints) -> dict[str, _StreamEnds]:
        windows = self._ports.setdefault(port, Windows())
        batch = EventBatch(rows.t_ns[own], windows.shift)
        is_damaged = rows.is_malformed[own]
        damaged, directions = np.flatnonzero(is_damaged), rows.directions[own]
        batch.count("rows", np.arange(len(own)))
        batch.count("frames", np.flatnonzero(rows.framed[own]))
        batch.count("commands", np.flatnonzero(directions == _CODES[Direction.CONTROL]))
        batch.count("feedback", np.flatnonzero(directions == _CODES[Direction.FEEDBACK]))
        named = np.where(NAMES_MOTOR[rows.kinds[own]], rows.nums[own], 0)
        motors = np.where(is_damaged, rows.motor_hint[own], named)
        motors = np.where((motors >= MOTORS[0]) & (motors <= MOTORS[-1]), motors, 0)
        batch.count_each("rows", motors, MOTORS[-1])
        if len(damaged):
            at = own[damaged]
            batch.events("damaged", damaged)
            for direction, code in _CODES.items():
                batch.count(f"damaged {direction}", damaged[directions[damaged] == code])
            for motor in MOTORS:
                batch.events(f"damaged {motor}", damaged[motors[damaged] == motor])
            for code in np.unique(rows.faults[at]).tolist():
                batch.count(f"fault {faults_in(code)[0]}", damaged[rows.faults[at] == code])
        name = f"burst {port}"
        stream = _followed(batch, name, np.arange(len(own)), is_damaged.astype(np.int64))
        windows.add(batch)
        return {name: stream}


def _followed(batch: EventBatch, name: str, own: Ints, values: Ints) -> _StreamEnds:
    """Count the events of the rows of a stream; returns their part of the stream."""
    t_ns = batch.t_ns[own]
    grades = _GRADES[name.split(" ", 1)[0]](t_ns, values)
    hits = np.flatnonzero(grades != _NO_EVENT)
    if len(hits):
        _count_hits(batch, name, own[hits], values[hits], grades[hits])
    return _StreamEnds.of(t_ns, values)


_ALL_ONLINE: Final = sum(1 << motor_bit(motor) for motor in MOTORS)


def _counted_motors(batch: EventBatch, rows: Rows) -> Iterator[tuple[str, Ints, Ints]]:
    """Count what is about motors; yields the streams, with their rows and values."""
    found = motor_rows(rows)
    asked = rows.unanswered != NO_FACT
    online = rows.values(Role.ONLINE, found.any_feedback)
    batch.count("feedback", found.any_feedback)
    batch.count("any offline", found.any_feedback[online & _ALL_ONLINE != _ALL_ONLINE])
    for motor in MOTORS:
        commands, feedback = found.commands[motor], found.feedback[motor]
        own, bit = commands[asked[commands]], motor_bit(motor)
        batch.count(f"asked {motor}", own)
        batch.events(f"missed {motor}", own[rows.unanswered[own] >> bit & 1 == 1])
        batch.events(f"commands {motor}", commands[np.isin(rows.cmds[commands], ANSWERABLE)])
        batch.events(f"feedback {motor}", feedback)
        batch.count(f"free {motor}", commands[~NAMES_MOTOR[rows.kinds[commands]]])
        _count_delays(batch, rows, commands, motor)
        if len(feedback):
            errors = rows.values(Role.ERRORS, feedback)
            batch.count("any raised", feedback[errors != 0])
            yield f"raised {motor}", feedback, errors
        if len(found.any_feedback):
            yield f"offline {motor}", found.any_feedback, ~online >> bit & 1
        for code in _occurring(rows.kinds[commands]):
            if NAMES_MOTOR[code] or motor == MOTORS[0]:
                own = commands[rows.kinds[commands] == code]
                yield f"ratio {motor} {KINDS[code].name}", own, rows.t_ns[own]
        for role in (Role.SPEED, Role.POSITION):
            for kind in by_role(role, target=True):
                own = commands[rows.kinds[commands] == KINDS.index(kind)]
                batch.range(f"target {role} {motor}", own, rows.values(role, own))
            for kind in by_role(role, target=False):
                own = feedback[rows.kinds[feedback] == KINDS.index(kind)]
                values = rows.values(role, own)
                batch.count(f"present {role} {motor}", own)
                batch.range(f"present {role} {motor}", own, values)
                if len(own):
                    yield f"jump {role} {motor}", own, values


def _count_delays(batch: EventBatch, rows: Rows, commands: Ints, motor: int) -> None:
    known = commands[rows.answer_ns[commands] != NO_FACT]
    known = known[NAMES_MOTOR[rows.kinds[known]]]
    for code in _occurring(rows.kinds[known]):
        own = known[rows.kinds[known] == code]
        grades = grade_of(rows.answer_ns[own] // DELAY_UNIT_NS)
        for grade in _occurring(grades):
            batch.events(f"delay {motor} {KINDS[code].name} {grade}", own[grades == grade])


_CODES: Final = {direction: code for code, direction in enumerate(Direction)}
