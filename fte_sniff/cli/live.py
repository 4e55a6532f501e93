"""Owns `fte-sniff live`: capture a port, record it, and watch it.

It must not know how a capture runs or how a screen looks; it starts the one and shows it the other.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.filtering import filter_option, row_filter, selection
from fte_sniff.cli.keeping import keep_rows_option
from fte_sniff.cli.signals import signals_call
from fte_sniff.cli.stdout import abandon_stdout
from fte_sniff.errors import UsageError, shown
from fte_sniff.protocol import DEFAULT_BAUD, Row

if TYPE_CHECKING:
    from fte_sniff.session.live import LiveSession
    from fte_sniff.session.plan import CapturePlan

LOOK_EVERY_S = 0.1
"""Seconds that plain output waits for rows before it looks at signals again."""

_LINE_WORDS = click.Choice(["on", "off", "leave"])


@click.command(name="live", short_help="Capture a port, record it and watch it.")
@click.argument("port")
@click.option("--baud", type=click.INT, default=DEFAULT_BAUD, show_default=True, help="Bits/s.")
@click.option("--dtr", type=_LINE_WORDS, default="off", show_default=True, help="Set DTR.")
@click.option("--rts", type=_LINE_WORDS, default="off", show_default=True, help="Set RTS.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Record to this file.")
@click.option("--force", is_flag=True, help="Overwrite the recording if it exists.")
@click.option("--no-record", is_flag=True, help="Record nothing.")
@click.option("--plain", is_flag=True, help="Print one line a row instead of the screen.")
@filter_option
@keep_rows_option(1_000_000)
@click.option("--duration", type=click.FloatRange(min=0), metavar="S", help="End after S seconds.")
@click.option("--count", type=click.IntRange(min=1), metavar="N", help="End after N rows.")
def command(
    filter_text: str | None,
    plain: bool,
    output: Path | None,
    no_record: bool,
    keep_rows: int,
    **options: Any,
) -> None:
    r"""Capture PORT, record it and watch it.

    PORT is a device, or what else pyserial opens: socket://host:port, rfc2217://host:port, loop://,
    hwgrep://, or sim://, a simulated host and controller (sim://?seed=1&rate=200&drop=0.01).
    Nothing is ever written to it. The recording goes to fte-sniff-<UTC time>.mcap in this folder,
    unless -o names it or --no-record does without. The filter is for the eyes: all is recorded.

    \b
    fte-sniff live /dev/ttyUSB0
    fte-sniff live sim:// --plain --count 20 --no-record
    """
    if no_record and output is not None:
        raise UsageError("-o names a recording and --no-record wants none; leave one of them out")
    recording = None if no_record else output or _default_path()
    plan = _plan(recording=recording, **options)
    if plain or not (sys.stdout.isatty() and sys.stdin.isatty()):
        _print_lines(plan, filter_text)
    else:
        _show_screen(plan, filter_text, keep_rows)


def _default_path() -> Path:
    """`fte-sniff-<UTC time>.mcap` in the working folder, numbered where one is there already."""
    stem = f"fte-sniff-{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    path, number = Path(f"{stem}.mcap"), 1
    while path.exists():
        number += 1
        path = Path(f"{stem}-{number}.mcap")
    return path


def _plan(
    *,
    port: str,
    baud: int,
    dtr: str,
    rts: str,
    recording: Path | None,
    force: bool,
    duration: float | None,
    count: int | None,
) -> CapturePlan:
    from fte_sniff.capture.ports import ControlLine, PortSettings
    from fte_sniff.recording.writer import Existing
    from fte_sniff.session.plan import CapturePlan

    return CapturePlan(
        port=port,
        settings=PortSettings(baud, ControlLine(dtr), ControlLine(rts)),
        recording=recording,
        existing=Existing.REPLACE if force else Existing.REFUSE,
        duration_s=duration,
        count=count,
    )


def _print_lines(plan: CapturePlan, filter_text: str | None) -> None:
    from fte_sniff.analysis.tally import Tally
    from fte_sniff.cli.summary import summary
    from fte_sniff.formats.writers import OutputFormat, row_writer
    from fte_sniff.session.live import LiveSession

    select = selection(filter_text)
    writer = row_writer(OutputFormat.TABLE, sys.stdout, ports=False)
    tally = Tally()
    with LiveSession(plan) as session, signals_call(session.stop):
        if plan.recording is not None:
            click.echo(f"recording to {shown(str(plan.recording))}", err=True)
        try:
            for rows in _row_batches(session):
                tally.add(rows)
                writer.write(select(rows))
                sys.stdout.flush()
        except BrokenPipeError:
            abandon_stdout()
    click.echo(summary(tally), err=True)
    _leave(plan, session)


def _row_batches(session: LiveSession) -> Iterator[Sequence[Row]]:
    """What the session hands over, until it has ended."""
    running = True
    while running:
        update = session.wait(LOOK_EVERY_S)
        running = update.state.running
        if update.rows:
            yield update.rows


def _show_screen(plan: CapturePlan, filter_text: str | None, keep_rows: int) -> None:
    from fte_sniff.session.live import LiveSession
    from fte_sniff.tui.app import AtEnd, run_screen

    wanted = row_filter(filter_text)
    bounded = plan.duration_s is not None or plan.count is not None
    with LiveSession(plan) as session:
        at_end = AtEnd.LEAVE if bounded else AtEnd.STAY
        code = run_screen(session, at_end, wanted, keep_rows)
    _leave(plan, session)
    sys.exit(code)


def _leave(plan: CapturePlan, session: LiveSession) -> None:
    if plan.recording is not None:
        click.echo(f"recorded to {shown(str(plan.recording))}", err=True)
    if session.error is not None:
        raise session.error
