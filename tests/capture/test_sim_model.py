from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.sim_model import (
    ACCELERATION_RPM_S,
    TOP_SPEED_RPM,
    Controller,
    Motor,
    wheel_speeds,
)
from fte_sniff.protocol import KIND_BY_NAME, MOTORS, Frame, encode
from tests.protocol.oracle import frame_faults
from tests.slow import first

STEP_S = 0.002
SPEED = st.integers(-3000, 3000)
PLACE = st.integers(-50_000, 50_000)


def passed(motor, seconds):
    """The motor's speeds and places, step by step."""
    reported = []
    for _ in range(int(seconds / STEP_S)):
        motor.step(STEP_S)
        reported.append((motor.rpm, motor.pulses))
    return reported


@given(SPEED, SPEED)
def test_a_motor_reaches_its_speed_without_leaps_and_without_passing_it(first, second):
    motor = Motor()
    for target in (first, second):
        before = motor.rpm
        motor.turn(target)
        for rpm, _ in passed(motor, 3):
            assert abs(rpm - before) <= ACCELERATION_RPM_S * STEP_S + 0.5
            assert min(before, target) - 0.5 <= rpm <= max(before, target) + 0.5
            before = rpm
        assert round(motor.rpm) == target


@given(PLACE, PLACE, st.integers(200, 3000))
def test_a_motor_goes_to_its_place_within_the_limit_and_stays(first, second, limit):
    motor = Motor()
    for target in (first, second):
        before = motor.pulses
        motor.move(target, limit)
        for rpm, pulses in passed(motor, 3 + abs(target - before) / (limit * 500 / 60)):
            assert abs(rpm) <= limit + 1e-6
            assert min(before, target) - 2 <= pulses <= max(before, target) + 2
        assert (round(motor.pulses), motor.rpm) == (target, 0)


@given(SPEED)
def test_position_is_the_integral_of_speed(rpm):
    motor = Motor()
    motor.turn(rpm)
    passed(motor, 2)
    before = motor.pulses
    passed(motor, 6)
    assert abs((motor.pulses - before) - rpm / 60 * 500 * 6) <= 2 + abs(rpm) / 100


@given(SPEED)
def test_reset_stops_a_motor_and_calls_its_place_zero(rpm):
    motor = Motor()
    motor.turn(rpm)
    passed(motor, 1)
    motor.reset()
    passed(motor, 2)
    assert (motor.rpm, motor.pulses) == (0, 0)


def test_more_than_the_top_speed_is_the_top_speed():
    motor = Motor()
    motor.turn(-32768)
    passed(motor, 3)
    assert round(motor.rpm) == -TOP_SPEED_RPM


def test_the_sign_of_a_limit_means_nothing_and_a_limit_of_zero_holds():
    backward, held = Motor(), Motor()
    backward.move(1000, -600)
    held.move(1000, 0)
    passed(backward, 3)
    passed(held, 3)
    assert (round(backward.pulses), held.pulses) == (1000, 0)


def test_a_motor_that_goes_offline_runs_down_and_then_obeys_its_target():
    motor = Motor()
    motor.turn(1000)
    passed(motor, 2)
    motor.online = False
    passed(motor, 2)
    assert motor.rpm == 0
    motor.online = True
    passed(motor, 2)
    assert round(motor.rpm) == 1000


def reported(controller, motor):
    """The feedback of a motor, decoded; None while it is silent."""
    raw = controller.feedback(motor)
    if raw is None:
        return None
    assert frame_faults(raw) == ()
    return Frame("", 0, raw, None)


def obey(controller, name, **values):
    controller.obey(KIND_BY_NAME[name], values)


@pytest.fixture
def controller():
    return Controller(Random("a quiet one"))


SIGNS_OF_WHEELS = [
    ((30, 0, 0), (1, 1, 1, 1)),
    ((-30, 0, 0), (-1, -1, -1, -1)),
    ((0, 30, 0), (-1, 1, 1, -1)),
    ((0, 0, 500), (-1, 1, -1, 1)),
    ((0, 0, 0), (0, 0, 0, 0)),
]


