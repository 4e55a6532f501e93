"""Which rows belong together: runs without a gap, the frame before, answers, the motor of damage.

A relation is an array of indices, -1 where there is none, so that a period, an answer time or a
jump is a difference of two values by index:

    row         0    1    2    3    4          commands c to motors 1 and 2, feedback f, damage !
                c1   c2   f1   !    c1
    before     -1   -1   -1   -1    0          the frame before of the same port, kind and motor
    answer      2   -1                         the first feedback with its CMD, before the next
                                               command to the motor and the deadline

Nothing here has a state. Rows that come in batches are completed by `segments`, which computes the
relations of a batch together with the rows before and after it that they depend on.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum
from typing import Final, TypeAlias, cast

import numpy as np
import polars as pl

from fte_sniff.protocol.items import Change, Gap, GapKind
from fte_sniff.protocol.rows import (
    ARRAYS,
    FAULT_BITS,
    KIND_OF,
    NO_FACT,
    NO_KIND,
    NO_TIME,
    Array,
    Bools,
    Ints,
    Rows,
    field_of,
)
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    NUM_OFFSET,
    TAIL,
    Direction,
    Fault,
    Role,
    motor_bit,
)

DEADLINE_NS: Final = 1_000_000_000
"""Time in which a command must be answered."""

LATE: Final = 2.0
"""An answer is late from this many times the median of its motor and kind on."""

NONE: Final = -1
"""The index where there is no related row."""

COMMANDS: Final = np.array([*(kind.direction is Direction.CONTROL for kind in KINDS), False])
"""By kind code, whether it is a command."""
FEEDBACK: Final = np.array([*(kind.direction is Direction.FEEDBACK for kind in KINDS), False])
"""By kind code, whether it is feedback."""
NAMES_MOTOR: Final = np.array([*(kind.names_motor for kind in KINDS), False])
"""By kind code, whether it names a motor in NUM."""

ANSWERABLE: Final = np.unique(
    [cmd for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds]
)
"""The CMDs of feedback: commands with another CMD have no answer."""


def values_at(rows: Rows, name: str, at: Ints) -> Ints:
    """A field of the rows at some indices; 0 where they do not have it."""
    return field_of(rows.raw[at], rows.kinds[at], name)[0].astype(np.int64)


def feedback_with(rows: Rows, role: Role) -> tuple[Ints, Ints]:
    """The indices of the feedback with a field of a role, and its values."""
    at = np.flatnonzero(FEEDBACK[rows.kinds])
    values, known = field_of(rows.raw[at], rows.kinds[at], NAME_OF_ROLE[role])
    return at[known], values[known].astype(np.int64)


# Runs


Runs: TypeAlias = Array
"""Runs of rows without a gap between them; nothing is measured from one to the next. By row:

    number          of its run, rising
    feedback_seen   whether feedback came before it in its recording
    lost            whether a port is lost
    hidden          whether the recording has only rows that a filter selected
