from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.sim_model import ACCELERATION_RPM_S, TOP_SPEED_RPM, Motor

STEP_S = 0.002
SPEED = st.integers(-3000, 3000)
PLACE = st.integers(-50_000, 50_000)


def passed(motor, seconds):
    """The motor's speeds and places, step by step."""
    told = []
    for _ in range(int(seconds / STEP_S)):
        motor.step(STEP_S)
        told.append((motor.rpm, motor.pulses))
    return told


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


def test_a_motor_that_goes_offline_runs_down_and_then_does_what_it_was_told():
    motor = Motor()
    motor.turn(1000)
    passed(motor, 2)
    motor.online = False
    passed(motor, 2)
    assert motor.rpm == 0
    motor.online = True
    passed(motor, 2)
    assert round(motor.rpm) == 1000
