"""Base class of the panes, and the context that they draw."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from datetime import tzinfo
from typing import ClassVar, ParamSpec

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.geometry import Size
from textual.widgets import Static

from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import Row
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import first_fitting

HINT = later("J K: scroll   esc: close")

P = ParamSpec("P")

_CORNERS = 4


@dataclass(frozen=True, slots=True)
class PaneContext:
    """What a pane draws, at one moment."""

    row: Row | None
    """The row under the cursor."""
    index: int | None
    """Its index in the store."""
    row_number: int
    """Its number among the shown rows, from 1; 0 without a row."""
    following: bool
    """Whether the cursor follows the end."""
    now_ns: int | None
    """The time at the cursor, nanoseconds since 1970 UTC; None without times."""
    newest_ns: int | None
    """The newest row's time plus the time since it came."""
    store: RowStore
    models: LiveModels
    line_setup: LineSetup
    palette: Palette
    zone: tzinfo
    """Zone of the table's times of day."""


class Pane(VerticalScroll, can_focus=False):
    """A page below the table; keys and the mouse wheel scroll it."""

    NAME: ClassVar[str]
    """Name in the action of its key: `pane('motors')`."""
    EXPLAINS_ROW: ClassVar[bool] = False
    """Whether it is about the cursor's row: it is then as tall as its text, up to half a screen."""
    REDRAW_S: ClassVar[float] = 0.0
    """Shortest time between two drawings, seconds."""
    HINT: ClassVar[str] = HINT
    """Its keys; shown after the title where they fit."""

    def __init__(self) -> None:
        super().__init__()
        self._page = Static()
        self._title: str | None = None
        self._drawn: Text | None = None
        self._wanted: tuple[object, ...] = ()
        self.display = False
        self.set_class(self.EXPLAINS_ROW, "-row")

    def compose(self) -> ComposeResult:
        """The page."""
        yield self._page

    @abstractmethod
    def draw(self, context: PaneContext) -> None:
        """Draw the context with `set_title` and `set_page`."""

    def zoom(self, by: int) -> None:
        """Show more time (`by` 1) or less (-1), in panes over time."""

    def forget_texts(self) -> None:
        """Draw everything anew the next time."""
        self._wanted, self._drawn = (), None

    @property
    def page_size(self) -> Size:
        """Cells for the page; one column is reserved for the scroll bar."""
        region = self.scrollable_content_region
        bar = 0 if self.show_vertical_scrollbar else 1
        return Size(max(1, region.width - bar), max(1, region.height))

    def set_title(self, *titles: str) -> None:
        """Set the first title that fits, or else the last."""
        width = self.size.width - _CORNERS
        title = first_fitting(titles, width)
        text = first_fitting((f"{title}   {_(self.HINT)}", title), width)
        if text != self._title:
            self._title = text
            self.border_title = Text(text)

    def set_page_of(self, draw: Callable[P, Text], *args: P.args, **kwargs: P.kwargs) -> bool:
        """Show `draw(...)`, where it is not shown already; returns whether it is new."""
        wanted = (draw, args, kwargs)
        is_new = wanted != self._wanted
        if is_new:
            self._wanted = wanted
            self.set_page(draw(*args, **kwargs))
        return is_new

    def set_page(self, page: Text) -> None:
        """Show the page, where it is not shown already."""
        page.no_wrap = True
        if page != self._drawn or page.spans != (self._drawn and self._drawn.spans):
            self._drawn = page
            self._page.update(page)
