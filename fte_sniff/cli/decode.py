"""Owns `fte-sniff decode`: recordings, raw bytes and hex text to rows in a form that others read.

It must not know formats or the frame table; it wires a reader to a filter to a writer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.filtering import filter_option, selection
from fte_sniff.cli.inputs import batches_of, check_inputs, input_arguments
from fte_sniff.cli.outputs import format_option, text_output
from fte_sniff.cli.summary import summary
from fte_sniff.errors import shown
from fte_sniff.formats.kinds import InputKind
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.tally import Tally

Select = Callable[[Sequence[Row]], list[Row]]


@click.command(name="decode", short_help="Files to a table, JSON lines or CSV.")
@input_arguments
@format_option(OutputFormat.TABLE)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="Write to this file instead of standard output.",
)
@click.option("--force", is_flag=True, help="Overwrite the output file if it exists.")
@filter_option
@click.option("--limit", type=click.IntRange(min=0), metavar="N", help="Stop after N rows.")
def command(
    files: tuple[Path, ...],
    kind: InputKind | None,
    form: OutputFormat,
    output: Path | None,
    force: bool,
    filter_text: str | None,
    limit: int | None,
) -> None:
    """Decode recordings (.mcap), raw bytes (.bin .raw) and hex text (.hex .txt .log).

    '-' reads standard input. Rows go to standard output, a summary to standard error.

    \b
    fte-sniff decode samples/clean.mcap
    fte-sniff decode samples/damaged.raw --filter "status = 'malformed'"
    fte-sniff decode samples/clean.hex --format csv -o clean.csv
    """
    from fte_sniff.analysis.tally import Tally

    check_inputs(files, output)
    select = selection(filter_text)
    tally = Tally()
    notes: list[str] = []
    written = 0
    with text_output(output, force=force) as stream:
        writer = row_writer(form, stream, ports=len(files) > 1)
        for rows in _limited(_selected(files, kind, select, tally, notes.append), limit):
            writer.write(rows)
            written += len(rows)
        writer.end()
    for note in notes:
        click.echo(f"fte-sniff: {shown(note)}", err=True)
    click.echo(summary(tally, written, partly=written == limit), err=True)


def _selected(
    files: Iterable[Path],
    kind: InputKind | None,
    select: Select,
    tally: Tally,
    note: Callable[[str], None],
) -> Iterator[list[Row]]:
    """The rows that are wanted, in the order of the files; the tally takes all that were read."""
    for path in files:
        for rows in batches_of(path, kind, note):
            tally.add(rows)
            yield select(rows)


def _limited(batches: Iterable[list[Row]], limit: int | None) -> Iterator[list[Row]]:
    left = limit
    for rows in batches:
        if left is None:
            yield rows
            continue
        yield rows[:left]
        left -= len(rows[:left])
        if not left:
            return
