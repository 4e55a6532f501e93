import dataclasses
import itertools
from random import Random
from urllib.parse import urlencode

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.simulation import (
    ACCELERATION_RPM_S,
    STEP_S,
    Controller,
    Motor,
    Simulation,
    SimulationParameters,
    parse_parameters,
)
from fte_sniff.errors import PortError
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, MOTORS, Status, byte_time_ns, encode
from tests.examples import examples
from tests.support.columns import fed
from tests.support.faults import frame_faults

POSITION = KIND_BY_NAME["position"]
SHARE = st.floats(0, 1)
DRAWN = {
    "seed": st.integers(0, 2**64),
    "rate": st.floats(20, 1152),
    **dict.fromkeys(("drop", "flip", "noise"), SHARE),
    "wire": st.sampled_from(["both", "control", "feedback"]),
}
ANY_PARAMETERS = st.builds(SimulationParameters, **DRAWN)
LEGAL_PARAMETERS = st.builds(
    SimulationParameters,
    **DRAWN,
    host=st.sampled_from(["on", "off"]),
    frames=st.integers(0, 10**9),
)


def items_of(parameters, baud=115_200):
    """The items with bytes."""
    return (item for item in Simulation(parameters, baud) if item.data)


def received(count, **asked):
    return list(itertools.islice(items_of(SimulationParameters(**asked)), count))


@examples(30)
@given(ANY_PARAMETERS)
def test_the_same_parameters_give_the_same_bytes_at_the_same_times(parameters):
    twice = [list(itertools.islice(items_of(parameters), 60)) for _ in range(2)]
    assert twice[0] == twice[1]


@examples(30)
@given(ANY_PARAMETERS, st.sampled_from([115_200, 921_600]))
def test_nothing_overlaps_on_the_wire_and_every_byte_takes_its_time(parameters, baud):
    free_ns = 0
    for item in itertools.islice(items_of(parameters, baud), 60):
        assert item.t_ns >= free_ns + len(item.sent or item.data) * byte_time_ns(baud)
        free_ns = item.t_ns


def test_without_faults_all_is_legal_and_in_step():
    framer = Framer("sim")
    items = received(3000, seed=3)
    rows = [row for item in items for row in fed(framer, Chunk("sim", item.t_ns, item.data))]
    rows += list(framer.finish())
    assert [row.raw for row in rows] == [item.sent for item in items]
    assert all(row.framed and row.status is Status.OK for row in rows)


def is_faulty(item):
    """Whether an item is noise, has one bit flipped, or has lost 1 to 4 adjacent bytes."""
    if not item.sent:
        return 1 <= len(item.data) <= 8
    if len(item.data) == len(item.sent):
        changed = int.from_bytes(item.data, "big") ^ int.from_bytes(item.sent, "big")
        return changed.bit_count() == 1
    lost = len(item.sent) - len(item.data)
    cuts = (item.sent[:at] + item.sent[at + lost :] for at in range(11 - lost))
    return 1 <= lost <= 4 and item.data in cuts


@pytest.mark.parametrize("fault", ["flip", "drop", "noise"])
def test_faults_are_as_frequent_as_asked(fault):
    damaged = [item for item in received(5000, **{fault: 0.1}) if item.data != item.sent]
    assert abs(len(damaged) - 500) < 5 * (5000 * 0.1 * 0.9) ** 0.5
    assert all(map(is_faulty, damaged))


def test_a_host_shows_every_kind_of_command_within_half_a_minute_and_pauses():
    items = received(1200, wire="control")
    kinds = [Row("", 0, item.sent, None).kind.name for item in items]
    assert kinds[0] == "reset"
    assert set(kinds) == {"reset", "speed", "position", "mecanum"}
    assert max(b.t_ns - a.t_ns for a, b in itertools.pairwise(items)) > 10**9


@given(LEGAL_PARAMETERS)
def test_what_is_written_into_a_url_is_read_out_of_it(parameters):
    assert parse_parameters(urlencode(dataclasses.asdict(parameters))) == parameters


@pytest.mark.parametrize(
    ("query", "reported"),
    [
        ("zzz=1", ["'zzz'", "it has seed, rate"]),
        ("seed=x", ["seed=x", "is not a valid integer"]),
        ("seed=-1", ["seed=-1", "x>=0"]),
        ("seed=1.5", ["seed=1.5", "is not a valid integer"]),
        ("seed=", ["seed="]),
        ("seed", ["seed="]),
        ("drop=1.01", ["drop=1.01", "0<=x<=1"]),
        ("flip=-0.1", ["flip=-0.1", "0<=x<=1"]),
        ("drop=nan", ["drop=nan", "is not a number"]),
        ("rate=0", ["rate=0", "0.01<=x"]),
        ("rate=inf", ["rate=inf"]),
        ("wire=a", ["wire=a", "'both', 'control', 'feedback'"]),
        ("host=yes", ["host=yes", "'on', 'off'"]),
        ("frames=-1", ["frames=-1"]),
        ("\x1b[31m=1", [r"\x1b[31m"]),
        ("seed=\x1b[31m", [r"seed=\x1b[31m"]),
    ],
)
def test_a_bad_parameter_is_one_line_that_names_it_and_what_is_legal(query, reported):
    with pytest.raises(PortError) as refused:
        parse_parameters(query)
    message = str(refused.value)
    assert message.isprintable()
    for part in reported:
        assert part in message


