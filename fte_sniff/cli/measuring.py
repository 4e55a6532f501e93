"""Measure files for `stats`, `check`, `findings` and `report`, and print what was measured."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, explain_no_frames, print_notes
from fte_sniff.cli.options import format_option
from fte_sniff.cli.streams import EXIT_INTERRUPTED, print_err, progress_line
from fte_sniff.errors import FileError
from fte_sniff.formats.writers import printable_json
from fte_sniff.session.measured import observe

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.analysis.model import RowModel
    from fte_sniff.session.inputs import InputReading


text_or_json_option = format_option(
    "A table for people, or one JSON object.", ["table", "json"], "table"
)
"""The `--format` option of a command that prints text, or a JSON object."""


def print_json(value: Any) -> None:
    """Print indented JSON on standard output, without a copy of the whole text."""
    encoder = json.JSONEncoder(ensure_ascii=False, indent=2)
    sys.stdout.writelines(map(printable_json, encoder.iterencode(value)))
    sys.stdout.write("\n")


pair_option = click.option(
    "--pair", is_flag=True, help="The files are wires of one line, recorded at the same time."
)
"""The `--pair` option."""


@dataclass(slots=True)
class FilesMeasured:
    """The measurements of files, also after Ctrl-C."""

    reading: InputReading
    interrupted: bool = False

    def finish(self, *, refused: bool = False) -> None:
        """Print notes about the files and exit unless all is well; `refused` means exit code 1."""
        reading = self.reading
        print_notes(reading)
        if self.interrupted:
            print_err(f"fte-sniff: interrupted; {reading.tally.rows:,} rows were read")
            sys.exit(EXIT_INTERRUPTED)
        if advice := explain_no_frames(reading.tally, reading):
            print_err(f"fte-sniff: {advice}")
        if reading.unreadable:
            sys.exit(FileError.exit_code)
        if refused:
            sys.exit(1)


def measure(query: InputQuery, *models: RowModel, pair: bool = False) -> FilesMeasured:
    """Let models observe all rows of the files.

    Raises:
        FileError: no file can be read.
        InputTextError: a filter, time, date or zone is invalid.
    """
    with progress_line(reads_stdin=STDIN in query.files) as line:
        measured = FilesMeasured(query.read(query.row_filter(), progress=line.progress, pair=pair))
        try:
            for name, items in measured.reading.streams():
                for model in models:
                    model.begin(name)
                observe(items, *models)
        except KeyboardInterrupt:
            measured.interrupted = True
    return measured


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
