"""`fte-sniff view`: the screen of `live` on files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import chain, islice
from pathlib import Path

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, check_inputs, input_options
from fte_sniff.cli.options import (
    REREAD_ROWS,
    keep_rows_option,
    line_setup,
    units_options,
)
from fte_sniff.cli.output import exit_if_unreadable, print_notes
from fte_sniff.cli.progress import progress_line
from fte_sniff.cli.settings import config_option, lang_option, load_settings
from fte_sniff.cli.streams import ending_signals
from fte_sniff.errors import UsageError
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.inputs import Input, RecordingInput


@click.command(name="view", short_help="Show files on the screen of live.")
@input_options
@keep_rows_option(10_000_000, REREAD_ROWS)
@units_options
@config_option
@lang_option
def command(
    query: InputQuery,
    keep_rows: int,
    resolution: float | None,
    gear_ratio: float | None,
    config: Path | None,
    lang: str | None,
) -> None:
    """Show recordings, raw bytes or hex text on the screen of `live`.

    A folder means the recordings in it. The rows of several files are merged by time.

    \b
    fte-sniff view samples/damaged.mcap
    """
    if STDIN in query.files:
        raise UsageError(
            "view reads files only, since the keys come from standard input;"
            " 'fte-sniff decode -' reads it"
        )
    if not (sys.stdout.isatty() and sys.stdin.isatty()):
        raise UsageError("view needs a terminal; 'fte-sniff decode' writes rows to pipes and files")
    settings = load_settings(config)
    check_inputs(query.files)
    from fte_sniff.session.replay import RecordingPages, ReplaySession
    from fte_sniff.tui.app import run_screen
    from fte_sniff.tui.options import StartOptions

    wanted = query.row_filter()
    with progress_line() as line:
        reading = query.read(None, progress=line.progress)
        batches = iter(reading)
        # The first batch is read now, so that its error comes before the screen.
        opening_rows = [*islice(batches, 1)]
    ports = reading.source.ports
    setup = line_setup(settings, ports, resolution, gear_ratio, query.baud or DEFAULT_BAUD)
    only_recordings = all(isinstance(one, RecordingInput) for one in reading.inputs)
    pages = RecordingPages() if only_recordings else None
    session = ReplaySession(
        chain(opening_rows, batches),
        " ".join(map(str, query.files)),
        None if reading.span else _row_count(reading.inputs),
        list(map(str, query.paths())),
        pages,
    )
    opening = StartOptions(
        row_filter=wanted,
        keep_rows=keep_rows,
        line_setup=setup,
        export_source=reading.source,
        zone=query.zone_given(),
        language=settings.language(lang),
        choices=settings.choices,
        save_choices=settings.keep,
        warnings=settings.trouble,
    )
    code = run_screen(session, opening, pages)
    with ending_signals(session.stop) as request_end:
        # A stopped terminal may not block the exit.
        request_end()
        print_notes(reading)
    if session.error is not None:
        raise session.error
    exit_if_unreadable(reading)
    sys.exit(code)


def _row_count(inputs: Sequence[Input]) -> int | None:
    counts = [one.count for one in inputs if one.count is not None]
    return sum(counts) if len(counts) == len(inputs) else None
