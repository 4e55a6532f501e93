"""The commands of the screen: their keys, what they run, and when they can work.

Keys are those of less, lnav and termshark, without those of tmux. The footer shows the keys with a
short text that work now; the help shows all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Flag, auto
from functools import partial
from typing import Final

from textual.keys import format_key

from fte_sniff.i18n import _, later
from fte_sniff.protocol.spec import MOTORS


class Needs(Flag):
    """What must be there for a command to work."""

    NOTHING = 0
    ROWS = auto()
    """A row is shown."""
    BELOW = auto()
    """The end is not followed."""
    RUNS = auto()
    """More rows can come."""
    PANE = auto()
    """A page is open."""
    PLOTS = auto()
    """The page of motors is open."""
    FILTER = auto()
    EARLIER = auto()
    """Something else was shown before."""
    SEARCH = auto()
    FAULTS = auto()
    """A row is not `ok`."""
    SAVES = auto()
    """The command line is open, and what is typed can have a name."""
    ANYWHERE = auto()
    """The command line may be open; other commands need that it is closed."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command: its keys, what it runs, and its texts, in English."""

    keys: str
    """By Textual's names, joined by `,`; empty for a command of the palette alone."""
    run: str
    """The owner and its method: `table.page(1)`; unique."""
    meaning: str
    short: str = ""
    """Its text in the footer, where it is not empty."""
    needs: Needs = Needs.NOTHING

    @property
    def key_display(self) -> str:
        """Its keys as they are written on the screen."""
        return " ".join(map(key_name, filter(None, self.keys.split(","))))


KEY_NAMES: Final = frozenset(
    (
        *(later("space"), later("up"), later("down"), later("left"), later("right")),
        *(later("enter"), later("backspace"), later("tab")),
    )
)
"""Keys that are written as words, not as signs."""


def key_name(key: str) -> str:
    """The name of a key in the language of the screen."""
    return _(key) if key in KEY_NAMES else format_key(key).replace("ctrl+", "^")


_rows = partial(Command, needs=Needs.ROWS)
_pane = partial(Command, needs=Needs.PANE)
_plots = partial(Command, needs=Needs.PLOTS)
_anywhere = partial(Command, needs=Needs.ANYWHERE)

