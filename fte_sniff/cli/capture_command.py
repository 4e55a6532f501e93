"""Run a capture with screen or plain lines."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import reduce
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.analysis.counters import Tally
from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.cli.options import (
    FileName,
    Seconds,
    filter_option,
    keep_rows_option,
    remembered_bench,
    row_filter,
    selection,
    units_options,
)
from fte_sniff.cli.output import summary
from fte_sniff.cli.recording_options import plan_of, recording_options
from fte_sniff.cli.settings import Remembered, config_option, lang_option
from fte_sniff.cli.streams import ENDING, abandon_stdout, nobody_reads, signals_call, tell
from fte_sniff.errors import FteSniffError, printable
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import DEFAULT_BAUD, PortEvent, PortEventKind, Row
from fte_sniff.session.live_session import LOOK_EVERY_S, LiveSession

if TYPE_CHECKING:
    from fte_sniff.analysis.statistics import LineSetup
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.capture.source import Wiring
    from fte_sniff.session.capture_state import CapturePlan, CaptureState
    from fte_sniff.tui.options import StartOptions


_STDOUT = Path("-")
_LINE_WORDS = click.Choice(["on", "off", "leave"])


_DURATION = Seconds(min=0, min_open=True)

_OPTIONS: tuple[Callable[[Callable[..., Any]], Callable[..., Any]], ...] = (
    click.option("--baud", type=click.INT, help=f"Bits/s.  [default: {DEFAULT_BAUD}]"),
    click.option("--dtr", type=_LINE_WORDS, default="off", show_default=True, help="Set DTR."),
    click.option("--rts", type=_LINE_WORDS, default="off", show_default=True, help="Set RTS."),
    click.option("-o", "--output", type=FileName(), help="Record to this file."),
    click.option("--force", is_flag=True, help="Overwrite the recording if it exists."),
    click.option("--no-record", is_flag=True, help="Record nothing."),
    recording_options,
    click.option(
        "--keep-recording", is_flag=True, help="Go on when the view is killed or its terminal gone."
    ),
    click.option("--plain", is_flag=True, help="Print one line a row instead of the screen."),
    filter_option,
    keep_rows_option(1_000_000),
    units_options,
    config_option,
    lang_option,
    click.option(
        "--no-reconnect", is_flag=True, help="End when a port is lost; do not wait for it."
    ),
    click.option(
        "--duration", type=_DURATION, metavar="S", help="End after S seconds, or 5min, or 1h."
    ),
    click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N rows."),
)


def capture_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of a command that captures.

    `config` is for `remembered`; all others but `no_reconnect`, which the wiring is to know, go on
    to `run_capture`.
    """
    return reduce(lambda decorated, option: option(decorated), reversed(_OPTIONS), command)


def run_capture(
    wiring_with: Callable[[PortSettings], Wiring],
    ports: Sequence[str],
    settings: Remembered,
    *,
    baud: int | None,
    dtr: str,
    rts: str,
    plain: bool,
    lang: str | None,
    filter_text: str | None,
    keep_rows: int,
    resolution: float | None,
    gear_ratio: float | None,
    **planned: Any,
) -> None:
    """Capture, record and show or print, until the end.

    Args:
        wiring_with: the wiring, given how its ports are to be opened.
        ports: what the user calls them.
        settings: what holds where no option says otherwise; the others are the options,
            `planned` those that `plan_of` knows.

    Raises:
        FteSniffError: what went wrong, once all is closed.
    """
    from fte_sniff.capture.serial_port import ControlLine, PortSettings

    if baud is None:
        baud = settings.defaults(ports, "baud").baud or DEFAULT_BAUD
    wiring = wiring_with(PortSettings(baud, ControlLine(dtr), ControlLine(rts)))
    plan = plan_of(wiring, **planned)
    bench = remembered_bench(settings, ports, resolution, gear_ratio, baud)
    if _is_stdout(plan.recording):
        _fill_stdout(plan)
    elif plain or not (sys.stdout.isatty() and sys.stdin.isatty()):
        if resolution is not None:
            tell("fte-sniff: lines tell positions in pulses; the screen shows turns too")
        _print_lines(plan, filter_text)
    else:
        opening = _opening(plan, bench, settings, lang)
        _show_screen(
            plan, replace(opening, row_filter=row_filter(filter_text), keep_rows=keep_rows)
        )


