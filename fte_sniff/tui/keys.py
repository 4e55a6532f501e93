"""Key bindings: the single source of the keys, of the key line and of the help.

Keys are those of less, lnav and termshark, without those of tmux. Each has priority: it acts before
the next key is handled, so that keys that are typed ahead go to the field that an earlier key
opened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import cast

from textual import actions
from textual.binding import Binding, BindingType
from textual.dom import DOMNode

from fte_sniff.tui.i18n import _, later


class Where(Enum):
    """Where an action of the key table may act."""

    ROWS = "rows"
    """On the table, which first comes back in place of the top view."""
    VIEW = "view"
    """On the table and on the top view."""
    ANYWHERE = "anywhere"
    """Also while a field or a page is open."""


@dataclass(frozen=True)
class Command(Binding):
    """A key of the key table, and where its action may act."""

    where: Where = Where.VIEW


def _key(
    keys: str,
    action: str,
    short: str,
    meaning: str,
    display: str | None = None,
    where: Where = Where.VIEW,
) -> Command:
    """A command with its text in the key line, if it is shown there, and in the help."""
    return Command(
        keys,
        action,
        short or meaning,
        show=bool(short),
        key_display=display,
        priority=True,
        tooltip=meaning,
        where=where,
    )


def _row_key(
    keys: str, action: str, short: str, meaning: str, display: str | None = None
) -> Command:
    """A command on rows: the table comes back first."""
    return _key(keys, action, short, meaning, display, Where.ROWS)


MOVING: tuple[Command, ...] = (
    _row_key("up,k", "move(-1)", "", "one row up; leaves the end", "up k"),
    _row_key("down,j", "move(1)", "", "one row down", "down j"),
    _row_key("pageup,ctrl+u", "page(-1)", "", "one page up", "pgup ^u"),
    _row_key("pagedown,ctrl+d", "page(1)", "", "one page down", "pgdn ^d"),
    _row_key("home,g", "first", "", "the first row", "home g"),
    _row_key(
        "end,G", "follow", "Follow", "the last row, and follow what comes, also after enter", "G"
    ),
    _row_key("left,h", "aside(-1)", "", "columns to the left", "left h"),
    _row_key("right,l", "aside(1)", "", "columns to the right", "right l"),
)

OPENING = Binding("enter", "app.pane('detail')", show=False, priority=True)
"""A key of the table alone: the top view has its own."""

FINDING: tuple[Command, ...] = (
    _key("f", "filter", "Filter", "filter the rows: motor = 1 AND rpm > 500", "f"),
    _key("F", "unfilter", "", "show all rows again", "F"),
    _row_key("e", "fault(1)", "Fault", "the next row with a fault", "e"),
    _row_key("E", "fault(-1)", "", "the previous row with a fault", "E"),
    _row_key(
        "a", "raised(1)", "Flags", "the next row whose ERROR or ONLINE is not all in order", "a"
    ),
    _row_key(
        "A", "raised(-1)", "", "the previous row whose ERROR or ONLINE is not all in order", "A"
    ),
    _row_key(
        "slash", "search", "Search", "find rows that have a text or bytes (hex:AA ?? 03)", "/"
    ),
    _row_key("n", "again(1)", "", "the next hit of the search", "n"),
    _row_key("N", "again(-1)", "", "the previous hit of the search", "N"),
    _row_key("x", "only", "", "show only rows that are like this one in a cell", "x"),
    _row_key("X", "without", "", "hide rows that are like this one in a cell", "X"),
    _key("backspace", "filter_before", "", "return to the previous filter", "backspace"),
    _row_key("m", "mark", "", "mark the row, or remove its mark", "m"),
    _row_key("number_sign", "note", "", "write a note on the row; an empty one removes it", "#"),
    _row_key("u", "to_mark(1)", "", "the next marked row", "u"),
    _row_key("U", "to_mark(-1)", "", "the previous marked row", "U"),
    _row_key("o", "landmark(1)", "", "the next lost port or gap", "o"),
    _row_key("O", "landmark(-1)", "", "the previous lost port or gap", "O"),
    _row_key(
        "colon", "goto", "", "go to a row (1200), 50%, a time (12:00:03.5), away (+2s), @byte", ":"
    ),
)

HANDLING: tuple[Command, ...] = (
    _key(
        "space,p",
        "pause",
        "Pause",
        "freeze the view, never the capture; play a file from here",
        "space",
    ),
    _key("less_than_sign", "speed(-1)", "", "play more slowly, down to 0.1×", "<"),
    _key("greater_than_sign", "speed(1)", "", "play faster, up to 100×", ">"),
    _row_key("v", "select", "", "select rows from here to the cursor, for y, Y and w", "v"),
    _row_key("y", "copy_text", "", "copy the row decoded (through the terminal, OSC 52)", "y"),
    _row_key("Y,c", "copy", "", "copy the row's bytes as hex", "Y c"),
    _key("w", "save", "Save", "save the selected rows, or all that are shown, to a file", "w"),
    _key("P", "picture", "", "save a screenshot as SVG or HTML", "P"),
    _row_key("t", "times", "", "times: UTC, local, since the first row, since a mark", "t"),
    _row_key("d", "changes", "", "highlight bytes that changed, dim the others", "d"),
    _row_key("C", "columns", "", "choose columns, their order and widths", "C"),
    _key("ctrl+t", "theme", "", "switch the theme: dark, light, with more contrast", "^t"),
    _key("ctrl+p", "palette", "", "find a command by its name", "^p"),
    _key("escape", "dismiss", "", "cancel: a save, selection, search, notice or pane", "esc"),
)
"""Change the view, copy and save."""

UNDERSTANDING: tuple[Command, ...] = (
    _row_key("i", "pane('detail')", "Detail", "what each byte means (also enter)", "i"),
    _row_key("right_square_bracket", "field(1)", "", "look at the next field of the row", "]"),
    _row_key("left_square_bracket", "field(-1)", "", "look at the previous field", "["),
    _row_key("R", "related", "", "from a command to its answer, or back", "R"),
    _row_key("b", "pane('bytes')", "Bytes", "the bytes around the row", "b"),
    _key("M", "pane('motors')", "Motors", "target and feedback of each motor", "M"),
    _key("T", "top", "Top", "one line for each kind and motor, in place of the table", "T"),
    _key("S", "pane('statistics')", "Stats", "rates, use of the line, faults over time", "S"),
    _key("z", "zoom(-1)", "", "less time in the plots of the motors", "z"),
    _key("Z", "zoom(1)", "", "more time in the plots of the motors", "Z"),
    _key(
        "r", "plot_range", "", "outliers of the motors: markers at the edge, or the full range", "r"
    ),
    _key("plus", "grow_pane(1)", "", "a larger pane; the mouse drags its border", "+"),
    _key("minus", "grow_pane(-1)", "", "a smaller pane", "-"),
    _key("L", "pane_side", "", "the pane beside the table or below it, from 160 columns on", "L"),
    _key("J", "scroll_pane(1)", "", "scroll the pane down", "J"),
    _key("K", "scroll_pane(-1)", "", "scroll the pane up", "K"),
)
"""Panes; the key of the open pane closes it."""

TOP: tuple[Command, ...] = (
    _key("enter", "app.choose", "Rows", "the rows of this kind and motor, as a filter", "enter"),
    _key("full_stop", "sort(1)", "Sort", "sort by the next column", "."),
    _key("comma", "sort(-1)", "", "sort by the previous column", ","),
    _key("I", "reverse", "Reverse", "sort the other way round", "I"),
    _key("up,k", "move_line(-1)", "", "one line up", "up k"),
    _key("down,j", "move_line(1)", "", "one line down", "down j"),
    _key("pageup,ctrl+u", "page_lines(-1)", "", "one page up", "pgup ^u"),
    _key("pagedown,ctrl+d", "page_lines(1)", "", "one page down", "pgdn ^d"),
)

LEAVING: tuple[Command, ...] = (
    _key("question_mark", "help", "Help", "all keys and signs", "?"),
    _key("q", "leave", "Quit", "close the pane; quit; a recording is stopped by a second q", "q"),
    _key("Q,ctrl+q", "quit", "", "quit at once, and print where the recording is", "Q ^q"),
    _key("ctrl+z", "suspend_process", "", "to the shell until `fg`; a capture goes on", "^z"),
)

UNBOUND: tuple[Command, ...] = (
    _key("", "language", "", "switch the language: English, Chinese"),
    _row_key("", "events", "", "show or hide the lines of port events and gaps"),
    _row_key("", "notes", "", "list all marks and notes"),
)

SHOWN_FIRST: tuple[str, ...] = (
    "help",
    "leave",
    "filter",
    "fault(1)",
    "search",
    "top",
    "pause",
    "follow",
    "pane('detail')",
    "pane('motors')",
    "pane('statistics')",
    "pane('bytes')",
    "save",
    "raised(1)",
)
"""Actions in the key line, the most important first."""

COMMANDS: tuple[Binding, ...] = tuple(
    binding
    for binding in (*FINDING, *UNDERSTANDING, *HANDLING, *UNBOUND, *MOVING, *LEAVING)
    if binding.action != "palette"
)

SEARCH_WORDS: Mapping[str, str] = {
    "filter": "where query sql show only",
    "unfilter": "clear remove reset filter",
    "fault(1)": "next error damage malformed",
    "fault(-1)": "error damage malformed",
    "raised(1)": "next alarm flag",
    "raised(-1)": "alarm flag",
    "search": "find grep text hex bytes",
    "only": "filter by cell include",
    "without": "filter by cell exclude",
    "filter_before": "undo back filter",
    "mark": "bookmark flag",
    "note": "comment remark annotate text label",
    "notes": "bookmarks comments annotations",
    "speed(-1)": "playback slow",
    "speed(1)": "playback fast",
    "goto": "jump seek time row number offset",
    "pause": "stop freeze hold play playback",
    "select": "range block rows",
    "copy_text": "clipboard yank",
    "copy": "clipboard yank hex",
    "save": "export write csv jsonl parquet mcap hex raw txt",
    "picture": "screenshot image export svg html print",
    "times": "clock timestamp utc local zone",
    "columns": "fields width layout delta",
    "changes": "difference diff cansniffer dim highlight",
    "events": "separator port lines hide show",
    "related": "answer reply response request pair jump",
    "landmark(1)": "next gap lost port disconnect missing",
    "landmark(-1)": "gap lost port disconnect missing",
    "field(1)": "next byte highlight",
    "field(-1)": "byte highlight",
    "theme": "colours colors dark light contrast appearance",
    "language": "locale english chinese 中文 translation",
    "dismiss": "escape close back",
    "pane('detail')": "explain decode inspect row",
    "pane('bytes')": "hex dump",
    "top": "htop sorted summary overview streams live",
    "pane('motors')": "plot curve chart graph rpm speed",
    "pane('statistics')": "stats rates counters",
    "zoom(-1)": "zoom in",
    "zoom(1)": "zoom out",
    "first": "top start beginning home",
    "follow": "bottom end tail newest last live",
    "help": "keys shortcuts manual",
    "leave": "exit close end",
    "quit": "exit close end",
    "suspend_process": "background shell",
}
"""Further words by which the list of commands finds an action."""


def _of_list(key: str, short: str, display: str) -> Binding:
    """A key for the key line only; the list handles it itself."""
    return Binding(key, f"list('{key}')", short, key_display=display)


_BACK = _of_list("escape", later("Back"), "esc")
_MOVES = (_of_list("up", later("Up"), "up"), _of_list("down", later("Down"), "down"))

PICKING = (_of_list("enter", later("Pick"), "enter"), _BACK, *_MOVES)

CHOOSING = (
    _of_list("enter", later("Apply"), "enter"),
    _BACK,
    _of_list("space", later("Show"), "space"),
    *_MOVES,
)

INTERRUPT = replace(
    _key("ctrl+c", "interrupt", "", "copy a selection, or quit", where=Where.ANYWHERE),
    description="Quit",
)
"""Quits, but copies where text is selected in a field."""

WHERE: Mapping[tuple[str, tuple[object, ...]], Where] = {
    actions.parse(command.action)[1:]: command.where
    for command in (
        *(*MOVING, *FINDING, *HANDLING, *UNDERSTANDING),
        *(*TOP, *LEAVING, *UNBOUND, INTERRUPT),
    )
}
"""Where an action may act, by its name and parameters."""

SECTIONS: tuple[tuple[str, tuple[Binding, ...]], ...] = (
    ("Move", MOVING),
    ("Find", FINDING),
    ("Understand", UNDERSTANDING),
    ("Top view", TOP[:4]),
    ("Handle", (*HANDLING, *LEAVING)),
)


KEY_NAMES = frozenset(
    (
        *(later("space"), later("up"), later("down"), later("left"), later("right")),
        *(later("enter"), later("backspace")),
    )
)


def key_names(binding: Binding) -> str:
    """Names of a binding's keys."""
    names = (binding.key_display or binding.key).split(" ")
    return " ".join(_(name) if name in KEY_NAMES else name for name in names)


def bindings(*groups: tuple[Binding, ...]) -> list[BindingType]:
    """The groups as a class attribute BINDINGS."""
    return [cast(BindingType, binding) for group in groups for binding in group]


def translate_keys(node: DOMNode) -> None:
    """Translate the descriptions of a widget's keys."""
    english = type(node)._merge_bindings().key_to_bindings
    for key, known in english.items():
        # A new list, since the old one belongs to the class.
        node._bindings.key_to_bindings[key] = [
            replace(one, description=_(one.description), tooltip=_(one.tooltip)) for one in known
        ]
