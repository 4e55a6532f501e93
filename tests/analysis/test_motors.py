"""The state of the motors, and their events over time."""

from __future__ import annotations

from itertools import pairwise, product, takewhile

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import ANSWERABLE, Facts, Pairing, motor_rows
from fte_sniff.analysis.motors import Health, MotorEvent, MotorEvents, Motors, MotorState
from fte_sniff.protocol import KIND_BY_NAME, KINDS, Direction, Fault, Row, encode
from fte_sniff.protocol.rows import Rows

SECOND = 1_000_000_000
SMALL = st.integers(-300, 300)


def _frame(draw: st.DrawFn, t_ns: int | None) -> Row:
    kind = draw(st.sampled_from(KINDS))
    values = {
        field.name: draw(
            st.integers(field.low, min(field.high, field.low + 15)) | st.just(field.high)
        )
        for field in kind.fields
    }
    raw = encode(kind, values, draw(st.sampled_from(kind.cmds)))
    if draw(st.integers(0, 9)) == 0:
        return Row("p", 0, raw[:-1], t_ns, (Fault.TRUNCATED,), framed=False)
    if draw(st.integers(0, 9)) == 0:
        raw = raw[:2] + draw(st.sampled_from([b"\x00", b"\x09"])) + raw[3:]
    return Row("p", 0, raw, t_ns)


@st.composite
def row_lists(draw: st.DrawFn) -> list[Row]:
    steps = draw(st.lists(st.integers(0, SECOND), max_size=25))
    has_times = draw(st.booleans())
    rows, t_ns = [], 0
    for step in steps:
        t_ns += step
        rows.append(_frame(draw, t_ns if has_times else None))
    return rows


def states_of(rows: list[Row], cuts: list[int], now_ns: int = 40 * SECOND) -> list[MotorState]:
    motors = Motors()
    edges = [0, *sorted(min(cut, len(rows)) for cut in cuts), len(rows)]
    for start, end in pairwise(edges):
        motors.observe(Rows.of(rows[start:end]))
    return motors.states(now_ns)


@given(row_lists(), st.lists(st.integers(0, 25), max_size=4))
def test_batches_of_any_size_give_the_same_states(rows: list[Row], cuts: list[int]) -> None:
    assert states_of(rows, cuts) == states_of(rows, [])


