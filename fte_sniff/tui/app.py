"""Owns the screen as a whole: what is on it, the timer that feeds it, and what each key does.

It must not know where rows come from, how they are filtered, or what their bytes mean.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Sequence
from enum import Enum
from time import monotonic_ns
from typing import ClassVar

from textual import on
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.filter import LineFilter
from textual.widgets import Footer, Input

from fte_sniff.analysis.bench import NO_BENCH, Bench
from fte_sniff.analysis.feed import Feed
from fte_sniff.analysis.filter import RowFilter
from fte_sniff.analysis.store import DEFAULT_BOUND
from fte_sniff.errors import FteSniffError, shown
from fte_sniff.protocol import spaced_hex
from fte_sniff.tui.colourless import Colourless
from fte_sniff.tui.help import HelpPage
from fte_sniff.tui.keys import (
    FINDING,
    HANDLING,
    INTERRUPT,
    LEAVING,
    TABLE_ACTIONS,
    UNDERSTANDING,
    bindings,
)
from fte_sniff.tui.notices import NoticeLine
from fte_sniff.tui.panes import Panes
from fte_sniff.tui.prompt.field import Line
from fte_sniff.tui.prompt.filter import FilterField
from fte_sniff.tui.prompt.goto import GotoField, parse_goal
from fte_sniff.tui.status import StatusLine
from fte_sniff.tui.table.header import TableHeader
from fte_sniff.tui.table.widget import RowTable
from fte_sniff.tui.title import TitleLine, mode_of
from fte_sniff.tui.watched import Watched

TICK_S = 1 / 12
"""Between two looks at the feed: soon enough for the eye, seldom enough to stay calm."""

LOW = 16
"""Lines below which a pane has to be content with very few."""

TALL = 40
"""Lines from which on a pane leaves the table more than the few rows it must."""

ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
"""Signals upon which the screen closes and leaves the terminal as it was."""


class AtEnd(Enum):
    """What the screen does when its feed has ended."""

    STAY = "stay"
    """The rows can still be looked at."""
    LEAVE = "leave"
    """The screen closes by itself."""


class SniffApp(App[None]):
    """The screen over one feed."""

    CSS_PATH = "screen.tcss"
    TITLE = "fte-sniff"
    ENABLE_COMMAND_PALETTE = False
    """Textual's palette fails on very small terminals and on keys that are typed ahead."""
    BINDINGS: ClassVar[list[BindingType]] = [
        INTERRUPT,
        *bindings(LEAVING, FINDING, HANDLING, UNDERSTANDING),
    ]

    def __init__(
        self,
        feed: Feed,
        at_end: AtEnd = AtEnd.STAY,
        row_filter: RowFilter | None = None,
        keep_rows: int = DEFAULT_BOUND,
        signals: Sequence[signal.Signals] = ENDING_SIGNALS,
        bench: Bench = NO_BENCH,
    ) -> None:
        """A screen that has not begun.

        Args:
            feed: where rows come from.
            at_end: what to do when no more rows can come.
            row_filter: shows only the rows that it wants, until the user says otherwise.
            keep_rows: rows that can be looked at, at least 1; the oldest leave the screen first.
            signals: upon which the screen closes; others do what they did before.
            bench: what the user said about the set-up.
        """
        super().__init__()
        self.animation_level = "none"
        self.VERTICAL_BREAKPOINTS = [(0, "-tiny"), (LOW, "-low"), (TALL, "-tall")]
        self.failure: FteSniffError | None = None
        """Why the screen had to close, where the feed failed."""
        self._watched = Watched(feed, row_filter, keep_rows)
        self._at_end, self._signals = at_end, signals
        self._title_line, self._header = TitleLine(), TableHeader()
        self._table = RowTable(self._watched.store, self._header)
        self._panes = Panes(self._watched.store, self._table, bench)
        self._notice = NoticeLine()
        self._filter_field, self._goto_field = (
            FilterField(row_filter, self._set_filter),
            GotoField(self._go),
        )
        self._status_line = StatusLine()

    def compose(self) -> ComposeResult:
        """The screen from top to bottom."""
        yield self._title_line
        yield self._header
        yield self._table
        yield from self._panes
        yield self._notice
        yield self._filter_field
        yield self._goto_field
        yield self._status_line
        yield Footer(compact=True, show_command_palette=False)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Whether a key may do this now: a field that asks and the help have keys of their own."""
        if action not in TABLE_ACTIONS:
            return True
        return len(self.screen_stack) == 1 and not isinstance(self.focused, Line)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """What every line drawn goes through last."""
        return [Colourless()] if self.no_color else super().get_line_filters()

    def on_mount(self) -> None:
        """Begin to look at the feed, a file at its first row; end when the system says so."""
        self._table.focus()
        self.tick()
        if not self._watched.state.live:
            self._table.action_first()
        self.set_interval(TICK_S, self.tick)
        loop = asyncio.get_running_loop()
        for number in self._signals:
            # Off the main thread there are no signal handlers; whoever runs it there ends it.
            with contextlib.suppress(RuntimeError, ValueError):
                loop.add_signal_handler(number, self.exit)

    def on_unmount(self) -> None:
        """Give the signals back."""
        loop = asyncio.get_running_loop()
        for number in self._signals:
            with contextlib.suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)

    def tick(self) -> None:
        """Look at the feed, and draw what changed."""
        try:
            news = self._watched.look(monotonic_ns())
        except FteSniffError as failure:
            self.failure = failure
            self.exit()
            return
        self._panes.tell_events(news.events)
        for event in news.events:
            self._notice.tell_event(event)
        if news.trouble:
            self._notice.tell(shown(news.trouble), worry=True)
        if news.ended and self._at_end is AtEnd.LEAVE:
            self.exit()
        elif news.ended and self._watched.state.ended:
            self._notice.tell(f"ended: {shown(self._watched.state.ended)}", worry=True)
        if news.changed:
            self._table.ports = self._watched.ports
            self._table.sync()
        self._show_state()
        state = self._watched.state
        self._panes.tick(monotonic_ns(), state.live and state.running)

    def _show_state(self) -> None:
        """Draw the lines above and below the table, where they changed."""
        watched, view = self._watched, self._table.viewport
        mode = mode_of(watched.state, view.paused, view.following)
        self._title_line.show(watched.state, mode, view.waiting if view.paused else view.below)
        self._status_line.show(watched.numbers(view))
        self._filter_field.tell_shown(watched.shown_words)
        self._table.tell_empty(watched.empty_words)

    @on(RowTable.Moved)
    def _follow_cursor(self) -> None:
        self._show_state()
        self._panes.follow_cursor()

    def _set_filter(self, line: str) -> None:
        self._filter_field.standing = line
        self._watched.set_filter(RowFilter.parse(line) if line else None, self._table.near)
        self._table.sync()

    def _go(self, line: str) -> None:
        if not line:
            return
        row = self._watched.row_of(parse_goal(line), self._table.viewport.cursor)
        if row is None:
            self._notice.tell("no row here has a time to go by", worry=False)
            return
        last = self._table.viewport.count - 1
        self._table.jump(row)
        if row > last >= 0:
            self._notice.tell(f"there is no row {row + 1:,}; this is the last", worry=False)

    def action_filter(self) -> None:
        """Ask for a filter."""
        self._filter_field.ask()

    def action_unfilter(self) -> None:
        """Show all rows again."""
        self._set_filter("")
        self._filter_field.fall_back()

    def action_goto(self) -> None:
        """Ask where to go."""
        self._goto_field.ask()

    def action_fault(self, by: int) -> None:
        """Go to the next row with a fault, or to the one before."""
        if not self._table.jump_to_fault(by):
            where = "below" if by > 0 else "above"
            self._notice.tell(f"no row with a fault {where} this one", worry=False)

    def action_pause(self) -> None:
        """Freeze the view, or let it go on."""
        self._table.pause()

    def action_pane(self, name: str) -> None:
        """Show the pane of that name, or close it; to explain one row is to stay on it."""
        self._panes.toggle(name)
        if self._panes.holds_row:
            self._table.stay()
        self._show_state()

    def action_zoom(self, by: int) -> None:
        """Look at more time, or less."""
        self._panes.zoom(by)

    def action_scroll_pane(self, by: int) -> None:
        """Move the page of the pane."""
        self._panes.scroll(by)

    def action_copy(self) -> None:
        """Hand the row's bytes to the terminal as hex."""
        row = self._table.cursor_row
        if row is not None:
            self.copy_to_clipboard(spaced_hex(row.raw))
            self._notice.tell(f"copied {spaced_hex(row.raw)}", worry=False)

    def action_dismiss(self) -> None:
        """Close the pane, or put the notice away."""
        if self._notice.display:
            self._notice.put_away()
        else:
            self._panes.close()

    def action_leave(self) -> None:
        """End."""
        self.exit()

    def action_help(self) -> None:
        """Show the page of help."""
        self.push_screen(HelpPage())

    def action_interrupt(self) -> None:
        """Copy the selection of a field; where nothing is selected, end."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
        else:
            self.exit()


def run_screen(
    feed: Feed,
    at_end: AtEnd = AtEnd.STAY,
    row_filter: RowFilter | None = None,
    keep_rows: int = DEFAULT_BOUND,
    signals: Sequence[signal.Signals] = ENDING_SIGNALS,
    bench: Bench = NO_BENCH,
) -> int:
    """Show the feed until the user ends it, or a signal does; the feed is then asked to stop.

    Args:
        feed: where rows come from.
        at_end: what to do when no more rows can come.
        row_filter: shows only the rows that it wants, until the user says otherwise.
        keep_rows: rows that can be looked at, at least 1; the oldest leave the screen first.
        signals: upon which the screen closes; others do what they did before.
        bench: what the user said about the set-up.

    Returns:
        0, or another number where the screen itself broke, which then has been said.

    Raises:
        FteSniffError: the feed failed; the terminal is as it was before.
    """
    app = SniffApp(feed, at_end, row_filter, keep_rows, signals, bench)
    try:
        app.run()
    finally:
        feed.stop()
    if app.failure is not None:
        raise app.failure
    return app.return_code or 0
