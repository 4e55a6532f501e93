"""Measure files for `stats`, `check`, `findings` and `report`, and print what was measured."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, explain_no_frames, is_typed, print_notes
from fte_sniff.cli.options import all_of, format_option
from fte_sniff.cli.streams import EXIT_INTERRUPTED, print_err, progress_line
from fte_sniff.errors import FileError, UsageError, printable
from fte_sniff.formats.writers import printable_json
from fte_sniff.protocol import iso_time

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.segments import Analysis, Part
    from fte_sniff.analysis.table import Table
    from fte_sniff.session.inputs import InputReading, ReadingCounts
    from fte_sniff.session.measured import Measurement


text_or_json_option = format_option(
    "A table for people, or one JSON object.", ["table", "json"], "table"
)
"""The `--format` option of a command that prints text, or a JSON object."""


def print_json(value: Any) -> None:
    """Print indented JSON on standard output, without a copy of the whole text."""
    encoder = json.JSONEncoder(ensure_ascii=False, indent=2)
    sys.stdout.writelines(map(printable_json, encoder.iterencode(value)))
    sys.stdout.write("\n")


many_files_options = all_of(
    click.option(
        "--pair",
        is_flag=True,
        help="The files are wires of one line, recorded at the same time.",
    ),
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Processes that read the files of several captures.  [default: 1]",
    ),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Read the files on a Dask cluster, such as tcp://192.168.0.9:8786; its workers see the"
        " same files.",
    ),
)
"""The options `--pair`, `--jobs` and `--cluster`; their values are those of `ManyFiles`."""


@dataclass(frozen=True, slots=True)
class ManyFiles:
    """How several files are read."""

    pair: bool = False
    jobs: int | None = None
    cluster: str | None = None


HERE: Final = ManyFiles()


@dataclass(slots=True)
class FilesMeasured:
    """The measurements of files, also after Ctrl-C."""

    reading: InputReading
    interrupted: bool = False

    def finish(
        self, *, refused: bool = False, counted: int | None = None, filter_text: str | None = None
    ) -> None:
        """Print notes about the files and exit unless all is well; `refused` means exit code 1.

        `counted` rows matched the filter.
        """
        reading = self.reading
        print_notes(reading)
        if self.interrupted:
            print_err(f"fte-sniff: interrupted; {reading.tally.rows:,} rows were read")
            sys.exit(EXIT_INTERRUPTED)
        if advice := explain_no_frames(reading.tally, reading):
            print_err(f"fte-sniff: {advice}")
        elif reading.tally.rows and counted == 0 and filter_text is not None:
            print_err(f"fte-sniff: none of them matches the filter: {printable(filter_text)}")
        if reading.unreadable:
            sys.exit(FileError.exit_code)
        if refused:
            sys.exit(1)


def measure(
    query: InputQuery,
    analysis: Analysis[Part],
    many: ManyFiles = HERE,
    observer: Callable[[InputReading], Callable[[Table], None]] | None = None,
) -> tuple[Part, FilesMeasured]:
    """Count all rows of the files.

    `observer` returns what receives each table of a reading; only for `HERE`.

    Raises:
        FileError: no file can be read, or the cluster cannot be reached.
        UsageError: the options contradict each other, or the cluster's address is invalid.
        InputTextError: a filter, time, date or zone is invalid.
    """
    from fte_sniff.session.jobs import check_address
    from fte_sniff.session.measured import Measurement

    if many.cluster is not None:
        if many.jobs is not None:
            raise UsageError("--jobs is for this machine; leave it out with --cluster")
        check_address(many.cluster)
    measurement, wanted = Measurement(analysis), query.row_filter()
    with progress_line(shown=not is_typed(query.files)) as line:
        reading = query.read(None, progress=line.progress, pair=many.pair)
        measured, jobs = FilesMeasured(reading), min(many.jobs or 1, len(reading.groups))
        if observer is not None:
            measurement.also = observer(reading)
        try:
            if jobs == 1 and many.cluster is None:
                measurement.read(reading, wanted, query.baud)
            else:
                _measure_elsewhere(query, measurement, reading, many, jobs)
        except KeyboardInterrupt:
            measured.interrupted = True
    return measurement.total, measured


def _measure_elsewhere(
    query: InputQuery,
    measurement: Measurement[Part],
    reading: InputReading,
    many: ManyFiles,
    jobs: int,
) -> None:
    """Count each group of inputs in another process, and add up what comes back."""
    from fte_sniff.session.jobs import executor_of, mapped

    if STDIN in query.files:
        raise UsageError("--jobs and --cluster read files; '-' is standard input of this process")
    if (span := reading.span) is not None:
        query = replace(
            query, since=iso_time(span.first_ns), until=iso_time(span.end_ns), zone=None
        )
    named = Path if many.cluster is None else _absolute
    groups = [
        replace(query, files=tuple(named(one.name) for one in group.inputs))
        for group in reading.groups
    ]
    count = partial(_measure_group, measurement.analysis, pair=many.pair)
    with executor_of(jobs, many.cluster) as executor:
        for total, counts in mapped(count, groups, executor):
            measurement.add(total)
            reading.include(counts)


def _absolute(name: str) -> Path:
    return Path(name).absolute()


def _measure_group(
    analysis: Analysis[Part], query: InputQuery, *, pair: bool
) -> tuple[Part, ReadingCounts]:
    """Count the inputs of a query in this process."""
    from fte_sniff.session.measured import Measurement

    measurement = Measurement(analysis)
    reading = query.read(None, pair=pair)
    measurement.read(reading, query.row_filter(), query.baud)
    return measurement.total, reading.counts


HEAD_STYLE = "dim"
LEAST_NAME = 21
"""Cells that a name is shortened to at most."""


class TextTable:
    """A table that fits a width: names lose their start, then the last columns are dropped.

    `rich.table.Table` would wrap or cut cells in all columns instead.
    """

    def __init__(self, heads: Sequence[str]) -> None:
        self._lines = [("", list(heads), "")]

    def append(self, cells: Sequence[str], style: str = "", mark: str = "") -> None:
        """Append a line: the name, then a cell for each further head.

        `mark` is in a column left of the name, with its style.
        """
        self._lines.append((mark, list(cells), style))

    def lines(self, width: int | None) -> Iterator[Text]:
        """The lines in at most `width` cells, if they can be shortened so far; None: no limit."""
        from rich.cells import cell_len
        from rich.text import Text

        from fte_sniff.formats.cell_text import fit_path, fit_right, padded

        marks = max(cell_len(mark) for mark, _, _ in self._lines)
        names, *widths = (
            max(map(cell_len, column))
            for column in zip(*(cells for _, cells, _ in self._lines), strict=True)
        )
        if width is not None:
            room = width - marks
            names = max(min(names, LEAST_NAME), min(names, room - sum(widths) - 2 * len(widths)))
            while len(widths) > 1 and names + sum(widths) + 2 * len(widths) > room:
                widths.pop()
        for number, (mark, (name, *cells), style) in enumerate(self._lines):
            values = "".join(
                f"  {fit_right(cell, room)}" for cell, room in zip(cells, widths, strict=False)
            )
            lead = f"{padded(mark, marks)}{padded(fit_path(name, names), names)}"
            line = Text.assemble((lead, style), values, style="" if number else HEAD_STYLE)
            line.rstrip()
            yield line


def print_lines(lines: Callable[[int | None], Iterable[Text]]) -> None:
    """Print lines that fit a given width, None for any; with colours on a terminal.

    A longer line is cut, unless its overflow is `ignore`.
    """
    if not sys.stdout.isatty():
        sys.stdout.writelines(f"{line.plain.rstrip()}\n" for line in lines(None))
        return
    from rich.console import Console

    console = Console(file=sys.stdout)
    for line in lines(console.width):
        is_cut = line.overflow != "ignore"
        console.print(line, no_wrap=True, overflow=line.overflow or "ellipsis", crop=is_cut)
