"""Rows as lines of a table, and explained byte by byte; plain and coloured.

rich is not needed before a terminal is written to.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from functools import cache
from textwrap import wrap
from typing import TYPE_CHECKING, TextIO

import click

from fte_sniff.errors import printable
from fte_sniff.formats.looks import LOOKS, mark_of
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    Row,
    Status,
    faults_text,
    iso_time,
    spaced_hex,
    status_of,
)
from fte_sniff.protocol.dissect import ExplainedField, dissect, explain

if TYPE_CHECKING:
    from rich.console import Console


GAP = "  "

KIND_WIDTH = max(len(kind.name) for kind in KINDS)
VALUES_WIDTH = max(
    len(" ".join(f"{field.name}={field.text(field.low)}" for field in kind.fields))
    for kind in KINDS
)
OFFSET_WIDTH = 9
PORT_WIDTH = 14
RAW_WIDTH = len(spaced_hex(bytes(FRAME_LENGTH)))
_CLOCK = slice(len("1970-01-01T"), len("1970-01-01T12:00:00.000"))
_CLOCK_WIDTH = _CLOCK.stop - _CLOCK.start

_WIDTHS = (PORT_WIDTH, OFFSET_WIDTH, 1, KIND_WIDTH, VALUES_WIDTH, RAW_WIDTH, 0)
_SHORT_WIDTHS = (PORT_WIDTH, 1, KIND_WIDTH, 0)


@cache
def _time_width(zone: tzinfo) -> int:
    """The characters of every time in a zone."""
    return len(iso_time(0, zone))


@dataclass(frozen=True, slots=True)
class TextLayout:
    """The cells of all lines of one output, padded to their widths; the last may be empty.

    They are fixed: a new column of `COLUMNS` is not among them.
    """

    times: bool
    ports: bool
    zone: tzinfo = UTC
    """Zone of the times."""

    @property
    def time_width(self) -> int:
        """The characters of a time."""
        return _time_width(self.zone)

    def header(self) -> list[str]:
        """The names above the cells."""
        offset = "offset".rjust(OFFSET_WIDTH)
        names = ("time", "port", offset, "", "kind", "values", "raw", "faults")
        return self._padded((self.time_width, *_WIDTHS), *names)

    def cells(self, row: Row) -> list[str]:
        """The cells of a row."""
        return self._padded(
            (self.time_width, *_WIDTHS),
            "-" if row.t_ns is None else iso_time(row.t_ns, self.zone),
            printable(row.port),
            str(row.offset).rjust(OFFSET_WIDTH),
            mark_of(row),
            kind_text(row),
            values_text(row),
            spaced_hex(row.raw),
            faults_text(row.faults),
        )

    def short_header(self) -> list[str]:
        """The names above the cells for a terminal."""
        time = "time UTC" if self.zone == UTC else "local time"
        return self._padded((_CLOCK_WIDTH, *_SHORT_WIDTHS), time, "port", "", "kind", "values")

    def short_cells(self, row: Row) -> list[str]:
        """The cells of a row for a terminal: no offset, and the faults before the bytes."""
        kind, faults, raw = kind_text(row), faults_text(row.faults), spaced_hex(row.raw)
        text = GAP.join(filter(None, (values_text(row), faults, raw)))
        if not row.framed:
            kind, text = faults, raw
        clock = "" if row.t_ns is None else iso_time(row.t_ns, self.zone)[_CLOCK]
        port = printable(row.port)[-PORT_WIDTH:]
        cells = (clock, port, mark_of(row), kind, text)
        return self._padded((_CLOCK_WIDTH, *_SHORT_WIDTHS), *cells)

    def _padded(self, widths: tuple[int, ...], *cells: str) -> list[str]:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        if not self.ports:
            del padded[1]
        if not self.times:
            del padded[0]
        return padded


def kind_text(row: Row) -> str:
    """The name of the row's kind, or a dash."""
    kind = row.kind
    return kind.name if kind else "-"


def values_text(row: Row) -> str:
    """The row's values: `motor=1 rpm=1000 error=0x00 online=0x0F`; of damage, its length."""
    if not row.framed:
        return f"{len(row.raw)} byte{'s' if len(row.raw) != 1 else ''}"
    kind = row.kind
    if kind is None:
        return f"cmd=0x{row.cmd:02X}"
    return " ".join(f"{field.name}={field.text(field.read(row.raw))}" for field in kind.fields)


class PlainWriter:
    """Writes one plain line a row with aligned columns, for pipes and files."""

    def __init__(self, stream: TextIO, *, ports: bool, zone: tzinfo = UTC) -> None:
        self._stream = stream
        self._ports, self._zone = ports, zone
        self._layout: TextLayout | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        if rows:
            cells = self._begin(times=rows[0].t_ns is not None).cells
            self._stream.writelines(_joined(cells(row)) for row in rows)

    def _begin(self, *, times: bool) -> TextLayout:
        if self._layout is None:
            self._layout = TextLayout(times=times, ports=self._ports, zone=self._zone)
            self._stream.write(_joined(self._layout.header()))
        return self._layout

    def close(self) -> None:
        """Do nothing: all rows are written."""


