"""Run a capture for `live` and `bridge`: with the screen, with plain lines, or to stdout."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.analysis.tally import Tally
from fte_sniff.cli.check_report import read_rules, verdict_lines
from fte_sniff.cli.options import (
    FileName,
    Seconds,
    alert_of,
    alert_option,
    all_of,
    filter_option,
    keep_rows_option,
    line_setup,
    row_filter,
    units_options,
)
from fte_sniff.cli.output import print_saved, summary
from fte_sniff.cli.recording_options import capture_plan, recording_options
from fte_sniff.cli.service import FileCommand, ServiceManager
from fte_sniff.cli.settings import Settings, config_option, lang_option
from fte_sniff.cli.streams import (
    abandon_stdout,
    ending_signals,
    has_no_reader,
    print_err,
)
from fte_sniff.errors import FteSniffError, UsageError, printable
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.platform import ENDING_SIGNALS, HANG_UP, signals
from fte_sniff.protocol import DEFAULT_BAUD, PortEvent, PortEventKind, Row

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert
    from fte_sniff.analysis.verdicts import RuleCheck
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.capture.source import Wiring
    from fte_sniff.recording.recorder import Outcome
    from fte_sniff.session.capture_state import CapturePlan
    from fte_sniff.session.live_session import LiveSession
    from fte_sniff.tui.options import StartOptions


_STDOUT = Path("-")
_LINE_WORDS = click.Choice(["on", "off", "leave"])


_DURATION = Seconds(min=0, min_open=True)

capture_options = all_of(
    click.option("-b", "--baud", type=click.INT, help=f"Bits/s.  [default: {DEFAULT_BAUD}]"),
    click.option("--dtr", type=_LINE_WORDS, default="off", show_default=True, help="Set DTR."),
    click.option("--rts", type=_LINE_WORDS, default="off", show_default=True, help="Set RTS."),
    click.option("-o", "--output", type=FileName(), help="Record to this file."),
    click.option("--force", is_flag=True, help="Overwrite the recording if it exists."),
    click.option("--no-record", is_flag=True, help="Record nothing."),
    recording_options,
    click.option(
        "--keep-recording",
        is_flag=True,
        help="Continue when the view is killed or its terminal closed.",
    ),
    click.option("--plain", is_flag=True, help="Print one line per row instead of the screen."),
    click.option(
        "--check",
        "rules",
        type=FileName(),
        metavar="FILE",
        help="Check the rows by the rules of a file (docs/check.md); exit code 1 if they do not"
        " pass.",
    ),
    click.option(
        "--headless",
        is_flag=True,
        help="Only record, as a service: no rows, one line for each file and port event. "
        "SIGUSR1 begins the next file.",
    ),
    click.option(
        "--on-file",
        metavar="CMD",
        help="With --headless: run CMD PATH for each finished file; no shell.",
    ),
    filter_option,
    alert_option,
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
"""The options of a command that captures.

