"""The search: what people see of a row is found in it, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.search import Search
from fte_sniff.errors import InputTextError
from fte_sniff.protocol import COLUMN_BY_NAME, KINDS, Damage, Fault, Frame, Row, encode, spaced_hex
from fte_sniff.row_batch import Codebook, pack

NOON_NS = 1_769_860_800_000_000_000


def frame(name: str, **values: int) -> Row:
    kind = next(kind for kind in KINDS if kind.name == name)
    return Frame("/dev/ttyUSB0", 1230, encode(kind, values), NOON_NS + 435_000)


ROWS: Sequence[Row] = (
    frame("speed", motor=1, rpm=1000),
    frame("speed_feedback", motor=2, rpm=-7, error=4, online=15),
    frame("mecanum", vx_cm_s=1, vy_cm_s=-2, wz_mrad_s=3),
    Damage("COM7", 9, bytes.fromhex("0102"), None, (Fault.NOISE, Fault.LINE_ERROR)),
    Damage("COM7", 11, bytes(range(256)), NOON_NS, (Fault.NOISE,)),
)


def found(typed: str, rows: Sequence[Row] = ROWS) -> list[int]:
    codebook = Codebook()
    mask = Search.parse(typed).mask(*pack(rows, codebook), codebook)
    return [int(at) for at in np.flatnonzero(mask)]


@pytest.mark.parametrize(
    ("typed", "rows"),
    [
        ("motor=1 rpm=1000", [0]),
        ("RPM=", [0, 1]),
        ("error=04", [1]),
        ("E04", [1]),
        ("O0F", []),
        ("M2", [1]),
        ("m2 rpm=-7 e04", [1]),
        ("M1 1000", [0]),
        ("r=1000", [0]),
        ("speed fb", [1]),
        ("position fb", []),
        ("online", []),
        ("vy=-2", [2]),
        ("speed_feedback", [1]),
        ("speed", [0, 1]),
        ("ttyusb0", [0, 1, 2]),
        ("noise,line", [3]),
        ("12:00:00.000435", [0, 1, 2]),
        ("1230", [0, 1, 2]),
        ("AA 01", [0]),
        ("aa01", [0]),
        ("01 02", [1, 3, 4]),
        ("0102", [1, 3, 4]),
        ("hex:01 02", [1, 3, 4]),
        ("hex: 0?02", [1, 3, 4]),
        ("f0f1f2f3f4f5f6f7f8f9fafb", [4]),
        ("hex:??????", [0, 1, 2, 4]),
        ("com7 noise", []),
        ("zzz", []),
        ("...", []),
    ],
)
def test_what_is_seen_is_found(typed: str, rows: list[int]) -> None:
    assert found(typed) == rows


@pytest.mark.parametrize(
    ("typed", "column", "rows"),
    [
        ("com7", "port", [3, 4]),
        ("ttyusb0", "port", [0, 1, 2]),
        ("12:00:00.000435", "time", [0, 1, 2]),
        ("1230", "offset", [0, 1, 2]),
    ],
)
def test_what_no_column_tells_is_not_looked_at(typed: str, column: str, rows: list[int]) -> None:
    codebook = Codebook()
    packed = pack(ROWS, codebook)
    search = Search.parse(typed)
    others = set(COLUMN_BY_NAME) - {column}
    assert search.mask(*packed, codebook, {column}).nonzero()[0].tolist() == rows
    assert not search.mask(*packed, codebook, others).any()


@pytest.mark.parametrize("typed", ["motor=1", "speed", "noise", "aa 01"])
def test_kind_values_faults_and_bytes_are_looked_at_in_any_columns(typed: str) -> None:
    codebook = Codebook()
    packed = pack(ROWS, codebook)
    search = Search.parse(typed)
    assert (search.mask(*packed, codebook, ()) == search.mask(*packed, codebook)).all()


@pytest.mark.parametrize("typed", ["hex:", "hex:A", "hex:zz", "hex:A A", "hex:aa0"])
def test_what_is_no_hex_is_told(typed: str) -> None:
    with pytest.raises(InputTextError, match="is not hex: two digits a byte"):
        Search.parse(typed)


@given(st.binary(min_size=10, max_size=40), st.data())
def test_bytes_side_by_side_are_found_and_set_off(raw: bytes, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(raw) - 1))
    end = data.draw(st.integers(start + 1, len(raw)))
    wanted = raw[start:end]
    search = Search.parse(f"hex:{wanted.hex()}")
    row = Damage("p", 0, raw, None, (Fault.NOISE,))
    assert found(search.typed, [row]) == [0]
    shown = spaced_hex(raw)
    assert all(shown[a:b] == spaced_hex(wanted) for a, b in search.places(shown))
    assert search.places(shown)


@given(st.binary(min_size=10, max_size=14), st.binary(min_size=1, max_size=2))
def test_bytes_that_are_not_there_are_not_found(raw: bytes, wanted: bytes) -> None:
    row = Damage("p", 0, raw, None, (Fault.NOISE,))
    assert bool(found(f"hex:{wanted.hex()}", [row])) == (wanted in raw)


def test_places_are_those_of_the_text_whatever_its_case() -> None:
    assert Search.parse("Speed").places("speed SPEED_feedback") == [(0, 5), (6, 11)]
    assert Search.parse("a.c").places("abc a.c") == [(4, 7)]
