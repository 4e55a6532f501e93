"""Measure files for `stats`, `check`, `findings` and `report`, and print what was measured."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import tzinfo
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.cli.input_files import STDIN, InputQuery, explain_no_frames, gap_text, print_notes
from fte_sniff.cli.options import format_option
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, TranslatableText, UsageError
from fte_sniff.formats.looks import LOOKS
from fte_sniff.formats.writers import printable_json
from fte_sniff.i18n import _
from fte_sniff.protocol.columns import iso_time

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.findings import Finding
    from fte_sniff.analysis.segments import Analysis, Counts
    from fte_sniff.session.inputs import InputReading, ReadingCounts


text_or_json_option = format_option(
    "A table for people, or one JSON object.", ["table", "json"], "table"
)
"""The `--format` option of a command that prints text, or a JSON object."""


def print_json(value: Any) -> None:
    """Print indented JSON on standard output, without a copy of the whole text."""
    encoder = json.JSONEncoder(ensure_ascii=False, indent=2)
    sys.stdout.writelines(map(printable_json, encoder.iterencode(value)))
    sys.stdout.write("\n")


def measure(query: InputQuery, analysis: Analysis) -> tuple[Counts, InputReading]:
    """Count all rows of the files, here, in worker processes, or on a cluster.

    Raises:
        FileError: no file can be read, or the cluster cannot be reached.
        UsageError: standard input cannot be read elsewhere.
        InputTextError: a filter, time, date or zone is invalid.
    """
    from fte_sniff.session.measured import measured, total_of

    if query.cluster is not None:  # its workers may be in other folders
        query = replace(query, files=tuple(path.absolute() for path in query.files))
    wanted = query.row_filter()
    reading = query.read()
    if query.cluster is None and min(query.jobs or 1, len(reading.groups)) == 1:
        return measured(reading, analysis, wanted, query.baud), reading
    return total_of(analysis, _parts_from_elsewhere(query, reading, analysis)), reading


def _parts_from_elsewhere(
    query: InputQuery, reading: InputReading, analysis: Analysis
) -> Iterator[Counts]:
    """What other processes count in each group of the files."""
    from fte_sniff.session.jobs import executor_of, mapped

    if STDIN in query.files:
        raise UsageError("--jobs and --cluster read files; '-' is standard input of this process")
    own = replace(query, jobs=None, cluster=None)
    if (span := reading.span) is not None:
        own = replace(own, since=iso_time(span.first_ns), until=iso_time(span.end_ns))
    queries = [
        replace(own, files=tuple(Path(one.name) for one in group)) for group in reading.groups
    ]
    with executor_of(min(query.jobs or 1, len(queries)), query.cluster) as executor:
        for part, counts in mapped(partial(_count, analysis), queries, executor):
            reading.include(counts)
            yield part


def _count(analysis: Analysis, query: InputQuery) -> tuple[Counts, ReadingCounts]:
    total, reading = measure(query, analysis)
    return total, reading.counts


def finish(*readings: InputReading, refused: bool = False) -> None:
    """Print notes about the files and exit unless all is well; `refused` means exit code 1."""
    for reading in readings:
        print_notes(reading)
        if gaps := reading.reported_gaps:
            print_err(f"fte-sniff: {gap_text(gaps)} left out when recorded")
        if advice := explain_no_frames(reading.tally, reading):
            print_err(f"fte-sniff: {advice}")
    if any(reading.unreadable for reading in readings):
        sys.exit(FileError.exit_code)
    if refused:
        sys.exit(1)


def headline(one: Finding, found: Sequence[Finding], zone: tzinfo) -> str:
    """The cause, motor and span of a finding; without days if all findings are of one."""
    days = {iso_time(t_ns, zone)[:10] for each in found for t_ns in (each.first_ns, each.last_ns)}
    shown = slice(11 if len(days) == 1 else 0, 19)
    first, last = (iso_time(t_ns, zone)[shown] for t_ns in (one.first_ns, one.last_ns))
    cause = str(one.cause)
    if one.motor is not None:
        cause = TranslatableText("{cause}, motor {motor}", cause=cause, motor=one.motor)
    return _("{cause}, {first} to {last}", cause=cause, first=first, last=last)


HEAD_STYLE: Final = "dim"


_STYLES: Final = {look.mark: look.style for look in LOOKS.values() if look.mark.strip()}


def table_lines(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[Text]:
    """The lines of a table: names on the left, and cells that are aligned at the right.

    A name that begins with the mark of a status has its style.

    Args:
        heads: those of the columns.
        rows: of each the name, and a cell for each further head.
    """
    from rich.cells import cell_len
    from rich.text import Text

    from fte_sniff.formats.cell_text import fit_right, padded

    lines = [[*map(_, heads)], *rows]
    names, *widths = (max(map(cell_len, column)) for column in zip(*lines, strict=True))
    for number, (name, *cells) in enumerate(lines):
        values = (f"  {fit_right(one, room)}" for one, room in zip(cells, widths, strict=True))
        text = (padded(name, names), _STYLES.get(name[:1], ""))
        line = Text.assemble(text, *values, style="" if number else HEAD_STYLE)
        line.rstrip()
        yield line


def print_lines(lines: Iterable[Text]) -> None:
    """Print lines as they are, however wide the terminal is; with colours on a terminal."""
    if not sys.stdout.isatty():  # rich would end the program where a pipe is closed
        sys.stdout.writelines(f"{line.plain}\n" for line in lines)
        return
    from rich.console import Console

    console = Console(file=sys.stdout)
    for line in lines:
        console.print(line, soft_wrap=True)
