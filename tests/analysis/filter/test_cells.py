"""Filters made from the cells of a row: each keeps what is alike, and its opposite the rest."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.cell_filter import both, cell_filters
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, Row, encode, frame_faults

NOON_NS = 1_769_860_800_000_000_000
PORTS = st.sampled_from(["/dev/ttyUSB0", "it's", "[串口]", "\x1b]0;x\x07", "\udcff"])
RAWS = st.sampled_from(
    [
        encode(kind, {field.name: getattr(field, end) for field in kind.fields})
        for kind in KINDS
        for end in ("low", "high")
    ]
    + [bytes.fromhex("AA7701000100000000EE")]
)
FRAMES = st.builds(lambda port, raw: Frame(port, 0, raw, NOON_NS, frame_faults(raw)), PORTS, RAWS)
DAMAGE = st.builds(
    lambda port, faults, t_ns: Damage(port, 0, b"\x01\x02", t_ns, tuple(faults)),
    PORTS,
    st.lists(st.sampled_from(list(Fault)), unique=True, max_size=2),
    st.sampled_from([None, NOON_NS - 1, NOON_NS + 1]),
)
ROWS = st.one_of(FRAMES, DAMAGE)


@given(ROWS, ROWS)
def test_a_row_is_among_those_alike_and_every_other_is_on_one_side(row: Row, other: Row) -> None:
    for cell in cell_filters(row):
        only, without = RowFilter.parse(cell.only), RowFilter.parse(cell.without)
        assert only.select([row]) == [row]
        assert without.select([row]) == []
        if cell.column != "time" or other.t_ns is not None:
            assert len(only.select([other])) + len(without.select([other])) == 1


@given(ROWS)
def test_a_row_without_faults_can_be_filtered_by_that_and_one_with_faults_by_each(row: Row) -> None:
    told = [cell.only for cell in cell_filters(row) if cell.column == "faults"]
    assert told == ([f"faults = '{fault}'" for fault in row.faults] or ["faults IS NULL"])


@pytest.mark.parametrize(
    ("standing", "added", "made"),
    [
        ("", "motor = 1", "motor = 1"),
        ("motor = 1", "motor = 1", "motor = 1"),
        ("motor = 1", "speed", "motor = 1 AND speed"),
        ("motor = 1 AND speed", "motor = 1", "motor = 1 AND speed"),
        ("motor = 1 or speed", "rpm = 2", "(motor = 1 or speed) AND rpm = 2"),
        ("motor = 1 || speed", "rpm = 2", "(motor = 1 || speed) AND rpm = 2"),
        ("port = 'OR'", "rpm = 2", "(port = 'OR') AND rpm = 2"),
    ],
)
def test_filters_are_joined(standing: str, added: str, made: str) -> None:
    assert both(standing, added) == made
    RowFilter.parse(made)
