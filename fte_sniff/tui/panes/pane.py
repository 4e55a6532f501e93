"""Pane base class."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from datetime import tzinfo
from typing import ClassVar

from rich.cells import cell_len
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.geometry import Size
from textual.widgets import Static

from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import Row
from fte_sniff.tui.i18n import _
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.table.widget import AbstractMeta

_CORNERS = 4


@dataclass(frozen=True, slots=True)
class PaneContext:
    """What there is to be looked at by a pane, at one moment."""

    row: Row | None
    """The row under the cursor."""
    index: int | None
    """Its index in the store; None where there is no row."""
    place: int
    """The place of the cursor's row among those shown, from 1; 0 where there is none."""
    following: bool
    """Whether the cursor follows the end, so that the newest is what is looked at."""
    now_ns: int | None
    """The time at the cursor, nanoseconds since 1970 UTC; None without times."""
    newest_ns: int | None
    """The newest row's time and what has passed since; the same where the end is followed."""
    store: RowStore
    models: LiveModels
    bench: LineSetup
    palette: Palette
    zone: tzinfo
    """Of the times of day that the table shows."""


class Pane(VerticalScroll, can_focus=False, metaclass=AbstractMeta):
    """A page below the table; keys and the mouse wheel scroll it."""

    EVERY_S: ClassVar[float] = 0.0
    """How long what is drawn may stay as it is, seconds; 0 draws it anew at every look."""

    def __init__(self, hint: str) -> None:
        """`hint` tells the keys; it stands behind the title where there is room."""
        super().__init__()
        self._page = Static()
        self._drawn: Text | None = None
        self._hint = hint
        self.display = False

    def compose(self) -> ComposeResult:
        """One page."""
        yield self._page

    @property
    def room(self) -> Size:
        """Cells for the page; one column is kept for the bar that scrolls it."""
        region = self.scrollable_content_region
        bar = 0 if self.show_vertical_scrollbar else 1
        return Size(max(1, region.width - bar), max(1, region.height))

    @abstractmethod
    def see(self, sight: PaneContext) -> None:
        """Draw what there is to see."""

    @property
    def laid_out(self) -> bool:
        """Whether it has its place on the screen."""
        return bool(self.scrollable_content_region)

    def entitle(self, *titles: str) -> None:
        """Put a title over the page: the first that has room, or else the last."""
        room = self.size.width - _CORNERS
        title = next((one for one in titles if cell_len(one) <= room), titles[-1])
        both = f"{title}   {_(self._hint)}"
        self.border_title = Text(both if cell_len(both) <= room else title)

    def draw(self, page: Text) -> None:
        """Put this onto the page, if it is not what is there."""
        page.no_wrap = True
        if page != self._drawn or page.spans != (self._drawn and self._drawn.spans):
            self._drawn = page
            self._page.update(page)
