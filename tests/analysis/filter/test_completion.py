"""Completions at the cursor, and filters made from cells."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.completion import completions
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import EXAMPLES, both, cell_filters
from fte_sniff.protocol import COLUMN_BY_NAME, KINDS, Direction, Fault, Row, Status, encode
from fte_sniff.protocol.rows import Rows, fault_bits, faults_in
from tests.support.faults import frame_faults

CLOCK, TIME = "'12:00:00.250'", "'2026-01-31T12:00:00.250000007Z'"


@pytest.mark.parametrize(
    ("text", "start", "choices"),
    [
        ("time > ", 7, (CLOCK, TIME)),
        ("time > '", 7, (CLOCK, TIME)),
        ("time > '12:0", 7, (CLOCK,)),
        ("time > '2026-01-3", 7, (TIME,)),
        ("time IN ('12:00:05', '2026", 21, (TIME,)),
        ("time BETWEEN '1", 13, (CLOCK,)),
        ("port > '1", 7, ()),
    ],
)
def test_a_time_is_completed_from_the_suggested_one(
    text: str, start: int, choices: tuple[str, ...]
) -> None:
    found = completions(text, t_ns=1_769_860_800_250_000_007)
    assert (found.start, found.choices) == (start, choices)


@pytest.mark.parametrize(
    ("text", "start", "choices"),
    [
        ("mo", 0, ("motor",)),
        ("MO", 0, ("motor",)),
        ("motor = 1 AND rp", 14, ("rpm",)),
        ("motor = 1 && (rp", 14, ("rpm",)),
        ("NOT malf", 4, ("malformed",)),
        ("motor = 1 o", 10, ("OR",)),
        ("motor = 1 ", 10, ("AND", "OR")),
        ("rpm > vx", 6, ("vx_cm_s",)),
        ("NOT ab", 4, ("abs(",)),
        ("rpm = 1 - ab", 10, ("abs(",)),
        ("motor betw", 6, ("BETWEEN",)),
        ("port li", 5, ("LIKE",)),
        ("status = ", 9, tuple(f"'{word}'" for word in Status)),
        ("status = 'su", 9, ("'suspect'",)),
        ('status = "su', 9, ("'suspect'",)),
        ("status != mal", 10, ("'malformed'",)),
        ("direction NOT IN ('control', ", 29, tuple(f"'{word}'" for word in Direction)),
        ("faults IN (", 11, tuple(f"'{word}'" for word in Fault)),
        ("faults = 'noi", 9, ("'noise'",)),
        ("port = 'x", 7, ()),
        ("port = 'unfinished mo", 21, ()),
        ("", 0, (*COLUMN_BY_NAME, "NOT")),
    ],
)
def test_a_word_is_completed(text: str, start: int, choices: tuple[str, ...]) -> None:
    found = completions(text)
    assert (found.start, found.choices[: len(choices) or None]) == (start, choices)


def test_the_word_before_the_cursor_is_completed() -> None:
    assert completions("mo = 1 AND rpm > 5", 2).choices == ("motor", "motor_hint")


@given(st.text(max_size=20) | st.sampled_from([text for text, _ in EXAMPLES]), st.integers(-3, 60))
def test_any_text_and_cursor_are_accepted(text: str, cursor: int) -> None:
    found = completions(text, cursor)
    assert 0 <= found.start <= len(text)


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
FRAMES = st.builds(lambda port, raw: Row(port, 0, raw, NOON_NS, frame_faults(raw)), PORTS, RAWS)
DAMAGE = st.builds(
    lambda port, faults, t_ns: Row(
        port, 0, b"\x01\x02", t_ns, faults_in(fault_bits(faults)), framed=False
    ),
    PORTS,
    st.lists(st.sampled_from(list(Fault)), unique=True, max_size=2),
    st.sampled_from([None, NOON_NS - 1, NOON_NS + 1]),
)
ROWS = st.one_of(FRAMES, DAMAGE)


@given(ROWS, ROWS)
def test_a_cell_filter_keeps_its_row_and_the_opposite_drops_it(row: Row, other: Row) -> None:
    for cell in cell_filters(row):
        only, without = RowFilter.parse(cell.only), RowFilter.parse(cell.without)
        assert only.matches(Rows.of([row])).all()
        assert not without.matches(Rows.of([row])).any()
        if cell.column != "time" or other.t_ns is not None:
            others = Rows.of([other])
            assert only.matches(others) != without.matches(others)


@given(ROWS)
def test_a_row_has_a_filter_for_each_fault_or_for_none(row: Row) -> None:
    found = [cell.only for cell in cell_filters(row) if cell.column == "faults"]
    assert found == ([f"faults = '{fault}'" for fault in row.faults] or ["faults IS NULL"])


@pytest.mark.parametrize(
    ("current", "added", "made"),
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
def test_filters_are_joined(current: str, added: str, made: str) -> None:
    assert both(current, added) == made
    RowFilter.parse(made)
