import dataclasses
from urllib.parse import urlencode

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.capture.simulation import (
    PARAMETERS,
    SimulationParameters,
    parameters_help,
    parse_parameters,
    simulate,
)
from fte_sniff.errors import PortError

SHARE = st.floats(0, 1)
ANY_PARAMETERS = st.builds(
    SimulationParameters,
    seed=st.integers(0, 2**64),
    rate=st.floats(0.01, 1152),
    drop=SHARE,
    flip=SHARE,
    noise=SHARE,
    wire=st.sampled_from(["both", "control", "feedback"]),
    host=st.sampled_from(["on", "off"]),
    frames=st.integers(0, 10**9),
)


@given(ANY_PARAMETERS)
def test_what_is_written_into_a_url_is_read_out_of_it(parameters):
    assert parse_parameters(urlencode(dataclasses.asdict(parameters))) == parameters


def test_nothing_asked_gives_the_defaults():
    assert parse_parameters("") == SimulationParameters()


@pytest.mark.parametrize(
    ("query", "told"),
    [
        ("sed=1", ["'sed'", "did you mean seed?", "rate", "frames"]),
        ("zzz=1", ["'zzz'", "it knows seed, rate"]),
        ("seed=x", ["seed=x", "whole number >= 0"]),
        ("seed=-1", ["seed=-1", ">= 0"]),
        ("seed=1.5", ["seed=1.5", "whole number"]),
        ("seed=", ["seed="]),
        ("seed", ["seed="]),
        ("seed=1&seed=2", ["seed twice"]),
        ("drop=1.01", ["drop=1.01", "0..1"]),
        ("flip=-0.1", ["flip=-0.1", "0..1"]),
        ("noise=nan", ["noise=nan", "0..1"]),
        ("rate=0", ["rate=0", "0.01.."]),
        ("rate=inf", ["rate=inf"]),
        ("wire=a", ["wire=a", "both|control|feedback"]),
        ("host=yes", ["host=yes", "on|off"]),
        ("frames=-1", ["frames=-1"]),
        ("\x1b[31m=1", [r"\x1b[31m"]),
        ("seed=\x1b[31m", [r"seed=\x1b[31m"]),
    ],
)
def test_a_bad_parameter_is_one_line_that_names_it_and_what_is_legal(query, told):
    with pytest.raises(PortError) as refused:
        parse_parameters(query)
    message = str(refused.value)
    assert message.isprintable()
    for part in told:
        assert part in message


@pytest.mark.parametrize(("baud", "most"), [(115_200, 1152), (9600, 96), (3_000_000, 30_003)])
def test_a_rate_that_the_line_cannot_carry_is_refused(baud, most):
    next(iter(simulate(SimulationParameters(rate=most), baud)))
    with pytest.raises(PortError, match=f"at most {most} frames/s"):
        simulate(SimulationParameters(rate=most + 1), baud)


def test_the_help_has_a_line_for_every_parameter():
    lines = parameters_help().splitlines()
    for parameter, line in zip(PARAMETERS, lines, strict=False):
        assert line.startswith(parameter.name)
        assert parameter.range_text in line
        assert f"default {parameter.default}" in line
    assert "1152" in lines[-1]
