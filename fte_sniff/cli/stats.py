"""Owns `fte-sniff stats`: the numbers over files, for people or as one JSON object.

It must not count anything, nor know how files are read.
"""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import ReadOptions, check_inputs, input_arguments, opened
from fte_sniff.cli.options import (
    filter_option,
    line_speed_option,
    row_filter,
    span_of,
    span_options,
)
from fte_sniff.cli.output import hint
from fte_sniff.cli.stats_json import ReportOptions, document
from fte_sniff.cli.streams import tell
from fte_sniff.protocol import DEFAULT_BAUD
from fte_sniff.session.pipeline import InputReading

if TYPE_CHECKING:
    from fte_sniff.analysis.summary import StatisticsSummary
    from fte_sniff.recording.metadata import Selection


class Form(StrEnum):
    """The forms that numbers can be written in."""

    TEXT = "text"
    JSON = "json"


@click.command(name="stats", short_help="Numbers over files: rates, faults, silences, answers.")
@input_arguments
@click.option(
    "--format",
    "form",
    type=click.Choice([form.value for form in Form]),
    callback=lambda _context, _option, word: Form(word),
    default=Form.TEXT.value,
    show_default=True,
    help="Text for people, or one JSON object (docs/stats.md).",
)
@filter_option
@span_options
@line_speed_option
def command(
    files: tuple[Path, ...],
    how: ReadOptions,
    form: Form,
    filter_text: str | None,
    since: str | None,
    until: str | None,
    baud: int | None,
) -> None:
    """Tell the numbers over recordings, raw bytes or hex text: all files together.

    How long, how many rows and bytes, how full each line was and how long it was silent; faults by
    kind; rate, period, jitter and values of each kind of frame by motor; how long answers took,
    and which flags were seen. Where --filter is given, of the rows for which it holds.

    \b
    fte-sniff stats samples/damaged.mcap
    fte-sniff stats logs/ --from -10m
    fte-sniff stats samples/clean.mcap --format json
    """
    check_inputs(files)
    wanted = row_filter(filter_text)
    inputs = opened(files, how)
    span = span_of(since, until, (one.times for one in inputs), how.zone_given())
    reading = InputReading(inputs, span, wanted)
    survey = _surveyed(reading, baud)
    asked = ReportOptions(filter_text, reading.tally.rows, reading.left_out, _selections(reading))
    if form is Form.JSON:
        numbers = document(survey, asked)
        click.echo(json.dumps(numbers, ensure_ascii=False, indent=2))
    else:
        _show(survey, asked)
    for note in reading.notes:
        tell(f"fte-sniff: {note}")
    if span is not None and not reading.tally.rows:
        tell("fte-sniff: no row lies between --from and --to")
    elif advice := hint(reading.tally):
        tell(f"fte-sniff: {advice}")


def _selections(reading: InputReading) -> list[Selection]:
    """What the inputs tell of filters before this one."""
    return [selection for one in reading.inputs for selection in one.selections()]


def _surveyed(reading: InputReading, baud: int | None) -> StatisticsSummary:
    from fte_sniff.analysis.statistics import LineSetup
    from fte_sniff.analysis.summary import StatisticsSummary

    survey = StatisticsSummary(LineSetup(baud or DEFAULT_BAUD))
    before = None
    for one, left_out in zip(reading.inputs, reading.left_out_of, strict=True):
        told = {port.name: port.baud for port in one.ports if port.baud} if baud is None else {}
        survey.begin(one.name, told, [(gap.first_ns, gap.last_ns) for gap in left_out])
        if not one.follows(before):
            survey.interrupt()
        for batch in reading.of(one):
            if batch.after_loss:
                survey.interrupt()
            survey.add(batch.sequence(), batch.events)
        if one.losses:
            survey.interrupt()
        before = one
    return survey


def _show(survey: StatisticsSummary, asked: ReportOptions) -> None:
    from fte_sniff.cli.stats_report import page

    if not sys.stdout.isatty():
        lines = page(survey, asked, None)
        sys.stdout.writelines(f"{line.plain.rstrip()}\n" for line in lines)
        return
    from rich.console import Console

    console = Console(file=sys.stdout)
    for line in page(survey, asked, console.width):
        console.print(line, no_wrap=True, overflow="ellipsis", crop=True)
