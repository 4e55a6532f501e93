"""SniffApp: compose, keys, shutdown."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import monotonic_ns
from typing import ClassVar

from textual import on
from textual.actions import ActionParseResult
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.dom import DOMNode
from textual.driver import Driver
from textual.drivers.linux_driver import LinuxDriver
from textual.events import Event, Key
from textual.filter import LineFilter

from fte_sniff.analysis.counters import Tally
from fte_sniff.analysis.feed import Feed
from fte_sniff.analysis.row_store import BlockSource
from fte_sniff.errors import FteSniffError, printable
from fte_sniff.session.save import SaveJob
from fte_sniff.tui.actions import (
    FilterActions,
    GotoActions,
    MarkActions,
    NavigationActions,
    SearchActions,
)
from fte_sniff.tui.export_actions import ExportActions
from fte_sniff.tui.goto import GotoField
from fte_sniff.tui.i18n import THEMES, _, speak
from fte_sniff.tui.keys import (
    FINDING,
    HANDLING,
    INTERRUPT,
    LEAVING,
    TABLE_ACTIONS,
    UNDERSTANDING,
    bindings,
    say_keys,
)
from fte_sniff.tui.notices import NoticeLine
from fte_sniff.tui.options import USUAL, AtEnd, Choices, StartOptions
from fte_sniff.tui.panes.switcher import Panes
from fte_sniff.tui.prompt import FilterField, PromptLine, SaveField, SearchField
from fte_sniff.tui.status_bar import KeyLine, StatusLine, TitleLine, mode_of
from fte_sniff.tui.table.columns import TableView, zone_at
from fte_sniff.tui.table.theme import OWN, NoColor
from fte_sniff.tui.table.widget import RowTable, TableHeader
from fte_sniff.tui.terminal import Terminal
from fte_sniff.tui.view_model import TICK_S, HitCount, PollInterval, ViewModel, ViewUpdate


class Leaving(SearchActions, MarkActions, ExportActions):
    """Ways back and out."""

    def action_dismiss(self) -> None:
        """End one thing that was begun: a save, a selection, a notice, a search, a pane."""
        if self._end_saving() or self._unselect():
            return
        if self._notice.display and not self._searching:
            self._notice.put_away()
        elif not self._end_search():
            self._panes.close()

    def action_leave(self) -> None:
        """End."""
        self.exit()


LOW = 16
"""Lines below which a pane has to be content with very few."""

TALL = 40
"""Lines from which on a pane leaves the table more than the few rows it must."""


class SniffApp(FilterActions, GotoActions, NavigationActions, Leaving):
    """The screen over one feed."""

    CSS_PATH = Path(__file__).with_name("screen.tcss")
    TITLE = "fte-sniff"
    ENABLE_COMMAND_PALETTE = False
    """Textual's palette fails on very small terminals and on keys that are typed ahead."""
    BINDINGS: ClassVar[list[BindingType]] = [
        INTERRUPT,
        *bindings(LEAVING, FINDING, HANDLING, UNDERSTANDING),
    ]

    def __init__(
        self, feed: Feed, opening: StartOptions = USUAL, source: BlockSource | None = None
    ) -> None:
        """A screen that has not begun.

        Args:
            feed: where rows come from.
            opening: how it begins.
            source: gives the feed's rows again, so that not all need to lie in memory.
        """
        super().__init__()
        speak(opening.language)
        say_keys(self)
        for theme in OWN:
            self.register_theme(theme)
        self.theme = opening.choices.theme or THEMES[0]
        self.animation_level = "none"
        self.VERTICAL_BREAKPOINTS = [(0, "-tiny"), (LOW, "-low"), (TALL, "-tall")]
        self.failure: FteSniffError | None = None
        """Why the screen had to close, where the feed failed."""
        self._opening = opening
        self._rhythm = PollInterval(feed)
        row_filter = opening.row_filter
        self._watched = ViewModel(feed, row_filter, opening.store(source))
        self._title_line, self._header = TitleLine(), TableHeader()
        look = TableView(choice=opening.choices.columns)
        self._table = RowTable(self._watched.store, self._header, look)
        self._panes = Panes(self._watched.store, self._table, opening.bench)
        self._notice = NoticeLine()
        self._filter_field = FilterField(row_filter, self._set_filter, self._time_here)
        self._search_field = SearchField(self._search)
        self._goto_field = GotoField(self._go)
        self._save_field = SaveField(self._target, self._save)
        self._filters_before: list[str] = []
        self._saving: SaveJob | None = None
        self._status_line = StatusLine()
        self._hit_count = HitCount(self._watched.store, self._table)
        self.choices_before = self.choices

    def compose(self) -> ComposeResult:
        """The screen from top to bottom."""
        yield self._title_line
        yield self._header
        yield self._table
        yield from self._panes
        yield self._notice
        yield self._filter_field
        yield self._search_field
        yield self._goto_field
        yield self._save_field
        yield self._status_line
        yield KeyLine()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Whether a key may do this now: a field that asks and the help have keys of their own."""
        if action not in TABLE_ACTIONS:
            return True
        return len(self.screen_stack) == 1 and not isinstance(self.focused, PromptLine)

    async def run_action(
        self,
        action: str | ActionParseResult,
        default_namespace: DOMNode | None = None,
        namespaces: Mapping[str, DOMNode] | None = None,
    ) -> bool:
        """Do what a key asks for; what was told of the key before it then holds no more."""
        told = self._notice.passing
        done = await super().run_action(action, default_namespace, namespaces)
        if done:
            self._notice.pass_by(told)
        return done

    def get_driver_class(self) -> type[Driver]:
        """Ours, where Textual would take the terminal itself."""
        usual = super().get_driver_class()
        return Terminal if usual is LinuxDriver else usual

    def get_line_filters(self) -> Sequence[LineFilter]:
        """What every line drawn goes through last."""
        return [NoColor()] if self.no_color else super().get_line_filters()

    def on_mount(self) -> None:
        """Begin to look at the feed, a file at its first row; end when the system says so."""
        self._table.focus()
        if self._opening.trouble:
            self._notice.warn(printable("; ".join(self._opening.trouble)))
        self.tick()
        if not self._watched.state.live:
            self._table.action_first()
        self.set_interval(TICK_S, self._tick_by_clock)
        if self._watched.state.running:
            self._rhythm.listen(lambda: self.call_later(self._tick_woken))
        loop = asyncio.get_running_loop()
        for number in self._opening.signals:
            # Off the main thread there are no signal handlers; whoever runs it there ends it.
            with contextlib.suppress(RuntimeError, ValueError):
                loop.add_signal_handler(number, self.exit)

    def on_unmount(self) -> None:
        """Leave no half file, and give the signals back."""
        self._rhythm.end()
        if self._saving is not None:
            self._saving.abandon()
        loop = asyncio.get_running_loop()
        for number in self._opening.signals:
            with contextlib.suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)

    @property
    def choices(self) -> Choices:
        """What the user has chosen by now."""
        return Choices(self.theme, self._table.look.choice)

    @property
    def seen(self) -> Tally:
        """The count of all rows that came to the screen."""
        return self._watched.tally

    def _time_here(self) -> int | None:
        row = self._table.cursor_row
        return None if row is None else row.t_ns

    def now_ns(self) -> int:
        """The time of a look at the feed, by a rising clock."""
        return monotonic_ns()

    def _tick_woken(self) -> None:
        self._rhythm.woken()
        self.tick()

    def _tick_by_clock(self) -> None:
        if self._rhythm.strike():
            self.tick()

    async def on_event(self, event: Event) -> None:
        """Keys come before a file's rows."""
        state = self._watched.state
        if isinstance(event, Key) and state.running and not state.live:
            self._panes.rest()
            self._rhythm.key()
        await super().on_event(event)

    def tick(self) -> None:
        """Look at the feed, and draw what changed."""
        state = self._watched.state
        keys_first = state.running and self._rhythm.keys_come
        try:
            # A file can wait until what is there was counted; a wire cannot.
            wait = keys_first or (self._panes.overtaken and not state.live)
            news = self._watched.look(self.now_ns(), take=not wait)
        except FteSniffError as failure:
            self._close_for(failure)
            return
        if not self._watched.state.running:
            self._rhythm.end()
        self._panes.tell_events(news.events)
        self._panes.add_changes(news.changes)
        self._tell_news(news)
        if news.changed:
            start_ns = self._watched.start_ns
            self._table.set_look(ports=self._watched.ports)
            if start_ns is not None and self._table.start_ns is None:
                self._table.set_look(zone=zone_at(start_ns, self._opening.zone))
            self._table.start_ns = start_ns
            self._table.sync()
        self._hit_count.tick()
        self._show_state()
        if not keys_first:
            state = self._watched.state
            self._panes.tick(self.now_ns(), state.live and state.running)

    def _tell_news(self, news: ViewUpdate) -> None:
        """Say what happened to ports, the recording and the feed; leave, where that was asked."""
        state = self._watched.state
        for event in news.events if state.live else ():
            self._notice.tell_event(event, self._table.look.shown_zone)
        if news.trouble:
            self._notice.hold("recording", printable(_(news.trouble)))
        elif not state.trouble:
            self._notice.release("recording")
        if news.ended and self._opening.at_end is AtEnd.LEAVE:
            self.exit()
        elif news.ended and state.ended:
            why = printable(_(state.ended))
            self._notice.hold("end", _("ended: {reason}").format(reason=why))
        elif news.ended and self._watched.events_words:
            self._notice.tell(self._watched.events_words)

    def _show_state(self) -> None:
        """Draw the lines above and below the table, where they changed."""
        watched, view = self._watched, self._table.viewport
        mode = mode_of(watched.state, view.paused, view.following)
        self._title_line.show(watched.state, mode, view.waiting if view.paused else view.below)
        self._status_line.show(watched.numbers(view, self._hit_count.words))
        self._filter_field.tell_shown(watched.shown_words)
        self._table.tell_empty(watched.empty_words)

    def _handle_exception(self, error: Exception) -> None:
        """Rows that cannot be read any more end the screen with a reason, whoever wants them."""
        if isinstance(error, FteSniffError):
            self._close_for(error)
        else:
            super()._handle_exception(error)

    @on(RowTable.Failed)
    def _fail(self, event: RowTable.Failed) -> None:
        self._close_for(event.failure)

    def _close_for(self, failure: FteSniffError) -> None:
        self.failure = failure
        self.exit()

    @on(RowTable.Moved)
    def _follow_cursor(self) -> None:
        self._show_state()
        self._panes.follow_cursor()


def run_screen(
    feed: Feed,
    opening: StartOptions = USUAL,
    source: BlockSource | None = None,
    tell: Callable[[Tally], None] = lambda _tally: None,
) -> int:
    """Show the feed until the user ends it, or a signal does; the feed is then asked to stop.

    Args:
        feed: where rows come from.
        opening: how the screen begins.
        source: gives the feed's rows again, so that not all need to lie in memory.
        tell: is told at the end what the screen has seen.

    Returns:
        0, or another number where the screen itself broke, which then has been said.

    Raises:
        FteSniffError: the feed failed; the terminal is as it was before.
    """
    app = SniffApp(feed, opening, source)
    try:
        app.run()
    finally:
        feed.stop()
        tell(app.seen)
    if app.choices != app.choices_before:
        opening.keep(app.choices)
    if app.failure is not None:
        raise app.failure
    return app.return_code or 0
