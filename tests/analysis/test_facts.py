"""Facts of rows: answers of commands, and the motor of damage."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import ANSWERABLE, DEADLINE_NS, MOST_HELD, Facts
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.model import StreamChange
from fte_sniff.protocol import KIND_BY_NAME, MOTORS, Direction, Fault, Gap, GapKind, Row, encode
from fte_sniff.protocol.rows import FACTS, Rows
from tests.analysis.pieces import Step, captures

MS = 1_000_000


def frame(kind: str, motor: int, t_ms: float | None) -> Row:
    values = {one.name: 0 for one in KIND_BY_NAME[kind].fields if one.default is None}
    if "motor" in values:
        values["motor"] = motor
    return Row("p", 0, encode(KIND_BY_NAME[kind], values), None if t_ms is None else int(t_ms * MS))


def command(motor: int, t_ms: float | None) -> Row:
    return frame("speed", motor, t_ms)


def answer(motor: int, t_ms: float | None) -> Row:
    return frame("speed_feedback", motor, t_ms)


def damage(raw: str, t_ms: float | None, fault: Fault = Fault.TRUNCATED) -> Row:
    return Row(
        "p", 0, bytes.fromhex(raw), None if t_ms is None else int(t_ms * MS), (fault,), framed=False
    )


def batches(steps: Sequence[Step], cuts: Sequence[int]) -> list[tuple[Rows, list[StreamChange]]]:
    """The steps in batches that end at the cuts, each with a codebook of its own."""
    found = []
    edges = [0, *sorted({min(cut, len(steps)) for cut in cuts}), len(steps)]
    for start, end in pairwise(edges):
        rows, changes = list[Row](), list[StreamChange]()
        for step in steps[start:end]:
            if isinstance(step, Row):
                rows.append(step)
            else:
                changes.append(StreamChange(len(rows), step))
        found.append((Rows.of(rows), changes))
    return found


def fed(steps: Sequence[Step], cuts: Sequence[int] = ()) -> list[Row]:
    """The rows with their facts; the steps come in batches that end at the cuts."""
    facts = Facts()
    found = [row for rows, changes in batches(steps, cuts) for row in facts.feed(rows, changes)]
    return [*found, *facts.interrupt()]


def facts_of(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    return [tuple(getattr(row, name) for name in FACTS) for row in rows]


@given(captures(), st.lists(st.integers(0, 60), max_size=6))
def test_any_division_into_batches_gives_the_same_facts(steps: list[Step], cuts: list[int]) -> None:
    whole = fed(steps)
    assert whole == [one for one in steps if isinstance(one, Row)]
    assert facts_of(fed(steps, cuts)) == facts_of(whole)


def previous_by_hand(steps: Sequence[Step], field: str) -> list[int | None]:
    """The field in the frame before of the same port, motor and kind, which no gap is after."""
    found, last = list[int | None](), dict[object, Row]()
    for step in steps:
        if isinstance(step, Gap):
            last.clear()
        if not isinstance(step, Row):
            continue
        if not step.framed or step.kind is None:
            found.append(None)
            continue
        key = step.port, step.kind.name, step.values.get("motor")
        found.append(last[key].values.get(field) if key in last else None)
        last[key] = step
    return found


def jumps(steps: Sequence[Step], field: str) -> list[bool]:
    """The rows for which `abs(field - previous(field)) > 0`."""
    own = [one for one in steps if isinstance(one, Row)]
    values = [one.values.get(field) if one.framed else None for one in own]
    pairs = zip(values, previous_by_hand(steps, field), strict=True)
    return [None not in pair and pair[0] != pair[1] for pair in pairs]


MOVING = st.builds(
    lambda kind, motor, rpm, port: Row(
        port,
        0,
        encode(
            KIND_BY_NAME[kind],
            {
                one.name: {"motor": motor, "rpm": rpm}.get(one.name, 0)
                for one in KIND_BY_NAME[kind].fields
            },
        ),
        None,
    ),
    st.sampled_from(["speed", "position", "mecanum", "speed_feedback", "reset"]),
    st.integers(1, 2),
    st.sampled_from([-32768, -1, 0, 1, 32767]),
    st.sampled_from("pq"),
)
STEPS = st.lists(
    MOVING
    | st.just(damage("AA01", None))
    | st.sampled_from([Gap(GapKind.DAMAGE), Gap(GapKind.PORT, port_lost=True)]),
    max_size=40,
)
CUTS = st.lists(st.integers(0, 40), max_size=6)


@pytest.mark.parametrize("field", ["rpm", "motor", "online"])
@given(STEPS, CUTS)
def test_previous_is_that_of_the_frame_before_for_any_division(
    field: str, steps: list[Step], cuts: list[int]
) -> None:
    expected = jumps(steps, field)
    wanted = RowFilter.parse(f"abs({field} - previous({field})) > 0")
    assert wanted.needs_facts
    stream = wanted.stream()
    live = [stream.matches(*batch).tolist() for batch in batches(steps, cuts)]
    assert [one for some in live for one in some] == expected
    whole = Rows.of(fed(steps, cuts))
    assert wanted.matches(whole).tolist() == expected
    unknown = RowFilter.parse(f"previous({field}) IS NULL").matches(whole).tolist()
    assert unknown == [one is None for one in previous_by_hand(steps, field)]


def answers_by_hand(steps: Sequence[Step]) -> list[tuple[int | None, bool | None]]:
    """`answer_ns` and `unanswered` of every row, by the text of docs/stats.md."""
    found, lost, covered = list[tuple[int | None, bool | None]](), False, False
    for at, row in enumerate(steps):
        if not isinstance(row, Row):
            if isinstance(row, Gap):
                lost = lost if row.port_lost is None else row.port_lost
                covered = covered and row.kind is not GapKind.OTHER_RECORDING
            continue
        covered |= row.framed and row.direction is Direction.FEEDBACK
        if (
            not row.framed
            or row.kind is None
            or row.direction is not Direction.CONTROL
            or row.cmd not in ANSWERABLE
        ):
            found.append((None, None))
            continue
        motors = [row.values["motor"]] if row.kind.names_motor else [*MOTORS]
        each = [answer_by_hand(steps, at, row, motor) for motor in motors]
        if False in [one[0] for one in each]:
            found.append((None, True if covered and not lost else None))
        elif None in [one[0] for one in each]:
            found.append((None, None))
        else:
            delays = [one[1] for one in each]
            known = None if None in delays else max(one for one in delays if one is not None)
            found.append((known, False))
    return found


def answer_by_hand(
    steps: Sequence[Step], at: int, asked: Row, motor: int
) -> tuple[bool | None, int | None]:
    """Whether a motor answered, None if that is not known; and after how many nanoseconds."""
    for row in steps[at + 1 :]:
        if isinstance(row, Gap):
            return None, None
        if not isinstance(row, Row):
            continue
        timed = row.t_ns is not None and asked.t_ns is not None
        delay = row.t_ns - asked.t_ns if timed else None  # type: ignore[operator]
        if delay is not None and delay > DEADLINE_NS:
            return False, None
        if not isinstance(row, Row) or not row.framed or row.kind is None:
            continue
        if row.direction is Direction.CONTROL:
            if not row.kind.names_motor or row.values["motor"] == motor:
                return False, None
        elif row.values["motor"] == motor and row.cmd == asked.cmd:
            return True, delay if delay is not None and delay >= 0 else None
    return None, None


@given(captures())
def test_answers_are_those_of_a_search_by_hand(steps: list[Step]) -> None:
    found = [(row.answer_ns, row.unanswered) for row in fed(steps)]
    assert found == answers_by_hand(steps)


@pytest.mark.parametrize(
    ("rows", "answers"),
    [
        ([command(1, 0), answer(1, 5)], [(5 * MS, False)]),
        ([command(1, 0), answer(2, 5), command(1, 9)], [(None, True), (None, None)]),
        ([command(1, 0), answer(2, 1000)], [(None, None)]),
        ([command(1, 0), answer(2, 1001)], [(None, True)]),
        ([command(1, 0), answer(1, 1001)], [(None, True)]),
        ([command(1, 0), answer(1, 1000)], [(1000 * MS, False)]),
        ([command(1, None), answer(1, None)], [(None, False)]),
        ([command(1, 5), answer(1, None)], [(None, False)]),
        ([command(1, 5), answer(1, 2)], [(None, False)]),
        ([frame("reset", 0, 0), answer(1, 5)], [(None, None)]),
    ],
    ids=[
        "answered",
        "another command comes first",
        "the rows end at the deadline",
        "the deadline passes",
        "the answer is too late",
        "the answer is in time",
        "rows without times",
        "an answer without a time",
        "times that fall",
        "a reset",
    ],
)
def test_a_command_is_answered_before_the_next_one_and_the_deadline(
    rows: list[Row], answers: list[tuple[int | None, bool | None]]
) -> None:
    found = [(one.answer_ns, one.unanswered) for one in fed([answer(4, None), *rows])]
    controls = [pair for pair, row in zip(found[1:], rows, strict=True) if row.raw[0] == 0xAA]
    assert controls == answers


def test_nothing_is_unanswered_before_the_first_feedback_of_a_recording() -> None:
    """The wire of the answers may not be recorded."""
    commands = [command(1, 0), command(1, 5), command(1, 9), command(1, 2000)]
    assert [row.unanswered for row in fed(commands)] == [None] * 4
    found = fed([*commands[:2], answer(2, 7), *commands[2:]])
    assert [row.unanswered for row in found] == [None, None, None, True, None]
    for kind, missed in ((GapKind.OTHER_RECORDING, None), (GapKind.DAMAGE, True)):
        found = fed([answer(2, 0), Gap(kind), *commands])
        assert [row.unanswered for row in found[1:-1]] == [missed] * 3


def test_a_command_to_all_motors_has_the_slowest_answer() -> None:
    answers = [frame("speed_feedback", motor, motor) for motor in MOTORS]
    answers = [Row("p", 0, one.raw[:1] + b"\3" + one.raw[2:], one.t_ns) for one in answers]
    assert fed([frame("mecanum", 0, 0), *answers])[0].answer_ns == 4 * MS
    assert fed([frame("mecanum", 0, 0), *answers[:3]])[0].unanswered is None
    late = [answer(4, -5), frame("mecanum", 0, 0), *answers[:3], answer(1, 2000)]
    assert fed(late)[1].unanswered is True


def test_nothing_is_unanswered_while_a_port_is_lost() -> None:
    lost, found = (Gap(GapKind.PORT, port_lost=one) for one in (True, False))
    first = answer(1, -5)
    rows = fed([first, lost, command(1, 0), command(1, 5), found, command(1, 9), command(1, 10)])
    assert [row.unanswered for row in rows[1:]] == [None, None, True, None]


def test_rows_without_times_wait_for_a_bounded_number_of_rows() -> None:
    rows = Rows.of([command(1, None), *[answer(2, None)] * (MOST_HELD + 1)])
    decided = Facts().feed(rows)
    assert len(decided) == len(rows)
    assert decided[0].unanswered is None


CYCLE = [
    one for motor in MOTORS for one in (command(motor, motor * 10), answer(motor, motor * 10 + 4))
]


@pytest.mark.parametrize(
    ("rows", "hint"),
    [
        ([damage("55010300", 5)], 3),
        ([damage("AA0102000000000000 00", 5, Fault.BAD_TAIL)], 2),
        ([damage("FF010200000000000FEE", 5, Fault.BAD_HEADER)], 2),
        ([damage("1234", 5, Fault.NOISE)], None),
        ([answer(1, 0), answer(2, 1), damage("12", 2), answer(4, 3), answer(1, 4)], 3),
        ([answer(1, 0), answer(2, 1), damage("12", 2), answer(3, 3), answer(4, 4)], None),
        ([answer(1, 0), answer(2, 1), damage("12", 2), answer(4, 1500), answer(1, 1501)], None),
        ([*CYCLE, command(1, 50), damage("5501", 54), command(2, 60), answer(2, 64)], 1),
        ([*CYCLE, command(1, 50), damage("AA01", 54), command(2, 60), answer(2, 64)], None),
        ([command(3, 0), command(4, 1), damage("5501", 2)], None),
        ([command(3, 0), damage("5501", 2000)], None),
    ],
    ids=[
        "header, CMD and NUM",
        "a wrong tail",
        "a wrong header",
        "alone",
        "the motor that is missing between its neighbours",
        "nothing is missing between its neighbours",
        "neighbours that are far away",
        "the motor that was asked",
        "a damaged command is not an answer",
        "two motors were asked",
        "asked long ago",
    ],
)
def test_damage_has_the_motor_that_its_bytes_or_neighbours_name(
    rows: list[Row], hint: int | None
) -> None:
    found = fed(rows)
    assert [one.motor_hint for one in found if not one.framed] == [hint]
    assert all(one.motor_hint is None for one in found if one.framed)


def test_rows_wait_at_most_the_deadline() -> None:
    facts = Facts()
    rows = Rows.of([command(1 + at % 4, at * 2) for at in range(3000)])
    waiting = []
    for start in range(0, len(rows), 100):
        facts.feed(rows[start : start + 100])
        waiting.append(len(facts.interrupt()) if start == 2900 else 0)
    assert 0 < waiting[-1] <= 4
    assert np.count_nonzero(waiting) == 1
