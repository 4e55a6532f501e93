"""The application: composes the screen, polls the feed, handles signals and the end."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC
from inspect import isawaitable
from pathlib import Path
from time import monotonic_ns
from typing import TYPE_CHECKING, ClassVar

from rich.console import RenderableType
from textual import on
from textual.actions import ActionParseResult, parse
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.dom import DOMNode
from textual.driver import Driver
from textual.events import Event, InputEvent, Key, MouseDown, Resize
from textual.filter import LineFilter
from textual.screen import Screen
from textual.widgets import Input

from fte_sniff.analysis.feed import Feed
from fte_sniff.analysis.model import Tally
from fte_sniff.analysis.row_store import BlockSource
from fte_sniff.analysis.time_text import LOCAL
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.platform import POSIX
from fte_sniff.protocol import zone_at
from fte_sniff.session.notes import RowKey
from fte_sniff.session.user_state import Place
from fte_sniff.tui.cells import TimeStyle
from fte_sniff.tui.commands import (
    COMMANDS,
    FINDING,
    HANDLING,
    INTERRUPT,
    LEAVING,
    PALETTE,
    UNDERSTANDING,
    action_of,
    bindings,
    key_names,
)
from fte_sniff.tui.export import ExportField
from fte_sniff.tui.filters import FilterField
from fte_sniff.tui.find import GotoField, SearchField
from fte_sniff.tui.i18n import LANGUAGES, THEMES, _, choice_after, set_language, switch_language
from fte_sniff.tui.modals import ChosenColumns, ColumnChooser, Entry, HelpPage, Picker
from fte_sniff.tui.notes import NotesField
from fte_sniff.tui.options import DEFAULTS, Choices, StartOptions
from fte_sniff.tui.painter import CONTRAST_THEMES, ColorRules, NoColor, ReadableColors
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.panes.row import DetailPane
from fte_sniff.tui.panes.switcher import PaneSwitcher
from fte_sniff.tui.playback import PlaybackControl
from fte_sniff.tui.prompt import Focus, Parts, PromptField
from fte_sniff.tui.status_bar import KeyLine, NoticeLine, StatusLine, TitleLine, mode_of
from fte_sniff.tui.table import RowTable, TableHeader
from fte_sniff.tui.view_model import TICK_S, HitStatus, PollInterval, ViewModel, ViewUpdate

if TYPE_CHECKING:
    from fte_sniff.tui.terminal import FramePacer

LOW = 16
"""Lines of the terminal below which a pane has only a few."""

TALL = 40
"""Lines of the terminal from which on a pane takes the larger part."""


class SniffApp(App[None]):
    """The screen over one feed.

    It composes the widgets, runs the commands on what owns them, polls the feed, and ends.
    """

    CSS_PATH = Path(__file__).with_name("screen.tcss")
    TITLE = "fte-sniff"
    ENABLE_COMMAND_PALETTE = False
    """Textual's palette fails on very small terminals and on keys that are typed ahead."""
    BINDINGS: ClassVar[list[BindingType]] = [
        INTERRUPT,
        *bindings(LEAVING, FINDING, HANDLING, UNDERSTANDING),
    ]

    def __init__(
        self, feed: Feed, options: StartOptions = DEFAULTS, source: BlockSource | None = None
    ) -> None:
        """Build the screen; with a `source`, which reads rows again, not all stay in memory."""
        super().__init__()
        set_language(options.language)
        for theme in CONTRAST_THEMES:
            self.register_theme(theme)
        self.theme = options.choices.theme or THEMES[0]
        self.language = options.language
        self.animation_level = "none"
        self.VERTICAL_BREAKPOINTS = [(0, "-tiny"), (LOW, "-low"), (TALL, "-tall")]
        self.failure: FteSniffError | None = None
        self.pacer: FramePacer | None = None
        """Set by the driver of a terminal, which may be slow."""
        self._options = options
        self._model = ViewModel(feed, options.row_filter, options.store(source), options.alert)
        self._poll_interval = PollInterval(feed)
        self._alerts = 0
        self._compose_widgets()
        self.first_choices = self.choices

    def _compose_widgets(self) -> None:
        options, store = self._options, self._model.store
        rules = ColorRules(options.colors)
        self._warnings = [*options.warnings, *rules.mistakes]
        self._notice = NoticeLine()
        header = TableHeader()
        self._table = RowTable(store, header, self._notice, options.choices.view)
        self._table.rules = rules if options.colors else None
        self._panes = PaneSwitcher(store, header, self._table, self._notice, options)
        self._focus = Focus(self, self._table, header, self._panes.top)
        self._title_line, self._status_line = TitleLine(), StatusLine()
        self._key_line = KeyLine()
        self._hit_status = HitStatus(store, self._table)
        parts = Parts(options, self._model, self._table, self._panes, self._focus, self._notice)
        self.filters, self.notes, self.search = (
            FilterField(parts),
            NotesField(parts),
            SearchField(parts),
        )
        self.goto, self.export = GotoField(parts), ExportField(parts)
        self.playback = PlaybackControl(parts)
        self._owners: Mapping[str, object] = {
            "app": self,
            "table": self._table,
            "top": self._panes.top,
            "panes": self._panes,
            "filters": self.filters,
            "notes": self.notes,
            "search": self.search,
            "goto": self.goto,
            "export": self.export,
            "playback": self.playback,
        }

    def compose(self) -> ComposeResult:
        """The screen from top to bottom."""
        yield self._title_line
        yield self._panes
        yield self._notice
        yield self.filters
        yield self.filters.name_field
        yield self.notes
        yield self.search
        yield self.goto
        yield self.export
        yield self._status_line
        yield self._key_line

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Whether a key may act now."""
        return action != "command" or self._focus.allows(COMMANDS[str(parameters[0])].where)

    async def run_action(
        self,
        action: str | ActionParseResult,
        default_namespace: DOMNode | None = None,
        namespaces: Mapping[str, DOMNode] | None = None,
    ) -> bool:
        """Run the action of a key, and remove the answer to the key before."""
        before = self._notice.answer
        done = await super().run_action(action, default_namespace, namespaces)
        if done:
            self._notice.remove_answer(before)
        return done

    async def action_command(self, run: str) -> None:
        """Run a command of the table of commands, on what owns it."""
        self._focus.prepare(COMMANDS[run].where)
        owner, name, parameters = parse(run)
        waits = getattr(self._owners[owner], f"action_{name}")(*parameters)
        if isawaitable(waits):
            await waits

    def action_dismiss(self) -> None:
        """End one thing that was begun: a save, a selection, a notice, a search, a pane."""
        if self.export.abandon() or self._table.end_selection():
            return
        if self._notice.display and not self.search.is_searching:
            self._notice.dismiss()
        elif not self.search.end() and not self._panes.close():
            if self._panes.top.display:
                self.action_top()
            else:
                self.playback.stop()

    def action_leave(self) -> None:
        """Close the open pane, else quit."""
        if not self._panes.close():
            self._quit()

    def _quit(self) -> None:
        """Quit; while the capture is recorded, only at the second request."""
        state = self._model.state
        is_recording = state.recording is not None and state.running
        if is_recording and not self._notice.asks:
            self._notice.ask(_("press q or ^c again to stop recording and quit"))
        else:
            self.exit()

    def action_interrupt(self) -> None:
        """Copy the selected text of a field; without one, leave fields and pages, and quit."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
            return
        while len(self.screen_stack) > 1:
            self.pop_screen()
        self._focus.leave()  # the question is behind them
        self._quit()

    def action_open(self) -> None:
        """Show the rows of the chosen finding or time of a pane, else explain the row."""
        pane = self._panes.open
        if self.filters.show_finding():
            return
        if pane is not None and (span := pane.chosen_span) is not None:
            self._panes.close()
            self._table.go_to_fault_between(*span)
        else:
            self._panes.action_switch(DetailPane.NAME)

    def action_choose(self) -> None:
        """Show the rows of the chosen finding, else of the line of the top view."""
        if not self.filters.show_finding():
            self.filters.choose()

    def action_top(self) -> None:
        """Show one line for each kind and motor in place of the table, or the table again."""
        self._focus.show_top(not self._panes.top.display)
        if self._panes.top.display and self._panes.explains_row:
            self._panes.close()
        self._panes.call_after_refresh(self._panes.redraw)

    def action_columns(self) -> None:
        """Choose columns and their order."""

        def choose(chosen: ChosenColumns | None) -> None:
            if chosen is not None:
                self._table.set_view(choice=chosen.names, delta=chosen.delta)

        chooser = ColumnChooser(self._table.view, self._table.scrollable_size.width)
        self.push_screen(chooser, choose)

    def action_help(self) -> None:
        """Show the help page."""
        self.push_screen(HelpPage(self._table.palette))

    def action_theme(self) -> None:
        """Switch to the next theme."""
        self.theme = choice_after(self.theme, THEMES)
        self._table.sync()
        self._notice.inform(_("theme {name}", name=self.theme))

    def action_language(self) -> None:
        """Switch to the next language."""
        self.language = choice_after(self.language, list(LANGUAGES))
        switch_language(self.language)
        self._key_line.refresh()
        for field in self.query(PromptField):
            field.translate()
        self._panes.forget_texts()
        self._table.refresh()
        self._notice.inform(_("the language is English"))

    def action_palette(self) -> None:
        """Pick a command from a list."""
        entries = [
            Entry(
                _(command.tooltip),
                command.run,
                key_names(command),
                f"{command.words} {command.key_display} {command.tooltip}",
            )
            for command in PALETTE
        ]
        self.push_screen(Picker(_("commands"), entries), self._run_picked)

    async def _run_picked(self, run: str | None) -> None:
        if run is not None:
            await self.run_action(action_of(run))

    def action_overview(self, cell: int) -> None:
        """Go to the most important row of a cell of the scroll bar that was clicked."""
        self._table.jump_to_cell(cell)

    def get_default_screen(self) -> Screen[object]:
        """Give the screen the class of its height: the first resize need not style all again."""
        screen: Screen[object] = super().get_default_screen()
        height = self.size.height
        _, name = max(one for one in self.VERTICAL_BREAKPOINTS or () if one[0] <= height)
        return screen.add_class(name, update=False)

    def get_driver_class(self) -> type[Driver]:
        """Our driver in place of Textual's for Linux."""
        driver = super().get_driver_class()
        if POSIX:
            from textual.drivers.linux_driver import LinuxDriver

            from fte_sniff.tui.terminal import Terminal

            return Terminal if driver is LinuxDriver else driver
        return driver

    def get_line_filters(self) -> Sequence[LineFilter]:
        """The filter for a terminal with no or 16 colours."""
        if self.no_color:
            return [NoColor()]
        few = [ReadableColors()] if self.console.color_system == "standard" else []
        return [*super().get_line_filters(), *few]

    def on_mount(self) -> None:
        """Start to poll, a file at its first row; quit on signals."""
        self._focus.start()
        if self._warnings:
            self._notice.warn("; ".join(map(_, self._warnings)))
        self.tick()
        if not self._model.state.live and self.notes.left_at == self._options.place.cursor:
            self._table.action_first()
        if self._options.play_speed is not None:
            self.call_later(self.playback.action_pause)
        self.set_interval(TICK_S, self._on_clock)
        loop = asyncio.get_running_loop()
        for number in self._options.signals:
            # Only the main thread can have signal handlers.
            with contextlib.suppress(RuntimeError, ValueError):
                loop.add_signal_handler(number, self.exit)

    def on_unmount(self) -> None:
        """Remove an unfinished file and the signal handlers."""
        if self.export.job is not None:
            self.export.job.abandon()
        self.notes.save()
        loop = asyncio.get_running_loop()
        for number in self._options.signals:
            with contextlib.suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)

    @property
    def choices(self) -> Choices:
        """What the user has chosen by now."""
        view, panes, before = self._table.view, self._panes.pane_layout, self._options
        switched = self.language != before.language
        return Choices(
            self.theme,
            view.choice,
            self.language if switched else before.choices.language,
            tuple(self.filters.saved.items()),
            panes.beside,
            panes.height,
            panes.width,
            view.delta,
            view.changes,
            view.events,
        )

    @property
    def place(self) -> Place:
        """Where the view is now."""
        row = self._table.cursor_row
        return Place(
            self.filters.own,
            self._table.view.choice,
            None if row is None else RowKey(row.port, row.offset, row.t_ns),
        )

    @property
    def tally(self) -> Tally:
        """Counts over all rows that reached the screen."""
        return self._model.tally

    def now_ns(self) -> int:
        """The time of a poll, by a monotonic clock."""
        return monotonic_ns()

    def _on_clock(self) -> None:
        state = self._model.state
        at_rest = self._model.at_rest and not self._panes.models_pending
        if self._poll_interval.on_clock(at_rest=at_rest, captures=state.live and state.running):
            self.tick()

    async def on_event(self, event: Event) -> None:
        """Let keys come before a file's rows."""
        state = self._model.state
        if isinstance(event, InputEvent | Resize):
            self._poll_interval.on_input()
        if isinstance(event, Key) and state.running and not state.live:
            self._panes.postpone_models()
            self._poll_interval.on_key()
        await super().on_event(event)

    def tick(self) -> None:
        """Poll the feed, and draw what changed."""
        state = self._model.state
        keys_first = state.running and self._poll_interval.key_was_recent
        # A file waits until its rows are counted; a live feed cannot.
        wait = keys_first or (self._panes.models_late and not state.live)
        try:
            update = self._model.poll(self.now_ns(), take_rows=not wait)
        except FteSniffError as failure:
            self._close_for(failure)
            return
        if self._model.state.live and not state.live:
            self._table.action_follow()  # what was recorded so far is read
        self._panes.observe(update.events, update.stream_changes)
        self.notes.find_noted(update.rows, update.first)
        self._report(update)
        if update.changed or update.events:
            self._update_table()
        self._hit_status.tick()
        self._show_state()
        if not keys_first:
            play = self._model.playback
            playhead_ns = None if play is None else play.t_ns
            self._panes.tick(self.now_ns(), self._model.state, playhead_ns)
            if play is not None and play.is_over and not state.running:
                self.playback.stop()

    def _update_table(self) -> None:
        start_ns = self._model.start_ns
        self._table.set_view(ports=self._model.ports)
        if start_ns is not None and self._table.start_ns is None:
            self._set_zone(start_ns)
        self._table.start_ns = start_ns
        self._table.sync()

    def _set_zone(self, start_ns: int) -> None:
        """Set the offset of local times; show these where the user has named a zone."""
        wanted = self._options.zone
        zone = zone_at(start_ns, wanted or LOCAL)
        is_first = wanted is not None and zone != UTC
        self._table.set_view(
            zone=zone, times=TimeStyle.LOCAL if is_first else self._table.view.times
        )

    def _report(self, update: ViewUpdate) -> None:
        """Show notices of port events, the recording and the feed; quit at the end if wanted."""
        state = self._model.state
        for event in update.events if state.live or self._model.playback else ():
            self._notice.on_port_event(event, self._table.view.shown_zone)
        if update.rings:
            self.bell()
            self._title_line.flash()
        self._report_alert()
        if update.trouble:
            self._notice.unpin("recording")  # the other one is new
            self._notice.pin("recording", _(update.trouble))
        elif not state.trouble:
            self._notice.unpin("recording")
        if update.ended and self._notice.asks:
            self._notice.remove_answer(self._notice.answer)  # nothing is recorded any more
        if update.ended and self._options.leave_at_end:
            self.exit()
        elif update.ended and state.ended:
            self._notice.pin("end", _("ended: {reason}", reason=_(state.ended)))
        elif update.ended and self._model.events_text:
            self._notice.report(self._model.events_text)

    def _report_alert(self) -> None:
        alert = self._model.alert
        if alert is None or alert.last is None or alert.count == self._alerts:
            return
        self._alerts = alert.count
        text = _("{count:,} rows match the alert")
        if alert.last.t_ns is not None:
            text = _("{count:,} rows match the alert, the last at {time}")
        zone = self._table.view.shown_zone
        time = clock_text(alert.last.t_ns or 0, 3, zone)
        self._notice.pin("alert", text.format(count=alert.count, time=time))

    def _show_state(self) -> None:
        model, viewport = self._model, self._table.viewport
        play = model.playback
        newest_in_view = viewport.following or not viewport.below
        mode = mode_of(model.state, viewport.paused, newest_in_view, play)
        unseen = viewport.waiting if viewport.paused else viewport.below
        speed = None if play is None else play.speed
        self._title_line.show(model.state, mode, speed or unseen, int(model.recorded_s))
        self._key_line.mode = mode
        top_time = self._panes.top_time(live=model.state.live and model.state.running)
        self._status_line.numbers = model.status_counters(
            viewport, self._hit_status.text, self._panes.health, top_time
        )
        if model.filter_count is not None:
            self.filters.set_count(*model.filter_count)
        self._table.set_empty_text(model.empty_text)

    def _display(self, screen: Screen[object], renderable: RenderableType | None) -> None:
        """Draw a frame, unless the terminal is still busy with the last one."""
        if self.pacer is None:
            super()._display(screen, renderable)
        elif self.pacer.begins():
            super()._display(screen, renderable)
            self.pacer.ended()

    def _handle_exception(self, error: Exception) -> None:
        """Close the screen with a reason where rows cannot be read any more."""
        if isinstance(error, FteSniffError):
            self._close_for(error)
        else:
            super()._handle_exception(error)

    @on(RowTable.Failed)
    def _on_table_failed(self, event: RowTable.Failed) -> None:
        self._close_for(event.failure)

    def _close_for(self, failure: FteSniffError) -> None:
        self.failure = failure
        self.exit()

    def on_mouse_down(self, event: MouseDown) -> None:
        """Leave an open field where the rows behind it are clicked."""
        self._focus.clicked(event.widget)

    @on(RowTable.Opened)
    def _on_double_click(self) -> None:
        self._panes.explain_row()

    @on(Pane.Pointed)
    def _on_pointed(self, event: Pane.Pointed) -> None:
        self._table.look_at(event.field)

    @on(Pane.Resized)
    def _on_pane_resized(self) -> None:
        self._panes.redraw()

    @on(RowTable.Moved)
    def _on_table_moved(self) -> None:
        self._show_state()
        self.notes.show_note()
        self._panes.on_table_moved()


def run_screen(
    feed: Feed,
    options: StartOptions = DEFAULTS,
    source: BlockSource | None = None,
    on_exit: Callable[[Tally], None] = lambda _tally: None,
) -> int:
    """Show the feed until the user quits or a signal comes, then stop the feed.

    With a `source`, which reads rows again, not all stay in memory. `on_exit` is called with the
    counts over all rows. Returns 0, or another number where the screen failed, which it has then
    reported. Raises FteSniffError if the feed failed; the terminal is restored.
    """
    app = SniffApp(feed, options, source)
    try:
        app.run()
    finally:
        feed.stop()
        on_exit(app.tally)
    if options.save_choices is not None and app.choices != app.first_choices:
        options.save_choices(app.choices)
    if app.failure is not None:
        raise app.failure
    if options.save_place is not None:
        options.save_place(app.place)
    return app.return_code or 0
