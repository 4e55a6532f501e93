"""The application: composes the screen, polls the feed, runs the commands, and ends."""

from __future__ import annotations

import asyncio
import contextlib
import gc
from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import UTC
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import Any, ClassVar, Final, TypeAlias, cast

from rich.text import Text
from textual import on, work
from textual.actions import parse
from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.containers import Container, Vertical
from textual.driver import Driver
from textual.events import Event, Key, MouseDown
from textual.reactive import Reactive
from textual.screen import Screen
from textual.widgets import Input

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.analysis.findings import Cause, Finding
from fte_sniff.analysis.motors import MotorState, Trouble
from fte_sniff.analysis.time_text import LOCAL
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.cell_text import clock_text
from fte_sniff.i18n import LANGUAGES, THEMES, _, choice_after, set_language, switch_language
from fte_sniff.platform import POSIX
from fte_sniff.protocol.columns import zone_at
from fte_sniff.protocol.dissect import dissect
from fte_sniff.protocol.spec import Status
from fte_sniff.session.feeds import ItemFeed
from fte_sniff.tui.cells import TableView, TimeStyle
from fte_sniff.tui.commands import COMMANDS, FOOTER, Needs
from fte_sniff.tui.detail import DetailPage
from fte_sniff.tui.examine import Examiner
from fte_sniff.tui.export import Export
from fte_sniff.tui.filters import Columns, Filters
from fte_sniff.tui.find import Find, Goto, Searching
from fte_sniff.tui.findings import FindingsPage
from fte_sniff.tui.help import HelpPage
from fte_sniff.tui.line import CommandLine
from fte_sniff.tui.motors import MotorsPage
from fte_sniff.tui.notes import NotesControl
from fte_sniff.tui.options import DEFAULTS, Choices, StartOptions
from fte_sniff.tui.pages import Context, Page, Pane
from fte_sniff.tui.parts import Parts
from fte_sniff.tui.status import LINE, KeyLine, StatusLine, TitleLine, badge_text, mode_of
from fte_sniff.tui.streams import StreamsPage
from fte_sniff.tui.strip import LOW, MotorStrip, strip_text
from fte_sniff.tui.table import RowTable, TableHeader
from fte_sniff.tui.typed import Turn, TypedKeys
from fte_sniff.tui.view import Span, View

TICK_S: Final = 0.03
"""Time between two polls of the feed while nothing comes."""

PAUSE_S: Final = 0.21
"""Time from the drawing of rows to the next poll: they come at most five times a second."""

FIRST_S: Final = 0.3
"""Time after the first rows of a file, which are drawn before more are read."""

NEWS_NS: Final = 500_000_000, 100_000_000
"""Shortest time between two drawings of the motors and the page: while rows come, which is also
that between two drawings of the lines, and while the cursor moves."""

SHARE: Final = 96, 8
"""What takes long to draw waits this many times as long, in the same cases; at most thrice the time
while rows come, as the first drawings take far longer than those that follow."""

FINDINGS_NS: Final = 5_000_000_000
"""Shortest time between two searches for findings in a capture."""

OVER_NS: Final = 20_000_000_000
"""Time after the end of a finding in which its line stays."""

LEAST: Final = 9
"""Lines of the terminal from which on the column names and the keys are shown."""

BESIDE_CELLS: Final = 160
"""Cells from which on the pane can be beside the table."""


Part: TypeAlias = MotorStrip | RowTable | Pane
"""What can have the keys."""


class MainScreen(Screen[None], inherit_bindings=False):
    """The screen; the keys are those of the app."""

    focused = Reactive(None, repaint=False)
    """What has the keys; a change draws only the two that it concerns."""