@pytest.mark.parametrize(("motion", "signs"), SIGNS_OF_WHEELS)
def test_mecanum_wheels_turn_as_the_chassis_moves(controller, motion, signs):
    obey(
        controller, "mecanum", **dict(zip(("vx_cm_s", "vy_cm_s", "wz_mrad_s"), motion, strict=True))
    )
    controller.advance_to(3)
    wanted = wheel_speeds(*motion)
    for motor, sign, rpm in zip(MOTORS, signs, wanted, strict=True):
        feedback = reported(controller, motor)
        assert (feedback.kind.name, feedback.cmd) == ("speed_feedback", 3)
        assert abs(feedback.values["rpm"] - rpm) <= 2
        assert (feedback.values["rpm"] > 0) - (feedback.values["rpm"] < 0) == sign


def test_motions_of_the_chassis_add_up():
    together = wheel_speeds(10, 20, 300)
    parts = ((10, 0, 0), (0, 20, 0), (0, 0, 300))
    alone = zip(*(wheel_speeds(*part) for part in parts), strict=True)
    assert together == pytest.approx([sum(wheel) for wheel in alone])


def test_each_motor_answers_in_its_own_mode(controller):
    obey(controller, "mecanum", vx_cm_s=10, vy_cm_s=0, wz_mrad_s=0)
    obey(controller, "speed", motor=1, rpm=300)
    obey(controller, "position", motor=2, rpm=1000, pulses=-4000)
    controller.advance_to(4)
    kinds = {
        motor: (reported(controller, motor).kind.name, reported(controller, motor).cmd)
        for motor in MOTORS
    }
    assert kinds == {
        1: ("speed_feedback", 1),
        2: ("position_feedback", 2),
        3: ("speed_feedback", 3),
        4: ("speed_feedback", 3),
    }
    assert abs(reported(controller, 1).values["rpm"] - 300) <= 1
    assert reported(controller, 2).values["pulses"] == -4000


def test_reset_stops_all_and_zeroes_positions(controller):
    obey(controller, "position", motor=2, rpm=1000, pulses=4000)
    obey(controller, "speed", motor=1, rpm=700)
    controller.advance_to(3)
    obey(controller, "reset")
    controller.advance_to(5)
    assert [reported(controller, motor).values["rpm"] for motor in MOTORS] == [0, 0, 0, 0]
    obey(controller, "position", motor=2, rpm=0, pulses=0)
    assert reported(controller, 2).values["pulses"] == 0


def test_a_position_past_the_field_wraps_as_a_counter_does(controller):
    controller.motors[1].pulses = 2**31 + 5
    obey(controller, "position", motor=1, rpm=0, pulses=0)
    assert reported(controller, 1).values["pulses"] == -(2**31) + 5


def test_frames_that_are_no_commands_change_nothing(controller):
    before = [controller.feedback(motor) for motor in MOTORS]
    obey(controller, "speed", motor=9, rpm=100)
    obey(controller, "speed_feedback", motor=1, rpm=100, error=0, online=15)
    controller.advance_to(1)
    assert [controller.feedback(motor) for motor in MOTORS] == before


@pytest.mark.parametrize("seed", first(1, range(4)))
def test_now_and_then_one_motor_is_offline_and_silent_and_the_flags_show_which(seed):
    controller = Controller(Random(seed))
    spells = []
    for tenths in range(1, 4000):
        controller.advance_to(tenths / 10)
        feedback = [reported(controller, motor) for motor in MOTORS]
        silent = [motor for motor, one in zip(MOTORS, feedback, strict=True) if one is None]
        assert len(silent) <= 1
        bit = sum(1 << (motor - 1) for motor in silent)
        flags = {(one.values["error"], one.values["online"]) for one in feedback if one}
        assert flags == {(bit, 0x0F & ~bit)}
        spells.append(bool(silent))
    assert 0.001 < sum(spells) / len(spells) < 0.1


def test_the_feedback_is_what_the_protocol_encodes(controller):
    values = {"motor": 3, "rpm": 0, "error": 0, "online": 15}
    assert controller.feedback(3) == encode(KIND_BY_NAME["speed_feedback"], values, 1)
