"""Faults as numbers, and back."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import Fault
from fte_sniff.protocol.framer import tables as fault_sets
from fte_sniff.protocol.framer.tables import FAULT_SETS, set_of

GIVEN = [fault for fault in Fault if fault is not Fault.LINE_ERROR]
"""The framer gives all others."""


def test_every_number_is_that_of_its_faults() -> None:
    assert len(FAULT_SETS) == 2 ** len(GIVEN)
    for number, faults in enumerate(FAULT_SETS):
        assert set_of(faults) == number
    assert FAULT_SETS[0] == ()


@given(st.lists(st.sampled_from(GIVEN), unique=True))
def test_faults_have_one_number_in_whatever_order_they_come(faults: list[Fault]) -> None:
    assert sorted(FAULT_SETS[set_of(faults)]) == sorted(faults)
    assert set_of(faults) == set_of(reversed(faults))


def test_the_names_are_those_of_the_numbers() -> None:
    for name in ("UNKNOWN_CMD", "BAD_HEADER", "BAD_TAIL", "TRUNCATED", "OVERLONG", "NOISE"):
        assert FAULT_SETS[getattr(fault_sets, name)] == (Fault[name],)
    assert FAULT_SETS[fault_sets.AMBIGUOUS] == (Fault.AMBIGUOUS,)