class SniffApp(App[None]):
    """The screen over one feed."""

    CSS_PATH = Path(__file__).with_name("screen.tcss")
    TITLE = "fte-sniff"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", "interrupt", show=False, priority=True),
        Binding("ctrl+q", "quit", show=False, priority=True),
    ]

    def __init__(self, feed: ItemFeed, options: StartOptions = DEFAULTS) -> None:
        """Build the screen."""
        super().__init__()
        set_language(options.language)
        self.language = options.language
        self.theme = options.choices.theme or THEMES[0]
        self.animation_level = "none"
        self.HORIZONTAL_BREAKPOINTS = [(BESIDE_CELLS, "-beside")]
        self.VERTICAL_BREAKPOINTS = [(0, "-least"), (LEAST, "-tiny"), (LOW, "-low")]
        self.failure: FteSniffError | None = None
        self._options = options
        self.view = View(feed, options.pulses_per_turn, options.alert)
        self._is_stale = False
        """Whether the table lacks rows that came while the terminal was slow."""
        self.view.set_filter(options.row_filter)
        self._compose_parts()
        self.typed = TypedKeys(self)
        self._asked: tuple[object, ...] = ()
        self._drawn: tuple[object, ...] = ()
        """What the user asked for and what came, as of the last drawing of the motors."""
        self._draw_due_ns = self._search_due_ns = self._show_due_ns = 0
        self._span = Span(0, 0, None, None)
        self._states: Sequence[MotorState] = ()
        self._searched, self._examiner = -1, Examiner(self.view.store)
        self._began_ns, self._elapsed_ns = self.now_ns(), 0
        self._reported = set[tuple[Cause, str, int | None]]()
        """Topics of the findings that go on, which are or were shown in a line."""
        self._bind_keys()
        self.first_choices = self.choices

    def _compose_parts(self) -> None:
        options, view = self._options, self.view
        self._header, self.status, self.title_line = TableHeader(), StatusLine(), TitleLine()
        look = TableView(choice=options.choices.columns)
        self.table = RowTable(view, self._header, look)
        self.strip, self.line, self.pane = MotorStrip(), CommandLine(), Pane()
        self.findings, self.motors, self.streams = FindingsPage(), MotorsPage(), StreamsPage()
        pages: tuple[Page, ...] = (DetailPage(), self.motors, self.streams, self.findings)
        self._pages = {page.NAME: page for page in pages}
        parts = Parts(options, view, self.table, self.line, self.status)
        self.filters, self.notes = Filters(parts), NotesControl(parts)
        self.search, self.export = Searching(parts), Export(parts)
        self.goto, self.find, self.columns = Goto(parts), Find(parts), Columns(parts)

    def compose(self) -> ComposeResult:
        """The screen from top to bottom."""
        yield self.title_line
        yield self.strip
        with Container(id="body"):
            yield Vertical(self._header, self.table, id="main")
            yield self.pane
        yield self.status
        yield self.line
        yield KeyLine(compact=True, show_command_palette=False)

    def get_default_screen(self) -> Screen[None]:
        """The screen without keys of its own."""
        return MainScreen(id="_default")

    def get_driver_class(self) -> type[Driver]:
        """Our driver; Textual's on Windows."""
        if not POSIX:
            return super().get_driver_class()
        from fte_sniff.tui.terminal import Terminal

        return Terminal

    # Keys and commands

    def _bind_keys(self) -> None:
        """Bind the commands, those of the footer first, in the language of the screen."""
        bound = [command for command in COMMANDS.values() if command.keys]
        for command in sorted(bound, key=lambda one: FOOTER.find(f" {one.keys} ") % len(FOOTER)):
            self.bind(
                command.keys,
                f"app.command({command.run!r}, {self.language!r})",
                description=_(command.short),
                show=bool(command.short),
                key_display=command.key_display.split(" ")[0],
            )

    async def on_event(self, event: Event) -> None:
        """Let a key wait for its turn."""
        if isinstance(event, Key) and not event.is_forwarded:
            self.typed.put(event)
        else:
            await super().on_event(event)

    async def on_turn(self, event: Turn) -> None:
        """Give a key to what has the focus, then to the commands; name one that cannot work now."""
        await super().on_event(event.key)
        if self.line.question is None and len(self.screen_stack) == 1:
            for command in COMMANDS.values():
                is_its = event.key.key in command.keys.split(",")
                if is_its and not self.check_action("command", (command.run,)):
                    self.status.inform(_("not now: {meaning}", meaning=_(command.meaning)))

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Whether a command can work now."""
        if action != "command":
            return True
        if parameters[1:] not in ((), (self.language,)):
            return False  # a key is bound once in each language, for the footer
        needs, question = COMMANDS[str(parameters[0])].needs, self.line.question
        if question is not None and not needs & (Needs.ANYWHERE | Needs.SAVES):
            return False
        page = self.pane.page
        there = {
            Needs.ROWS: self.table.viewport.count > 0,
            Needs.BELOW: not self.table.viewport.following,
            Needs.RUNS: self.view.state.running,
            Needs.PANE: page is not None,
            Needs.PLOTS: page is self.motors,
            Needs.FILTER: bool(self.filters.current),
            Needs.EARLIER: bool(self.filters.earlier),
            Needs.SEARCH: self.search.matches is not None,
            Needs.FAULTS: any(self.view.tally.by_bits),
            Needs.SAVES: question is not None and question.saves is not None,
        }
        return all(holds for need, holds in there.items() if need in needs)

    def action_command(self, run: str, _language: str = "") -> None:
        """Run a command; the answer to the key before is removed."""
        answers = self.status.answers
        owner, name, parameters = parse(run)
        owned = (self, f"do_{name}") if owner == "app" else (getattr(self, owner), name)
        getattr(*owned)(*parameters)
        if self.status.answers == answers:
            self.status.inform("")
        self.show_state()

    def get_system_commands(self, screen: Screen[Any]) -> Iterable[SystemCommand]:
        """The commands of the palette."""
        for run, command in COMMANDS.items():
            if self.check_action("command", (run,)):
                title = f"{_(command.meaning)}  {command.key_display}".rstrip()
                yield SystemCommand(title, "", partial(self.action_command, run))

    def do_move(self, by: int) -> None:
        """Move in the part that has the focus."""
        self.line.step(-by) if self.line.question else self._part.move(by)

    def do_page(self, by: int) -> None:
        """Move by pages."""
        if isinstance(self._part, Pane):
            self._part.move(by * self._part.size.height)
        else:
            self.table.page(by)

    def do_aside(self, by: int) -> None:
        """Move sideways in the part that has the focus."""
        self.strip.move(by) if self._part is self.strip else self.table.aside(by)

    def do_next_part(self) -> None:
        """Give the focus to the next part, or complete the typed line."""
        if self.line.question is not None:
            self.line.complete()
            return
        self.screen_stack[0].focus_next()

    @property
    def _part(self) -> Part:
        """The part that has the keys, or gets them back from the line."""
        focused = self.screen_stack[0].focused
        return focused if isinstance(focused, Part) else self.table

    def do_open(self) -> None:
        """Show the rows of what is chosen, else explain the row."""
        page = self.pane.page
        if self._part is self.strip:
            self.filters.add(f"motor = {self.strip.chosen}")
        elif page is self.findings and self.findings.chosen is not None:
            self.filters.show(self.findings.chosen, page)
            self._show(None)
        elif page is self.streams and self.streams.chosen is not None:
            self.filters.add(self.streams.chosen.condition, page)
            self._show(None)
        elif self.table.viewport.count:
            self.do_switch(DetailPage.NAME)

    def do_back(self) -> None:
        """Return to what was shown before, with the list that led from there."""
        left = self.filters.before()
        if left is not None:
            self._show(left)

    def do_switch(self, name: str) -> None:
        """Show a page in place of any other, or close it where it is shown."""
        page = self._pages[name]
        self._show(None if self.pane.page is page else page)

    def _show(self, page: Page | None) -> None:
        """Show a page; one that explains a row stops following the end."""
        self.pane.show(page)
        if page is not None and page.EXPLAINS_ROW:
            self.table.stop_following()
        if page is None:
            self.filters.look_away()
        if page is None and self._part is self.pane:
            self.table.focus()
        self._asked = ()
        self.call_after_refresh(self.show_state)

    def do_motor(self, motor: int) -> None:
        """Show one motor in the pane, or all again."""
        is_shown = self.pane.page is self.motors
        self.motors.chosen = None if is_shown and self.motors.chosen == motor else motor
        if not is_shown:
            self._show(self.motors)

    def do_field(self, by: int) -> None:
        """Look at the next field of the cursor's row, or at the previous one."""
        row = self.table.cursor_row
        if row is None:
            return
        if self.pane.page is None or not self.pane.page.EXPLAINS_ROW:
            self.do_switch(DetailPage.NAME)
        count, current = len(dissect(row)), self.table.field
        start = (-1 if by > 0 else count) if current is None else current
        self.table.look_at((start + by) % count)

    def do_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if self.table.selection_start is None:
            self.table.stop_following()
            self.table.selection_start = self.table.last_index
            self.status.inform(_("selecting: move, then y or Y copies, w saves, esc ends it"))
        else:
            self.table.selection_start = None
        self.table.draw()

    def do_times(self) -> None:
        """Switch to the next time style; without a mark or another zone, two are skipped."""
        if self.view.first_ns is None:
            self.status.inform(_("no row here has a time"))
            return
        styles = list(TimeStyle)
        if not self.table.marks:
            styles.remove(TimeStyle.MARK)
        if self.table.look.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        style = choice_after(self.table.look.times, styles)
        self.table.set_look(times=style)
        self._asked = ()
        self.status.inform(_(style.meaning))

    def do_changes(self) -> None:
        """Highlight the bytes that changed, or no longer."""
        changes = not self.table.look.changes
        self.table.set_look(changes=changes)
        on = _("bytes that differ from the frame before of the same kind and motor are highlighted")
        self.status.inform(on if changes else _("changed bytes are not highlighted"))

    def do_theme(self) -> None:
        """Switch to the next theme."""
        self.theme = choice_after(self.theme, THEMES)
        self.table.draw()
        self._asked = ()
        self.status.inform(_("theme {name}", name=self.theme))

    def do_language(self) -> None:
        """Switch to the next language."""
        self.language = choice_after(self.language, list(LANGUAGES))
        switch_language(self.language)
        self._bind_keys()
        self._asked = ()
        self._header.refresh()
        self.status.inform(_("the language is English"))

    def do_dismiss(self) -> None:
        """End one thing that was begun: a line, a save, a selection, a notice, a search, a pane."""
        if self.line.question is not None:
            self.line.close()
        elif self.export.abandon():
            return
        elif self.table.selection_start is not None:
            self.do_select()
        elif not (self.status.dismiss() or self.search.end()):
            self._show(None)

    def do_help(self) -> None:
        """Show the help."""
        self.push_screen(HelpPage())

    def do_leave(self) -> None:
        """Close the pane, else quit; while the capture is recorded, only at the second request."""
        state = self.view.state
        if self.pane.page is not None:
            self._show(None)
        elif state.recording is not None and state.running and not self.status.asks:
            text = _("press q or ^c again to stop recording and quit")
            self.status.inform(text, asks=True)
        else:
            self.exit()

    def do_quit(self) -> None:
        """Quit at once."""
        self.exit()

    def do_suspend(self) -> None:
        """Go to the shell."""
        self.action_suspend_process()

    def action_interrupt(self) -> None:
        """Copy the selected text of a field; without one, leave all, and quit."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
            return
        while len(self.screen_stack) > 1:
            self.pop_screen()
        self.line.close()
        self.pane.show(None)
        self.do_leave()

    @property
    def _output(self) -> Any:
        """The output of our driver; None with another."""
        return getattr(self._driver, "output", None)

    # Time

    def on_mount(self) -> None:
        """Start to poll, a file at its first row; quit on signals."""
        self.table.focus()
        for warning in self._options.warnings:
            self.status.warn(_(warning))
        self.tick()
        if not self.view.state.live:
            self.table.jump(0)
        self.set_timer(FIRST_S if self.view.store.next else TICK_S, self._on_clock)
        loop = asyncio.get_running_loop()
        for number in self._options.signals:
            # Only the main thread can have signal handlers.
            with contextlib.suppress(RuntimeError, ValueError):
                loop.add_signal_handler(number, self.exit)

    def on_resize(self) -> None:
        """Draw all of the new size, also where it comes while the effects of a key are awaited."""
        self.screen.refresh()

    def on_unmount(self) -> None:
        """Remove an unfinished file."""
        self.export.abandon()

    def now_ns(self) -> int:
        """The monotonic clock."""
        return monotonic_ns()

    def _on_clock(self) -> None:
        """Poll and draw, and come back; later after rows, so that these are drawn together."""
        rows = self.view.store.next
        if self._output is not None and self._output.is_gone:
            cast(Any, self._driver).hang_up()
        if not self.view.at_rest or self._is_stale or self._searched != self.view.store.known:
            self.tick()
        else:
            self.show_state()
        self.search.step()
        is_soon = rows == self.view.store.next and not self.view.at_rest
        self.set_timer(TICK_S if is_soon else PAUSE_S, self._on_clock)

    def tick(self) -> None:
        """Poll the feed, and draw what changed, unless the terminal is slow."""
        view, before = self.view, self.view.state
        first, shown = view.store.next, view.shown.count
        try:
            update = view.poll(self.now_ns())
        except FteSniffError as failure:
            self.failure = failure
            self.exit()
            return
        if view.state.live and not before.live:
            self.table.follow()  # what was recorded so far is read
        self.notes.find_noted(update.rows, first)
        self._report(before.trouble, ended=before.running and not view.state.running)
        self._report_alert(update)
        for event in update.events if view.state.live else ():
            self.status.on_port_event(event, self.table.look.shown_zone)
        self._examine()
        self._is_stale |= len(update.rows) > 0 or bool(update.events) or shown != view.shown.count
        if len(self.screen_stack) > 1 or (self._output is not None and self._output.is_slow):
            return  # the help is above, or the terminal has not yet drawn what was written
        if self._is_stale:
            self._sync_table()
        if self.now_ns() >= self._show_due_ns:
            self.show_state()
        self._is_stale = False

    def _sync_table(self) -> None:
        first_ns, look = self.view.first_ns, self.table.look
        if first_ns is not None and look.zone == UTC and look.times is TimeStyle.CLOCK:
            wanted = self._options.zone
            zone = zone_at(first_ns, wanted or LOCAL)
            is_first = wanted is not None and zone != UTC
            look = replace(look, zone=zone, times=TimeStyle.LOCAL if is_first else look.times)
        self.table.look = replace(look, ports=self.view.store.ports)
        self.table.sync()

    def _report(self, before: str | None, *, ended: bool) -> None:
        """Show troubles of the recording, alerts, and the end of the feed; quit then if wanted."""
        state, status, trouble = self.view.state, self.status, self.view.state.trouble
        is_new = getattr(trouble, "form", trouble) != getattr(before, "form", before)
        if trouble and trouble != before and (is_new or status.warns("recording")):
            status.warn(_(trouble), "recording")
        elif before and not trouble and status.warns("recording"):
            status.warn(_("over: {text}", text=_(before)), "recording")
        if ended and status.asks:
            status.inform("")  # nothing is recorded any more
        if ended and self._options.leave_at_end:
            self.exit()
        elif ended and state.ended:
            status.warn(_("ended: {reason}", reason=_(state.ended)), "end")

    def _report_alert(self, update: FeedUpdate) -> None:
        """Ring the bell where rows match the alert, and show how many there are."""
        alert = self.view.alert
        if alert is None or not self.view.state.live:
            return
        if alert.observe(update.rows, self.now_ns() / 1e9, update.events):
            self.bell()
        if alert.last is not None:
            text = _("{count:,} rows match the alert", count=alert.count)
            if alert.last.t_ns is not None:
                time = clock_text(alert.last.t_ns, 3, self.table.look.shown_zone)
                text = _("{text}, the last at {time}", text=text, time=time)
            self.status.warn(text, "alert")

    def _examine(self) -> None:
        """Search for findings in a thread, if rows came since the last search, a while ago."""
        view, now_ns = self.view, self.now_ns()
        is_due = now_ns >= self._search_due_ns if view.state.running else view.at_rest
        is_busy = any(one.group == "findings" and one.is_running for one in self.workers)
        if is_due and self._searched != view.store.known and not is_busy:
            self._searched = view.store.known
            self._search_due_ns = now_ns + FINDINGS_NS
            self._find()

    @work(group="findings", exclusive=True)
    async def _find(self) -> None:
        search = partial(self._examiner.search, lives=self.view.lives)
        found, coverage = await asyncio.to_thread(search)
        self.findings.take(found, coverage)
        if self.view.state.live:
            self._announce(found)
        elif found and not self.typed.began:
            self._show(self.findings)
        self.show_state()

    def _announce(self, found: Sequence[Finding]) -> None:
        """Show what goes on now, a line each; events of ports were shown before.

        A line grows with its finding until esc, and is removed some time after its end.
        """
        now_ns = self.view.now_ns(self.now_ns()) or 0
        going_on = {
            (one.cause, one.port, one.motor): one
            for one in sorted(found, key=lambda one: one.last_ns)
            if one.cause is not Cause.PORT and one.last_ns > now_ns - OVER_NS
        }
        for topic in self._reported - going_on.keys():
            self.status.forget(topic)
        for topic, one in going_on.items():
            if topic not in self._reported or self.status.warns(topic):
                since = clock_text(one.first_ns, 0, self.table.look.shown_zone)[:8]
                self.status.warn(f"{since}  {_(one.text)}", topic)
        self._reported = {*going_on}

    # What is shown

    @on(Pane.Changed)
    def show_all(self) -> None:
        """Draw all that has changed, however little time has passed."""
        self._asked = ()
        self.show_state()

    @on(RowTable.Moved)
    def show_state(self) -> None:
        """Draw the lines, the motors and the page, as far as they have changed."""
        if not self.is_running or len(self.screen_stack) != 1:
            return
        self._look_at_finding()
        self._show_due_ns = self.now_ns() + NEWS_NS[0]
        viewport, state = self.table.viewport, self.view.state
        mode = mode_of(state, at_end=viewport.following)
        if state.running:
            self._elapsed_ns = self.now_ns() - self._began_ns
        badge = badge_text(state, mode, viewport.below)
        self.title_line.show(state, badge, self._elapsed_ns / 1e9)
        self.notes.show()
        self.status.show(self._numbers(), chosen=bool(self.filters.current or self.search.text))
        self.table.empty_text = self._empty_text()
        self._show_motors()
        self.refresh_bindings()

    def _look_at_finding(self) -> None:
        """Look at the chosen finding, its first row under the cursor, or at that of the rows."""
        chosen = self.findings.chosen
        if self.pane.page is self.findings and not self.view.lives and chosen is not None:
            self.filters.finding = chosen
            if chosen != self.view.finding:
                self.table.stay_at(self.view.store.index_at(chosen.first_ns))
        self.view.finding = self.filters.finding

    def _numbers(self) -> list[Text]:
        """The numbers of the status line, the most important first."""
        view, tally, viewport = self.view, self.view.tally, self.table.viewport
        parts = [_("{count:,} rows", count=tally.rows)]
        if self.filters.current:
            parts = [f"{_('filter')} {self.filters.text}"]
        if self.search.text:
            parts.append(self.search.text)
        if malformed := tally.by_status[Status.MALFORMED]:
            share = malformed / tally.rows
            text = "<0.1%" if share < 0.001 else f"{share:.1%}"
            parts.append(_("{count:,} malformed ({share})", count=malformed, share=text))
        if viewport.count and not viewport.following:
            parts.append(_("row {number:,}", number=viewport.cursor + 1))
        if view.lives and {one.trouble for one in self._states} == {Trouble.UNKNOWN}:
            parts.append(_("no feedback"))  # not even from a motor that is commanded
        rate = view.frames_per_s(self.now_ns())
        if rate is not None:
            parts.append(_("{rate:,.0f} frames/s", rate=rate))
        return [Text(part) for part in parts]

    def _empty_text(self) -> str:
        """Why no row is shown."""
        view = self.view
        if view.shown.pending:
            return _("filtering ...")
        if view.store.next:
            return _(
                "the filter hides all {count:,} rows; F shows them again", count=view.store.next
            )
        return _("nothing came yet") if view.state.running else _("nothing came")

    def _show_motors(self) -> None:
        """Draw the motors and the page at the cursor's row, or now, where they have changed."""
        view, table, pane, now_ns = self.view, self.table, self.pane, self.now_ns()
        cursor = None if self.table.viewport.following else table.cursor_index
        chosen = self.strip.chosen if self._part is self.strip else None
        asked = (
            *(view.finding, chosen, self.strip.size, self.theme, self.language),
            *(pane.page, pane.size, table.field, view.shown.matches),
            *(self.findings.at, self.streams.at, self.motors.chosen, self.motors.window),
        )
        seconds = now_ns // 1_000_000_000 if view.lives else 0  # also while nothing comes
        newest = view.store.next if cursor is None else 0
        drawn = (table.cursor_index, view.shown.count, newest, seconds, self.findings.listed)
        if asked == self._asked and (drawn == self._drawn or now_ns < self._draw_due_ns):
            return
        self._asked, self._drawn = asked, drawn
        self._span = view.span(cursor, now_ns)
        self._states = view.motors(self._span)
        self.strip.text = strip_text(
            self._states,
            (self.size.width, self.strip.size.height),
            table.palette,
            lambda t_ns: clock_text(t_ns, 0, table.look.shown_zone)[:8],
            self._times_of_trouble(),
            chosen,
        )
        pane.draw(Context(view, self._span, self._states, table, pane.room))
        case, took_ns = cursor is not None, self.now_ns() - now_ns
        self._draw_due_ns = now_ns + max(NEWS_NS[case], min(SHARE[case] * took_ns, 3 * NEWS_NS[0]))

    def _times_of_trouble(self) -> dict[int, int]:
        """By motor, the start of the chosen finding, or in trouble, of the first that goes on."""
        chosen, now_ns, found = self.view.finding, self._span.now_ns, list[Finding]()
        if chosen is not None:
            found = [chosen]
        elif now_ns is not None:
            well = (Trouble.NONE, Trouble.UNKNOWN)
            troubled = {one.motor for one in self._states if one.trouble not in well}
            near = (one for one in self.findings.listed if one.motor in troubled)
            found = [one for one in near if one.first_ns <= now_ns < one.last_ns + OVER_NS]
        latest = sorted(found, key=lambda one: -one.first_ns)
        return {one.motor: one.first_ns for one in latest if one.motor}

    # Messages of the parts

    @on(CommandLine.Typed)
    def _on_typed(self, event: CommandLine.Typed) -> None:
        """Show what continues the line; the parts have the keys again once it is closed."""
        if self.line.question is None:
            self._part.focus()
            self.status.forget(LINE)
        elif event.suggestions:
            self.status.pin(LINE, f"tab: {'   '.join(event.suggestions)}")
        else:
            self.status.pin(LINE, _("enter applies   esc: back   up: earlier"))
        self.show_state()

    def on_mouse_down(self, event: MouseDown) -> None:
        """Leave an open line where a part is clicked."""
        if isinstance(event.widget, Part):
            self.line.close()

    # The end

    @property
    def choices(self) -> Choices:
        """What the user has chosen by now."""
        before = self._options
        switched = self.language != before.language
        return Choices(
            self.theme,
            self.table.look.choice,
            self.language if switched else before.choices.language,
            tuple(self.filters.saved.items()),
        )


def run_screen(feed: ItemFeed, options: StartOptions = DEFAULTS) -> int:
    """Show the feed until the user quits or a signal comes, then stop the feed.

    `on_exit` is called with the counts over all rows. Returns 0, or another number where the screen
    failed, which it has then reported. Raises FteSniffError if the feed failed; the terminal is
    restored.
    """
    gc.freeze()  # what is loaded stays
    gc.set_threshold(50_000)  # a search for cycles is not free, and there are few
    app = SniffApp(feed, options)
    try:
        app.run()
    finally:
        feed.stop()
    if options.save_choices is not None and app.choices != app.first_choices:
        options.save_choices(app.choices)
    if app.failure is not None:
        raise app.failure
    return app.return_code or 0
