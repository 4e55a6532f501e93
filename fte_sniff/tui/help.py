"""Help page: all keys, and what the signs in the table mean.

Its texts come from `keys`, the row vocabulary and the examples of the filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, TypeAlias

from rich.cells import cell_len
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from fte_sniff.analysis.filter.terms import EXAMPLES
from fte_sniff.formats.cell_text import padded, wrap
from fte_sniff.formats.text_layout import ORDER_MARK
from fte_sniff.protocol import COLUMNS, FAULT_MEANINGS, Status, status_of
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.keys import SECTIONS, key_names, translate_keys
from fte_sniff.tui.panes.detail import UNCERTAIN_ORDER
from fte_sniff.tui.status_bar import KeyLine
from fte_sniff.tui.table.columns import MARKS, RAISED_MARK, TimeStyle
from fte_sniff.tui.table.painter import Sign

RAISED = later("ERROR or ONLINE reports that a motor is not in order")

Pair: TypeAlias = tuple[str, str]
"""A key or a name, and its meaning."""


def help_pairs() -> Iterator[tuple[str, list[Pair]]]:
    """Sections of the page: a heading and its pairs."""
    for heading, keys in SECTIONS:
        yield _(heading), [(key_names(key), _(key.tooltip)) for key in keys]
    signs = [(MARKS[status], status.value) for status in Status]
    signs.append((RAISED_MARK, _(RAISED)))
    signs.append((ORDER_MARK, _(UNCERTAIN_ORDER)))
    signs += [(sign, _(sign.meaning)) for sign in Sign if sign.meaning]
    yield _("Signs before a row"), signs
    yield _("Times"), [(_(style), _(style.meaning)) for style in TimeStyle]
    yield (
        _("Faults"),
        [
            (f"{MARKS[status_of((fault,))]} {fault}", _(meaning))
            for fault, meaning in FAULT_MEANINGS.items()
        ],
    )
    columns = [(column.name, _(column.meaning)) for column in COLUMNS]
    yield _("Columns, and names in a filter"), columns
    yield _("Filters"), [(example, _(meaning)) for example, meaning in EXAMPLES]


def help_text(width: int) -> Text:
    """The page in `width` cells."""
    lines = []
    for heading, pairs in help_pairs():
        lines.append(Text(heading, style="bold"))
        left_width = min(max(cell_len(left) for left, _right in pairs), width // 2)
        for pair in pairs:
            lines += _pair_lines(pair, left_width, width)
        lines.append(Text())
    return Text("\n", no_wrap=True).join(lines)


def _pair_lines(pair: Pair, left_width: int, width: int) -> Iterator[Text]:
    """Side by side where the left side fits, else one below the other."""
    left, right = pair
    indent = " " * (left_width + 4)
    lines = wrap(right, max(8, width - len(indent)))
    if cell_len(left) <= left_width:
        first = lines.pop(0) if lines else ""
        yield Text.assemble("  ", (padded(left, left_width), "bold"), "  ", first)
    else:
        yield from (Text("  " + line, style="bold") for line in wrap(left, max(8, width - 2)))
    yield from (Text(indent + line) for line in lines)


class HelpPage(ModalScreen[None]):
    """The help page over the screen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(keys, action, short, priority=True, show=bool(short), key_display=display)
        for keys, action, short, display in (
            ("escape,question_mark,q,enter", "dismiss", later("Back"), "esc"),
            ("down,j", "scroll(1)", later("Down"), "down"),
            ("up,k", "scroll(-1)", later("Up"), "up"),
            ("pagedown,ctrl+d,space", "page(1)", later("Page"), "space"),
            ("pageup,ctrl+u", "page(-1)", "", None),
            ("home,g", "edge(-1)", later("Start"), "g"),
            ("end,G", "edge(1)", later("End"), "G"),
        )
    ]

    def __init__(self) -> None:
        super().__init__()
        translate_keys(self)
        self._text = Static()
        # An attribute, since a query finds nothing once the page is dismissed.
        self._page = VerticalScroll(self._text, id="help", can_focus=False)
        self._page.border_title = _("Keys and signs")

    def compose(self) -> ComposeResult:
        """The page and its keys."""
        yield self._page
        yield KeyLine()

    def on_mount(self) -> None:
        """Update the subtitle when the page is scrolled."""
        self.watch(self._page, "scroll_y", self._show_rest)

    def on_resize(self) -> None:
        """Wrap the page to the new width."""
        width = self._page.scrollable_content_region.width
        self._text.update(help_text(width))
        self.call_after_refresh(self._show_rest)

    def _show_rest(self) -> None:
        page = self._page
        below = round(page.max_scroll_y - page.scroll_y)
        more = _("{count} more lines: down, pgdn, end   esc: back").format(count=below)
        page.border_subtitle = more if below > 0 else _("esc: back")

    def action_scroll(self, by: int) -> None:
        """Scroll by lines, once the page is laid out."""
        self.call_after_refresh(self._page.scroll_relative, y=by, animate=False)

    def action_page(self, by: int) -> None:
        """Scroll by a page."""
        (self._page.scroll_page_down if by > 0 else self._page.scroll_page_up)(animate=False)

    def action_edge(self, by: int) -> None:
        """Go to the end, or to the start (negative)."""
        (self._page.scroll_end if by > 0 else self._page.scroll_home)(animate=False)
