"""Owns the page of help over the screen: every key, and what the signs in the table mean.

It must not repeat a key or a meaning: keys come from `keys`, faults and
columns from the vocabulary of rows, examples of filters from the filter.
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
from fte_sniff.formats.text_layout import ORDER_MARK
from fte_sniff.protocol import COLUMNS, FAULT_MEANINGS, Status, status_of
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.keys import SECTIONS, key_names, say_keys
from fte_sniff.tui.panes.detail import UNCERTAIN_ORDER
from fte_sniff.tui.status_bar import KeyLine
from fte_sniff.tui.table.columns import MARKS, RAISED_MARK, TimeStyle
from fte_sniff.tui.table.painter import Sign
from fte_sniff.tui.text import padded, wrap

RAISED = later("ERROR or ONLINE tells of a motor that is not in order")

Pair: TypeAlias = tuple[str, str]
"""A key or a name, and what it means."""


def help_pairs() -> Iterator[tuple[str, list[Pair]]]:
    """The page's sections: a heading, and what stands under it."""
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
            (f"{MARKS[status_of((fault,))]} {fault}", _(said))
            for fault, said in FAULT_MEANINGS.items()
        ],
    )
    columns = [(column.name, _(column.meaning)) for column in COLUMNS]
    yield _("Columns, and names in a filter"), columns
    yield _("Filters"), [(example, _(meaning)) for example, meaning in EXAMPLES]


def help_text(width: int) -> Text:
    """The page for so many cells."""
    lines = []
    for heading, pairs in help_pairs():
        lines.append(Text(heading, style="bold"))
        names = min(max(cell_len(left) for left, _words in pairs), width // 2)
        for pair in pairs:
            lines += _pair_lines(pair, names, width)
        lines.append(Text())
    return Text("\n", no_wrap=True).join(lines)


def _pair_lines(pair: Pair, names: int, width: int) -> Iterator[Text]:
    """Beside each other where there is room, else one below the other."""
    left, right = pair
    indent = " " * (names + 4)
    words = wrap(right, max(8, width - len(indent)))
    if cell_len(left) <= names:
        first = words.pop(0) if words else ""
        yield Text.assemble("  ", (padded(left, names), "bold"), "  ", first)
    else:
        yield from (Text("  " + line, style="bold") for line in wrap(left, max(8, width - 2)))
    yield from (Text(indent + line) for line in words)


class HelpPage(ModalScreen[None]):
    """The page of help; any of its keys puts it away."""

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
        say_keys(self)
        self._text = Static()
        # Kept by name: what comes after the page is put away finds nothing on the screen.
        self._page = VerticalScroll(self._text, id="help", can_focus=False)
        self._page.border_title = _("Keys and signs")

    def compose(self) -> ComposeResult:
        """One page that can be moved up and down."""
        yield self._page
        yield KeyLine()

    def on_mount(self) -> None:
        """Say at every move how much more there is."""
        self.watch(self._page, "scroll_y", self._tell_more)

    def on_resize(self) -> None:
        """Set the page anew for another width."""
        width = self._page.scrollable_content_region.width
        self._text.update(help_text(width))
        self.call_after_refresh(self._tell_more)

    def _tell_more(self) -> None:
        page = self._page
        below = round(page.max_scroll_y - page.scroll_y)
        more = _("{count} more lines: down, pgdn, end   esc: back").format(count=below)
        page.border_subtitle = more if below > 0 else _("esc: back")

    def action_scroll(self, by: int) -> None:
        """Move the page by lines, when it is laid out: the key may have come before."""
        self.call_after_refresh(self._page.scroll_relative, y=by, animate=False)

    def action_page(self, by: int) -> None:
        """Move the page by what is in view."""
        (self._page.scroll_page_down if by > 0 else self._page.scroll_page_up)(animate=False)

    def action_edge(self, by: int) -> None:
        """Go to the page's end, or its start (below 0)."""
        (self._page.scroll_end if by > 0 else self._page.scroll_home)(animate=False)
