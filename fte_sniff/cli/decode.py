"""Owns `fte-sniff decode`: recordings, raw bytes and hex text to rows in a form that others read.

It must not know formats or the frame table; it wires readers to a filter to a writer.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import ReadOptions, check_inputs, input_arguments, opened
from fte_sniff.cli.options import FileName, filter_option, row_filter, span_of, span_options
from fte_sniff.cli.output import file_output, form_of, format_option, summary, text_output
from fte_sniff.cli.streams import tell
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.session.pipeline import InputReading

if TYPE_CHECKING:
    from fte_sniff.recording.bulk_writer import Note


@click.command(name="decode", short_help="Files to a table, JSON lines, CSV, Parquet or MCAP.")
@input_arguments
@format_option(None, tuple(OutputFormat))
@click.option(
    "-o",
    "--output",
    type=FileName(),
    help="Write to this file instead of standard output; without --format its end says the form.",
)
@click.option("--force", is_flag=True, help="Overwrite the output file if it exists.")
@filter_option
@span_options
@click.option("--limit", type=click.IntRange(min=0), metavar="N", help="Stop after N rows.")
def command(
    files: tuple[Path, ...],
    how: ReadOptions,
    form: OutputFormat | None,
    output: Path | None,
    force: bool,
    filter_text: str | None,
    since: str | None,
    until: str | None,
    limit: int | None,
) -> None:
    """Decode recordings (.mcap), raw bytes (.bin .raw) and hex text (.hex .txt .log).

    '-' reads standard input; a folder stands for the recordings in it, and they come in order of
    time. Rows go to standard output, a summary to standard error.

    \b
    fte-sniff decode samples/clean.mcap
    fte-sniff decode samples/damaged.raw --filter "status = 'malformed'"
    fte-sniff decode samples/clean.mcap --from +10s --to +20s
    fte-sniff decode samples/clean.hex --format csv -o clean.csv
    """
    check_inputs(files, output)
    form = form or form_of(output)
    wanted = row_filter(filter_text)
    inputs = opened(files, how)
    span = span_of(since, until, (one.times for one in inputs), how.zone_given())
    reading = InputReading(inputs, span, wanted, limit)
    _write(form, output, reading, force=force)
    for note in reading.notes:
        tell(f"fte-sniff: {note}")
    told = summary(
        reading.tally,
        reading.written,
        partly=reading.written == limit,
        filter_text=filter_text,
        spanned=span is not None,
        left_out=reading.left_out,
    )
    tell(told)


def _write(form: OutputFormat, output: Path | None, reading: InputReading, *, force: bool) -> None:
    if form is OutputFormat.PARQUET:
        from fte_sniff.analysis.dataframe import TABLE_SCHEMA
        from fte_sniff.formats.parquet import write_parquet

        with file_output(output, form, force=force) as path:
            write_parquet((batch.frame() for batch in reading), path, dict(TABLE_SCHEMA))
    elif form is OutputFormat.MCAP:
        _record(output, reading, force=force)
    elif form is OutputFormat.RAW:
        _pour(output, reading, force=force)
    else:
        with text_output(output, force=force) as stream:
            writer = row_writer(form, stream, ports=len(reading.inputs) > 1)
            for batch in reading:
                batch.write_to(writer)
                # Who reads along is not to wait for what has not come yet.
                stream.flush()
            writer.end()


def _pour(output: Path | None, reading: InputReading, *, force: bool) -> None:
    from fte_sniff.session.save import UNKNOWN, RawSink

    with file_output(output, OutputFormat.RAW, force=force) as path:
        sink = RawSink(path, UNKNOWN)
        try:
            for batch in reading:
                sink.write(batch.sequence())
        finally:
            sink.end()
    if len(sink.ports) > 1:
        reading.notes.append(
            f"{_named(output)}: holds the bytes of {len(sink.ports)} ports in one stream, and"
            " nothing in it tells them apart; for one of them say"
            f" --filter \"port = '{min(sink.ports)}'\""
        )


def _named(output: Path | None) -> str:
    return "standard output" if str(output) == "-" else str(output)


def _record(output: Path | None, reading: InputReading, *, force: bool) -> None:
    from fte_sniff.recording.bulk_writer import write_recording
    from fte_sniff.recording.metadata import LEFT_OUT_NAME, OF_A_PART, SELECTION_NAME
    from fte_sniff.row_batch import Codebook

    codebook = Codebook()
    with file_output(output, OutputFormat.MCAP, force=force) as path:
        ports = [port for one in reading.inputs for port in one.ports]
        facts = {name: fact for one in reading.inputs for name, fact in one.facts.items()}
        own = {name: fact for name, fact in facts.items() if name not in OF_A_PART}

        def notes() -> Iterator[Note]:
            yield from ((LEFT_OUT_NAME, one.told()) for one in reading.missing)
            yield from ((SELECTION_NAME, one.told()) for one in reading.selections)

        write_recording(path, ports, (batch.columns(codebook) for batch in reading), own, notes)