The command passes `config` to `load_settings`, `no_reconnect` to its wiring, and all others to
`run_capture`.
"""


def run_capture(
    wiring_with: Callable[[PortSettings], Wiring],
    ports: Sequence[str],
    settings: Settings,
    *,
    baud: int | None,
    dtr: str,
    rts: str,
    plain: bool,
    headless: bool,
    on_file: str | None,
    lang: str | None,
    filter_text: str | None,
    alert_text: str | None,
    rules: Path | None,
    keep_rows: int,
    resolution: float | None,
    gear_ratio: float | None,
    **planned: Any,
) -> None:
    """Capture, record and show or print, until the end.

    `wiring_with` builds the wiring from the settings of its ports, whose names are as the user
    wrote them; the settings have defaults for options that are not given. `planned` are the options
    of `capture_plan`. Raises FteSniffError after everything is closed, if the capture failed.
    """
    from fte_sniff.capture.serial_port import ControlLine, PortSettings

    if baud is None:
        baud = settings.default(ports, "baud") or DEFAULT_BAUD
    wiring = wiring_with(PortSettings(baud, ControlLine(dtr), ControlLine(rts)))
    plan = capture_plan(wiring, **planned)
    setup = line_setup(settings, ports, resolution, gear_ratio, baud)
    code = 0
    with _judged(rules) as observe:
        if headless or on_file is not None:
            others = {"--plain": plain, "--filter": filter_text, "--alert": alert_text}
            _check_headless(headless, plan, [name for name, given in others.items() if given])
            _record_headless(plan, FileCommand(on_file), observe)
        elif _is_stdout(plan.recording):
            _record_to_stdout(plan, observe)
        elif plain or not (sys.stdout.isatty() and sys.stdin.isatty()):
            if resolution is not None:
                print_err("fte-sniff: lines show positions in pulses; only the screen shows turns")
            _print_lines(plan, filter_text, alert_of(alert_text), observe)
        else:
            from fte_sniff.tui.options import StartOptions

            start = StartOptions(
                row_filter=row_filter(filter_text),
                alert=alert_of(alert_text),
                keep_rows=keep_rows,
                leave_at_end=plan.duration_s is not None or plan.count is not None,
                signals=_ending_signals(plan),
                line_setup=setup,
                language=settings.language(lang),
                colors=settings.colors,
                choices=settings.choices,
                save_choices=settings.keep,
                warnings=settings.trouble,
            )
            code = _show_screen(plan, start, observe)
    sys.exit(code)


Observer = Callable[[FeedUpdate], None]


@contextmanager
def _judged(path: Path | None) -> Iterator[Observer | None]:
    """Context that checks the rows its observer receives, and prints the verdicts at the end.

    Raises FteSniffError if a rule is invalid; exits with code 1 if a rule does not pass.
    """
    if path is None:
        yield None
        return
    rules = read_rules(path)
    from fte_sniff.analysis.verdicts import RuleCheck

    check = RuleCheck(rules)
    try:
        yield lambda update: check.observe(update.rows, update.events, update.changes)
    except FteSniffError:
        if check.total.rows:
            _print_verdicts(check)
        raise
    _print_verdicts(check)
    if any(one.refuses for one in check.verdicts()):
        sys.exit(1)


def _print_verdicts(check: RuleCheck) -> None:
    for line in verdict_lines(check.verdicts(), None):
        print_err(line.plain.rstrip())
    if check.unseen:
        print_err(
            f"fte-sniff: {check.unseen:,} rows arrived too fast to be checked; run check on the "
            "recording"
        )


def _is_stdout(recording: Path | None) -> bool:
    """True if the recording goes to standard output: `-`, /dev/stdout or the same file."""
    if recording is None or recording == _STDOUT:
        return recording is not None
    try:
        return os.path.samestat(recording.stat(), os.fstat(sys.stdout.fileno()))
    except OSError:
        return False


def _ending_signals(plan: CapturePlan) -> tuple[signal.Signals, ...]:
    """The signals that end the capture; others end only the view."""
    return tuple(one for one in ENDING_SIGNALS if one not in HANG_UP or not plan.outlives_view)


def _ended_by_signals(
    session: LiveSession, plan: CapturePlan
) -> AbstractContextManager[Callable[[], None]]:
    return ending_signals(session.stop, _ending_signals(plan), session.hurry)


def _print_lines(
    plan: CapturePlan, filter_text: str | None, alert: Alert | None, observe: Observer | None
) -> None:
    wanted = row_filter(filter_text)
    from fte_sniff.session.live_session import LiveSession

    session = LiveSession(plan, observe)
    select = list if wanted is None else wanted.select
    lines = PlainLines(select, ports=len(plan.wiring.names) > 1, alert=alert)
    with _ended_by_signals(session, plan):
        session.begin()
        _report_device(session)
        if session.state.recording is not None:
            print_err(f"recording to {session.state.recording}")
        _report_pipe(session)
        _report_survivor(plan, session)
        try:
            for update in _updates(session):
                lines.write(update, session.state.error)
        except BrokenPipeError:
            abandon_stdout()
        finally:
            finish_session(session)
        lines.close(session.state.progress.waiting, plan.count)
        _report_recording(session)


def _check_headless(headless: bool, plan: CapturePlan, others: Sequence[str]) -> None:
    if not headless:
        raise UsageError("--on-file works with --headless; add it")
    if others:
        raise UsageError(f"--headless shows no rows; leave out {others[0]}")
    if plan.recording is None or _is_stdout(plan.recording):
        raise UsageError("--headless records to files; name one with -o, or leave out --no-record")


def _record_headless(plan: CapturePlan, command: FileCommand, observe: Observer | None) -> None:
    """Record as a service: no rows on standard output."""
    from fte_sniff.session.live_session import LiveSession

    manager = ServiceManager(os.environ)
    rotating = signals("SIGUSR1")
    for number in rotating:
        signal.signal(number, signal.SIG_IGN)
    session = LiveSession(plan, observe)
    lines = PlainLines(lambda _: [])
    with _ended_by_signals(session, plan):
        session.begin()
        for number in rotating:
            signal.signal(number, lambda *_: session.rotate())
        _report_device(session)
        _report_pipe(session)
        lines.follow_files(session.state.recording)
        ports = printable(" and ".join(plan.wiring.names))
        print_err(f"capturing {ports}, recording to {session.state.recording}")
        manager.notify("READY=1")
        try:
            for update in _updates(session):
                lines.write(update, session.state.error)
                command.update(session.state.recordings, session.state.recording)
                manager.alive(session.received_at_s)
                if session.stopping:
                    manager.notify("STOPPING=1")
        finally:
            finish_session(session)
        lines.close(session.state.progress.waiting, plan.count)
        command.update(session.state.recordings, None)
        try:
            _report_recording(session)
        finally:
            command.wait()


def _record_to_stdout(plan: CapturePlan, observe: Observer | None) -> None:
    """Write the recording, and nothing else, to standard output; a lost reader ends it."""
    from fte_sniff.session.live_session import LiveSession

    session = LiveSession(plan, observe)
    lines = PlainLines(lambda _: [])
    with _ended_by_signals(session, plan):
        session.begin()
        _report_device(session)
        print_err("recording to standard output")
        try:
            for update in _updates(session):
                gone = session.state.recording is None and has_no_reader(sys.stdout.fileno())
                lines.write(update, None if gone else session.state.error)
                if session.state.recording is None:
                    session.stop()
        finally:
            finish_session(session)
        lines.close(session.state.progress.waiting, plan.count)
        if session.state.error is not None:
            # A reader that went away ends the capture; rows after that are no loss.
            ended = has_no_reader(sys.stdout.fileno()) and session.state.stopped_recording
            raise ended or session.state.error


def _show_screen(plan: CapturePlan, options: StartOptions, observe: Observer | None) -> int:
    """Show the screen; the exit code is not 0 if it failed."""
    from fte_sniff.session.live_session import LiveSession

    code = 0
    seen: list[Tally] = []
    session = LiveSession(plan, observe)
    with _ended_by_signals(session, plan):
        # Imported while the capture process starts on another core and opens the port.
        from fte_sniff.session.notes import Notes, capture_start
        from fte_sniff.tui.app import run_screen

        session.begin()
        _report_pipe(session)
        _report_survivor(plan, session)
    files = [path for path in session.state.recordings if path.is_file()]
    notes = Notes(files, [capture_start(path) for path in files])
    try:
        if not session.stopping:
            options = replace(options, notes=notes)
            code = run_screen(session, options, on_exit=seen.append)
    finally:
        # The screen has replaced the signal handlers.
        with _ended_by_signals(session, plan) as request_end:
            # A stopped terminal may not block the exit either.
            request_end()
            finish_session(session, seen, plan.count)
            _report_recording(session)
            print_saved(notes)
    return code


def _report_device(session: LiveSession) -> None:
    if session.state.device is not None:
        print_err(f"a host program can open {printable(session.state.device)}")


def _report_pipe(session: LiveSession) -> None:
    if session.state.waits_for_reader:
        print_err(f"waiting for a reader of {session.state.recording}")


def _report_survivor(plan: CapturePlan, session: LiveSession) -> None:
    if plan.outlives_view:
        pid = session.capture_pid
        print_err(f"the capture continues if this view is killed; `kill {pid}` ends it then")


def _report_recording(session: LiveSession) -> None:
    """Print the path of the recording; raise the error of the capture, if any."""
    state = session.state
    if state.recording is not None and state.outcome is not None:
        _print_recording(state.recordings, state.recording, state.outcome)
    if state.error is not None:
        raise state.error


def _print_recording(recordings: Sequence[Path], last: Path, outcome: Outcome) -> None:
    several = f"{outcome.first} to " if outcome.first != last else ""
    gone = part = ""
    if outcome.deleted_files:
        count = outcome.deleted_files
        files = "1 older file" if count == 1 else f"{count:,} older files"
        gone = f"; {files} with {outcome.deleted_rows:,} rows deleted (--on-full rotate-oldest)"
    if outcome.triggered:
        kept, rows, fired = outcome.triggered
        events = f"{fired:,} event{'s' * (fired != 1)}" if fired else "--trigger never fired"
        part = f"{kept:,} of {rows:,} rows ({events}) "
    print_err(f"recorded {part}to {several}{last}{gone}")
    there = sum(path.exists() for path in recordings)
    if there > 1:
        print_err(f"{there} files; all of them: fte-sniff decode {_pattern(recordings[0])}")


def _pattern(first: Path) -> str:
    """A shell pattern that matches all files of a sequence."""
    stem = first.stem.removesuffix("00001")
    return shlex.quote(str(first.with_name(f"{escape(stem)}*{first.suffix}")))


_EXPECTED_EVENTS = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})


class PlainLines:
    """Prints and counts the rows and events of a capture."""

    def __init__(
        self,
        select: Callable[[Sequence[Row]], list[Row]],
        *,
        ports: bool = False,
        alert: Alert | None = None,
    ) -> None:
        self._select = select
        self._alert = alert
        self._writer = row_writer(OutputFormat.TABLE, sys.stdout, ports=ports)
        self._tally = Tally()
        self._events: Counter[PortEventKind] = Counter()
        self._failure: FteSniffError | None = None
        self._recording: str | None = None
        self._follows_files = False
        self._not_shown = 0

    def follow_files(self, first: Path | None) -> None:
        """Report each file after the first one."""
        self._follows_files, self._recording = True, str(first)

    def write(self, update: FeedUpdate, failure: FteSniffError | None) -> None:
        """Print an update; report an error of the capture once.

        Raises OSError if standard output cannot be written.
        """
        for event in update.events:
            self._print_event(event)
        if update.state.running:
            self._print_problem(failure, update.state.recording)
        self._not_shown = update.state.not_shown
        self._tally.update(update.rows)
        self._writer.write(self._select(update.rows))
        rings = self._alert is not None and self._alert.observe(update.rows, time.monotonic())
        if rings and sys.stderr.isatty():
            sys.stderr.write("\a")
            sys.stderr.flush()
        sys.stdout.flush()

    def close(self, unframed: int, limit: int | None = None) -> None:
        """Print the summary; see there for `unframed` and `limit`."""
        if self._events:
            kinds = ", ".join(f"{kind} {count:,}" for kind, count in self._events.items())
            print_err(f"port events: {kinds}")
        if self._not_shown:
            print_err(f"{self._not_shown:,} more rows arrived too fast to be printed")
        print_err(summary(self._tally, unframed=unframed, limit=limit))

    def _print_problem(self, failure: FteSniffError | None, recording: str | None) -> None:
        """Report once that the recording has stopped, and the file in which it continues."""
        if failure is not None and str(failure) != str(self._failure):
            self._failure, self._recording = failure, None
            print_err(str(failure))
        reports = self._follows_files or self._failure is not None
        if reports and recording and recording != self._recording:
            self._recording = recording
            print_err(f"recording goes on in {recording}")

    def _print_event(self, event: PortEvent) -> None:
        if event.kind not in _EXPECTED_EVENTS:
            self._events[event.kind] += 1
            detail = f": {event.detail}" if event.detail else ""
            print_err(f"{event.port} {event.kind.replace('_', ' ')}{detail}")


def finish_session(
    session: LiveSession, seen: Sequence[Tally] = (), limit: int | None = None
) -> None:
    """Stop a session and wait for its end; reports data still to be written, prints no rows.

    To `seen`, counts of rows that a screen has shown, the remaining rows are added for the summary,
    which also names the `limit` of the rows.
    """
    session.stop()
    not_shown = 0
    for update in _updates(session):
        not_shown = update.state.not_shown
        for tally in seen:
            tally.update(update.rows)
    session.close()
    for tally in seen:
        if not_shown:
            print_err(f"{not_shown:,} more rows arrived too fast to be shown")
        print_err(summary(tally, unframed=session.state.progress.waiting, limit=limit))


def _updates(session: LiveSession) -> Iterator[FeedUpdate]:
    """The updates until the end; reports data still to be written."""
    from fte_sniff.session.live_session import WAIT_S

    running = True
    reported: set[str] = set()
    while running:
        update = session.wait(WAIT_S)
        running, backlog = update.state.running, session.state.backlog
        if running and backlog is not None and backlog not in reported:
            reported.add(backlog)
            print_err(f"{backlog}; Ctrl-C drops them")
        yield update