"""

RUN: Final = np.dtype([("number", "i4"), ("feedback_seen", "?"), ("lost", "?"), ("hidden", "?")])

NO_RUNS: Final[Runs] = np.zeros(0, RUN)


def runs_of(rows: Rows, changes: Iterable[Change] = (), before: Runs = NO_RUNS) -> Runs:
    """The runs of rows with changes between them; `before` are those of the rows before."""
    found, recording = np.zeros(len(rows), RUN), np.zeros(len(rows), np.int64)
    found[:] = before[-1] if len(before) else 0
    for index, gap in ((one.index, one.what) for one in changes if isinstance(one.what, Gap)):
        later = found[index:]
        later["number"] += 1
        if gap.kind is GapKind.OTHER_RECORDING:
            recording[index:], later["feedback_seen"], later["hidden"] = index, False, False
        if gap.kind is GapKind.SELECTED:
            later["hidden"] = True
        if gap.port_lost is not None:
            later["lost"] = gap.port_lost
    feedback = np.append(np.flatnonzero(FEEDBACK[rows.kinds]), len(rows))
    found["feedback_seen"] |= np.arange(len(rows)) >= feedback[np.searchsorted(feedback, recording)]
    return found


def row_before(keys: Ints, runs: Runs) -> Ints:
    """For each row, the row before it with the same key in its run; keys below 0 have none."""
    found, at = np.full(len(keys), NONE, np.int64), np.flatnonzero(keys >= 0)
    if not len(at):
        return found
    number = (runs["number"][at] - runs["number"][0]).astype(np.int64)
    groups = number * (int(keys.max()) + 1) + keys[at]
    order = _sorting(groups)
    same = np.flatnonzero(np.diff(groups[order]) == 0)
    found[at[order[same + 1]]] = at[order[same]]
    return found


def _sorting(keys: Ints) -> Ints:
    """The indices that sort numbers from 0 on; those of equal ones rise."""
    # Numpy sorts numbers of 16 bits in linear time.
    is_small = int(keys.max(initial=0)) < 1 << 16
    return np.argsort(keys.astype(np.uint16) if is_small else keys, kind="stable")


def stream_keys(rows: Rows) -> Ints:
    """A number for the port, kind and motor of each frame; -1 for rows without a kind."""
    motors = np.where(NAMES_MOTOR[rows.kinds], rows.nums, 0).astype(np.int64)
    keys = (rows.port.astype(np.int64) * (NO_KIND + 1) + rows.kinds) * 256 + motors
    return np.where(rows.kinds == NO_KIND, NONE, keys)


def last_of(keys: Ints, count: int = 1) -> Ints:
    """The indices of the last ones, at most `count`, of each key that is not below 0."""
    at = np.flatnonzero(keys >= 0)
    order = at[_sorting(keys[at])]
    later = np.append(keys[order[count:]], np.full(count, NONE))[: len(order)]
    return order[np.flatnonzero(later != keys[order])]


def port_keys(rows: Rows) -> Ints:
    """The index of the port of each row; -1 for rows without a time."""
    return np.where(rows.timed, rows.port.astype(np.int64), NONE)


# Answers


class AnswerState(IntEnum):
    """Whether a command to one motor was answered."""

    ANSWERED = 0
    UNANSWERED = 1
    """Another command to the motor, or the deadline, came first."""
    UNKNOWN = 2
    """The rows end, or rows are missing, before that; it needs no answer; or it is not covered."""
    UNCOVERED = 3
    """No answer came, and no feedback before it: the wire of the answers may not be recorded."""
    HIDDEN = 4
    """A filter selected the rows of the recording: the answer may be among the others."""


def answers(rows: Rows, runs: Runs) -> pl.DataFrame:
    """The commands to each motor and their answers, a row for each command and motor.

    Columns: `command` and `answer` (indices, -1 without an answer), `motor`, `kind` (code), `cmd`,
    `state` (an `AnswerState`), `delay_ns` (null unless it is answered and both have times).
    """
    kinds, count = rows.kinds, len(rows)
    commands, feedback = (np.flatnonzero(one[kinds]) for one in (COMMANDS, FEEDBACK))
    to_all = ~NAMES_MOTOR[kinds[commands]]
    of_motors = [commands[to_all | (rows.nums[commands] == motor)] for motor in MOTORS]
    at = np.concatenate(of_motors)
    motors = np.repeat(MOTORS, [len(own) for own in of_motors])
    run_ends = np.searchsorted(runs["number"], runs["number"][at], "right")
    ends = np.concatenate([np.append(own, count)[1:] for own in of_motors])
    ends, cmds = np.minimum(ends, run_ends), rows.raw[:, CMD_OFFSET][at]
    # The first feedback with the motor and the CMD behind each command, by a sorted key of all.
    keys = rows.nums.astype(np.int64) << 8 | rows.raw[:, CMD_OFFSET]
    by_key = feedback[_sorting(keys[feedback])]
    came, own_keys = keys[by_key] * (count + 1) + by_key, (motors << 8 | cmds) * (count + 1)
    next_ = np.append(came, 2**62)[np.searchsorted(came, own_keys + at)]
    answer = np.minimum(next_ - own_keys, count)
    t_ns, came_ns = rows.t_ns[at], np.append(rows.t_ns, NO_TIME)[answer]
    delays, timed = came_ns - t_ns, (came_ns != NO_TIME) & (t_ns != NO_TIME)
    is_answered = (answer < ends) & ~(timed & (delays > DEADLINE_NS))
    latest = np.maximum.accumulate(rows.t_ns)[run_ends - 1] if count else t_ns
    overdue = (ends < run_ends) | ((t_ns != NO_TIME) & (latest - t_ns > DEADLINE_NS))
    seen, lost, hidden = (runs[name][at] for name in ("feedback_seen", "lost", "hidden"))
    is_covered, missing = seen & ~lost, overdue & np.isin(cmds, ANSWERABLE)
    state = np.full(len(at), AnswerState.UNKNOWN)
    state[missing & is_covered] = AnswerState.UNANSWERED
    state[missing & ~is_covered] = AnswerState.UNCOVERED
    state[is_answered] = AnswerState.ANSWERED
    state[hidden], is_answered[hidden] = AnswerState.HIDDEN, False
    has_delay = is_answered & timed & (delays >= 0)
    return pl.DataFrame(
        {
            "command": at,
            "answer": np.where(is_answered, answer, NONE),
            "motor": motors.astype(np.uint8),
            "kind": kinds[at],
            "cmd": cmds,
            "state": state.astype(np.uint8),
            "delay_ns": pl.Series(delays).set(pl.Series(~has_delay), None),
        }
    )


# The motor of damage

_NAMING_CMDS: Final = np.unique([cmd for kind in KINDS if kind.names_motor for cmd in kind.cmds])
_AROUND: Final = range(-2, 2)
"""The frames before damage, and after it, that must be in step."""


def motor_hints(rows: Rows, runs: Runs) -> Ints:
    """The motors that damaged rows probably belonged to, or `NO_FACT`.

    The first of these that names a motor: the row's own NUM; the frames of a direction before and
    after it, in which one motor is missing; the command that alone awaits an answer.
    """
    damaged = np.flatnonzero(rows.is_malformed)
    hints = np.full(len(rows), NO_FACT)
    hints[damaged] = own = _own_motors(rows, damaged)
    damaged = damaged[own == NO_FACT]
    if not len(damaged):
        return hints
    named = NAMES_MOTOR[rows.kinds] & np.isin(rows.nums, MOTORS)
    heads, found = rows.raw[damaged, 0], []
    for direction, of_kind in ((Direction.CONTROL, COMMANDS), (Direction.FEEDBACK, FEEDBACK)):
        other = np.isin(heads, [*HEADERS.values()]) & (heads != HEADERS[direction])
        missing = _missing_motors(rows, runs, np.flatnonzero(named & of_kind[rows.kinds]), damaged)
        found.append(np.where(other, NO_FACT, missing))
    commanded, answered = found
    clash = (commanded != NO_FACT) & (answered != NO_FACT) & (commanded != answered)
    asked = _asked_motors(rows, runs, np.flatnonzero(named), damaged)
    asked[heads == HEADERS[Direction.CONTROL]] = NO_FACT
    best = np.where(commanded != NO_FACT, commanded, np.where(answered != NO_FACT, answered, asked))
    hints[damaged] = np.where(clash, NO_FACT, best)
    return hints


def _own_motors(rows: Rows, at: Ints) -> Ints:
    """NUM of the rows in which header and CMD, or CMD and tail, name a kind that names a motor."""
    raw, length, nums = rows.raw[at], rows.length[at], rows.nums[at].astype(np.int64)
    heads = raw[:, 0].astype(np.int64) << 8 | raw[:, CMD_OFFSET]
    whole = (rows.faults[at] & FAULT_BITS[Fault.BAD_HEADER] != 0) & (length == FRAME_LENGTH)
    whole &= raw[:, FRAME_LENGTH - 1] == TAIL
    whole &= np.isin(raw[:, CMD_OFFSET], _NAMING_CMDS)
    names = (NAMES_MOTOR[KIND_OF[heads]] | whole) & (length > NUM_OFFSET)
    return np.where(names & np.isin(nums, MOTORS), nums, NO_FACT)


def _near(rows: Rows, runs: Runs, frames: Ints, numbers: Ints, at: Ints) -> tuple[Ints, Bools]:
    """Frames by number, and whether each exists in a row's run, within the deadline."""
    if not len(frames):
        return np.zeros(len(at), np.int64), np.zeros(len(at), np.bool_)
    found = frames[np.clip(numbers, 0, len(frames) - 1)]
    own, t_ns = rows.t_ns[found], rows.t_ns[at]
    far = (own != NO_TIME) & (t_ns != NO_TIME) & (np.abs(own - t_ns) > DEADLINE_NS)
    own_run = runs["number"][found] == runs["number"][at]
    return found, (numbers >= 0) & (numbers < len(frames)) & own_run & ~far


