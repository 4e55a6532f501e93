"""Run a capture for `live` and `bridge`: its options, the plan made of them, and its observers.

The observers print plain lines or show the screen.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from shlex import quote
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.analysis.tally import Tally
from fte_sniff.capture.silence import DEFAULT_SILENCE_S
from fte_sniff.cli.capture_loop import Observer, capture
from fte_sniff.cli.input_files import (
    FileName,
    filter_option,
    print_saved,
    row_filter,
    summary,
)
from fte_sniff.cli.live_data import Datagrams, data_options, local
from fte_sniff.cli.options import (
    alert_option,
    all_of,
    check_columns,
    columns_option,
    format_option,
    in_group,
    parse_seconds,
    seconds_from,
)
from fte_sniff.cli.settings import Settings
from fte_sniff.cli.streams import STDOUT, abandon_stdout, print_err
from fte_sniff.errors import UsageError, listed, printable, quoted, size_text
from fte_sniff.formats.writers import (
    ALL_COLUMNS,
    FORMAT_BY_SUFFIX,
    TEXT_FORMATS,
    OutputFormat,
)
from fte_sniff.i18n import _, later
from fte_sniff.platform import ENDING_SIGNALS, HANG_UP
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.spec import DEFAULT_BAUD, NAME_OF_ROLE, Role
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import DEFAULT_FREE_BYTES, RecordingOptions
from fte_sniff.session.save import ExportSource, text_writer

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter
    from fte_sniff.capture.wiring import Way, Wiring
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.session.control import CapturePlan, CaptureState
    from fte_sniff.session.live_session import LiveSession
    from fte_sniff.session.notes import Notes
    from fte_sniff.tui.options import StartOptions


_SIZE = re.compile(r"(0(?=$)|[0-9]{1,9}(?:\.[0-9]{1,9})?(?=\s*[kmgt]?b))\s*(?:([kmgt]?)b)?", re.I)
"""A number with a unit; only 0 needs none."""
_MOST_SECONDS = 10**9
_MIN_KEPT = 100_000


def _size(text: str) -> int:
    """The bytes of `512MB`."""
    if (found := _SIZE.fullmatch(text)) is None:
        raise click.BadParameter(f"{quoted(text)} is not a size; use for example 512MB or 2GB")
    return round(float(found[1]) * 10.0 ** (3 * " kmgt".index((found[2] or " ").lower())))


def _rotate(text: str) -> dict[str, Any]:
    """What begins the next file, as a field of `RecordingOptions`."""
    if _SIZE.fullmatch(text):
        return {"rotate_bytes": _size(text)}
    seconds = parse_seconds(text)
    if seconds is None or not 1 <= seconds <= _MOST_SECONDS:
        raise click.BadParameter(
            f"{quoted(text)} is neither a size nor a time from 1s; use for example 512MB or 1h"
        )
    return {"rotate_s": seconds}


_LINE_WORDS = click.Choice(["on", "off"])

capture_options = all_of(
    click.option(
        "-b", "--baud", type=click.INT, metavar="N", help=f"Bits/s.  [default: {DEFAULT_BAUD}]"
    ),
    click.option("--dtr", type=_LINE_WORDS, default="off", show_default=True, help="Set DTR."),
    click.option("--rts", type=_LINE_WORDS, default="off", show_default=True, help="Set RTS."),
    in_group(
        "Recording",
        click.option(
            "-o", "--output", type=FileName(), metavar="FILE", help="Record to this file."
        ),
        click.option("--force", is_flag=True, help="Overwrite the recording if it exists."),
        click.option("--no-record", is_flag=True, help="Record nothing."),
        click.option(
            "--keep-recording",
            is_flag=True,
            help="Continue without a view: killed, its terminal closed, or its rows not read.",
        ),
        click.option(
            "--rotate",
            type=_rotate,
            metavar="SIZE|TIME",
            help="Begin the next file at 512MB, or after 1h: NAME_00001.mcap, NAME_00002.mcap ....",
        ),
        click.option(
            "--max-size",
            type=_size,
            metavar="SIZE",
            help="Keep the newest rows: files of this total size, the oldest are deleted.",
        ),
        click.option(
            "--min-free",
            type=_size,
            metavar="SIZE",
            help="Leave this much free on the disk: recording waits for space.  "
            f"[default: {size_text(DEFAULT_FREE_BYTES).replace(' ', '')},"
            " less on a small or full disk]",
        ),
    ),
    in_group(
        "Rows that are shown",
        click.option("--plain", is_flag=True, help="Print one line per row instead of the screen."),
        click.option(
            "--headless",
            is_flag=True,
            help="Only record, as a service: no rows, one line for each file and port event.",
        ),
        format_option(
            "Print the rows in this format instead of the screen, each at once.", TEXT_FORMATS
        ),
        columns_option,
        filter_option,
        alert_option,
        click.option(
            "--silence",
            type=seconds_from(0.1, 86_400),
            metavar="S",
            help="Report a wire that was alive and sends nothing for S seconds.  [default: 2]",
        ),
    ),
    in_group("Rows for other programs", data_options),
    in_group(
        "End of the capture",
        click.option(
            "--duration",
            type=seconds_from(0.001),
            metavar="S",
            help="End after S seconds, or 5min, or 1h.",
        ),
        click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N rows."),
    ),
)
"""The options of a command that captures; `run_capture` takes their values."""


_UNRECORDED = RecordingOptions(keep_bytes=256_000_000, min_free_bytes=0)
"""Of the file through which the rows of an unrecorded capture go."""


def _check_output(output: Path) -> None:
    """Raise UsageError for standard output, and for the name of another format."""
    form = FORMAT_BY_SUFFIX.get(output.suffix.lower(), OutputFormat.MCAP)
    if str(output) == "-" or form is not OutputFormat.MCAP:
        raise UsageError(
            f"-o {output}: a capture is recorded to an MCAP file; for other formats use --format,"
            " or `fte-sniff decode --follow FILE` beside it"
        )


def _of_shown_rows(given: SimpleNamespace) -> list[str]:
    """The options that have no effect where no rows are shown; `--udp` sends filtered rows."""
    shown = {"--plain": given.plain, "--format": given.form, "--columns": given.columns}
    shown |= {"--alert": given.alert, "--filter": given.udp is None and given.filter_text}
    return [option for option, value in shown.items() if value]


def capture_plan(given: SimpleNamespace, wiring: Wiring) -> CapturePlan:
    """The plan of a capture with these options.

    Raises UsageError if options contradict each other, or the output is not a file of recordings.
    """
    from fte_sniff.session.control import CapturePlan

    output = given.output
    if given.no_record and (output is not None or given.keep_recording):
        raise UsageError("--no-record contradicts -o and --keep-recording; leave one of them out")
    if given.headless and (unused := _of_shown_rows(given)):
        raise UsageError("--headless shows no rows: leave out {options}", options=listed(unused))
    if output is not None:
        _check_output(output)
    found = RecordingOptions(
        **given.rotate or {}, keep_bytes=given.max_size, min_free_bytes=given.min_free
    )
    least = max(_MIN_KEPT, 2 * (found.rotate_bytes or 0))
    if found.keep_bytes is not None and found.keep_bytes < least:
        raise UsageError(f"--max-size must be at least {size_text(least)}: two files; raise it")
    path, existing = output, Existing.REPLACE if given.force else Existing.REFUSE
    if path is None:
        path, existing = Path(f"fte-sniff-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"), Existing.NUMBER
    if given.no_record:
        path, found = Path(mkdtemp(prefix="fte-sniff-")) / "rows.mcap", _UNRECORDED
    return CapturePlan(
        wiring,
        path,
        existing,
        found,
        is_temporary=given.no_record,
        outlives_view=given.keep_recording,
        shows_rows=not given.headless,
        duration_s=given.duration,
        count=given.count,
        silence_s=(given.alert and given.alert.silence_s) or given.silence or DEFAULT_SILENCE_S,
    )


def run_capture(
    ports: Sequence[str],
    settings: Settings,
    *,
    way: Way,
    link: str | None = None,
    pid: int | None = None,
    share: bool = False,
    **options: Any,
) -> None:
    """Capture, record and show or print, until the end.

    `way`, `link`, and `pid` are those of the wiring; the settings have defaults for options that
    are not given. `options` are the values of `capture_options`. Raises FteSniffError after
    everything is closed, if the capture failed.
    """
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.capture.wiring import Wiring

    given, zone = SimpleNamespace(**options), settings.live.get("zone")
    baud = given.baud
    if baud is None:
        baud = settings.default(ports, "baud") or DEFAULT_BAUD
    lines = given.dtr == "on", given.rts == "on"
    reconnect = settings.live.get("reconnect", True)
    wiring = Wiring(ports, PortSettings(baud, *lines, share), way, link, pid, reconnect)
    plan = capture_plan(given, wiring)
    wanted = row_filter(given.filter_text, zone)
    kept = HANG_UP if given.keep_recording else ()
    signals = tuple(one for one in ENDING_SIGNALS if one not in kept)
    drive, observers = None, list[Observer]()
    if given.headless:
        form = later("capturing {names}, recording to {path}")
        observers.append(CaptureReport(plan, zone, form))
    elif (
        given.plain
        or given.form
        or given.columns
        or not (sys.stdout.isatty() and sys.stdin.isatty())
    ):
        printed = OutputFormat(given.form or ("csv" if given.columns else "table"))
        check_columns(given.columns, printed)
        columns = given.columns or ALL_COLUMNS
        source = ExportSource(plan.wiring.names, columns=columns, zone=zone or UTC)
        write = text_writer(printed, sys.stdout, source)
        observers += [
            CaptureReport(plan, zone, later("recording to {path}")),
            PlainLines(plan, wanted, given.alert, write),
        ]
    else:
        from fte_sniff.tui.options import StartOptions

        start = StartOptions(
            row_filter=wanted,
            alert=given.alert,
            leave_at_end=given.duration is not None or given.count is not None,
            signals=signals,
            pulses_per_turn=settings.pulses_per_turn(ports),
            language=settings.language(),
            choices=settings.choices,
            save_choices=settings.keep,
            warnings=settings.trouble,
            zone=zone,
        )
        screen = Screen(plan, start)
        observers.append(screen)
        drive = screen.show
    is_network = settings.live.get("network", False)
    if given.udp is not None:
        observers.append(Datagrams(local("--udp", given.udp, is_network), wanted))
    if given.serve is not None:
        try:
            from fte_sniff.cli.foxglove_server import FoxgloveServer
        except ImportError as error:
            install = f"`{sys.executable} -m pip install 'fte-sniff[foxglove]'`"
            raise UsageError(f"--serve needs websockets: {install}") from error
        address = local("--serve", given.serve, is_network)
        observers.append(FoxgloveServer(address, plan.wiring.names, given.origins))
    elif given.origins:
        raise UsageError("--allow-origin works with --serve; add it")
    sys.exit(capture(plan, observers, signals, drive))


_EXPECTED_EVENTS = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})
_SELF_EXPLAINED = (PortEventKind.SHARED, PortEventKind.SILENT, PortEventKind.BYTES_AGAIN)
_WORDS = dict.fromkeys(_SELF_EXPLAINED, "") | {PortEventKind.WIRING: later(" note")}
"""What is printed of a kind of event, if not the kind: some details name what happened."""


class CaptureReport(Observer):
    """Prints where the capture goes, its port events and problems, and the summary at the end."""

    def __init__(self, plan: CapturePlan, zone: tzinfo | None, intro: str | None = None) -> None:
        """`intro` names each file, and the ports; None prints only the end."""
        self._plan, self._zone, self._intro = plan, zone or UTC, intro
        self._tally = Tally()
        self._printed = set[str]()
        self._is_wrong = False
        """Whether a row is damaged, or has an error flag."""

    def begun(self, session: LiveSession) -> None:
        """Print the file, and what a user may have to do."""
        device = session.capture.device
        if device is not None and self._intro is not None:
            print_err(f"a host program can open {printable(device)}")
        self._print_news(session.capture)
        if self._plan.outlives_view:
            pid = session.capture_pid
            print_err(f"the capture continues if this view is killed; `kill {pid}` ends it then")

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Count the rows; print the events, an error of the capture once, and each next file."""
        rows = update.rows
        self._tally.observe(rows)
        self._is_wrong |= bool(rows.faults.any() or rows.field(NAME_OF_ROLE[Role.ERRORS])[0].any())
        for event in update.events if self._intro is not None else ():
            if event.kind not in _EXPECTED_EVENTS:
                kind = _WORDS.get(event.kind, f" {_(event.kind.replace('_', ' '))}")
                print_err(f"{event.port}{_(kind)}{event.detail and f': {event.detail}'}")
        self._print_news(session.capture)

    def _print_news(self, state: CaptureState) -> None:
        """Print an error of a capture that goes on, and the name of its file, each once."""
        if self._intro is None:
            return
        lines = [str(state.error)] if state.error is not None and not state.is_ended else []
        if state.recording is not None and not self._plan.is_temporary:
            names = " and ".join(self._plan.wiring.names)
            lines.append(_(self._intro, names=names, path=state.recording))
        for line in [one for one in lines if one not in self._printed]:
            self._printed.add(line)
            print_err(line)

    def ended(self, session: LiveSession) -> None:
        """Print the summary, and the files that were recorded."""
        print_err(summary(self._tally, zone=self._zone))
        recordings = () if self._plan.is_temporary else session.capture.recordings
        if files := [path for path in recordings if Path(path).exists()]:
            if self._is_wrong and len(files) == 1:
                print_err(f"what is wrong, and when: fte-sniff findings {quote(files[0])}")
            several = (f"{files[0]} to ", f", {len(files)} files") if files[1:] else ("", "")
            print_err(f"recorded to {several[0]}{files[-1]}{several[1]}")


