"""Condition of simulated lines: baud rate, polarity, and everything that is not our protocol."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.line_condition import LineCondition, diagnose
from fte_sniff.protocol.spec import DEFAULT_BAUD, KINDS, Direction
from fte_sniff.session.doctor import COMMON_BAUDS
from tests.slow import first
from tests.support.faults import damaged_stream, draw_frame, ordinary
from tests.support.uart import AfterError
from tests.support.uart import received as received_by_hardware

CONTROL = tuple(kind for kind in KINDS if kind.direction is Direction.CONTROL)
FEEDBACK = tuple(kind for kind in KINDS if kind.direction is Direction.FEEDBACK)
TRAFFIC = {"all": KINDS, "control": CONTROL, "feedback": FEEDBACK, "one kind": FEEDBACK[:1]}


def frames(seed, kinds=KINDS, count=80):
    random = Random(f"verdict {seed}")
    return [draw_frame(random, ordinary, kinds) for _ in range(count)]


@pytest.mark.parametrize("after_error", AfterError)
@pytest.mark.parametrize("traffic", TRAFFIC)
@pytest.mark.parametrize(
    ("baud", "inverted"),
    first(
        2,
        [(57_600, False), (DEFAULT_BAUD, True), (38_400, True), (230_400, False), (921_600, False)],
    ),
)
def test_at_another_baud_or_polarity_a_line_is_unreadable(baud, inverted, traffic, after_error):
    data = received_by_hardware(
        1, frames(1, TRAFFIC[traffic], 200), baud, DEFAULT_BAUD, inverted=inverted,
        after_error=after_error,
    )  # fmt: skip
    found = diagnose(data)
    assert found.share < 0.1
    assert found.condition is LineCondition.UNREADABLE


@pytest.mark.parametrize("traffic", first(1, TRAFFIC))
@pytest.mark.parametrize("baud", COMMON_BAUDS)
def test_at_the_right_baud_a_line_is_sound(baud, traffic):
    data = received_by_hardware(5, frames(5, TRAFFIC[traffic], 20), baud, baud)
    found = diagnose(data)
    assert (found.condition, found.share) == (LineCondition.SOUND, 1.0)
    kinds = {"control": {Direction.CONTROL}, "all": set(Direction)}.get(
        traffic, {Direction.FEEDBACK}
    )
    assert found.directions == kinds


@pytest.mark.parametrize(("share", "condition"), [(0.02, "sound"), (0.4, "damaged")])
def test_a_damaged_stream_has_the_right_baud(share, condition):
    data, _ = damaged_stream(7, 300, share, "ordinary")
    assert diagnose(data).condition == condition


@pytest.mark.parametrize(
    ("data", "condition"),
    [
        (b"", LineCondition.SILENT),
        (b"\0" * 5, LineCondition.LOW),
        (b"\0" * 500, LineCondition.LOW),
        (b"\x37\x99\xc2", LineCondition.TOO_LITTLE),
        (Random(1).randbytes(600), LineCondition.UNREADABLE),
        (frames(1)[0], LineCondition.SOUND),
    ],
)
def test_other_conditions(data, condition):
    assert diagnose(data).condition == condition


@given(st.binary(max_size=200))
def test_any_bytes_get_a_consistent_diagnosis(data):
    found = diagnose(data)
    assert found.size == len(data)
    assert 0 <= found.share <= 1
    assert found.directions or found.condition not in (LineCondition.SOUND, LineCondition.DAMAGED)
