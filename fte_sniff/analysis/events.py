"""Events of trouble, counted by window of time: what `findings` searches for spans.

A window has a power of two of nanoseconds, about a second; in long recordings it is longer
(`segments.added`). A column has a number for each window:

    count   `missed 3`     commands of motor 3 without an answer
    range   `target speed 3`, and of the times of events: the lowest and the highest value

`counted` counts a table in the shortest windows; the counts of several tables add up. What is late
is known only then, so the delays of answers are kept by bin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.durations import COARSE, bins_of, chosen, middles
from fte_sniff.analysis.relations import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    LATE,
    NAMES_MOTOR,
    AnswerState,
    values_at,
)
from fte_sniff.analysis.segments import Analysis, Counts, extent_of, summed, width_of
from fte_sniff.analysis.spans import surprise
from fte_sniff.analysis.table import Table
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Bools, Ints, Rows, fault_bits
from fte_sniff.protocol.spec import (
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    Direction,
    Fault,
    FrameKind,
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

_LEAST_JUMP: Final = 64
NO_TIMES: Final[Ints] = np.zeros(0, np.int64)
_FLAGS: Final = (Role.ERRORS, Role.ONLINE)
_ALL_ONLINE: Final = sum(1 << motor_bit(motor) for motor in MOTORS)
OF_PORT: Final = (
    PortEventKind.LINE_ERROR,
    PortEventKind.OVERRUN,
    PortEventKind.SILENT,
    PortEventKind.SHARED,
)
"""Port events that are counted by window."""

COLUMN_OF: Final = {Direction.CONTROL: "commands", Direction.FEEDBACK: "feedback"}
"""The column of a port with the frames of a direction."""


def by_role(role: Role, *, target: bool) -> list[FrameKind]:
    """The kinds that name a motor and have a target, or a present value, of that role."""
    direction = Direction.CONTROL if target else Direction.FEEDBACK
    return [
        kind
        for kind in KINDS
        if kind.direction is direction
        and kind.names_motor
        and any(one.role is role and one.name == kind.subject for one in kind.fields)
    ]


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


def is_late(own: tuple[int, int], others: Sequence[tuple[int, int]]) -> bool:
    """Whether the late ones among the answers of a motor are more than usual, and than chance.

    Args:
        own: late answers, and answers.
        others: those of earlier times, or of other motors; any of them that has less decides.
    """
    late, answers = own
    return any(
        late > max(LATE_SHARE, LATE_RATIO * events / max(1, rows)) * answers
        and surprise((events, rows), own) >= LEAST_SCORE
        for events, rows in others
    )


# Counting


class _Counter:
    """The columns of a table: for each port and name, its windows with events."""

    def __init__(self, t_ns: Ints, own: Bools) -> None:
        self.t_ns, self._own = t_ns, own
        self._windows, self._at = np.unique(t_ns >> SHIFT, return_inverse=True)
        self._found = [("", "", *[NO_TIMES] * 4)]

    def add(self, name: str, at: Ints, values: Ints | None = None, port: str = "") -> None:
        """Count rows by index; `values` of them, by default their times, make the range."""
        own = self._own[at]
        at, values = at[own], (self.t_ns[at] if values is None else values)[own]
        if not len(at):
            return
        windows = self._at[at]
        if (windows[1:] < windows[:-1]).any():
            order = np.argsort(windows, kind="stable")
            windows, values = windows[order], values[order]
        starts = np.flatnonzero(np.append(True, windows[1:] != windows[:-1]))
        counts = np.diff(starts, append=len(windows))
        low, high = (one.reduceat(values, starts) for one in (np.minimum, np.maximum))
        self._found.append((port, name, self._windows[windows[starts]], counts, low, high))

    def add_event(self, one: PortEvent) -> None:
        """Count what happened to a port."""
        t_ns = np.array([one.t_ns])
        count = np.ones_like(t_ns)
        self._found.append((one.port, str(one.kind), t_ns >> SHIFT, count, t_ns, t_ns))

    def frame(self) -> pl.DataFrame:
        """All columns, one below the other."""
        ports, names, *numbers = zip(*self._found, strict=True)
        at = np.repeat(np.arange(len(names)), [len(one) for one in numbers[0]])
        texts = {"port": pl.Series(ports).gather(at), "name": pl.Series(names).gather(at)}
        keys = ("window", "sum count", "least low", "greatest high")
        values = (np.concatenate(own).astype(np.int64) for own in numbers)
        return pl.DataFrame({**texts, **dict(zip(keys, values, strict=True))})


def counted(table: Table) -> Counts:
    """The counts of a table: `windows`, `delays`, `lost`, and those of `extent_of`."""
    timed = np.flatnonzero(table.rows.timed)
    rows, runs = table.with_facts.select(timed), table.runs.number[timed]
    is_own = (timed >= table.start) & (timed < table.stop)
    counter = _Counter(rows.t_ns, is_own)
    for code in np.unique(rows.port[is_own]).tolist():
        _count_port(counter, rows, runs, np.flatnonzero(rows.port == code), rows.ports[code])
    delays = _count_answers(counter, table, np.cumsum(table.rows.timed) - 1)
    _count_motors(counter, rows, runs)
    for one in table.events:
        if one.kind in OF_PORT:
            counter.add_event(one)
    lost = [
        (one.port, one.t_ns, str(one.kind))
        for one in table.events
        if one.kind in (PortEventKind.LOST, PortEventKind.FOUND_AGAIN)
    ]
    schema = {"port": pl.String, "t_ns": pl.Int64, "kind": pl.String}
    return {
        "windows": counter.frame(),
        "delays": delays,
        "lost": pl.DataFrame(lost, schema, orient="row").unique(maintain_order=True),
        **extent_of(table),
    }


ANALYSIS: Final = Analysis(counted, summed)


def _count_port(counter: _Counter, rows: Rows, runs: Ints, own: Ints, port: str) -> None:
    """Count the rows and the damage of a port."""
    kinds, directions, hints = rows.kinds[own], rows.directions[own], rows.motor_hint[own]
    is_damaged, faults = rows.is_malformed[own], rows.faults[own]
    motors = np.where(is_damaged, hints, np.where(NAMES_MOTOR[kinds], rows.nums[own], 0))
    after = is_damaged[1:] & is_damaged[:-1] & (runs[own][1:] == runs[own][:-1])
    found = {
        "rows": directions == directions,
        "damaged": is_damaged,
        "burst": np.append(False, after)[: len(own)],
    }
    for motor in MOTORS:
        found[f"rows {motor}"] = motors == motor
        found[f"damaged {motor}"] = is_damaged & (motors == motor)
    for code, direction in enumerate(Direction):
        found[COLUMN_OF[direction]] = directions == code
        found[f"damaged {direction}"] = is_damaged & (directions == code)
    for fault in Fault:
        found[f"fault {fault}"] = faults & fault_bits([fault]) != 0
    for name, which in found.items():
        counter.add(name, own[which], port=port)


def _count_answers(counter: _Counter, table: Table, index: Ints) -> pl.DataFrame:
    """Count commands and answers; `index` is that among the rows with times. Returns delays."""
    found = table.answers.filter(pl.col("cmd").is_in(ANSWERABLE)).drop_nulls("t_ns")
    found = found.with_columns(at=pl.Series(index[found["command"].to_numpy()]))
    for motor in MOTORS:
        own = found.filter(pl.col("motor") == motor)
        at, states = own["at"].to_numpy(), own["state"].to_numpy()
        counter.add(f"commands {motor}", at)
        counter.add(f"asked {motor}", at[states <= AnswerState.UNANSWERED])
        counter.add(f"missed {motor}", at[states == AnswerState.UNANSWERED])
    timed = found.drop_nulls("delay_ns")
    bins = pl.Series(bins_of(timed["delay_ns"].to_numpy(), COARSE), dtype=pl.Int64)
    return timed.group_by("motor", "kind", window=pl.col("t_ns") // (1 << SHIFT), bin=bins).agg(
        pl.len().cast(pl.Int64).alias("sum count"),
        pl.col("t_ns").min().alias("least low"),
        pl.col("t_ns").max().alias("greatest high"),
    )


def _count_motors(counter: _Counter, rows: Rows, runs: Ints) -> None:
    kinds, nums, anyone = rows.kinds, rows.nums, np.flatnonzero(FEEDBACK[rows.kinds])
    of_feedback = {role: values_at(rows, NAME_OF_ROLE[role], anyone) for role in _FLAGS}
    online, every = of_feedback[Role.ONLINE], of_feedback[Role.ERRORS]
    counter.add("feedback", anyone)
    counter.add("any offline", anyone[online & _ALL_ONLINE != _ALL_ONLINE])
    to_all = COMMANDS[kinds] & ~NAMES_MOTOR[kinds]
    for motor in MOTORS:
        mine = nums == motor
        feedback, errors = anyone[mine[anyone]], every[mine[anyone]]
        off = ~online >> motor_bit(motor) & 1
        counter.add(f"flagged {motor}", feedback[errors != 0])
        counter.add(f"lacking {motor}", anyone[off == 1])
        raised = running(errors, runs[feedback])
        counter.add(f"free {motor}", np.flatnonzero(to_all))
        counter.add(f"feedback {motor}", feedback)
        counter.add(f"raised {motor}", feedback[raised])
        for bit in range(8):
            counter.add(f"raised {motor} bit {bit}", feedback[raised & (errors >> bit & 1 == 1)])
        counter.add(f"offline {motor}", anyone[running(off, runs[anyone])])
        for code, kind in enumerate(KINDS):
            at = np.flatnonzero((kinds == code) & (mine | ~NAMES_MOTOR[kinds]))
            if COMMANDS[code] and (kind.names_motor or motor == MOTORS[0]):
                counter.add(f"period {motor} {kind.name}", at)
                uneven = at[irregular(rows.t_ns[at], runs[at])]
                counter.add(f"irregular {motor} {kind.name}", uneven)
        for role, is_target in product((Role.SPEED, Role.POSITION), (True, False)):
            for kind in by_role(role, target=is_target):
                at = np.flatnonzero(mine & (kinds == KINDS.index(kind)))
                values = values_at(rows, NAME_OF_ROLE[role], at)
                counter.add(f"{'target' if is_target else 'present'} {role} {motor}", at, values)
                if not is_target:
                    counter.add(f"jump {role} {motor}", at[jumps(values, runs[at])])


def since(counts: Counts, t_ns: int) -> dict[str, pl.DataFrame]:
    """The counts of the windows from a time on."""
    recent = pl.col("window") >= t_ns >> SHIFT
    later = {name: counts[name].filter(recent) for name in ("windows", "delays")}
    return {**counts, **later, "lost": counts["lost"].filter(pl.col("t_ns") >= t_ns)}


# Reading


class EventCounts(NamedTuple):
    """A column: the number of events by window, and the range of their times or values."""

    events: Ints
    low: Ints
    high: Ints


class Windows:
    """The columns of a port, or of all motors, as arrays over the windows in which rows are."""

    def __init__(self, columns: pl.DataFrame, keys: Ints, shift: int) -> None:
        """`keys` are the starts of the windows, shifted by `shift`, rising."""
        self.shift, self._keys = shift, keys
        self.starts_ns = keys << shift
        """The start of each window, rising."""
        self.width_ns = 1 << shift
        self._columns = columns.partition_by("name", as_dict=True, include_key=False)

    def __len__(self) -> int:
        return len(self._keys)

    def __getitem__(self, name: str) -> EventCounts:
        """A column; without an event its range is the other way round."""
        found = EventCounts(*(np.full(len(self), one) for one in (0, 2**63 - 1, -(2**63))))
        if (own := self._columns.get((name,))) is not None and len(self):
            keys = own["window"].to_numpy() >> (self.shift - SHIFT)
            at = np.minimum(np.searchsorted(self._keys, keys), len(self) - 1)
            names = ("sum count", "least low", "greatest high")
            ufuncs = (np.add, np.minimum, np.maximum)
            for values, column, ufunc in zip(found, names, ufuncs, strict=True):
                ufunc.at(values, at, own[column].to_numpy())
        return found

    def total(self, name: str) -> int:
        """The number of events of a column."""
        return int(self[name].events.sum())


class Events:
    """The events of all causes in what was counted."""

    def __init__(self, counts: Counts) -> None:
        columns, self.hidden_by = counts["windows"], counts["hidden"]["hidden_by"].to_list()
        self.extent: dict[str, Any] = counts["extent"].row(0, named=True)
        rows = columns.filter(pl.col("name") == "rows")
        keys = np.unique(rows["window"].to_numpy())
        shift = SHIFT + (longer := width_of(keys))
        self.usual, late = _late(counts["delays"])
        """By motor and kind of command, the median answer time, nanoseconds."""
        own = pl.concat([chosen(columns, port="").drop("port"), late])
        self.windows = Windows(own, keys >> longer, shift)
        """What is about motors."""
        self.ports = {
            port: Windows(
                chosen(columns, port=port).drop("port"),
                np.unique(chosen(rows, port=port)["window"].to_numpy() >> longer),
                shift,
            )
            for port in rows["port"].unique(maintain_order=True)
        }
        """What is about each port."""
        self.lost = list(_lost(counts["lost"]))
        """Ports that were lost: from when, and until when."""


def _late(delays: pl.DataFrame) -> tuple[dict[tuple[int, str], float], pl.DataFrame]:
    """The usual delays, and the columns of the answers that are late or not."""
    usual, found = dict[tuple[int, str], float](), list[pl.DataFrame]()
    names = ["name", "window", "sum count", "least low", "greatest high"]
    for (motor, kind), own in delays.partition_by("motor", "kind", as_dict=True).items():
        counts = own.group_by("bin").agg(pl.col("sum count").sum()).sort("bin")
        total = counts["sum count"].cum_sum()
        median = counts["bin"].to_numpy()[total.search_sorted(total[-1] / 2)]
        usual_ns = float(middles(np.array([median]), COARSE)[0])
        usual[int(motor), KINDS[kind].name] = usual_ns
        # A bin further by an octave has twice the durations.
        octaves = (1 << COARSE) * int(np.log2(LATE))
        which = {"timed": own, "late": own.filter(pl.col("bin") >= median + octaves)}
        for word, some in which.items():
            name = pl.lit(f"{word} {motor} {KINDS[kind].name}").alias("name")
            found.append(some.with_columns(name).select(names))
    schema = {"name": pl.String, **dict.fromkeys(names[1:], pl.Int64)}
    return usual, pl.concat([pl.DataFrame(schema=schema), *found])


def _lost(events: pl.DataFrame) -> Iterator[tuple[str, int, int | None]]:
    """Ports that were lost: from when, and until when; None if they were not found again."""
    for own in events.sort("t_ns").partition_by("port", maintain_order=True):
        rows = own.to_dicts()
        for one, after in zip(rows, [*rows[1:], None], strict=True):
            if one["kind"] == PortEventKind.LOST:
                is_found = after is not None and after["kind"] == PortEventKind.FOUND_AGAIN
                yield one["port"], one["t_ns"], after["t_ns"] if is_found and after else None