def _missing_motors(rows: Rows, runs: Runs, frames: Ints, at: Ints) -> Ints:
    """The motor that is missing at each row among frames of one direction."""
    end, count = np.searchsorted(frames, at), len(MOTORS)
    around = [_near(rows, runs, frames, end + by, at) for by in _AROUND]
    second, first, next_, last = (rows.nums[one].astype(np.int64) for one, _ in around)
    step = first - second
    in_step = ((first + 2 * step - next_) % count == 0) & ((first + 3 * step - last) % count == 0)
    in_step &= np.logical_and.reduce([near for _, near in around])
    return np.where(in_step, (first + step - MOTORS[0]) % count + MOTORS[0], NO_FACT)


def _asked_motors(rows: Rows, runs: Runs, frames: Ints, at: Ints) -> Ints:
    """The motor whose command alone awaits an answer at each row."""
    end = np.searchsorted(frames, at)
    (last, near), (before, _) = (_near(rows, runs, frames, end - by, at) for by in (1, 2))
    alone = ~COMMANDS[rows.kinds[before]] | (rows.nums[before] == rows.nums[last])
    alone |= (end < 2) | (runs["number"][before] != runs["number"][at])
    asked = near & COMMANDS[rows.kinds[last]] & alone
    return np.where(asked, rows.nums[last].astype(np.int64), NO_FACT)


