"""Rows as lines of a table, and explained byte by byte; plain and coloured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from textwrap import TextWrapper
from typing import TYPE_CHECKING, TextIO

import click

from fte_sniff.formats.text_layout import GAP, STATUS_MARK, TextLayout, kind_text, values_text
from fte_sniff.protocol import Frame, Row, Status, faults_text, spaced_hex
from fte_sniff.protocol.dissect import ExplainedField, dissect, explain

if TYPE_CHECKING:
    import polars as pl
    from rich.console import Console


class PlainWriter:
    """Writes one plain line a row with aligned columns, for pipes and files."""

    shows_order = True

    def __init__(self, stream: TextIO, *, ports: bool) -> None:
        self._stream = stream
        self._ports = ports
        self._layout: TextLayout | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        if rows:
            cells = self._begin(times=rows[0].t_ns is not None).cells
            self._stream.writelines(_joined(cells(row)) for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a DataFrame with the columns of the row contract."""
        from fte_sniff.formats.text_frame import frame_lines

        if frame.height:
            layout = self._begin(times=frame["time"][0] is not None)
            self._stream.write(frame_lines(frame, layout))

    def _begin(self, *, times: bool) -> TextLayout:
        """Write the header first, and return the layout."""
        if self._layout is None:
            self._layout = TextLayout(times=times, ports=self._ports)
            self._stream.write(_joined(self._layout.header()))
        return self._layout

    def close(self) -> None:
        """Do nothing: all rows are written."""


def _joined(cells: Iterable[str]) -> str:
    return GAP.join(cells).rstrip() + "\n"


class RichWriter:
    """Writes one coloured line a row, cut at the terminal's right edge.

    On a narrow terminal the times are short, there are no offsets, and faults precede the bytes.
    """

    def __init__(self, console: Console, *, ports: bool) -> None:
        self._console = console
        self._ports = ports
        self._cells: Callable[[Row], Iterable[str]] | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        if rows and self._cells is None:
            self._cells = self._begin(TextLayout(times=rows[0].t_ns is not None, ports=self._ports))
        if self._cells is not None:
            for row in rows:
                self._print(GAP.join(self._cells(row)), _style_of(row))

    def _begin(self, layout: TextLayout) -> Callable[[Row], Iterable[str]]:
        """Write the header, and return the function that makes the cells of a row."""
        if self._console.width >= layout.width:
            self._print(GAP.join(layout.header()), "bold")
            return layout.cells
        self._print(GAP.join(layout.narrow_header()), "bold")
        return layout.narrow_cells

    def close(self) -> None:
        """Do nothing: all rows are written."""

    def _print(self, line: str, style: str) -> None:
        self._console.print(
            line.rstrip(),
            style=style,
            markup=False,
            highlight=False,
            emoji=False,
            no_wrap=True,
            overflow="ellipsis",
            crop=True,
        )


def _style_of(row: Row) -> str:
    """The rich style of a row: by its status, then by its direction and kind."""
    if row.status is Status.MALFORMED:
        return "bold red"
    if row.status is Status.SUSPECT:
        return "yellow"
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None or not kind.fields:
        return "bold magenta"
    return "cyan" if kind.direction == "control" else "default"


_PLACE, _BYTES_WIDTH, _NAME, _VALUE = 5, 17, 9, 13
_BYTES_A_LINE = 6
_COLOR = {Status.OK: "green", Status.SUSPECT: "yellow", Status.MALFORMED: "red"}


class DissectionWriter:
    """Writes the explanation of each row, with an empty line between rows."""

    def __init__(self, stream: TextIO, width: int | None, *, colored: bool) -> None:
        """Create the writer.

        Args:
            stream: the text stream.
            width: columns to wrap the explanations at; None for no wrapping.
            colored: whether to use colours.
        """
        self._stream = stream
        self._wrap = _no_wrap if width is None else _wrapper(width)
        self._colored = colored
        self._has_rows = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        for row in rows:
            if self._has_rows:
                self._stream.write("\n")
            self._has_rows = True
            for line in _row_lines(row, self._wrap):
                self._stream.write((line if self._colored else click.unstyle(line)) + "\n")

    def close(self) -> None:
        """Do nothing: all rows are written."""


def _row_lines(row: Row, wrap: TextWrapper) -> Iterator[str]:
    yield _title(row)
    for sentence in explain(row):
        yield from _indented(sentence, 2, wrap, _COLOR[row.status])
    for part in dissect(row):
        yield from _part_lines(part, wrap)


def _title(row: Row) -> str:
    words = click.style(f"{row.status}", fg=_COLOR[row.status], bold=True)
    if row.faults:
        words += f" ({faults_text(row.faults)})"
    name = click.style(kind_text(row) if kind_text(row) != "-" else "damage", bold=True)
    return f"offset {row.offset}  {name}  {values_text(row)}  {words}".replace("    ", "  ")


def _part_lines(part: ExplainedField, wrap: TextWrapper) -> Iterator[str]:
    mark = STATUS_MARK[Status.MALFORMED] if part.fault else " "
    color = "red" if part.fault else None
    first, *further = _byte_groups(part.raw)
    lead = f"  {mark} {_place_text(part.offsets):<{_PLACE}} {first:<{_BYTES_WIDTH}}"
    lead += f" {part.name:<{_NAME}} {part.value:<{_VALUE}} "
    column = len(lead)
    meanings = [text for text in (part.meaning, part.note) if text] or [""]
    lines = [line for text in meanings for line in _wrapped(text, column, wrap)]
    yield click.style((lead + lines[0]).rstrip(), fg=color)
    yield from (click.style(" " * column + line, fg=color) for line in lines[1:])
    yield from (" " * 10 + group for group in further)
    for bit in part.bits:
        if bit.is_set:
            yield from _indented(f"bit {bit.number} set: {bit.meaning}", column, wrap, None)


def _place_text(places: range) -> str:
    if not places:
        return "-"
    return f"{places[0]}" if len(places) == 1 else f"{places[0]}-{places[-1]}"


def _byte_groups(raw: bytes) -> list[str]:
    return [
        spaced_hex(raw[at : at + _BYTES_A_LINE]) for at in range(0, len(raw), _BYTES_A_LINE)
    ] or ["--"]


def _indented(text: str, column: int, wrap: TextWrapper, color: str | None) -> Iterator[str]:
    for line in _wrapped(text, column, wrap):
        yield click.style(" " * column + line, fg=color)


def _wrapped(text: str, column: int, wrap: TextWrapper) -> list[str]:
    if wrap is _no_wrap:
        return [text]
    return _wrapper(max(wrap.width - column, 20)).wrap(text) or [""]


def _wrapper(width: int) -> TextWrapper:
    return TextWrapper(width=width, break_long_words=False, break_on_hyphens=False)


_no_wrap = _wrapper(1 << 16)
