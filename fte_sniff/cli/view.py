"""Owns `fte-sniff view`: the screen of `live` on files.

It must not know how files are read or how a screen looks; it shows the one what the other gives.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import (
    STDIN,
    ReadOptions,
    check_inputs,
    input_arguments,
    meant,
    opened,
)
from fte_sniff.cli.options import (
    REREAD,
    filter_option,
    keep_rows_option,
    line_speed_option,
    remembered_bench,
    row_filter,
    span_of,
    span_options,
    units_options,
)
from fte_sniff.cli.settings import config_option, lang_option, remembered
from fte_sniff.cli.streams import signals_call, tell
from fte_sniff.errors import UsageError
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.inputs import Input, RecordingInput

if TYPE_CHECKING:
    from fte_sniff.session.replay import Read


@click.command(name="view", short_help="Look at files on the screen that live has.")
@input_arguments
@filter_option
@span_options
@keep_rows_option(10_000_000, REREAD)
@line_speed_option
@units_options
@config_option
@lang_option
def command(
    files: tuple[Path, ...],
    how: ReadOptions,
    filter_text: str | None,
    since: str | None,
    until: str | None,
    keep_rows: int,
    baud: int | None,
    resolution: float | None,
    gear_ratio: float | None,
    config: Path | None,
    lang: str | None,
) -> None:
    """Look at recordings, raw bytes or hex text on the screen that `live` has.

    A folder stands for the recordings in it, and they come in order of time.

    \b
    fte-sniff view samples/damaged.mcap
    """
    if STDIN in files:
        raise UsageError(
            "view reads files only, since the keys come from standard input;"
            " 'fte-sniff decode -' reads it"
        )
    if not (sys.stdout.isatty() and sys.stdin.isatty()):
        raise UsageError("view needs a terminal; 'fte-sniff decode' writes rows to pipes and files")
    settings = remembered(config)
    check_inputs(files)
    from fte_sniff.session.pipeline import Viewing
    from fte_sniff.session.replay import RecordingPages, ReplaySession
    from fte_sniff.tui.app import run_screen
    from fte_sniff.tui.options import StartOptions

    wanted = row_filter(filter_text)
    notes: list[str] = []
    inputs = opened(files, how)
    ports = [port.name for one in inputs for port in one.ports]
    bench = remembered_bench(settings, ports, resolution, gear_ratio, baud or DEFAULT_BAUD)
    span = span_of(since, until, (one.times for one in inputs), how.zone_given())
    # What cannot be read at all is told before the screen opens, not on it.
    pages = RecordingPages() if _recordings_only(inputs) else None
    viewing = Viewing(inputs, span, baud, pages, notes.append)
    session = ReplaySession(
        _begun(iter(viewing)),
        " ".join(map(str, files)),
        None if span else _total(inputs),
        [str(path) for named in files for path in meant(named)],
    )
    opening = StartOptions(
        row_filter=wanted,
        keep_rows=keep_rows,
        bench=bench,
        origin=viewing.origin,
        zone=how.zone_given(),
        language=settings.language(lang),
        choices=settings.choices,
        keep=settings.keep,
        trouble=settings.trouble,
    )
    code = run_screen(session, opening, pages)
    with signals_call(session.stop) as ask:
        # A terminal that stands still may not hold up the end.
        ask()
        for note in notes:
            tell(f"fte-sniff: {note}")
    if session.error is not None:
        raise session.error
    sys.exit(code)


def _begun(reads: Iterator[Read]) -> Iterator[Read]:
    """The same, the first of which is read now."""
    first = next(reads, None)
    return reads if first is None else chain([first], reads)


def _recordings_only(inputs: Sequence[Input]) -> bool:
    return all(isinstance(one, RecordingInput) for one in inputs)


def _total(inputs: Sequence[Input]) -> int | None:
    """How many rows there will be; None where one input cannot tell."""
    counts = [one.count for one in inputs if one.count is not None]
    return sum(counts) if len(counts) == len(inputs) else None
