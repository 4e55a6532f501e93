"""The help: a page of keys and signs, and one of filters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, Final

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from fte_sniff.analysis.filter.row_filter import EXAMPLES
from fte_sniff.analysis.motors import Trouble
from fte_sniff.errors import listed
from fte_sniff.formats.looks import LOOKS, ORDER_MARK
from fte_sniff.i18n import _, later
from fte_sniff.protocol.columns import COLUMNS
from fte_sniff.protocol.spec import MOTORS, Fault, online_bit_text, status_of
from fte_sniff.tui.cells import RAISED_MARK, TimeStyle
from fte_sniff.tui.commands import SECTIONS
from fte_sniff.tui.detail import UNCERTAIN_ORDER
from fte_sniff.tui.painter import EVENT_SIGN, Sign

Pairs = Sequence[tuple[str, str]]
"""Keys, signs or names, each with its meaning, in the language of the screen."""

RAISED: Final = later("ERROR is not 00, or ONLINE is not 0F")
EVENT: Final = later("a port event, or rows that are missing: not a row")

STATES: Final = {
    Trouble.NONE: later("its commands are answered, and nothing is wrong"),
    Trouble.LATE: later(
        "more answers than before, or than of the others, take twice as long as usual"
    ),
    Trouble.OFF_TARGET: later("its feedback is far from its target"),
    Trouble.DAMAGE: later("more than 2 % of its rows are damaged"),
    Trouble.UNANSWERED: later("more than 2 % of its commands have no answer"),
    Trouble.ERROR: later("its ERROR byte is not 00"),
    Trouble.OFFLINE: later(
        "its bit of ONLINE is 0; which bit is which motor is an assumption: {bits}"
    ),
    Trouble.SILENT: later("it gets commands and sends nothing"),
    Trouble.UNKNOWN: later("no commands and no feedback"),
}
"""What each state of a motor means, in the last 10 s."""


def _key_sections() -> Iterator[tuple[str, Pairs]]:
    for heading, commands in SECTIONS:
        keys: dict[str, str] = {}
        for command in commands:
            meaning = _(command.meaning)
            keys[meaning] = f"{keys.get(meaning, '')} {command.key_display}".strip()
        yield _(heading), [(names, meaning) for meaning, names in keys.items()]
    bits = _(listed(online_bit_text(motor) for motor in MOTORS))
    yield (
        _("States of a motor"),
        [(_(one.value), _(meaning, bits=bits)) for one, meaning in STATES.items()],
    )
    signs = [(look.mark, status.value) for status, look in LOOKS.items()]
    signs += [(RAISED_MARK, _(RAISED)), (ORDER_MARK, _(UNCERTAIN_ORDER))]
    signs += [(sign.value, _(sign.meaning)) for sign in Sign if sign.meaning]
    yield _("Signs of rows"), [*signs, (EVENT_SIGN, _(EVENT))]
    yield _("Times"), [(_(style.value), _(style.meaning)) for style in TimeStyle]


def _filter_sections() -> Iterator[tuple[str, Pairs]]:
    yield _("Filters"), [(example, _(meaning)) for example, meaning in EXAMPLES]
    yield (
        _("Columns, and names in a filter"),
        [(column.name, _(column.meaning)) for column in COLUMNS],
    )
    yield (
        _("Faults"),
        [(f"{LOOKS[status_of((one,))].mark} {one}", _(one.meaning)) for one in Fault],
    )


PAGES: Final = (
    (later("Keys and signs"), _key_sections),
    (later("Filters"), _filter_sections),
)


def help_text(page: int) -> Group:
    """A page: a table under each heading."""
    parts = list[RenderableType]()
    for heading, pairs in PAGES[page][1]():
        table = Table.grid(padding=(0, 2, 0, 0))
        for name, meaning in pairs:
            table.add_row(Text(f"  {name}", "bold"), Text(meaning))
        parts += [Text(heading, "bold"), table, ""]
    return Group(*parts[:-1])


class HelpPage(ModalScreen[None]):
    """The help over the screen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,question_mark,enter", "dismiss", show=False),
        Binding("tab,f,right,left", "turn", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._page = 0
        self._text = Static()
        self._box = VerticalScroll(self._text, id="help")

    def compose(self) -> ComposeResult:
        """The page."""
        yield self._box

    def on_mount(self) -> None:
        """Show the first page."""
        self._draw()

    def _draw(self) -> None:
        self._text.update(help_text(self._page))
        title, other = PAGES[self._page][0], PAGES[1 - self._page][0]
        self._box.border_title = Text(_(title))
        self._box.border_subtitle = Text(_("tab: {page}   esc: back", page=_(other)))

    def action_turn(self) -> None:
        """Show the other page."""
        self._page = 1 - self._page
        self._box.scroll_home(animate=False)
        self._draw()
