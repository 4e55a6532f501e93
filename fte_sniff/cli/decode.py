"""`fte-sniff decode`: recordings, raw bytes and hex text to tables, CSV, JSONL, Parquet, MCAP."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.input_files import ReadOptions, check_inputs, input_arguments, open_inputs
from fte_sniff.cli.options import FileName, filter_option, row_filter, span_options, time_range
from fte_sniff.cli.output import file_output, format_for, format_option, summary, text_output
from fte_sniff.cli.streams import print_err
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.session.pipeline import InputReading, write_rows

if TYPE_CHECKING:
    from fte_sniff.recording.bulk_writer import NamedFacts


@click.command(name="decode", short_help="Files to a table, JSON lines, CSV, Parquet or MCAP.")
@input_arguments
@format_option(None, tuple(OutputFormat))
@click.option(
    "-o",
    "--output",
    type=FileName(),
    help="Write to this file instead of standard output; its extension selects the format.",
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

    '-' reads standard input; a folder means the recordings in it, in order of time. Rows go to
    standard output, a summary to standard error.

    \b
    fte-sniff decode samples/clean.mcap
    fte-sniff decode samples/damaged.raw --filter "status = 'malformed'"
    fte-sniff decode samples/clean.mcap --from +10s --to +20s
    fte-sniff decode samples/clean.hex --format csv -o clean.csv
    """
    check_inputs(files, output)
    form = form or format_for(output)
    wanted = row_filter(filter_text)
    inputs = open_inputs(files, how)
    span = time_range(since, until, (one.times for one in inputs), how.zone_given())
    reading = InputReading(inputs, span, wanted, limit)
    _write(form, output, reading, force=force)
    for note in reading.notes:
        print_err(f"fte-sniff: {note}")
    line = summary(
        reading.tally,
        reading.written,
        partly=reading.written == limit,
        filter_text=filter_text,
        spanned=span is not None,
        gaps=reading.reported_gaps,
    )
    print_err(line)


def _write(form: OutputFormat, output: Path | None, reading: InputReading, *, force: bool) -> None:
    if form is OutputFormat.PARQUET:
        from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
        from fte_sniff.formats.parquet import write_parquet

        with file_output(output, form, force=force) as path:
            write_parquet((table_frame(batch.rows) for batch in reading), path, dict(TABLE_SCHEMA))
    elif form is OutputFormat.MCAP:
        _write_recording(output, reading, force=force)
    elif form is OutputFormat.RAW:
        _write_raw(output, reading, force=force)
    else:
        with text_output(output, force=force) as stream:
            writer = row_writer(form, stream, ports=len(reading.inputs) > 1)
            for batch in reading:
                write_rows(writer, batch.rows)
                # A reader of the pipe gets each batch at once.
                stream.flush()
            writer.close()


def _write_raw(output: Path | None, reading: InputReading, *, force: bool) -> None:
    from fte_sniff.session.save import UNKNOWN, RawSink

    with file_output(output, OutputFormat.RAW, force=force) as path:
        sink = RawSink(path, UNKNOWN)
        try:
            for batch in reading:
                sink.write(batch.rows)
        finally:
            sink.end()
    if len(sink.ports) > 1:
        reading.notes.append(
            f"{_output_name(output)}: holds the bytes of {len(sink.ports)} ports in one stream, and"
            " nothing in it separates them; for one of them use"
            f" --filter \"port = '{min(sink.ports)}'\""
        )


def _output_name(output: Path | None) -> str:
    return "standard output" if str(output) == "-" else str(output)


def _write_recording(output: Path | None, reading: InputReading, *, force: bool) -> None:
    from fte_sniff.recording.bulk_writer import write_recording
    from fte_sniff.recording.metadata import (
        LEFT_OUT_NAME,
        PART_FACTS,
        SELECTION_NAME,
        gap_to_metadata,
    )
    from fte_sniff.row_batch import RowBatch

    with file_output(output, OutputFormat.MCAP, force=force) as path:
        ports = [port for one in reading.inputs for port in one.ports]
        facts = {name: fact for one in reading.inputs for name, fact in one.facts.items()}
        own = {name: fact for name, fact in facts.items() if name not in PART_FACTS}

        def metadata() -> Iterator[NamedFacts]:
            yield from ((LEFT_OUT_NAME, gap_to_metadata(gap)) for gap in reading.gaps)
            yield from ((SELECTION_NAME, one.to_metadata()) for one in reading.selections)

        batches = (RowBatch.from_rows(batch.rows, events=batch.events) for batch in reading)
        write_recording(path, ports, batches, own, metadata)