def _opening(
    plan: CapturePlan, bench: LineSetup, settings: Remembered, lang: str | None
) -> StartOptions:
    """How the screen begins, but for what is shown of the rows."""
    from fte_sniff.tui.options import AtEnd, StartOptions

    return StartOptions(
        AtEnd.STAY if plan.duration_s is None and plan.count is None else AtEnd.LEAVE,
        signals=tuple(_ending(plan)),
        bench=bench,
        language=settings.language(lang),
        choices=settings.choices,
        keep=settings.keep,
        trouble=settings.trouble,
    )


def _is_stdout(recording: Path | None) -> bool:
    """Whether the recording goes where rows would be printed: `-`, /dev/stdout and the like."""
    if recording is None or recording == _STDOUT:
        return recording is not None
    try:
        return os.path.samestat(recording.stat(), os.fstat(sys.stdout.fileno()))
    except OSError:
        return False


def _print_lines(plan: CapturePlan, filter_text: str | None) -> None:
    select = selection(filter_text)
    from fte_sniff.session.live_session import LiveSession

    session = LiveSession(plan)
    with signals_call(session.stop, _ending(plan), session.drop_leftover):
        session.begin()
        if session.told.device is not None:
            tell(f"a host program can open {printable(session.told.device)}")
        if session.told.recording is not None:
            tell(f"recording to {session.told.recording}")
        _tell_who_goes_on(plan, session)
        print_lines(session, select, ports=len(plan.wiring.names) > 1)
        _leave(session)


def _fill_stdout(plan: CapturePlan) -> None:
    """Let standard output have the recording, and nothing else."""
    from fte_sniff.session.live_session import LiveSession

    session = LiveSession(plan)
    with signals_call(session.stop, _ending(plan), session.drop_leftover):
        session.begin()
        if session.told.device is not None:
            tell(f"a host program can open {printable(session.told.device)}")
        tell("recording to standard output")
        tell_troubles(session)
        if session.told.error is not None:
            # What comes once nobody reads is no gap: the recording is what there was to do.
            ended = nobody_reads(sys.stdout.fileno()) and session.told.stopped_recording
            raise ended or session.told.error


def _show_screen(plan: CapturePlan, opening: StartOptions) -> None:
    from fte_sniff.session.live_session import LiveSession

    code = 0
    seen: list[Tally] = []
    session = LiveSession(plan)
    with signals_call(session.stop, _ending(plan), session.drop_leftover):
        # Loaded while the capture process starts on another core, and opens the port.
        from fte_sniff.tui.app import run_screen

        session.begin()
        _tell_who_goes_on(plan, session)
    try:
        if not session.stopping:
            code = run_screen(session, opening, tell=seen.append)
    finally:
        # The screen hears signals in its own way, and forgets ours.
        with signals_call(session.stop, _ending(plan), session.drop_leftover) as ask:
            # Nor may a terminal that stands still hold up the end.
            ask()
            see_out(session, seen)
            _leave(session)
    sys.exit(code)


def _ending(plan: CapturePlan) -> Sequence[signal.Signals]:
    """The signals that ask the capture to end; another one ends the view alone."""
    if plan.outlives_view:
        return [number for number in ENDING if number is not signal.SIGHUP]
    return ENDING


def _tell_who_goes_on(plan: CapturePlan, session: LiveSession) -> None:
    if plan.outlives_view:
        pid = session.capture_pid
        tell(f"the capture outlives this view if that is killed; `kill {pid}` ends it then")


def _leave(session: LiveSession) -> None:
    """Say where the recording lies; raise what went wrong, if something did."""
    told = session.told
    if told.recording is not None:
        _tell_where(told, told.recording)
    if told.error is not None:
        raise told.error


def _tell_where(told: CaptureState, last: Path) -> None:
    outcome = told.outcome
    first = outcome.first if outcome else told.recordings[0]
    several = f"{first} to " if first != last else ""
    gone = part = ""
    if outcome and outcome.deleted_files:
        count = outcome.deleted_files
        files = "1 older file" if count == 1 else f"{count:,} older files"
        gone = f"; {files} with {outcome.deleted_rows:,} rows deleted (--on-full rotate-oldest)"
    if outcome and outcome.triggered:
        kept, rows, fired = outcome.triggered
        events = f"{fired:,} event{'s' * (fired != 1)}" if fired else "--trigger never fired"
        part = f"{kept:,} of {rows:,} rows ({events}) "
    tell(f"recorded {part}to {several}{last}{gone}")
    there = sum(path.exists() for path in told.recordings)
    if there > 1:
        tell(f"{there} files; all of them: fte-sniff decode {_pattern(told.recordings[0])}")


