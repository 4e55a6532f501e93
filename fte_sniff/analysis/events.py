"""Events of trouble, counted by window of time: what `findings` searches for spans.

A window has a power of two of nanoseconds, about a second; in long recordings it is longer
(`segments.added`). A column has numbers for each window:

    count   `missed 3`     commands of motor 3 without an answer
    range   `target speed 3`, and of the times of events: the lowest and the highest value

`counted` counts a table in the shortest windows; the counts of several tables add up. What is late,
silent or off target is known only then: `Events` derives these columns from the sum.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from string import Formatter
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.durations import COARSE, bins_of, middles
from fte_sniff.analysis.relations import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    LATE,
    NAMES_MOTOR,
    AnswerState,
    feedback_with,
    is_off_target,
    motor_hints,
    values_at,
)
from fte_sniff.analysis.segments import Analysis, Counts, extent_of, width_of
from fte_sniff.analysis.spans import surprise
from fte_sniff.analysis.table import Table
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.rows import MOST_BYTES, Bools, Ints, Rows, fault_bits
from fte_sniff.protocol.spec import (
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    Direction,
    Fault,
    Role,
    motor_bit,
)

SHIFT: Final = 30
"""The shortest window has 2 to this power of nanoseconds, about a second."""

LEAST_SCORE: Final = 10.0
"""Minus the logarithm of the probability of a difference by chance, from which on it is none."""

RUNNING: Final = 3
"""Frames in a row with a flag from which on it is not a flipped bit."""

IRREGULAR: Final = 0.5
"""Octaves by which a period differs from the one before it, from which on it is irregular."""

LATE_SHARE: Final = 0.05
"""Share of a motor's answers that are late, from which on it is late."""

LATE_RATIO: Final = 3.0
"""How much larger this share is at least than before, or than that of each other motor."""

EXPECTED: Final = 6
"""Feedback of a motor in a window from which on its absence is silence."""

SETTLES: Final = 3
"""Windows before one whose targets a motor may still move to."""

VALUES: Final = (Role.SPEED, Role.POSITION)
"""The roles of values that have targets."""

_LEAST_JUMP: Final = 64
_OF_PORT: Final = (
    *(PortEventKind.LINE_ERROR, PortEventKind.OVERRUN, PortEventKind.SILENT),
    *(PortEventKind.SHARED, PortEventKind.LOST, PortEventKind.FOUND_AGAIN),
)
"""Port events that are counted."""


_KEYS: Final = {
    "motor": MOTORS,
    "kind": [kind.name for kind in KINDS],
    "role": [*map(TranslatableText, VALUES)],
    "bit": range(8),
    "fault": Fault,
    "direction": Direction,
    "event": _OF_PORT,
}


_FORMS: Final = (
    *("rows", "frames", "damaged", "rows {motor}", "damaged {motor}", "fault {fault}", "{event}"),
    *("{direction}", "damaged {direction}", "feedback", "online", "free"),
    *("commands {motor}", "asked {motor}", "missed {motor}", "feedback {motor}"),
    *("lacking {motor}", "offline {motor}", "errors {motor}", "flagged {motor}"),
    *("raised {motor}", "raised {motor} bit {bit}", "active {motor}", "silent {motor}"),
    *("period {kind}", "irregular {kind}", "period {motor} {kind}", "irregular {motor} {kind}"),
    *("timed {motor} {kind}", "late {motor} {kind}", "target {role} {motor}"),
    *("present {role} {motor}", "jump {role} {motor}", "held {role} {motor}", "off {role} {motor}"),
)
"""The names of all columns."""


