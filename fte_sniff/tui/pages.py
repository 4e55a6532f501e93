"""The pane beside or below the table, and what its pages have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Generic, TypeVar

from rich.console import Console, Group, RenderableType
from rich.style import Style
from rich.text import Text
from textual.app import ComposeResult
from textual.containers import VerticalScroll
from textual.events import Click
from textual.geometry import Size
from textual.message import Message
from textual.widgets import Static

from fte_sniff.analysis.motors import MotorState
from fte_sniff.i18n import _
from fte_sniff.tui.table import RowTable
from fte_sniff.tui.view import Span, View

LINE: Final = "line"
"""Key in the meta data of a style, under which the number of a line that can be chosen is."""

CHOSEN: Final = "chosen"
"""Key under which is whether it is the chosen line."""

Listed = TypeVar("Listed")


@dataclass(frozen=True, slots=True)
class Context:
    """What a page draws, at one moment."""

    view: View
    span: Span
    states: Sequence[MotorState]
    """The motors at the end of the span."""
    table: RowTable
    """It has the cursor's row, and how rows look."""
    size: Size
    """Cells for the text."""

    def row_text(self, index: int) -> str:
        """The number of a row among those shown."""
        shown = self.view.shown
        if not shown.has(index):
            return _("a row that the filter hides")
        return _("row {number:,}", number=shown.position_of(index) + 1)


class Page(ABC):
    """One kind of pane: a text as a function of the context."""

    NAME: ClassVar[str]
    """Name in the command of its key: `panes.switch('motors')`."""
    SHORT: ClassVar[bool] = False
    """Whether the pane is only as high as its text, so that the table keeps the rest."""
    EXPLAINS_ROW: ClassVar[bool] = False
    """Whether it is about the cursor's row, which then should not move away."""

    @abstractmethod
    def title(self, context: Context) -> str:
        """The title, the most important first: it is cut where the pane is narrow."""

    @abstractmethod
    def text(self, context: Context) -> Text:
        """The page."""

    def move(self, by: int) -> bool:
        """Choose another line; False where none can be chosen, so that the page scrolls."""
        return False


class ListPage(Page, Generic[Listed]):
    """A page with a list, in which one line is chosen."""

    def __init__(self) -> None:
        self.listed: Sequence[Listed] = ()
        self.at = 0
        """The chosen line."""

    @property
    def chosen(self) -> Listed | None:
        """That to which enter leads; None in an empty list."""
        return self.listed[self.at] if self.listed else None

    def choose(self, at: int) -> None:
        """Choose the line with a number, or the nearest."""
        self.at = max(0, min(at, len(self.listed) - 1))

    def move(self, by: int) -> bool:
        """Choose the next line (`by` 1), or the one before (-1)."""
        self.choose(self.at + by)
        return bool(self.listed)

    def meta(self, number: int) -> Style:
        """What finds a line again: for the mouse, and for the chosen one to be in view."""
        return Style(meta={LINE: number, CHOSEN: number == self.at})


def text_of(*parts: RenderableType, width: int) -> Text:
    """Tables and texts, wrapped to some cells."""
    console = Console(width=width, markup=False, emoji=False, highlight=False)
    segments = console.render(Group(*parts), console.options)
    text = Text.assemble(*((one.text, one.style or "") for one in segments))
    text.right_crop(1)  # the end of the last line
    return text


class Pane(VerticalScroll, can_focus=False, inherit_bindings=False):
    """Shows one page."""

    class Changed(Message):
        """It has another size, or another line is chosen."""

    def __init__(self) -> None:
        super().__init__()
        self._text = Static()
        self.page: Page | None = None
        """What is shown; None while it is closed."""
        self.display = False

    def compose(self) -> ComposeResult:
        """The text."""
        yield self._text

    def show(self, page: Page | None) -> None:
        """Show a page from its first line on, or close."""
        self.page = page
        self.display = self.can_focus = page is not None
        self.set_class(page is not None and page.SHORT, "-short")
        self.scroll_home(animate=False)

    def draw(self, context: Context) -> None:
        """Draw the page."""
        page = self.page
        if page is None or not self.scrollable_content_region:
            return
        self.border_title = Text(page.title(context))
        text = page.text(context)
        text.no_wrap = True
        before = self._text.content
        if not isinstance(before, Text) or text != before or text.spans != before.spans:
            self._text.update(text, layout=False)
            self._text.styles.height = text.plain.count("\n") + 1
            self.call_after_refresh(self._reveal, text)

    def _reveal(self, text: Text) -> None:
        """Scroll until the chosen line can be seen."""
        styles = ((one.start, one.style) for one in text.spans if isinstance(one.style, Style))
        chosen = next((at for at, style in styles if style.meta.get(CHOSEN)), None)
        if chosen is not None:
            at, height = text.plain[:chosen].count("\n"), self.size.height
            if not self.scroll_y <= at < self.scroll_y + height - 1:
                self.scroll_to(y=max(0, at - height // 2), animate=False)

    @property
    def room(self) -> Size:
        """Cells for the text; one column is reserved for the scroll bar."""
        region = self.scrollable_content_region
        bar = 0 if self.show_vertical_scrollbar else 1
        return Size(max(1, region.width - bar), max(1, region.height))

    def move(self, by: int) -> None:
        """Choose another line, or scroll."""
        if self.page is not None and not self.page.move(by):
            self.scroll_relative(y=by, animate=False)

    def on_resize(self) -> None:
        """Post the message."""
        self.post_message(self.Changed())

    async def on_click(self, event: Click) -> None:
        """Choose the line under the mouse; a double click opens it."""
        line = event.style.meta.get(LINE)
        if isinstance(line, int) and isinstance(self.page, ListPage):
            self.page.choose(line)
            self.post_message(self.Changed())
            if event.chain == 2:
                await self.run_action("app.command('app.open')")
