"""The commands of the screen: their keys, the key line, the help and the palette.

Keys are those of less, lnav and termshark, without those of tmux. Each has priority: it acts before
the next key is handled, so that keys that are typed ahead go to the field that an earlier key
opened.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum
from functools import partial
from typing import cast

from textual.binding import Binding, BindingType
from textual.keys import format_key

from fte_sniff.protocol import MOTORS
from fte_sniff.tui.i18n import _, later


class Mode(StrEnum):
    """What the view does, as an English word."""

    LOADING = "LOADING"
    LIVE = "LIVE"
    FOLLOWING = "FOLLOWING"
    WAITING = "WAITING"
    SCROLLED = "SCROLLED"
    PAUSED = "PAUSED"
    PLAYING = "PLAYING"
    HELD = "PAUSED AT"
    ENDED = "ENDED"
    FILE = "FILE"


_OF_FILE = (Mode.LOADING, Mode.FILE)
_OF_PLAYBACK = (Mode.PLAYING, Mode.HELD)
_HELD = (Mode.PAUSED, Mode.HELD)


class Where(Enum):
    """Where a command may act."""

    ROWS = "rows"
    """On the table, which first comes back in place of the top view."""
    VIEW = "view"
    """On the table and on the top view."""
    ANYWHERE = "anywhere"
    """Also while a field or a page is open."""


@dataclass(frozen=True)
class Command(Binding):
    """A command: its keys, its texts, and what it calls."""

    run: str = ""
    """The owner and its method, without `action_`: `table.fault(1)`; unique."""
    where: Where = Where.VIEW
    rank: int = 0
    """Its importance in the key line, 1 is the most important; 0 before all, for one view."""
    words: str = ""
    """Further words by which the palette finds it."""
    instead: Mapping[Mode, str] = field(default_factory=dict, hash=False)
    """Its text in the key line in some modes."""


def action_of(run: str) -> str:
    """The action of a binding that runs a command."""
    return f"app.command({run!r})"


KEY_NAMES = frozenset(
    (
        *(later("space"), later("up"), later("down"), later("left"), later("right")),
        *(later("enter"), later("backspace")),
    )
)
"""Keys that are written as words, not as signs."""


def _display(key: str) -> str:
    return key if key in KEY_NAMES else format_key(key).replace("ctrl+", "^")


def _key(
    keys: str,
    run: str,
    meaning: str,
    *,
    where: Where = Where.VIEW,
    short: str = "",
    display: str | None = None,
    rank: int = 0,
    words: str = "",
    instead: Mapping[Mode, str] | None = None,
) -> Command:
    """A command; `short` is its text in the key line, where it is not empty."""
    return Command(
        keys,
        action_of(run),
        short or meaning,
        show=bool(short),
        key_display=display or " ".join(map(_display, keys.split(","))),
        priority=True,
        tooltip=meaning,
        run=run,
        where=where,
        rank=rank,
        words=words,
        instead=instead or {},
    )


_rows = partial(_key, where=Where.ROWS)
"""A command on rows: the table comes back first."""

MOVING: tuple[Command, ...] = (
    _rows("up,k", "table.move(-1)", "one row up; leaves the end"),
    _rows("down,j", "table.move(1)", "one row down"),
    _rows("pageup,ctrl+u", "table.page(-1)", "one page up"),
    _rows("pagedown,ctrl+d", "table.page(1)", "one page down"),
    _rows("home,g", "table.first", "the first row", words="top start beginning home"),
    _rows(
        "end,G",
        "table.follow",
        "the last row, and follow what comes, also after enter",
        short="Follow",
        instead=dict.fromkeys((*_OF_FILE, *_OF_PLAYBACK, Mode.ENDED), "End"),
        display="G",
        rank=8,
        words="bottom end tail newest last live",
    ),
    _rows("left,h", "panes.aside(-1)", "columns to the left; a time in the statistics"),
    _rows("right,l", "panes.aside(1)", "columns to the right; a time in the statistics"),
)

FINDING: tuple[Command, ...] = (
    _key(
        "f",
        "filters.ask",
        "filter the rows: motor = 1 AND rpm > 500",
        short="Filter",
        rank=3,
        words="where query sql show only",
    ),
    _key("F", "filters.unfilter", "show all rows again", words="clear remove reset filter"),
    _rows(
        "e",
        "table.fault(1)",
        "the next row with a fault",
        short="Fault",
        rank=4,
        words="next error damage malformed",
    ),
    _rows("E", "table.fault(-1)", "the previous row with a fault", words="error damage malformed"),
    _rows(
        "a",
        "table.raised(1)",
        "the next row whose ERROR or ONLINE is not all in order",
        words="next alarm flag",
    ),
    _rows(
        "A",
        "table.raised(-1)",
        "the previous row whose ERROR or ONLINE is not all in order",
        words="alarm flag",
    ),
    _rows(
        "right_curly_bracket",
        "table.unanswered(1)",
        "the next command without an answer",
        words="next missing reply response silent timeout",
    ),
    _rows(
        "left_curly_bracket",
        "table.unanswered(-1)",
        "the previous command without an answer",
        words="missing reply response silent timeout",
    ),
    _rows(
        "slash",
        "search.ask",
        "find rows that have a text or bytes (hex:AA ?? 03)",
        short="Search",
        rank=6,
        words="find grep text hex bytes",
    ),
    _rows("n", "search.again(1)", "the next hit of the search"),
    _rows("N", "search.again(-1)", "the previous hit of the search"),
    _rows(
        "x",
        "filters.only",
        "show only rows that are like this one in a cell",
        words="filter by cell include",
    ),
    _rows(
        "X",
        "filters.without",
        "hide rows that are like this one in a cell",
        words="filter by cell exclude",
    ),
    _key(
        "backspace",
        "filters.filter_before",
        "return to the previous filter",
        words="undo back filter",
    ),
    _rows("m", "notes.mark", "mark the row, or remove its mark", words="bookmark flag"),
    _rows(
        "number_sign",
        "notes.ask",
        "write a note on the row; an empty one removes it",
        words="comment remark annotate text label",
    ),
    _rows("u", "notes.to_mark(1)", "the next marked row"),
    _rows("U", "notes.to_mark(-1)", "the previous marked row"),
    _rows(
        "o",
        "table.landmark(1)",
        "the next lost port or gap",
        words="next gap lost port disconnect missing",
    ),
    _rows(
        "O",
        "table.landmark(-1)",
        "the previous lost port or gap",
        words="gap lost port disconnect missing",
    ),
    _rows(
        "colon",
        "goto.ask",
        "go to a row (1200), 50%, a time (12:00:03.5), away (+2s), @byte",
        words="jump seek time row number offset",
    ),
)

HANDLING: tuple[Command, ...] = (
    _key(
        "space,p",
        "playback.pause",
        "freeze the view, never the capture; play a file from here",
        short="Pause",
        instead=dict.fromkeys(_OF_FILE, "Play") | dict.fromkeys(_HELD, "Continue"),
        display="space",
        rank=7,
        words="stop freeze hold play playback",
    ),
    _key(
        "less_than_sign",
        "playback.speed(-1)",
        "play more slowly, down to 0.1×",
        words="playback slow",
    ),
    _key(
        "greater_than_sign", "playback.speed(1)", "play faster, up to 100×", words="playback fast"
    ),
    _rows(
        "v",
        "table.select",
        "select rows from here to the cursor, for y, Y and w",
        words="range block rows",
    ),
    _rows(
        "y",
        "export.copy_text",
        "copy the row decoded (through the terminal, OSC 52)",
        words="clipboard yank",
    ),
    _rows("Y,c", "export.copy", "copy the row's bytes as hex", words="clipboard yank hex"),
    _key(
        "w",
        "export.ask",
        "save the selected rows, or all that are shown, to a file",
        words="export write csv jsonl parquet mcap hex raw txt",
    ),
    _key(
        "P",
        "export.picture",
        "save a screenshot as SVG",
        words="screenshot image export svg print",
    ),
    _rows(
        "t",
        "table.times",
        "times: UTC, local, since the first row, since a mark",
        words="clock timestamp utc local zone",
    ),
    _rows(
        "d",
        "table.changes",
        "highlight bytes that changed, dim the others",
        words="difference diff cansniffer dim highlight",
    ),
    _rows(
        "C",
        "app.columns",
        "choose columns and their order",
        words="fields layout delta",
    ),
    _key(
        "ctrl+t",
        "app.theme",
        "switch the theme: dark, light, with more contrast",
        words="colours colors dark light contrast appearance",
    ),
    _key("ctrl+p", "app.palette", "find a command by its name"),
    _key(
        "escape",
        "app.dismiss",
        "cancel: a save, selection, search, notice or pane",
        words="escape close back",
    ),
)

UNDERSTANDING: tuple[Command, ...] = (
    _rows(
        "i",
        "panes.switch('detail')",
        "what each byte means (also enter)",
        short="Detail",
        rank=9,
        words="explain decode inspect row",
    ),
    _key(
        "exclamation_mark",
        "panes.switch('findings')",
        "what is wrong: cause, motor and time; enter shows its rows",
        short="Findings",
        rank=5,
        words="findings problem trouble cause error diagnose",
    ),
    _rows(
        "right_square_bracket",
        "panes.field(1)",
        "look at the next field of the row",
        words="next byte highlight",
    ),
    _rows(
        "left_square_bracket",
        "panes.field(-1)",
        "look at the previous field",
        words="byte highlight",
    ),
    _rows(
        "R",
        "table.related",
        "from a command to its answer, or back",
        words="answer reply response request pair jump",
    ),
    _rows(
        "b",
        "panes.switch('bytes')",
        "the bytes around the row",
        words="hex dump",
    ),
    _key(
        "M",
        "panes.switch('motors')",
        "target and feedback of each motor",
        short="Motors",
        rank=10,
        words="plot curve chart graph rpm speed",
    ),
    _key(
        "T",
        "app.top",
        "one line for each kind and motor, in place of the table",
        short="Top",
        rank=11,
        words="htop sorted summary overview streams live",
    ),
    _key(
        "S",
        "panes.switch('statistics')",
        "rates, use of the line, faults over time",
        short="Stats",
        rank=12,
        words="stats rates counters",
    ),
    *(
        _key(f"{motor}", f"panes.motor({motor})", "one motor on the whole screen, or all again")
        for motor in MOTORS
    ),
    _key("z", "panes.change('zoom', -1)", "less time in the plots of the motors", words="zoom in"),
    _key("Z", "panes.change('zoom', 1)", "more time in the plots of the motors", words="zoom out"),
    _key(
        "r",
        "panes.change('switch_range')",
        "outliers of the motors: markers at the edge, or the full range",
    ),
    _key("plus", "panes.grow(1)", "a larger pane"),
    _key("minus", "panes.grow(-1)", "a smaller pane"),
    _key("L", "panes.move", "the pane beside the table or below it, from 160 columns on"),
    _key("J", "panes.change('scroll_lines', 1)", "scroll the pane down"),
    _key("K", "panes.change('scroll_lines', -1)", "scroll the pane up"),
)

TOP: tuple[Command, ...] = (
    _key("enter", "app.choose", "the rows of this kind and motor, as a filter", short="Rows"),
    _key("full_stop", "top.sort(1)", "sort by the next column", short="Sort"),
    _key("comma", "top.sort(-1)", "sort by the previous column"),
    _key("I", "top.reverse", "sort the other way round", short="Reverse"),
    _key("up,k", "top.move_line(-1)", "one line up"),
    _key("down,j", "top.move_line(1)", "one line down"),
    _key("pageup,ctrl+u", "top.page_lines(-1)", "one page up"),
    _key("pagedown,ctrl+d", "top.page_lines(1)", "one page down"),
)

LEAVING: tuple[Command, ...] = (
    _key(
        "question_mark",
        "app.help",
        "all keys and signs",
        short="Help",
        rank=1,
        words="keys shortcuts manual",
    ),
    _key(
        "q",
        "app.leave",
        "close the pane; quit; a recording is stopped by a second q",
        short="Quit",
        rank=2,
        words="exit close end",
    ),
    _key(
        "Q,ctrl+q",
        "app.quit",
        "quit at once, and print where the recording is",
        words="exit close end",
    ),
    _key(
        "ctrl+z",
        "app.suspend_process",
        "to the shell until `fg`; a capture goes on",
        words="background shell",
    ),
)

UNBOUND: tuple[Command, ...] = (
    _key(
        "",
        "app.language",
        "switch the language: English, Chinese",
        words="locale english chinese 中文 translation",
    ),
    _rows(
        "",
        "table.events",
        "show or hide the lines of port events and gaps",
        words="separator port lines hide show",
    ),
    _rows("", "notes.notes", "list all marks and notes", words="bookmarks comments annotations"),
)
"""Commands of the palette alone."""

INTERRUPT = _key("ctrl+c", "app.interrupt", "copy a selection, or quit", where=Where.ANYWHERE)
"""Quits, but copies where text is selected in a field."""

OPENING = _rows("enter", "app.open", "what each byte means, or the rows of a finding")
"""A key of the table alone: the top view has its own."""

COMMANDS: Mapping[str, Command] = {
    command.run: command
    for command in (
        *(*FINDING, *UNDERSTANDING, *HANDLING, *UNBOUND, *MOVING, *LEAVING),
        *(*TOP, INTERRUPT, OPENING),
    )
}
"""All commands by what they run."""

PALETTE: tuple[Command, ...] = tuple(
    command
    for command in COMMANDS.values()
    if command not in (*TOP, INTERRUPT, OPENING) and command.run != "app.palette"
)
"""The commands that the palette lists."""


def _together(commands: tuple[Command, ...]) -> tuple[Command, ...]:
    """The commands, those with one meaning as one with all their keys."""
    by_meaning: dict[str, Command] = {}
    for one in commands:
        other = by_meaning.setdefault(one.tooltip, one)
        if other is not one:
            keys = f"{other.key_display} {one.key_display}"
            by_meaning[one.tooltip] = replace(other, key_display=keys)
    return tuple(by_meaning.values())


SECTIONS: tuple[tuple[str, tuple[Command, ...]], ...] = (
    ("Move", MOVING),
    ("Find", FINDING),
    ("Understand", _together(UNDERSTANDING)),
    ("Top view", TOP[:4]),
    ("Handle", (*HANDLING, *LEAVING)),
)
"""The keys in the help, under their headings."""


def rank_of(binding: Binding) -> int:
    """Its place in the key line; keys that are not of the table, such as a field's, come first."""
    command = _BY_ACTION.get(binding.action)
    return 0 if command is None else command.rank


