"""Overview in the scroll bar: where faults, flags, marks, gaps and lost ports are in all rows.

Textual's `ScrollBarRender` draws only the thumb. This one adds signs, which differ from those of
rows, since the bar is beside rows of other times; a click on one goes to the most important row
there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from rich.color import Color
from rich.segment import Segment, Segments
from rich.style import Style
from textual.scrollbar import ScrollBarRender

from fte_sniff.analysis.landmarks import Landmarks, Overview
from fte_sniff.analysis.row_store import RowNote, RowStore
from fte_sniff.protocol import Status
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.table.viewport import RowMarks

DENSE: Final = 0.1
"""Share of the rows of a cell from which on its colour fills the cell."""

BAR_MARKS: Final = {Status.SUSPECT: "░", Status.MALFORMED: "▐"}
"""Sign of each status in the bar; shapes, since there may be no colours."""

BAR_RAISED: Final = "▲"
BAR_MARKED: Final = "◄"
BAR_EVENT: Final = "═"

_STATUSES: Final = {RowNote.SUSPECT: Status.SUSPECT, RowNote.MALFORMED: Status.MALFORMED}


@dataclass(frozen=True, slots=True)
class BarSign:
    """What one cell of the bar shows."""

    text: str
    style: Style

    def over(self, cell: Style) -> Style:
        """The style over that of a cell of the bar; the thumb, which is reversed, stays visible."""
        return cell + (Style(bgcolor=self.style.color) if cell.reverse else self.style)


class OverviewBar:
    """Signs of the shown rows for the cells of a bar."""

    def __init__(self, store: RowStore, landmarks: Landmarks, marks: RowMarks) -> None:
        self._store, self._landmarks, self._marks = store, landmarks, marks
        self._overview = Overview(store)
        self._height = self._rows = 0

    def signs(self, height: int, palette: Palette) -> Mapping[int, BarSign]:
        """The signs by cell, for a bar of `height` cells."""
        self._height, self._rows = height, self._store.view.count
        found = {}
        for at, cell in enumerate(self._overview.cells(height)):
            if cell.worst is RowNote.RAISED:
                sign, color = BAR_RAISED, palette.raised.color
            elif cell.worst:
                status = _STATUSES[cell.worst]
                sign, color = BAR_MARKS[status], palette.statuses[status].color
            else:
                continue
            style = Style(color=color, bgcolor=color if cell.share >= DENSE else None)
            found[at] = BarSign(sign, style)
        for landmark in self._landmarks.between(self._store.first, self._store.next + 1):
            if not landmark.is_routine:
                found[self._cell_of(landmark.index)] = BarSign(BAR_EVENT, palette.events)
        for index in self._marks:
            found[self._cell_of(index)] = BarSign(BAR_MARKED, palette.signs)
        return found

    @property
    def _per_cell(self) -> int:
        return max(1, -(-self._rows // max(1, self._height)))

    def _cell_of(self, index: int) -> int:
        position = min(self._store.view.position_of(index), max(0, self._rows - 1))
        return position // self._per_cell

    def position_at(self, cell: int) -> int | None:
        """Position of the row to which a click on a cell goes."""
        start, end = cell * self._per_cell, (cell + 1) * self._per_cell
        view = self._store.view
        between = self._landmarks.between(self._store.first, self._store.next + 1)
        special = [*self._marks, *(one.index for one in between if not one.is_routine)]
        positions = sorted(
            position for one in special if start <= (position := view.position_of(one)) < end
        )
        if positions:
            return positions[0]
        return self._overview.worst_between(start, end)


class OverviewRender(ScrollBarRender):
    """The scroll bar with the signs of an overview."""

    signs: Mapping[int, BarSign]

    @classmethod
    def with_signs(cls, signs: Mapping[int, BarSign]) -> type[OverviewRender]:
        """A renderer of these signs."""
        return type("OverviewRender", (cls,), {"signs": signs})

    @classmethod
    def render_bar(
        cls,
        size: int = 25,
        virtual_size: float = 50,
        window_size: float = 20,
        position: float = 0,
        thickness: int = 1,
        vertical: bool = True,
        back_color: Color = Color.parse("#555555"),  # noqa: B008
        bar_color: Color = Color.parse("bright_magenta"),  # noqa: B008
    ) -> Segments:
        """The bar of the base class, with a sign in some of its cells."""
        bar = super().render_bar(
            size, virtual_size, window_size, position, thickness, vertical, back_color, bar_color
        )
        segments = list(bar.segments)
        for cell, sign in cls.signs.items():
            if cell < len(segments):
                style = segments[cell].style or Style.null()
                shown = sign.over(style)
                if not style.reverse:
                    shown += Style(meta={"@mouse.down": f"app.overview({cell})"})
                segments[cell] = Segment(sign.text, shown)
        return Segments(segments, new_lines=True)