class PlainLines(Observer):
    """Prints one line for each row that passes a filter."""

    def __init__(
        self,
        plan: CapturePlan,
        wanted: RowFilter | None,
        alert: Alert | None,
        write: Callable[[Rows], None],
    ) -> None:
        """None filters nothing, and alerts to nothing."""
        self._plan, self._alert, self._write = plan, alert, write
        self._wanted = None if wanted is None else wanted.stream()
        self._is_over = False

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Print the rows; raises OSError, once, if standard output cannot be written.

        Without a reader the capture ends, as with a closed screen, unless it outlives its view.
        """
        if self._is_over or session.hurried:
            return
        rows = update.rows
        if self._wanted is not None:
            rows = self._wanted.select(rows, update.changes)
        self._is_over = True
        try:
            self._write(rows)
            sys.stdout.flush()
        except BrokenPipeError:
            abandon_stdout()
            if not self._plan.outlives_view:
                if not self._plan.is_temporary:
                    print_err(_NO_READER)
                session.stop()
            return
        self._is_over = False
        rings = self._alert is not None and self._alert.observe(
            update.rows, time.monotonic(), update.events
        )
        if rings and sys.stderr.isatty():
            print("\a", end="", file=sys.stderr, flush=True)


_NO_READER = f"{STDOUT} has no reader any more: the capture ends; with --keep-recording it goes on"


class Screen(CaptureReport):
    """The screen; it polls the capture itself, and prints at the end where all is saved."""

    def __init__(self, plan: CapturePlan, options: StartOptions) -> None:
        super().__init__(plan, options.zone)
        self._options = options
        self._notes: Notes | None = None

    def show(self, session: LiveSession) -> int:
        """Show the screen until the user leaves it; the exit code is not 0 if it failed."""
        from fte_sniff.session.notes import Notes
        from fte_sniff.tui.app import run_screen

        self._notes = Notes(dict.fromkeys(map(Path, session.state().files)))
        if session.stopping:
            return 0
        return run_screen(session, replace(self._options, notes=self._notes))

    def ended(self, session: LiveSession) -> None:
        """Print the end of the capture, and where the notes were saved."""
        super().ended(session)
        if self._notes is not None:
            print_saved(self._notes)
