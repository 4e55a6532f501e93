"""Search texts, the next fault or raised flag, and the hit counter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import (
    HitCounter,
    HitPosition,
    Search,
    find_fault,
    find_raised,
    find_unanswered,
)
from fte_sniff.errors import InputTextError
from fte_sniff.protocol import COLUMN_BY_NAME, KIND_BY_NAME, KINDS, Fault, Row, encode, spaced_hex
from fte_sniff.protocol.rows import Rows

NOON_NS = 1_769_860_800_000_000_000


def frame(name: str, **values: int) -> Row:
    kind = next(kind for kind in KINDS if kind.name == name)
    return Row("/dev/ttyUSB0", 1230, encode(kind, values), NOON_NS + 435_000)


ROWS: Sequence[Row] = (
    frame("speed", motor=1, rpm=1000),
    frame("speed_feedback", motor=2, rpm=-7, error=4, online=15),
    frame("mecanum", vx_cm_s=1, vy_cm_s=-2, wz_mrad_s=3),
    Row("COM7", 9, bytes.fromhex("0102"), None, (Fault.NOISE, Fault.LINE_ERROR), framed=False),
    Row("COM7", 11, bytes(range(256)), NOON_NS, (Fault.NOISE,), framed=False),
)


def found(typed: str, rows: Sequence[Row] = ROWS) -> list[int]:
    mask = Search.parse(typed).matches(Rows.of(rows))
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
def test_displayed_texts_are_found(typed: str, rows: list[int]) -> None:
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
def test_hidden_columns_are_not_searched(typed: str, column: str, rows: list[int]) -> None:
    batch = Rows.of(ROWS)
    search = Search.parse(typed)
    others = set(COLUMN_BY_NAME) - {column}
    assert search.matches(batch, {column}).nonzero()[0].tolist() == rows
    assert not search.matches(batch, others).any()


@pytest.mark.parametrize("typed", ["motor=1", "speed", "noise", "aa 01"])
def test_kind_values_faults_and_bytes_are_always_searched(typed: str) -> None:
    batch = Rows.of(ROWS)
    search = Search.parse(typed)
    assert (search.matches(batch, ()) == search.matches(batch)).all()


@pytest.mark.parametrize("typed", ["hex:", "hex:A", "hex:zz", "hex:A A", "hex:aa0"])
def test_invalid_hex_is_refused(typed: str) -> None:
    with pytest.raises(InputTextError, match="is not hex: two digits a byte"):
        Search.parse(typed)


@given(st.binary(min_size=10, max_size=40), st.data())
def test_bytes_in_sequence_are_found_and_marked(raw: bytes, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(raw) - 1))
    end = data.draw(st.integers(start + 1, len(raw)))
    wanted = raw[start:end]
    search = Search.parse(f"hex:{wanted.hex()}")
    row = Row("p", 0, raw, None, (Fault.NOISE,), framed=False)
    assert found(search.typed, [row]) == [0]
    shown = spaced_hex(raw)
    assert all(shown[a:b] == spaced_hex(wanted) for a, b in search.spans(shown))
    assert search.spans(shown)


@given(st.binary(min_size=10, max_size=14), st.binary(min_size=1, max_size=2))
def test_missing_bytes_are_not_found(raw: bytes, wanted: bytes) -> None:
    row = Row("p", 0, raw, None, (Fault.NOISE,), framed=False)
    assert bool(found(f"hex:{wanted.hex()}", [row])) == (wanted in raw)


def test_spans_ignore_case() -> None:
    assert Search.parse("Speed").spans("speed SPEED_feedback") == [(0, 5), (6, 11)]
    assert Search.parse("a.c").spans("abc a.c") == [(4, 7)]


TEN_BYTES = RowFilter.parse("length = 10")


RAW_BY_FLAG = {
    False: bytes.fromhex("55010100010000000FEE"),
    True: bytes.fromhex("55010100010000080FEE"),
}
"""Feedback that all is in order, and that it is not."""


def rows_with_faults(faulty: list[bool]) -> list[Row]:
    """Odd rows are three bytes long, so that the filter hides them."""
    found: list[Row] = []
    for number, wrong in enumerate(faulty):
        raw = bytes.fromhex("AA0101000100000000EE") if number % 2 == 0 else b"\x01\x02\x03"
        faults = (Fault.LINE_ERROR,) if wrong else ()
        found.append(Row("p", number, raw, number, faults, framed=len(raw) == 10))
    return found


@given(
    st.lists(st.booleans(), max_size=60),
    st.integers(-5, 65),
    st.sampled_from((1, -1)),
    st.booleans(),
    st.integers(1, 70),
)
def test_the_nearest_fault_is_found(
    faulty: list[bool], start: int, by: int, filtered: bool, bound: int
) -> None:
    store = RowStore(bound, block_rows=8)
    store.append(Rows.of(rows_with_faults(faulty)))
    if filtered:
        store.view.set_filter(TEN_BYTES)
        store.view.filter_step()
    shown = [
        at
        for at in range(store.first, store.next)
        if faulty[at] and not (filtered and at % 2) and (at - start) * by > 0
    ]
    nearest = min(shown, key=lambda at: abs(at - start), default=None)
    assert find_fault(store, start, by) == nearest


@given(
    st.lists(st.tuples(st.booleans(), st.booleans()), max_size=60),
    st.integers(-5, 65),
    st.sampled_from((1, -1)),
    st.booleans(),
    st.integers(1, 70),
)
def test_the_nearest_raised_flag_is_found_and_only_in_frames(
    flags: list[tuple[bool, bool]], start: int, by: int, filtered: bool, bound: int
) -> None:
    rows: list[Row] = [
        Row("p", number, RAW_BY_FLAG[raised], number)
        if framed
        else Row("p", number, RAW_BY_FLAG[raised], number, (Fault.NOISE,), framed=False)
        for number, (framed, raised) in enumerate(flags)
    ]
    store = RowStore(bound, block_rows=8)
    store.append(Rows.of(rows))
    if filtered:
        store.view.set_filter(RowFilter.parse("kind = 'speed_feedback'"))
        store.view.filter_step()
    shown = [
        at
        for at in range(store.first, store.next)
        if flags[at] == (True, True) and (at - start) * by > 0
    ]
    assert find_raised(store, start, by) == min(shown, key=lambda at: abs(at - start), default=None)


@given(
    st.lists(st.sampled_from((None, False, True)), max_size=40),
    st.integers(0, 40),
    st.integers(-5, 45),
    st.sampled_from((1, -1)),
)
def test_the_nearest_unanswered_command_is_found_among_those_known(
    missed: list[bool | None], known: int, start: int, by: int
) -> None:
    store = RowStore(block_rows=8)
    rows = Rows.of(
        [Row("p", 9 * at, RAW_BY_FLAG[False], at, unanswered=one) for at, one in enumerate(missed)]
    )
    store.append(rows)
    store.fill(rows[:known])
    wanted = [at for at, one in enumerate(missed[:known]) if one and (at - start) * by > 0]
    nearest = min(wanted, key=lambda at: abs(at - start), default=None)
    assert find_unanswered(store, start, by) == nearest


def rows_between(start: int, stop: int) -> Sequence[Row]:
    kind = KIND_BY_NAME["speed"]
    raws = (encode(kind, {"motor": 1 + at % 4, "rpm": at}) for at in range(start, stop))
    return [Row("p", 10 * at, raw, at) for at, raw in enumerate(raws, start)]


def third(rows: Rows) -> npt.NDArray[np.bool_]:
    return np.asarray(rows.offset % 30 == 0)


def counter_of(store: RowStore) -> HitCounter:
    hits = HitCounter(store, third)
    while hits.step():
        pass
    return hits


def position_by_hand(store: RowStore, index: int) -> HitPosition:
    indices = [store.view.index(at) for at in range(store.view.count)]
    passing = [at for at in indices if at % 3 == 0]
    number = passing.index(index) + 1 if index in passing else None
    return HitPosition(number, len(passing))


@pytest.mark.parametrize("row_filter", [None, "motor = 1", "rpm > 10", "motor = 9"])
@pytest.mark.parametrize("bound", [1000, 50])
def test_hit_positions_equal_a_count_by_hand(row_filter: str | None, bound: int) -> None:
    store = RowStore(bound, block_rows=16)
    store.view.set_filter(RowFilter.parse(row_filter) if row_filter else None)
    hits = HitCounter(store, third)
    for start in range(0, 120, 7):
        store.append(Rows.of(rows_between(start, start + 7)))
        while hits.step():
            pass
        for index in range(store.first, store.next):
            assert hits.position(index) == position_by_hand(store, index)


def test_the_total_grows_with_every_step() -> None:
    store = RowStore(1000, block_rows=16)
    store.append(Rows.of(rows_between(0, 40)))
    hits = HitCounter(store, third)
    assert hits.position(3) == HitPosition(None, 0)
    assert hits.step()
    assert hits.position(3) == HitPosition(2, 6)
    while hits.step():
        pass
    store.append(Rows.of(rows_between(40, 45)))
    assert hits.position(3) == HitPosition(2, 14)


@pytest.mark.parametrize("row_filter", [None, "motor = 1"])
def test_hits_that_are_hidden_again_are_not_counted(row_filter: str | None) -> None:
    store = RowStore(1000, block_rows=16)
    store.view.set_filter(RowFilter.parse(row_filter) if row_filter else None)
    store.append(Rows.of(rows_between(0, 40)))
    hits = counter_of(store)
    for limit in (0, 20, 5, 33, None):
        store.limit = limit
        while hits.step():
            pass
        for index in range(store.next):
            assert hits.position(index) == position_by_hand(store, index)
        assert hits.position(-1) == position_by_hand(store, -1)


class Again:
    def load(self, start: int, count: int) -> Rows:
        return Rows.of(rows_between(start, start + count))


def test_rows_that_left_memory_before_they_were_counted_are_skipped() -> None:
    store = RowStore(1000, block_rows=16, source=Again(), most_blocks=2)
    store.append(Rows.of(rows_between(0, 64)))
    late = counter_of(store)
    assert late.position(63) == HitPosition(11, 11)
    early = RowStore(1000, block_rows=16, source=Again(), most_blocks=2)
    hits = HitCounter(early, third)
    for start in range(0, 64, 16):
        early.append(Rows.of(rows_between(start, start + 16)))
        while hits.step():
            pass
    assert hits.position(63) == HitPosition(22, 22)