def short_text(binding: Binding, mode: Mode = Mode.LIVE) -> str:
    """What a key does, in the key line in a mode."""
    command = _BY_ACTION.get(binding.action)
    instead = {} if command is None else command.instead
    return _(instead.get(mode, binding.description))


_BY_ACTION = {command.action: command for command in COMMANDS.values()}


def _of_list(key: str, short: str) -> Binding:
    """A key for the key line only; the list handles it itself."""
    return Binding(key, f"list('{key}')", short, key_display=_display(key))


_BACK = _of_list("escape", later("Back"))
_MOVES = (_of_list("up", later("Up")), _of_list("down", later("Down")))

PICKING = (_of_list("enter", later("Pick")), _BACK, *_MOVES)

READING = (
    _BACK,
    _of_list("slash", later("Find")),
    _of_list("space", later("Page")),
    *_MOVES,
    _of_list("g", later("Start")),
    _of_list("G", later("End")),
)

CHOOSING = (
    _of_list("enter", later("Apply")),
    _BACK,
    _of_list("space", later("Show")),
    *_MOVES,
)


def key_names(binding: Binding) -> str:
    """Names of a binding's keys, in the language of the screen."""
    names = (binding.key_display or binding.key).split(" ")
    return " ".join(_(name) if name in KEY_NAMES else name for name in names)


def bindings(*groups: tuple[Binding, ...]) -> list[BindingType]:
    """The groups as a class attribute BINDINGS."""
    return [cast(BindingType, binding) for group in groups for binding in group]