# The facts of rows


def with_facts(rows: Rows, runs: Runs, found: pl.DataFrame) -> Rows:
    """The rows with the columns of `rows.FACTS`; `found` are their `answers`."""
    before = row_before(stream_keys(rows), runs)
    previous = np.where(before == NONE, NO_FACT, rows.payloads[before] if len(rows) else before)
    unanswered, answer_ns = np.full(len(rows), NO_FACT), np.full(len(rows), NO_FACT)
    missed, undecided = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.bool_)
    names, asks = ("motor", "command", "state"), np.isin(found["cmd"].to_numpy(), ANSWERABLE)
    motors, commands, states = (found[name].to_numpy()[asks] for name in names)
    delays = found["delay_ns"].fill_null(2**62).to_numpy()[asks]
    for motor in MOTORS:
        own = motors == motor
        at, state = commands[own], states[own]
        unanswered[at] = 0
        missed[at[state == AnswerState.UNANSWERED]] |= 1 << motor_bit(motor)
        undecided[at[state > AnswerState.UNANSWERED]] = True
        answer_ns[at] = np.maximum(answer_ns[at], delays[own])
    unanswered[undecided] = NO_FACT
    facts = {
        "answer_ns": np.where(answer_ns == 2**62, NO_FACT, answer_ns),
        "unanswered": np.where(missed > 0, missed, unanswered),
        "motor_hint": motor_hints(rows, runs),
        "previous": previous,
    }
    return rows.replace(**{name: one.astype(ARRAYS[name][0]) for name, one in facts.items()})


# What is late, and off target


TOLERANCE: Final = {Role.SPEED: 15, Role.POSITION: 50}
"""How near a value is to its target at least, RPM and pulses."""


def is_off_target(values: tuple[Ints, Ints], targets: tuple[Ints, Ints], role: Role) -> Bools:
    """Whether present values (lowest, highest) are all outside of recent targets.

    A quarter of the target, at least `TOLERANCE`, is near; a position that changes is on its way.
    """
    (least, greatest), (bottom, top) = values, targets
    near = np.maximum(np.maximum(np.abs(top), np.abs(bottom)) // 4, TOLERANCE[role])
    off = (least > top + near) | (greatest < bottom - near)
    if role is Role.POSITION:
        off &= greatest - least <= TOLERANCE[role]
    return cast("Bools", off)


def with_late(found: pl.DataFrame) -> pl.DataFrame:
    """Answers with `late`, by the median of the motor and kind of command; null without a delay."""
    usual = pl.col("delay_ns").median().over("motor", "kind")
    return found.with_columns(late=pl.col("delay_ns") >= LATE * usual)
