"""Base class of the panes, and the context that they draw."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from datetime import tzinfo
from typing import ClassVar, Final, ParamSpec

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.events import MouseMove
from textual.geometry import Size
from textual.message import Message
from textual.widgets import Static

from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.relations import CommandAnswer
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import Row
from fte_sniff.tui.cells import first_fitting
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import Palette

HINT = later("J K: scroll   esc: close")

FIELD: Final = "field"
"""Key in the meta data of a style, under which the number of a field is."""

_KEY_SPACE: Final = "   "
_KEY_GAP: Final = re.compile(" {2,}")

P = ParamSpec("P")

_CORNERS = 4


@dataclass(frozen=True, slots=True)
class PaneContext:
    """What a pane draws, at one moment."""

    row: Row | None
    index: int | None
    """Its index in the store."""
    row_number: int
    """Its number among the shown rows, from 1; 0 without a row."""
    following: bool
    now_ns: int | None
    """The time at the cursor, nanoseconds since 1970 UTC; None without times."""
    newest_ns: int | None
    """The newest row's time plus the time since it came."""
    rates_ns: int | None
    """Of rates: `newest_ns` while rows still come; None after the end."""
    store: RowStore
    models: LiveModels
    line_setup: LineSetup
    palette: Palette
    zone: tzinfo
    """Zone of the table's times of day."""
    field: int | None = None
    """Number in `dissect` of the field that the user looks at in the row."""
    answers: tuple[CommandAnswer, ...] = ()
    """The answers of the row, by motor, if it is a command."""
    command: CommandAnswer | None = None
    """The command that the row answers."""
    captures: int = 1

    @property
    def merged_text(self) -> str:
        """That numbers are of several captures, whose equal ports are one; empty for one."""
        return "" if self.captures < 2 else _("{count} captures as one", count=self.captures)

    def row_text(self, index: int) -> str:
        """The number of a row among those shown."""
        view = self.store.view
        if not view.has(index):
            return _("a row that the filter hides")
        return _("row {number:,}", number=view.position_of(index) + 1)


class Pane(VerticalScroll, can_focus=False):
    """A page below or beside the table; keys and the mouse wheel scroll it."""

    class Resized(Message):
        """The page has another size."""

    NAME: ClassVar[str]
    """Name in the action of its key: `pane('motors')`."""
    EXPLAINS_ROW: ClassVar[bool] = False
    """Whether it is about the cursor's row: it is then as tall as its text, up to half a screen."""
    REDRAW_S: ClassVar[float] = 0.0
    """Shortest time between two drawings, seconds."""
    is_behind: ClassVar[bool] = False
    """Whether it must be drawn again although nothing changed."""
    HINT: ClassVar[str] = HINT
    """Its keys."""

    class Pointed(Message):
        """The mouse is on a field of the cursor's row."""

        def __init__(self, field: int) -> None:
            super().__init__()
            self.field = field

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

    def on_mouse_move(self, event: MouseMove) -> None:
        """Post the field under the mouse."""
        field = event.style.meta.get(FIELD)
        if isinstance(field, int):
            self.post_message(self.Pointed(field))

    def on_resize(self) -> None:
        """Post the message."""
        self.post_message(self.Resized())

    @abstractmethod
    def draw(self, context: PaneContext) -> None:
        """Draw the context with `set_title` and `set_page`."""

    def scroll_lines(self, by: int) -> None:
        """Scroll by lines, or choose another one in a list."""
        self.scroll_relative(y=by, animate=False)

    def aside(self, by: int) -> bool:
        """Choose another column, to the right (`by` 1) or left (-1); False where there are none."""
        return False

    @property
    def chosen_span(self) -> tuple[int, int] | None:
        """Start and end of the chosen column, nanoseconds since 1970 UTC; None without one."""
        return None

    def forget_choice(self) -> None:
        """Choose no column, as the pane closes."""

    def zoom(self, by: int) -> None:
        """Show more time (`by` 1) or less (-1), in panes over time."""

    def forget_texts(self) -> None:
        """Draw everything anew the next time."""
        self._wanted, self._drawn = (), None

    def switch_range(self) -> None:
        """Show outliers, or leave them out, in panes with plots."""

    @property
    def page_size(self) -> Size:
        """Cells for the page; one column is reserved for the scroll bar."""
        region = self.scrollable_content_region
        bar = 0 if self.show_vertical_scrollbar else 1
        return Size(max(1, region.width - bar), max(1, region.height))

    @property
    def hint(self) -> str:
        """The keys that have an effect now; those that fit are shown after the title."""
        return self.HINT

    def set_title(self, *titles: str) -> None:
        """Set the first title that fits, or else the last."""
        width = self.size.width - _CORNERS
        title = first_fitting(titles, width)
        *keys, close = _KEY_GAP.split(_(self.hint))
        hints = (_KEY_SPACE.join((*keys[:n], close)) for n in range(len(keys), -1, -1))
        text = first_fitting((*(f"{title}{_KEY_SPACE}{hint}" for hint in hints), title), width)
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
        before = self._drawn
        if before is None or page != before or page.spans != before.spans:
            self._drawn = page
            # A layout of the whole screen takes twice as long as the drawing.
            lines_stay = before is not None and before.plain.count("\n") == page.plain.count("\n")
            self._page.update(page, layout=not lines_stay)
