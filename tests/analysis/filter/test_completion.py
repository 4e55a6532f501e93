"""Completions at the cursor, and filters made from cells."""

from __future__ import annotations

from string import ascii_letters

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import EXAMPLES, RowFilter
from fte_sniff.analysis.filter.terms import both, cell_filters, completions
from fte_sniff.protocol.columns import COLUMN_BY_NAME
from fte_sniff.protocol.rows import Row, fault_bits, faults_in
from fte_sniff.protocol.spec import KINDS, Direction, Fault, Status, encode
from tests.support.columns import rows_from
from tests.support.faults import frame_faults


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mo", ("motor", "motor_hint")),
        ("MO", ("motor", "motor_hint")),
        ("motor = 1 && (rp", ("rpm",)),
        ("NOT malf", ("malformed",)),
        ("motor = 1 o", ("OR",)),
        ("rpm > vx", ("vx_cm_s",)),
        ("rpm = 1 - ab", ("abs(",)),
        ("motor betw", ("BETWEEN",)),
        ("port li", ("LIKE",)),
        ("status = ", tuple(f"'{word}'" for word in Status)),
        ("status = 'su", ("'suspect'",)),
        ('status = "su', ("'suspect'",)),
        ("status != mal", ("'malformed'",)),
        ("direction NOT IN ('control', ", tuple(f"'{word}'" for word in Direction)),
        ("faults IN (", tuple(f"'{word}'" for word in Fault)),
        ("port = 'x", ()),
        ("port = 'unfinished mo", ()),
    ],
)
def test_last_word_is_completed(text: str, words: tuple[str, ...]) -> None:
    before = text.rstrip("'\"" + ascii_letters)
    assert completions(text) == [before + word for word in words]


def test_fields_come_first() -> None:
    assert completions("")[: len(COLUMN_BY_NAME)] == [*COLUMN_BY_NAME]
    assert "motor = 1 AND" in completions("motor = 1 ")


@given(st.text(max_size=20) | st.sampled_from([text for text, _ in EXAMPLES]))
def test_any_text_is_accepted(text: str) -> None:
    completions(text)


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
    for text, opposite in cell_filters(row).items():
        only, without = RowFilter.parse(text), RowFilter.parse(opposite)
        assert only.matches(rows_from([row])).all()
        assert not without.matches(rows_from([row])).any()
        if not text.startswith("time") or other.t_ns is not None:
            others = rows_from([other])
            assert only.matches(others) != without.matches(others)


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