MOVE: Final = (
    _anywhere("up,k", "app.move(-1)", "one row up; leaves the end"),
    _anywhere("down,j", "app.move(1)", "one row down"),
    Command("pageup,ctrl+u", "app.page(-1)", "one page up"),
    Command("pagedown,ctrl+d", "app.page(1)", "one page down"),
    Command("home,g", "table.jump(0)", "the first row"),
    Command("G,end", "table.follow", "the last row, and follow what comes", "End", Needs.BELOW),
    Command("left,h", "app.aside(-1)", "columns to the left"),
    Command("right,l", "app.aside(1)", "columns to the right"),
    _anywhere("tab", "app.next_part", "motors, table, pane: the next has the keys"),
    _rows("colon", "goto.ask", "go to a row (1200), 50%, a time (12:00:03.5), +2s"),
)
FIND: Final = (
    Command("f", "filters.ask", "filter the rows: motor = 1 AND rpm > 500", "Filter"),
    Command("F", "filters.accept('')", "show all rows again", "All", Needs.FILTER),
    Command("backspace", "app.back", "return to what was shown before", "Back", Needs.EARLIER),
    _rows("x", "filters.only", "show only rows that are like this one in a column"),
    _rows("X", "filters.without", "hide rows that are like this one in a column"),
    Command("slash", "search.ask", "find bytes (hex:AA ?? 03), a word, or a filter", "Search"),
    Command("n", "search.again(1)", "the next match", "Next", Needs.SEARCH),
    Command("N", "search.again(-1)", "the previous match", "", Needs.SEARCH),
    Command("e", "find.row('fault', 1)", "the next row with a fault", "Fault", Needs.FAULTS),
    _rows("E", "find.row('fault', -1)", "the previous row with a fault"),
    _rows("a", "find.row('raised', 1)", "the next raised ERROR or ONLINE"),
    _rows("A", "find.row('raised', -1)", "the previous raised ERROR or ONLINE"),
    _rows("right_curly_bracket", "find.row('unanswered', 1)", "the next command without an answer"),
    _rows("left_curly_bracket", "find.row('unanswered', -1)", "the previous unanswered command"),
    _rows("R", "find.related", "from a command to its answer, or back"),
    _rows("o", "find.landmark(1)", "the next lost port or gap"),
    _rows("O", "find.landmark(-1)", "the previous lost port or gap"),
    _rows("m", "notes.mark", "mark the row, or remove its mark"),
    _rows("number_sign", "notes.ask", "write a note on the row; an empty one removes it"),
    _rows("u", "notes.to_mark(1)", "the next marked row"),
    _rows("U", "notes.to_mark(-1)", "the previous marked row"),
)
_ONE = "one motor in the pane, or all again"
UNDERSTAND: Final = (
    Command(
        "exclamation_mark",
        "app.switch('findings')",
        "what is wrong: cause, motor, time",
        "Findings",
    ),
    Command("M", "app.switch('motors')", "target and feedback of each motor", "Motors"),
    Command("T", "app.switch('streams')", "rates, answers and faults by kind and motor", "Streams"),
    _rows("i", "app.switch('detail')", "what each byte means (also enter)"),
    Command("enter", "app.open", "the rows of what is chosen, or what each byte means"),
    _rows("right_square_bracket", "app.field(1)", "look at the next field"),
    _rows("left_square_bracket", "app.field(-1)", "look at the previous field"),
    *(Command(f"{motor}", f"app.motor({motor})", _ONE) for motor in MOTORS),
    _plots("z", "motors.zoom(-1)", "less time in the plots"),
    _plots("Z", "motors.zoom(1)", "more time in the plots"),
    _pane("J", "pane.move(1)", "the pane: one line down"),
    _pane("K", "pane.move(-1)", "the pane: one line up"),
)
HANDLE: Final = (
    Command("p,space", "table.pause", "freeze the view, never the capture", "Pause", Needs.RUNS),
    _rows("v", "app.select", "select rows from here to the cursor, for y, Y and w"),
    _rows("y", "export.copy_text", "copy the row decoded"),
    _rows("Y,c", "export.copy_hex", "copy the row's bytes as hex"),
    _rows("w", "export.ask", "save the selected rows, or all that are shown, to a file"),
    Command("P", "export.picture", "save a screenshot as SVG"),
    Command("t", "app.times", "times: UTC, local, since the first row, since a mark"),
    Command("d", "app.changes", "highlight bytes that changed"),
    Command("C", "columns.ask", "choose columns and their order"),
    Command("ctrl+t", "app.theme", "another theme"),
    Command("ctrl+s", "line.save", "save the filter by a name", "Save", Needs.SAVES),
    _anywhere("escape", "app.dismiss", "cancel: a save, selection, notice, search or pane"),
    Command("question_mark", "app.help", "all keys and signs", "Help"),
    Command("q", "app.leave", "close the pane; quit; a second q stops a recording", "Quit"),
    Command("Q", "app.quit", "quit at once, and print where the recording is"),
    Command("ctrl+z", "app.suspend", "to the shell until `fg`; a capture goes on"),
)
UNBOUND: Final = (Command("", "app.language", "switch the language: English, Chinese"),)
"""The command of the palette alone."""

SECTIONS: Final[tuple[tuple[str, tuple[Command, ...]], ...]] = (
    ("Move", MOVE),
    ("Find", FIND),
    ("Understand", UNDERSTAND),
    ("Handle", HANDLE),
)
"""The keys in the help, under their headings."""

FOOTER: Final = (
    " question_mark q f exclamation_mark M T slash ctrl+s F n backspace p,space G,end e "
)
"""The keys of the footer, the most important first."""

COMMANDS: Final[Mapping[str, Command]] = {
    command.run: command for command in (*MOVE, *FIND, *UNDERSTAND, *HANDLE, *UNBOUND)
}
"""All commands by what they run."""
