"""Landmarks between rows, and the overview of shown rows, against counts row by row."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.landmarks import Landmarks, Overview
from fte_sniff.analysis.row_store import RowNote, RowStore
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Damage,
    Fault,
    Frame,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows

SOUND = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 5})
COMMAND = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
RAISED = encode(KIND_BY_NAME["speed_feedback"], {"motor": 2, "rpm": 5, "error": 4})
EXAMPLES: dict[RowNote, Row] = {
    RowNote.NONE: Frame("p", 0, SOUND, 0),
    RowNote.RAISED: Frame("p", 0, RAISED, 0),
    RowNote.UNANSWERED: Frame("p", 0, COMMAND, 0, unanswered=True),
    RowNote.SUSPECT: Frame("p", 0, SOUND, 0, (Fault.AMBIGUOUS,)),
    RowNote.MALFORMED: Damage("p", 0, b"\x01", 0, (Fault.NOISE,)),
}
FILLED = 17
"""Rows whose facts become known at once."""

NOTE_LISTS = st.lists(st.sampled_from(RowNote), max_size=120)


@given(NOTE_LISTS, st.integers(1, 40), st.integers(1, 30), st.booleans())
def test_cells_show_the_worst_rows_of_their_share(
    notes: list[RowNote], bound: int, cells: int, filtered: bool
) -> None:
    store = RowStore(bound=bound, block_rows=7)
    if filtered:
        store.view.set_filter(RowFilter.parse("motor = 1"))
    overview = Overview(store)
    for note in notes:
        row = Rows.from_rows([EXAMPLES[note]])
        store.append(row)
        store.fill(row)
    shown = notes[-bound:]
    if filtered:
        shown = [note for note in shown if note not in (RowNote.RAISED, RowNote.MALFORMED)]
    per_cell = -(-len(shown) // cells) if shown else 1
    shares = [shown[at : at + per_cell] for at in range(0, len(shown), per_cell)]
    # A share of less than eight rows is counted exactly.
    found = overview.cells(cells)
    assert [cell.worst for cell in found] == [max(share) for share in shares]
    for start, share in zip(range(0, len(shown), per_cell), shares, strict=True):
        worst = max(share)
        expected = start + share.index(worst) if worst else None
        assert overview.worst_between(start, start + per_cell) == expected


@given(
    NOTE_LISTS,
    st.lists(st.none() | st.integers(0, 120), min_size=1, max_size=8),
    st.integers(1, 60),
    st.booleans(),
)
def test_cells_are_those_of_the_rows_that_are_played_and_whose_facts_are_known(
    notes: list[RowNote], limits: list[int | None], cells: int, filtered: bool
) -> None:
    store = RowStore(block_rows=64)
    if filtered:
        store.view.set_filter(RowFilter.parse("motor = 1"))
    rows = Rows.from_rows([EXAMPLES[note] for note in notes])
    store.append(rows)
    overview = Overview(store)
    for limit in (None, *limits):
        assert overview.cells(cells) == Overview(store).cells(cells)
        store.limit = limit
        store.fill(rows[store.known : store.known + FILLED])
        assert overview.cells(cells) == Overview(store).cells(cells)


def store_of(count: int) -> RowStore:
    store = RowStore()
    store.append(Rows.from_rows([Frame("p", 10 * n, SOUND, 1000 * n) for n in range(count)]))
    return store


def test_an_event_is_before_the_first_row_that_is_later() -> None:
    store = store_of(10)
    landmarks = Landmarks(store)
    lost = PortEvent(4500, "p", PortEventKind.LOST, "pulled out")
    opened = PortEvent(-5, "p", PortEventKind.OPENED, "")
    last = PortEvent(99_000, "p", PortEventKind.FOUND_AGAIN, "")
    error = PortEvent(5000, "p", PortEventKind.LINE_ERROR, "", 3)
    landmarks.add([lost, opened, last, error], [])
    assert [(one.index, one.what) for one in landmarks.between(0, 11)] == [
        (0, opened),
        (5, lost),
        (10, last),
    ]
    assert [one.what for one in landmarks.beyond(0, 1)] == [lost, last]
    assert [one.what for one in landmarks.beyond(9, -1)] == [lost]


def test_a_gap_is_a_landmark_unless_an_event_reports_it_or_nothing_is_before_it() -> None:
    landmarks = Landmarks(store_of(10))
    gap = Gap(GapKind.NOT_SHOWN, 7)
    changes = [
        StreamChange(0, Gap(GapKind.OTHER_RECORDING)),
        StreamChange(3, gap),
        StreamChange(6, Gap(GapKind.PORT, port="p")),
    ]
    landmarks.add([], changes)
    assert [one.what for one in landmarks.between(0, 11)] == [gap]
    assert landmarks.gaps == [3, 6]


def test_landmarks_leave_with_their_rows() -> None:
    store = RowStore(bound=5, block_rows=2)
    landmarks = Landmarks(store)
    store.append(Rows.from_rows([Frame("p", 0, SOUND, 0)] * 4))
    landmarks.add([], [StreamChange(2, Gap(GapKind.DAMAGE))])
    store.append(Rows.from_rows([Frame("p", 0, SOUND, 0)] * 4))
    landmarks.add([], [StreamChange(7, Gap(GapKind.DAMAGE))])
    assert landmarks.gaps == [7]
    assert [one.index for one in landmarks.between(0, 99)] == [7]