def _joined(cells: Iterable[str]) -> str:
    return GAP.join(cells).rstrip() + "\n"


class RichWriter:
    """Writes one coloured line a row, cut at the terminal's right edge.

    The times are short, and faults precede the bytes, so that they stay in sight.
    """

    def __init__(self, console: Console, *, ports: bool, zone: tzinfo = UTC) -> None:
        self._console = console
        self._ports, self._zone = ports, zone
        self._layout: TextLayout | None = None

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        for row in rows:
            if self._layout is None:
                times = row.t_ns is not None
                self._layout = TextLayout(times=times, ports=self._ports, zone=self._zone)
                self._print(self._layout.short_header(), "bold")
            self._print(self._layout.short_cells(row), _style_of(row))

    def close(self) -> None:
        """Do nothing: all rows are written."""

    def _print(self, cells: Iterable[str], style: str) -> None:
        self._console.print(
            GAP.join(cells).rstrip(),
            style=style,
            markup=False,
            highlight=False,
            emoji=False,
            no_wrap=True,
            overflow="ellipsis",
            crop=True,
        )


def _style_of(row: Row) -> str:
    if row.status is not Status.OK:
        return LOOKS[row.status].style
    kind = row.kind
    if kind is None or not kind.fields:
        return "bold magenta"
    return "cyan" if kind.direction == "control" else "default"


_OFFSETS, _BYTES, _NAME, _VALUE = 5, 17, 9, 13
_BYTES_A_LINE = 6
_LEAST_WRAP = 20


class DissectionWriter:
    """Writes the explanation of each row, with an empty line between rows."""

    def __init__(self, stream: TextIO, width: int | None, *, colored: bool) -> None:
        """Write to a text stream; without a `width` the explanations are not wrapped."""
        self._stream = stream
        self._width = width
        self._colored = colored
        self._has_rows = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        for row in rows:
            if self._has_rows:
                self._stream.write("\n")
            self._has_rows = True
            for line in _row_lines(row, self._width):
                self._stream.write((line if self._colored else click.unstyle(line)) + "\n")

    def close(self) -> None:
        """Do nothing: all rows are written."""


def _row_lines(row: Row, width: int | None) -> Iterator[str]:
    yield _title(row)
    for sentence in explain(row):
        yield from _indented(sentence, 2, width, LOOKS[row.status].color)
    for field in dissect(row):
        yield from _field_lines(field, width)


def _title(row: Row) -> str:
    status = click.style(f"{row.status}", fg=LOOKS[row.status].color, bold=True)
    if row.faults:
        status += f" ({faults_text(row.faults)})"
    kind = kind_text(row)
    name = click.style("damage" if kind == "-" else kind, bold=True)
    return f"offset {row.offset}  {name}  {values_text(row)}  {status}".replace("    ", "  ")


def _field_lines(field: ExplainedField, width: int | None) -> Iterator[str]:
    look = LOOKS[status_of((field.fault,) if field.fault else ())]
    mark, color = look.mark, look.color if field.fault else None
    first, *further = _byte_groups(field.raw)
    lead = f"  {mark} {_offsets_text(field.offsets):<{_OFFSETS}} {first:<{_BYTES}}"
    lead += f" {field.name:<{_NAME}} {field.value:<{_VALUE}} "
    column = len(lead)
    texts = [text for text in (field.meaning, field.note) if text] or [""]
    lines = [line for text in texts for line in _wrapped(text, column, width)]
    yield click.style((lead + lines[0]).rstrip(), fg=color)
    yield from (click.style(" " * column + line, fg=color) for line in lines[1:])
    yield from (" " * 10 + group for group in further)
    for bit in field.bits:
        if bit.is_raised:
            text = f"bit {bit.number} is {bit.is_set:d}: {bit.meaning}"
            yield from _indented(text, column, width, None)


def _offsets_text(offsets: range) -> str:
    if not offsets:
        return "-"
    return f"{offsets[0]}" if len(offsets) == 1 else f"{offsets[0]}-{offsets[-1]}"


def _byte_groups(raw: bytes) -> list[str]:
    return [
        spaced_hex(raw[at : at + _BYTES_A_LINE]) for at in range(0, len(raw), _BYTES_A_LINE)
    ] or ["--"]


def _indented(text: str, column: int, width: int | None, color: str | None) -> Iterator[str]:
    for line in _wrapped(text, column, width):
        yield click.style(" " * column + line, fg=color)


def _wrapped(text: str, column: int, width: int | None) -> list[str]:
    if width is None:
        return [text]
    room = max(width - column, _LEAST_WRAP)
    return wrap(text, room, break_long_words=False, break_on_hyphens=False) or [""]
