"""Owns `fte-sniff view`: the screen of `live` on files.

It must not know how files are read or how a screen looks; it shows the one what the other gives.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import click

from fte_sniff.cli.batches import Batch
from fte_sniff.cli.filtering import filter_option, row_filter
from fte_sniff.cli.inputs import STDIN, Input, check_inputs, input_arguments, meant, opened
from fte_sniff.cli.keeping import keep_rows_option
from fte_sniff.cli.signals import signals_call
from fte_sniff.cli.spans import span_of, span_options
from fte_sniff.cli.telling import tell
from fte_sniff.cli.units import bench_of, units_options
from fte_sniff.errors import UsageError
from fte_sniff.formats.kinds import InputKind


@click.command(name="view", short_help="Look at files on the screen that live has.")
@input_arguments
@filter_option
@span_options
@keep_rows_option(10_000_000)
@units_options
def command(
    files: tuple[Path, ...],
    kind: InputKind | None,
    topic: str | None,
    filter_text: str | None,
    since: str | None,
    until: str | None,
    keep_rows: int,
    resolution: float | None,
    gear_ratio: float | None,
) -> None:
    """Look at recordings, raw bytes or hex text on the screen that `live` has.

    A folder stands for the recordings in it, and they come in order of time.

    \b
    fte-sniff view samples/damaged.mcap
    """
    if not (sys.stdout.isatty() and sys.stdin.isatty()):
        raise UsageError("view needs a terminal; 'fte-sniff decode' writes rows to pipes and files")
    if STDIN in files:
        raise UsageError("view reads files only, since the keys come from standard input")
    bench = bench_of(resolution, gear_ratio)
    check_inputs(files)
    from fte_sniff.session.replay import ReplaySession
    from fte_sniff.tui.app import AtEnd, run_screen

    wanted = row_filter(filter_text)
    notes: list[str] = []
    inputs = opened(files, kind, topic)
    span = span_of(since, until, [one.times for one in inputs])
    batches = chain.from_iterable(one.batches(span, notes.append) for one in inputs)
    # What cannot be read at all is told before the screen opens, not on it.
    rows = (batch.sequence() for batch in _begun(batches))
    total = None if span else _total(inputs)
    read = [str(path) for named in files for path in meant(named)]
    session = ReplaySession(rows, " ".join(map(str, files)), total, read)
    code = run_screen(session, AtEnd.STAY, wanted, keep_rows, bench=bench)
    with signals_call(session.stop) as ask:
        # A terminal that stands still may not hold up the end.
        ask()
        for note in notes:
            tell(f"fte-sniff: {note}")
    if session.error is not None:
        raise session.error
    sys.exit(code)


def _begun(batches: Iterator[Batch]) -> Iterator[Batch]:
    """The same batches, the first of which is read now."""
    first = next(batches, None)
    return batches if first is None else chain([first], batches)


def _total(inputs: Sequence[Input]) -> int | None:
    """How many rows there will be; None where one input cannot tell."""
    counts = [one.count for one in inputs if one.count is not None]
    return sum(counts) if len(counts) == len(inputs) else None
