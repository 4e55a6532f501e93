"""`fte-sniff stats`: statistics over files, as text or as one JSON object."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, check_inputs, input_options
from fte_sniff.cli.options import line_speed_option
from fte_sniff.cli.output import exit_if_unreadable, explain_no_frames, print_notes
from fte_sniff.cli.progress import progress_line
from fte_sniff.cli.stats_json import statistics_json
from fte_sniff.cli.streams import print_err
from fte_sniff.formats.writers import printable_json
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.input_reading import InputReading

if TYPE_CHECKING:
    from fte_sniff.analysis.summary import StatisticsSummary
    from fte_sniff.analysis.timeline import Timeline


@click.command(name="stats", short_help="Statistics over files: rates, faults, silences, answers.")
@input_options
@click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="Text for people, or one JSON object (docs/stats.md).",
)
@line_speed_option
def command(query: InputQuery, form: str, baud: int | None) -> None:
    """Print statistics over recordings, raw bytes or hex text, all files together.

    Duration, rows and bytes, use and silences of each line; faults by kind; rate, period, jitter
    and values of each kind of frame by motor; answer times and flags seen. With --filter, only
    matching rows are counted.

    \b
    fte-sniff stats samples/damaged.mcap
    fte-sniff stats logs/ --from -10m
    fte-sniff stats samples/clean.mcap --format json
    """
    check_inputs(query.files)
    with progress_line(reads_stdin=STDIN in query.files) as line:
        reading = query.read(query.row_filter(), baud=baud, progress=line.progress)
        summary = summarize(reading, baud)
    if form == "json":
        numbers = statistics_json(summary, reading)
        click.echo(printable_json(json.dumps(numbers, ensure_ascii=False, indent=2)))
    else:
        _show(summary, reading)
    print_notes(reading)
    if advice := explain_no_frames(reading.tally, reading):
        print_err(f"fte-sniff: {advice}")
    exit_if_unreadable(reading)


def summarize(
    reading: InputReading, baud: int | None, timeline: Timeline | None = None
) -> StatisticsSummary:
    """Read the inputs, one after the other; returns their statistics, and fills the timeline."""
    from fte_sniff.analysis.statistics import LineSetup
    from fte_sniff.analysis.summary import StatisticsSummary
    from fte_sniff.row_batch import RowBatch

    summary = StatisticsSummary(LineSetup(baud or DEFAULT_BAUD))
    for one in reading.inputs:
        summary.begin(one.name)
        for batch in reading.batches_of(one):
            summary.observe(batch.rows, batch.events, batch.changes)
            if timeline is not None:
                timeline.observe(RowBatch.from_rows(batch.rows))
    return summary


def _show(summary: StatisticsSummary, reading: InputReading) -> None:
    from fte_sniff.cli.stats_report import report_lines

    if not sys.stdout.isatty():
        lines = report_lines(summary, reading, None)
        sys.stdout.writelines(f"{line.plain.rstrip()}\n" for line in lines)
        return
    from rich.console import Console

    console = Console(file=sys.stdout)
    for line in report_lines(summary, reading, console.width):
        console.print(line, no_wrap=True, overflow="ellipsis", crop=True)