@pytest.mark.parametrize("cut", range(5))
@pytest.mark.parametrize("speeds", [*product((100, 200), repeat=4)])
def test_a_target_is_as_old_as_its_first_command(speeds: tuple[int, ...], cut: int) -> None:
    rows: list[Row] = [
        Row("p", 10 * at, encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": rpm}), at, ())
        for at, rpm in enumerate(speeds)
    ]
    target = states_of(rows, [cut])[0].target
    same = len([*takewhile(lambda rpm: rpm == speeds[-1], reversed(speeds))])
    assert target is not None
    assert (target.t_ns, target.since_ns) == (3, 4 - same)


def _commands(row: Row, motor: int) -> bool:
    if not row.framed or row.kind is None:
        return False
    if row.direction is not Direction.CONTROL:
        return False
    return not row.kind.names_motor or row.values["motor"] == motor


def _tells(row: Row, motor: int) -> bool:
    return (
        row.framed
        and row.direction is Direction.FEEDBACK
        and row.kind is not None
        and row.values["motor"] == motor
    )


@given(row_lists())
def test_a_state_has_the_values_of_the_last_frames(rows: list[Row]) -> None:
    for state in states_of(rows, []):
        commands = [row for row in rows if _commands(row, state.motor)]
        feedback = [row for row in rows if _tells(row, state.motor)]
        assert (state.commands, state.feedback) == (len(commands), len(feedback))
        target = state.target
        if not commands:
            assert target is None
        else:
            last = commands[-1]
            values = {name: value for name, value in last.values.items() if name != "motor"}
            assert target is not None
            assert (target.kind, dict(target.values), target.t_ns) == (last.kind, values, last.t_ns)
        for name in ("rpm", "pulses"):
            reported = [row for row in feedback if name in row.values]
            reading = state.present.get(name)
            wanted = (reported[-1].values[name], reported[-1].t_ns) if reported else None
            assert wanted == (reading and (reading.value, reading.t_ns))
        _check_flags(state, feedback)


def _check_flags(state: MotorState, feedback: list[Row]) -> None:
    for name in ("error", "online"):
        bytes_ = [(row.values[name], row.t_ns) for row in feedback]
        if not bytes_:
            assert name not in state.flags
            continue
        changed: list[int | None] = [None] * 8
        for (before, _), (now, t_ns) in pairwise(bytes_):
            for bit in range(8):
                if (before ^ now) >> bit & 1:
                    changed[bit] = t_ns
        flags = state.flags[name]
        assert (flags.byte, flags.changed_ns) == (bytes_[-1][0], tuple(changed))


def _row(name: str, t_ns: int | None, **values: int) -> Row:
    return Row("p", 0, encode(KIND_BY_NAME[name], values), t_ns)


def test_a_motor_without_frames_has_no_values() -> None:
    state = states_of([_row("reset", 0)], [])[2]
    assert state.present == {}
    assert state.online is None
    assert state.delay_p50_ns is None
    assert state.feedback_per_s is None
    assert (state.answered, state.unanswered, state.waiting_since_ns) == (0, 0, None)


def test_the_speed_limit_of_a_position_command_is_not_present_speed() -> None:
    state = states_of([_row("position", 5, motor=1, rpm=1000, pulses=-7)], [])[0]
    assert state.target is not None
    assert dict(state.target.values) == {"rpm": 1000, "pulses": -7}
    assert "rpm" not in state.present
    assert state.waiting_since_ns == 5


def test_online_comes_from_the_feedback_of_any_motor() -> None:
    rows = [
        _row("speed_feedback", 1, motor=1, rpm=0, online=0x0F),
        _row("speed_feedback", 2, motor=2, rpm=0, online=0x0B),
    ]
    states = states_of(rows, [])
    assert [state.online for state in states] == [True, True, False, True]
    assert states[2].online_changed_ns == 2
    assert states[0].online_changed_ns is None


@pytest.mark.parametrize("rate", [10, 100, 1000])
def test_rates_and_delays(rate: int) -> None:
    step, delay = SECOND // rate, SECOND // rate // 4
    rows: list[Row] = []
    for number in range(4 * rate):
        rows.append(_row("speed", number * step, motor=1, rpm=5))
        rows.append(_row("speed_feedback", number * step + delay, motor=1, rpm=5))
    state = states_of(rows, [], now_ns=4 * SECOND)[0]
    assert state.commands_per_s == pytest.approx(rate, rel=0.06)
    assert state.feedback_per_s == pytest.approx(rate, rel=0.06)
    assert (state.delay_p50_ns, state.delay_p99_ns) == (delay, delay)
    assert (state.answered, state.unanswered) == (4 * rate, 0)


@st.composite
def exchanges(draw: st.DrawFn) -> list[Row]:
    """Commands and feedback of two motors, one time unit apart."""
    rows = list[Row]()
    for t_ns in range(draw(st.integers(0, 40))):
        kind = draw(st.sampled_from([kind for kind in KINDS if kind.cmds]))
        values = {one.name: 0 for one in kind.fields if one.default is None}
        if kind.names_motor:
            values["motor"] = draw(st.sampled_from([1, 1, 2]))
        rows.append(Row("p", 0, encode(kind, values, draw(st.sampled_from(kind.cmds))), t_ns))
    return rows


def observe(pairing: Pairing, rows: list[Row], motor: int = 1) -> None:
    batch = Rows.of(rows)
    pairing.observe(batch, motor_rows(batch), motor)


def paired_by_hand(rows: list[Row]) -> tuple[list[int], int, int, bool]:
    """For motor 1: the delays of what is answered, how many commands are not answered, how many of
    them before the first feedback of any motor, and whether the last one waits."""
    delays: list[int] = []
    unanswered = {True: 0, False: 0}
    covered = False
    asked: tuple[int, int, bool] | None = None
    for t_ns, row in enumerate(rows):
        covered |= row.framed and row.direction is Direction.FEEDBACK
        if _commands(row, 1):
            if asked is not None:
                unanswered[asked[2]] += 1
            asked = (row.raw[1], t_ns, covered) if row.raw[1] in ANSWERABLE else None
        elif asked is not None and _tells(row, 1) and row.raw[1] == asked[0]:
            delays.append(t_ns - asked[1])
            asked = None
    return delays, unanswered[True], unanswered[False], asked is not None


@given(exchanges(), st.lists(st.integers(0, 40), max_size=4))
def test_pairing_in_batches_of_any_size_follows_the_rule(rows: list[Row], cuts: list[int]) -> None:
    whole = Pairing()
    edges = [0, *sorted(min(cut, len(rows)) for cut in cuts), len(rows)]
    pieces = [Pairing() for _ in edges[1:]]
    for piece, (start, end) in zip(pieces, pairwise(edges), strict=True):
        observe(whole, rows[start:end])
        observe(piece, rows[start:end])
    for piece in pieces[1:]:
        pieces[0].merge(piece)
    delays, unanswered, uncovered, waits = paired_by_hand(rows)
    for pairing in (whole, pieces[0]):
        assert pairing.answered == len(delays)
        assert (pairing.unanswered, pairing.uncovered) == (unanswered, uncovered)
        assert pairing.waiting is waits
    assert whole.delays.values.tolist() == delays


def test_pairs_without_times_are_counted_but_not_measured() -> None:
    pairing = Pairing()
    command, feedback = (_row(name, None, motor=1, rpm=5) for name in ("speed", "speed_feedback"))
    observe(pairing, [command, feedback])
    assert pairing.answered == 1
    assert pairing.delays.percentile(50) is None
    observe(pairing, [command])
    assert pairing.waiting
    assert pairing.waiting_since_ns is None


SECOND_NS = 1_000_000_000


def row(name: str, at_ms: float, **values: int) -> Row:
    return Row("p", 0, encode(KIND_BY_NAME[name], values), round(at_ms * 1_000_000))


def session() -> list[Row]:
    """Motor 1 answers, motor 2 only every second command, motor 3 late once, motor 4 never."""
    rows = []
    for number in range(200):
        at, motor, turn = 20 * number, 1 + number % 4, number // 4
        rows.append(row("speed", at, motor=motor, rpm=5))
        if motor == 1 or (motor == 2 and turn % 2) or motor == 3:
            delay = 15 if (motor, turn) == (3, 30) else 3
            rows.append(row("speed_feedback", at + delay, motor=motor, rpm=5))
    return rows


@pytest.mark.parametrize("every", [1, 7, 1000])
def test_events_are_the_same_however_rows_are_divided(every: int) -> None:
    facts, motors, events, rows = Facts(), Motors(), MotorEvents(), session()
    for start in range(0, len(rows), every):
        batch = Rows.of(rows[start : start + every])
        motors.observe(batch)
        events.observe(batch, motors)
        events.observe_facts(facts.feed(batch))
    span = (0, 10 * SECOND_NS)
    found = {motor: events.counts(motor, span) for motor in (1, 2, 3, 4)}
    assert {motor: one.unanswered for motor, one in found.items()} == {1: 0, 2: 25, 3: 0, 4: 49}
    assert {motor: one.events[MotorEvent.LATE] for motor, one in found.items()} == {
        **dict.fromkeys((1, 2, 4), 0),
        3: 1,
    }
    assert found[1].asked == 50
    assert events.health(span) == {
        **{1: Health.SOUND, 2: Health.TROUBLED},
        **{3: Health.SOUND, 4: Health.SILENT},
    }
    assert events.delay_ns(50, span) == 3_000_000
    assert events.delay_ns(100, span) == 15_000_000
    assert events.ticks(4, MotorEvent.UNANSWERED, (0, 4 * SECOND_NS), 4).tolist() == [
        *(12, 13, 12, 12),
    ]


def test_nothing_is_known_of_rows_without_a_time_or_without_commands() -> None:
    events, motors = MotorEvents(), Motors()
    rows = Rows.of([Row("p", 0, encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 0}), None)] * 3)
    motors.observe(rows)
    events.observe(rows, motors)
    assert events.health((0, SECOND_NS)) == {}
    assert events.delay_ns(99, (0, SECOND_NS)) is None


def test_motors_are_not_called_silent_where_no_feedback_was_recorded() -> None:
    events, motors = MotorEvents(), Motors()
    rows = Rows.of([row("speed", 20 * number, motor=1, rpm=5) for number in range(50)])
    motors.observe(rows)
    events.observe(rows, motors)
    assert events.counts(1, (0, SECOND_NS)).asked == 0
    assert events.health((0, SECOND_NS)) == {}