def named(form: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The columns of a form such as `missed {motor}`, and what they are about."""
    keys = [key for _, key, *_ in Formatter().parse(form) if key]
    for values in product(*(_KEYS[key] for key in keys)):
        names = dict(zip(keys, values, strict=True))
        yield form.format(**names), names


_NAMES: Final = frozenset(name for form in _FORMS for name, _ in named(form))


# Events that depend on the frames beside them; none of them spans a gap


def running(flags: Ints, runs: Ints) -> Bools:
    """Values in which a bit is set that at least `RUNNING` values in a row have."""
    found = np.zeros(len(flags), np.bool_)
    if len(flags) >= RUNNING:
        beside = np.lib.stride_tricks.sliding_window_view(flags, RUNNING)
        one_run = runs[RUNNING - 1 :] == runs[: 1 - RUNNING]
        is_long = (np.bitwise_and.reduce(beside, axis=1) != 0) & one_run
        for by in range(RUNNING):
            found[by : by + len(is_long)] |= is_long
    return found


def jumps(values: Ints, runs: Ints) -> Bools:
    """Values far from both neighbours, where these are near each other."""
    first, middle, last = values[:-2], values[1:-1], values[2:]
    off = np.minimum(np.abs(middle - first), np.abs(middle - last))
    is_far = (off > _LEAST_JUMP) & (np.abs(last - first) <= off // 4) & (runs[2:] == runs[:-2])
    return np.concatenate(([False], is_far, [False]))[: len(values)]


def irregular(t_ns: Ints, runs: Ints) -> Bools:
    """Whether the period before each time differs from the one before it."""
    periods = np.maximum(np.diff(t_ns), 1).astype(np.float64)
    changes = np.abs(np.log2(periods[1:] / periods[:-1])) >= IRREGULAR
    changes &= runs[2:] == runs[:-2]
    return np.concatenate(([False, False], changes))[: len(t_ns)]


def is_more(
    own: tuple[int, int],
    other: tuple[int, int],
    least: float = LATE_SHARE,
    ratio: float = LATE_RATIO,
) -> bool:
    """Whether a share of events, late answers by default, is larger than another, and than chance.

    Args:
        own: events, and rows.
        other: those of an earlier time, or of another motor.
        least: the share from which on it is more.
        ratio: how much larger than the other one it is at least.
    """
    (events, rows), (others, all_) = own, other
    is_large = events > max(least, ratio * others / max(1, all_)) * rows
    return is_large and surprise(other, own) >= LEAST_SCORE


# Counting


class _Counter:
    """The columns of a table: for each port and name, its windows with events."""

    def __init__(self, t_ns: Ints, own: Bools) -> None:
        self.t_ns, self._own = t_ns, own
        self._windows = t_ns >> SHIFT << SHIFT
        none = np.zeros(0, np.int64)
        self._found = [("", "", none, none, none, none)]

    def add(self, name: object, at: Ints, values: Ints | None = None, port: str = "") -> None:
        """Count rows by index; `values` of them, by default their times, make the range."""
        own = self._own[at]
        at, values = at[own], (self.t_ns[at] if values is None else values)[own]
        windows = self._windows[at]
        if (windows[1:] < windows[:-1]).any():
            order = np.argsort(windows, kind="stable")
            windows, values = windows[order], values[order]
        starts = np.flatnonzero(np.append(True, windows[1:] != windows[:-1])[: len(windows)])
        if len(starts):
            counts = np.diff(starts, append=len(windows))
            low, high = (one.reduceat(values, starts) for one in (np.minimum, np.maximum))
            self._found.append((port, str(name), windows[starts], counts, low, high))

    def frame(self) -> pl.DataFrame:
        """All columns, one below the other."""
        ports, names, *numbers = zip(*self._found, strict=True)
        at = np.repeat(np.arange(len(names)), [len(one) for one in numbers[0]])
        texts = {"port": pl.Series(ports).gather(at), "name": pl.Series(names).gather(at)}
        keys = ("window", "sum count", "least low", "greatest high")
        values = (np.concatenate(own).astype(np.int64) for own in numbers)
        return pl.DataFrame({**texts, **dict(zip(keys, values, strict=True))})


def counted(table: Table) -> Counts:
    """The counts of a table: `windows`, `delays`, and those of `extent_of`."""
    timed = np.flatnonzero(table.rows.timed)
    rows, runs = table.rows.select(timed), table.runs["number"][timed]
    hints = motor_hints(table.rows, table.runs)[timed]
    is_own = (timed >= table.start) & (timed < table.stop)
    counter = _Counter(rows.t_ns, is_own)
    for code in np.unique(rows.port[is_own]).tolist():
        _count_port(counter, rows, hints, code)
    delays = _count_answers(counter, table, np.cumsum(table.rows.timed) - 1)
    _count_motors(counter, rows, runs)
    own = [one for one in table.events if one.kind in _OF_PORT]
    of_ports = _Counter(np.array([one.t_ns for one in own], np.int64), np.ones(len(own), np.bool_))
    for at, one in enumerate(own):
        of_ports.add(one.kind, np.array([at]), port=one.port)
    windows = pl.concat([counter.frame(), of_ports.frame()])
    return {"windows": windows, "delays": delays, "noise": _noise(table), **extent_of(table)}


def _noise(table: Table) -> pl.DataFrame:
    """The bytes outside of frames, by port: their number, range and times."""
    rows, ports = table.rows, pl.Series(table.rows.ports, dtype=pl.String)
    own = rows.select(table.counted[~rows.framed[table.counted] & rows.timed[table.counted]])
    raw = np.where(np.arange(MOST_BYTES) < own.length[:, None], own.raw, own.raw[:, :1])
    columns = {"port": ports.gather(own.port), "size": own.length, "t_ns": own.t_ns}
    frame = pl.DataFrame({**columns, "low": raw.min(axis=1), "high": raw.max(axis=1)})
    return frame.group_by("port").agg(
        pl.len().cast(pl.Int64).alias("sum rows"),
        pl.col("size").cast(pl.Int64).sum().alias("sum bytes"),
        pl.col("low").min().alias("least byte"),
        pl.col("high").max().alias("greatest byte"),
        pl.col("t_ns").min().alias("least t"),
        pl.col("t_ns").max().alias("greatest t"),
    )


ANALYSIS: Final = Analysis(counted)


def _count_port(counter: _Counter, rows: Rows, hints: Ints, code: int) -> None:
    """Count the rows and the damage of a port."""
    own, port = np.flatnonzero(rows.port == code), rows.ports[code]
    kinds, directions, faults = rows.kinds[own], rows.directions[own], rows.faults[own]
    is_damaged = rows.is_malformed[own]
    motors = np.where(is_damaged, hints[own], np.where(NAMES_MOTOR[kinds], rows.nums[own], 0))
    counter.add("rows", own, port=port)
    counter.add("frames", own[rows.framed[own]], port=port)
    counter.add("damaged", own[is_damaged], port=port)
    for motor in MOTORS:
        counter.add(f"rows {motor}", own[motors == motor], port=port)
        counter.add(f"damaged {motor}", own[is_damaged & (motors == motor)], port=port)
    for number, direction in enumerate(Direction):
        counter.add(direction, own[directions == number], port=port)
        counter.add(f"damaged {direction}", own[is_damaged & (directions == number)], port=port)
    for fault in Fault:
        counter.add(f"fault {fault}", own[faults & fault_bits([fault]) != 0], port=port)


def _count_answers(counter: _Counter, table: Table, index: Ints) -> pl.DataFrame:
    """Count commands and answers; `index` is that among the rows with times. Returns delays."""
    found = table.answers.filter(pl.col("cmd").is_in(ANSWERABLE)).drop_nulls("t_ns")
    at, of = index[found["command"].to_numpy()], found["motor"].to_numpy()
    states = found["state"].to_numpy()
    for motor in MOTORS:
        counter.add(f"commands {motor}", at[of == motor])
        counter.add(f"asked {motor}", at[(of == motor) & (states <= AnswerState.UNANSWERED)])
        counter.add(f"missed {motor}", at[(of == motor) & (states == AnswerState.UNANSWERED)])
    timed = found.drop_nulls("delay_ns")
    bins = pl.Series(bins_of(timed["delay_ns"].to_numpy(), COARSE), dtype=pl.Int64)
    window = pl.col("t_ns") // (1 << SHIFT) * (1 << SHIFT)
    return timed.group_by("motor", "kind", window=window, bin=bins).agg(
        pl.len().cast(pl.Int64).alias("sum count"),
        pl.col("t_ns").min().alias("least low"),
        pl.col("t_ns").max().alias("greatest high"),
    )


def _count_motors(counter: _Counter, rows: Rows, runs: Ints) -> None:
    kinds, nums, feedback = rows.kinds, rows.nums, np.flatnonzero(FEEDBACK[rows.kinds])
    having, online = feedback_with(rows, Role.ONLINE)
    with_errors, errors = feedback_with(rows, Role.ERRORS)
    counter.add("feedback", feedback)
    counter.add("online", having)
    for code, kind in enumerate(KINDS):
        own = np.flatnonzero(kinds == code)
        for motor in (MOTORS if kind.names_motor else ("",)) if COMMANDS[code] else ():
            at, of = own[nums[own] == motor] if motor else own, f"{motor} {kind.name}".strip()
            counter.add(f"period {of}", at)
            counter.add(f"irregular {of}", at[irregular(rows.t_ns[at], runs[at])])
    for motor in MOTORS:
        is_own, off = nums[with_errors] == motor, ~online >> motor_bit(motor) & 1
        at, flags = with_errors[is_own], errors[is_own]
        raised = running(flags, runs[at])
        counter.add(f"feedback {motor}", feedback[nums[feedback] == motor])
        counter.add(f"lacking {motor}", having[off == 1])
        counter.add(f"offline {motor}", having[running(off, runs[having])])
        counter.add(f"errors {motor}", at)
        counter.add(f"flagged {motor}", at[flags != 0])
        counter.add(f"raised {motor}", at[raised])
        for bit in range(8):
            counter.add(f"raised {motor} bit {bit}", at[raised & (flags >> bit & 1 == 1)])
    _count_values(counter, rows, runs)


def _count_values(counter: _Counter, rows: Rows, runs: Ints) -> None:
    """Count targets and present values, and the commands to all motors."""
    kinds, nums = rows.kinds, rows.nums
    counter.add("free", np.flatnonzero(COMMANDS[kinds] & ~NAMES_MOTOR[kinds]))
    for motor, role, (code, kind) in product(MOTORS, VALUES, enumerate(KINDS)):
        if kind.names_motor and kind.subject == NAME_OF_ROLE[role]:
            at = np.flatnonzero((nums == motor) & (kinds == code))
            values, is_target = values_at(rows, NAME_OF_ROLE[role], at), COMMANDS[code]
            counter.add(f"{'target' if is_target else 'present'} {role} {motor}", at, values)
            if not is_target:
                counter.add(f"jump {role} {motor}", at[jumps(values, runs[at])])


def off_target(rows: Rows, runs: Ints) -> set[int]:
    """The motors that are off a target in the last window that is over."""
    timed = np.flatnonzero(rows.timed)
    counter = _Counter(rows.t_ns[timed], np.ones(len(timed), np.bool_))
    _count_values(counter, rows.select(timed), runs[timed])
    windows = Windows(counter.frame(), 1 << SHIFT)
    for motor, role in product(MOTORS, VALUES):
        _derive_off_target(windows, motor, role)
    return {
        names["motor"]
        for name, names in named("off {role} {motor}")
        if windows[name].events[-2:-1].any()
    }


def since(counts: Counts, t_ns: int) -> dict[str, pl.DataFrame]:
    """The counts of the windows from a time on."""
    recent = pl.col("window") >= t_ns >> SHIFT << SHIFT
    return {**counts, **{name: counts[name].filter(recent) for name in ("windows", "delays")}}


# Reading


class EventCounts(NamedTuple):
    """A column: the number of events by window, and the range of their times or values."""

    events: Ints
    low: Ints
    high: Ints


_NO_EVENTS: Final = (0, 2**63 - 1, -(2**63))
"""The number and the range of a window without an event."""


class Windows(dict[str, EventCounts]):
    """The columns of a port, or of all motors, as arrays over the windows in which rows are."""

    def __init__(self, columns: pl.DataFrame, width_ns: int, starts_ns: Ints | None = None) -> None:
        """The columns of a frame; by default the windows are those of the frame."""
        own_ns = columns["window"].unique().sort().to_numpy()
        self.starts_ns = own_ns if starts_ns is None else starts_ns
        """The start of each window, rising."""
        self.width_ns = width_ns
        for (name,), own in columns.partition_by("name", as_dict=True).items():
            at = np.searchsorted(self.starts_ns[1:], own["window"].to_numpy(), "right")
            self[name] = found = self[name]
            np.add.at(found.events, at, own["sum count"].to_numpy())
            np.minimum.at(found.low, at, own["least low"].to_numpy())
            np.maximum.at(found.high, at, own["greatest high"].to_numpy())

    def __missing__(self, name: str) -> EventCounts:
        """A column without events; raises KeyError if there is not one of this name."""
        if name not in _NAMES:
            raise KeyError(name)
        return EventCounts(*(np.full(len(self.starts_ns), one) for one in _NO_EVENTS))

    def total(self, name: str) -> int:
        """The number of events of a column."""
        return int(self[name].events.sum())


class Events:
    """The events of all causes in what was counted."""

    def __init__(self, counts: Counts) -> None:
        columns, self.hidden_by = counts["windows"], counts["hidden"]["hidden_by"].to_list()
        self.extent: dict[str, Any] = counts["extent"].row(0, named=True)
        self.noise = counts["noise"].to_dicts()
        starts = columns["window"].unique().sort().to_numpy()
        width_ns = 1 << max(SHIFT, width_of(starts))
        self.usual, late = _late(counts["delays"])
        """By motor and kind of command, the median answer time, nanoseconds."""
        by_port = columns.partition_by("port", as_dict=True, include_key=False)
        own = by_port.pop(("",), columns.drop("port").clear())
        self.windows = Windows(pl.concat([own, late]), width_ns, starts)
        """What is about motors."""
        self.ports = {port: Windows(of, width_ns, starts) for (port,), of in by_port.items()}
        """What is about each port."""
        for motor in MOTORS:
            _derive_silences(self.windows, motor)
            for role in VALUES:
                _derive_off_target(self.windows, motor, role)


def _late(delays: pl.DataFrame) -> tuple[dict[tuple[int, str], float], pl.DataFrame]:
    """The usual delays, and the columns of the answers that are late or not."""
    usual, found = dict[tuple[int, str], float](), list[pl.DataFrame]()
    names = ["name", "window", "sum count", "least low", "greatest high"]
    for (motor, kind), own in delays.partition_by("motor", "kind", as_dict=True).items():
        counts = own.group_by("bin").agg(pl.col("sum count").sum()).sort("bin")
        total = counts["sum count"].cum_sum()
        median = counts["bin"].to_numpy()[total.search_sorted(total[-1] / 2)]
        usual[int(motor), KINDS[kind].name] = float(middles(np.array([median]), COARSE)[0])
        # A bin further by an octave has twice the durations.
        octaves = (1 << COARSE) * int(np.log2(LATE))
        which = {"timed": own, "late": own.filter(pl.col("bin") >= median + octaves)}
        for word, some in which.items():
            name = pl.lit(f"{word} {motor} {KINDS[kind].name}").alias("name")
            found.append(some.with_columns(name).select(names))
    schema = {"name": pl.String, **dict.fromkeys(names[1:], pl.Int64)}
    return usual, pl.concat([pl.DataFrame(schema=schema), *found])


def _derive_silences(windows: Windows, motor: int) -> None:
    """Add `silent`: windows without feedback of a motor, and `active`: with commands to it."""
    commands, feedback = windows[f"commands {motor}"], windows[f"feedback {motor}"]
    active, answers = commands.events > 0, feedback.events > 0
    if not (active & answers).any():
        return
    usual = max(1, int(np.median(feedback.events[active & answers])))
    width = max(1, -(-EXPECTED // usual))
    recent = np.convolve(feedback.events, np.ones(width), "full")[: len(answers)]
    # It begins with the last feedback, unless the host paused meanwhile; and ends with the next.
    starts, near = windows.starts_ns, (width + 1) * windows.width_ns
    before = np.maximum.accumulate(feedback.high)
    after = np.minimum.accumulate(feedback.low[::-1])[::-1]
    windows[f"active {motor}"] = commands._replace(events=active.astype(np.int64))
    windows[f"silent {motor}"] = EventCounts(
        (active & (recent < 0.5)).astype(np.int64),
        np.where(before > starts - near, before, commands.low),
        np.where(after < starts + windows.width_ns + near, after, commands.high),
    )


def _derive_off_target(windows: Windows, motor: int, role: Role) -> None:
    """Add `off`: windows with present values that are all outside of the recent targets.

    `held` are those in which a motor has targets that it may follow.
    """
    target, present = (windows[f"{word} {role} {motor}"] for word in ("target", "present"))
    asked = target.events > 0
    held = asked & (present.events > 0) & (_recent(windows["free"].events) <= 0)
    lows = -_recent(np.where(asked, -target.low, -(2**62)))
    highs = _recent(np.where(asked, target.high, -(2**62)))
    off = held.copy()
    off[held] = is_off_target(
        (present.low[held], present.high[held]), (lows[held], highs[held]), role
    )
    feedback = windows[f"feedback {motor}"]
    windows[f"held {role} {motor}"] = feedback._replace(events=held.astype(np.int64))
    windows[f"off {role} {motor}"] = feedback._replace(events=off.astype(np.int64))


def _recent(values: Ints) -> Ints:
    """The highest value of each window and of `SETTLES` before it."""
    padded = np.concatenate((np.full(SETTLES, -(2**62)), values))
    found: Ints = np.max([padded[by:][: len(values)] for by in range(SETTLES + 1)], axis=0)
    return found
