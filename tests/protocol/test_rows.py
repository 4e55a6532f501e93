"""Rows travel between processes whole."""

from __future__ import annotations

import pickle
from dataclasses import astuple

import pytest

from fte_sniff.protocol import Damage, Fault, Frame, Row

ROWS: list[Row] = [
    Frame("p", 1, b"\xaa" + b"\0" * 8 + b"\xee", 2, (Fault.AMBIGUOUS,), 3, True),
    Frame("p", 1, b"\x55" + b"\0" * 8 + b"\xee", None),
    Damage("q", 2**40, b"\xff" * 1024, 2**62, (Fault.NOISE, Fault.LINE_ERROR), None, True),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: type(row).__name__)
def test_a_pickled_row_has_all_that_it_had(row: Row) -> None:
    again = pickle.loads(pickle.dumps(row))
    assert type(again) is type(row)
    assert astuple(again) == astuple(row)
