"""Owns what is in the window: the rows, each with its sign and the time that its own counts from.

It must not know how they are painted, nor the terminal.
"""

from __future__ import annotations

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.tui.table.look import TimeStyle
from fte_sniff.tui.table.marks import Marks
from fte_sniff.tui.table.painter import Place, Sign
from fte_sniff.tui.table.viewport import Viewport


def places(
    store: RowStore,
    view: Viewport,
    marks: Marks,
    selected: range,
    times: TimeStyle,
    start_ns: int | None,
) -> list[Place]:
    """What the window holds, from top to bottom.

    Args:
        store: where the rows are.
        view: which of those shown are in view.
        marks: the rows that are marked.
        selected: the indices that are selected.
        times: what the rows' times count from.
        start_ns: the time of the first row of all, if it has one.
    """
    end = min(view.top + view.height, view.count)
    since = _since(store, view.top, times, marks, start_ns)
    made = []
    for index, row in store.shown.slice(view.top, end):
        made.append(Place(row, _sign(index, marks, selected), since))
        if times is TimeStyle.BEFORE:
            since = row.t_ns
    return made


def _sign(index: int, marks: Marks, selected: range) -> Sign:
    if index in marks:
        return Sign.MARKED
    return Sign.SELECTED if index in selected else Sign.NONE


def _since(
    store: RowStore, top: int, times: TimeStyle, marks: Marks, start_ns: int | None
) -> int | None:
    """The time that the window's first row counts from."""
    if times is TimeStyle.BEFORE:
        return store.shown.row(top - 1).t_ns if 0 < top <= store.shown.count else None
    if times is TimeStyle.MARK:
        latest = marks.latest
        return None if latest is None or latest < store.first else store.row(latest).t_ns
    return start_ns if times is TimeStyle.START else None