def _pattern(first: Path) -> str:
    """What opens all files of a sequence, for a shell."""
    stem = first.stem.removesuffix("00001")
    return shlex.quote(str(first.with_name(f"{escape(stem)}*{first.suffix}")))


_AS_EXPECTED = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})


class PlainLines:
    """Prints what comes from a capture, and counts it."""

    def __init__(
        self, select: Callable[[Sequence[Row]], list[Row]], *, ports: bool = False
    ) -> None:
        """Print to standard output the rows that `select` picks; with `ports`, whence they came."""
        self._select = select
        self._writer = row_writer(OutputFormat.TABLE, sys.stdout, ports=ports)
        self._tally = Tally()
        self._events: Counter[PortEventKind] = Counter()
        self._failure: FteSniffError | None = None
        self._recording: str | None = None
        self._not_shown = 0
        self._leftover = _Leftover()

    def take(self, update: FeedUpdate, failure: FteSniffError | None) -> None:
        """Print an update, and what went wrong with the capture, once.

        Raises:
            OSError: standard output cannot be written.
        """
        for event in update.events:
            self._take_event(event)
        if update.state.running:
            self._take_trouble(failure, update.state.recording)
            self._leftover.take(update)
        self._not_shown = update.state.not_shown
        self._tally.add(update.rows)
        self._writer.write(self._select(update.rows))
        sys.stdout.flush()

    def end(self) -> None:
        """Say what came."""
        if self._events:
            kinds = ", ".join(f"{kind} {count:,}" for kind, count in self._events.items())
            tell(f"port events: {kinds}")
        if self._not_shown:
            tell(f"{self._not_shown:,} rows more came too fast to be printed")
        tell(summary(self._tally))

    def _take_trouble(self, failure: FteSniffError | None, recording: str | None) -> None:
        """Say that the recording has stopped, and that it goes on; each once."""
        if failure is not None and str(failure) != str(self._failure):
            self._failure, self._recording = failure, None
            tell(str(failure))
        if self._failure is not None and recording and recording != self._recording:
            self._recording = recording
            tell(f"recording goes on in {recording}")

    def _take_event(self, event: PortEvent) -> None:
        if event.kind not in _AS_EXPECTED:
            self._events[event.kind] += 1
            detail = f": {event.detail}" if event.detail else ""
            tell(f"{event.port} {event.kind.replace('_', ' ')}{detail}")


def print_lines(
    session: LiveSession, select: Callable[[Sequence[Row]], list[Row]], *, ports: bool
) -> None:
    """Print what a session that has begun captures, until it ends or nobody reads."""
    lines = PlainLines(select, ports=ports)
    try:
        for update in _updates(session):
            lines.take(update, session.told.error)
    except BrokenPipeError:
        abandon_stdout()
    finally:
        see_out(session)
    lines.end()


def tell_troubles(session: LiveSession) -> None:
    """Print no rows, only what goes wrong, until the session ends; a lost recording ends it."""
    lines = PlainLines(lambda _: [])
    try:
        for update in _updates(session):
            gone = session.told.recording is None and nobody_reads(sys.stdout.fileno())
            lines.take(update, None if gone else session.told.error)
            if session.told.recording is None:
                session.stop()
    finally:
        see_out(session)
    lines.end()


def see_out(session: LiveSession, seen: Sequence[Tally] = ()) -> None:
    """End a session, wait for its end, and say what that has to wait for; rows are not printed.

    They are counted with those that were `seen` on a screen, of which is said then what came.
    """
    session.stop()
    leftover, not_shown = _Leftover(), 0
    for update in _updates(session):
        leftover.take(update)
        not_shown = update.state.not_shown
        for tally in seen:
            tally.add(update.rows)
    session.close()
    for tally in seen:
        if not_shown:
            tell(f"{not_shown:,} rows more came too fast to be shown")
        tell(summary(tally))


class _Leftover:
    """Says, once, that much waits to be written at the end."""

    _told = False

    def take(self, update: FeedUpdate) -> None:
        count = update.state.leftover
        if update.state.running and count and not self._told:
            self._told = True
            tell(f"writing what has arrived: {count:,} bytes wait; Ctrl-C drops them")


def _updates(session: LiveSession) -> Iterator[FeedUpdate]:
    """What the session hands over, until it has ended."""
    running = True
    while running:
        update = session.wait(LOOK_EVERY_S)
        running = update.state.running
        yield update