@pytest.mark.parametrize(("baud", "most"), [(115_200, 1152), (9600, 96), (3_000_000, 30_003)])
def test_a_rate_that_the_line_cannot_carry_is_refused(baud, most):
    next(iter(Simulation(SimulationParameters(rate=most), baud)))
    with pytest.raises(PortError, match=f"at most {most} frames/s"):
        Simulation(SimulationParameters(rate=most + 1), baud)


def passed(motor, seconds):
    """The motor's speeds and places, step by step."""
    for _ in range(int(seconds / STEP_S)):
        motor.step()
        yield motor.rpm, motor.pulses


@given(st.lists(st.integers(-3000, 3000), min_size=2, max_size=2))
def test_a_motor_reaches_its_speed_without_leaps_and_without_passing_it(targets):
    motor = Motor()
    for target in targets:
        before, motor.target_rpm = motor.rpm, target
        for rpm, _ in passed(motor, 3):
            assert abs(rpm - before) <= ACCELERATION_RPM_S * STEP_S + 0.5
            assert min(before, target) - 0.5 <= rpm <= max(before, target) + 0.5
            before = rpm
        assert round(motor.rpm) == target


@given(st.lists(st.integers(-50_000, 50_000), min_size=2, max_size=2), st.integers(200, 3000))
def test_a_motor_goes_to_its_place_within_the_limit_and_stays(targets, limit):
    motor = Motor(mode=POSITION, target_rpm=limit)
    for target in targets:
        before, motor.target_pulses = motor.pulses, target
        for rpm, pulses in passed(motor, 5 + abs(target - before) / (limit * 500 / 60)):
            assert abs(rpm) <= limit + 1e-6
            assert min(before, target) - 2 <= pulses <= max(before, target) + 2
        assert (round(motor.pulses), round(motor.rpm)) == (target, 0)


def reported(controller, motor):
    """The feedback of a motor, decoded."""
    raw = controller.feedback(motor)
    assert frame_faults(raw) == ()
    return Row("", 0, raw, None)


def obey(controller, name, **values):
    assert controller.obey(encode(KIND_BY_NAME[name], values))


@pytest.fixture
def controller():
    return Controller(Random("a quiet one"))


SPEEDS_OF_WHEELS = [
    ((30, 0, 0), (754, 754, 754, 754)),
    ((-30, 0, 0), (-754, -754, -754, -754)),
    ((0, 30, 0), (-754, 754, 754, -754)),
    ((0, 0, 500), (-477, 477, -477, 477)),
    ((10, -20, 500), (276, 226, -728, 1231)),
    ((0, 0, 0), (0, 0, 0, 0)),
]


@pytest.mark.parametrize(("motion", "speeds"), SPEEDS_OF_WHEELS)
def test_mecanum_wheels_turn_as_the_chassis_moves(controller, motion, speeds):
    obey(
        controller, "mecanum", **dict(zip(("vx_cm_s", "vy_cm_s", "wz_mrad_s"), motion, strict=True))
    )
    controller.advance_to(3)
    for motor, rpm in zip(MOTORS, speeds, strict=True):
        feedback = reported(controller, motor)
        assert (feedback.kind.name, feedback.cmd) == ("speed_feedback", 3)
        assert abs(feedback.values["rpm"] - rpm) <= 2


def test_weak_motor_loses_and_delays_its_answers_and_no_other_does():
    def answers(**asked):
        found = {motor: [] for motor in MOTORS}
        for item in received(6000, host="off", wire="feedback", seed=5, **asked):
            found[item.sent[2]].append(item.t_ns)
        return found

    weak = answers(weak_motor=3)
    usual = answers()
    sent = len(weak[1])
    assert all(sent - 200 <= len(weak[motor]) <= sent + 200 for motor in (1, 2, 4))
    assert 0.75 * sent < len(weak[3]) < 0.85 * sent
    # A late answer is far from the slot of its motor, 25 ms apart.
    slots = {t_ns // 5_000_000 % 5 for t_ns in usual[3]}
    late = [t_ns for t_ns in weak[3] if t_ns // 5_000_000 % 5 not in slots]
    assert 0.2 < len(late) / len(weak[3]) < 0.33
