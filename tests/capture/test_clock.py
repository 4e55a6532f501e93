import time

import pytest

from fte_sniff.capture.clock import Clock, ClockWatch


def test_the_clock_never_falls_and_is_utc():
    clock = Clock.tied()
    before_ns = time.time_ns()
    times = [clock.now_ns() for _ in range(10_000)]
    after_ns = time.time_ns()
    assert times == sorted(times)
    slack_ns = clock.uncertainty_ns + 1_000_000
    assert before_ns - slack_ns <= times[0] <= times[-1] <= after_ns + slack_ns


def test_the_clock_goes_on_from_its_tie_if_the_system_clock_is_set():
    tied = Clock.tied()
    elsewhere = Clock(0, tied.steady_at_tie_ns, 0)
    now_ns = elsewhere.now_ns()
    assert 0 <= now_ns <= tied.now_ns() - tied.utc_at_tie_ns
    assert abs(elsewhere.system_ahead_ns() - tied.utc_at_tie_ns) < 60 * 10**9


@pytest.mark.parametrize(
    ("ahead_ms", "steps_ms"),
    [
        # Drawn evenly by NTP, however far it gets in a week.
        ([0, 1, 2, 500, 900, 1400, 2300], [0, 0, 0, 0, 0, 0]),
        ([0, -3_600_000, -3_600_000, -3_600_001], [-3_600_000, 0, 0]),
        ([5, 1005, 1006], [1000, 0]),
        ([5, 1004, 5], [0, 0]),
        ([0, 60_000, 0], [60_000, -60_000]),
    ],
)
def test_a_clock_that_is_set_is_noticed_once_and_one_that_is_drawn_is_not(ahead_ms, steps_ms):
    first, *later = (ms * 1_000_000 for ms in ahead_ms)
    watch = ClockWatch(first)
    assert [watch.step(ahead_ns) for ahead_ns in later] == [ms * 1_000_000 for ms in steps_ms]
