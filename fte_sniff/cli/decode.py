"""`fte-sniff decode`: recordings, raw bytes and logs to text, Parquet, MCAP and pcapng."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import click

from fte_sniff.ahead import ahead
from fte_sniff.cli.input_files import (
    STDIN,
    InputQuery,
    exit_if_unreadable,
    follow_option,
    input_options,
    output_options,
    print_notes,
    summary,
)
from fte_sniff.cli.options import check_columns, columns_option, grouped_command, rows_format_option
from fte_sniff.cli.streams import ending_signals, interruptible, print_err
from fte_sniff.errors import UsageError
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat
from fte_sniff.platform import ENDING_SIGNALS
from fte_sniff.recording.metadata import Selection
from fte_sniff.recording.output_file import Existing
from fte_sniff.session.save import ExportSource, Write, exported, format_of, writing


@grouped_command(name="decode", short_help="Files to a table, JSON lines, CSV, Parquet or MCAP.")
@input_options()
@follow_option
@rows_format_option(OutputFormat)
@output_options("Write to this file instead of standard output; its extension selects the format.")
@columns_option
@click.option(
    "--limit",
    type=click.IntRange(min=0),
    default=sys.maxsize,
    show_default=False,
    metavar="N",
    help="Stop after N rows.",
)
def command(
    query: InputQuery,
    following: bool,
    form: str | None,
    output: Path | None,
    force: bool,
    columns: tuple[str, ...] | None,
    limit: int,
) -> None:
    """Decode recordings (.mcap), raw bytes (.bin .raw), hex text and logs (.hex .txt .log).

    '-' reads standard input; a folder means the recordings in it. The rows of several files are
    merged by time. Rows go to standard output, a summary to standard error.

    \b
    fte-sniff decode samples/clean.mcap
    fte-sniff decode samples/damaged.raw --filter "status = 'malformed'"
    fte-sniff decode samples/clean.mcap --from +10s --to +20s
    fte-sniff decode samples/clean.hex --format csv -o clean.csv
    fte-sniff decode samples/clean.mcap --columns time,motor,rpm
    fte-sniff decode --follow capture.mcap --filter "error = 1"
    """
    written = OutputFormat(form) if form else _format_for(output, chooses=columns is not None)
    check_columns(columns, written)
    if following and written is OutputFormat.PARQUET:
        raise UsageError("parquet is written as a whole; write csv, jsonl or mcap with --follow")
    # Following ends by Ctrl-C, as a capture does.
    follower = query.follower() if following else None
    ending = nullcontext() if follower is None else ending_signals(follower.stop)
    with ending:
        # The rows of a stream do not wait, unless the filter needs it.
        is_stream = follower is not None or STDIN in query.files
        row_filter = query.row_filter()
        reading = query.read(follower)
        reading.row_filter, reading.limit = row_filter, limit
        reading.has_facts = written in _WITH_FACTS and not is_stream
        source = reading.source(columns)
        with _opened(written, output, source, force=force) as write:
            for item in reading if is_stream else ahead(iter(reading)):
                write(item)
            if row_filter is not None:
                source.selections.append(Selection(row_filter.text, reading.tally.rows))
    print_notes(reading)
    print_err(summary(reading.tally, reading, zone=reading.zone))
    exit_if_unreadable(reading)


_WITH_FACTS = (OutputFormat.JSONL, OutputFormat.CSV, OutputFormat.PARQUET)
"""The formats with the columns that depend on later rows."""


def _format_for(output: Path | None, *, chooses: bool) -> OutputFormat:
    """The format for the extension of the output; without one a table, or CSV for chosen columns.

    Raises UsageError if the extension is unknown.
    """
    if output is not None and output.suffix:
        return format_of(output)
    return OutputFormat.CSV if chooses else OutputFormat.TABLE


@contextmanager
def _opened(
    form: OutputFormat, path: Path | None, source: ExportSource, *, force: bool
) -> Iterator[Write]:
    """Standard output (None or `-`), or a file that replaces `path` when complete.

    A command that fails or is interrupted leaves no file, and an old file stays until the new one
    is complete.

    Raises:
        UsageError: the format needs a file, or standard output is a terminal.
        FileError: the file exists (and `force` is not set), or cannot be written.
        BrokenPipeError: standard output lost its reader.
    """
    if path is not None and path != STDIN:
        existing = Existing.REPLACE if force else Existing.REFUSE
        with interruptible(ENDING_SIGNALS), exported(path, form, source, existing) as write:
            yield write
    elif form in (*TEXT_FORMATS, OutputFormat.HEX):
        with writing(form, sys.stdout, source) as write:
            yield write
    elif path is None or form is OutputFormat.PARQUET or sys.stdout.isatty():
        pipe = "" if form is OutputFormat.PARQUET else ", or - for a pipe"
        raise UsageError(f"{form} is not text: name a file to write it to with -o{pipe}")
    else:
        with (
            open(sys.stdout.fileno(), "wb", closefd=False) as stream,
            writing(form, stream, source) as write,
        ):
            yield write
