"""Rows as lines of a table, and explained byte by byte; plain and coloured."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from datetime import UTC, tzinfo
from shutil import get_terminal_size
from textwrap import wrap
from typing import Any, Final, NamedTuple, TextIO

import click

from fte_sniff.errors import printable
from fte_sniff.formats.looks import LOOKS, mark_of
from fte_sniff.i18n import translated
from fte_sniff.protocol.columns import iso_time, spaced_hex
from fte_sniff.protocol.dissect import ExplainedField, dissect, explain
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, VALUE_FIELDS, Status, status_of

GAP: Final = "  "
_CLOCK: Final = slice(len("1970-01-01T"), len("1970-01-01T12:00:00.000"))
_PORT: Final = 14
_KIND: Final = max(len(kind.name) for kind in KINDS)
_VALUES: Final = max(
    len(" ".join(f"{field.name}={field.text(field.low)}" for field in kind.fields))
    for kind in KINDS
)
_RAW: Final = len(spaced_hex(bytes(FRAME_LENGTH)))


class _Column(NamedTuple):
    """A column of the table."""

    head: str
    width: int
    cell: Callable[[Row], str]


def _full(zone: tzinfo) -> Sequence[_Column]:
    """All columns, for files and other programs."""
    return (
        _Column("time", len(iso_time(0, zone)), lambda row: _time(row, zone)),
        _Column("port", _PORT, lambda row: printable(row.port)),
        _Column("   offset", len("   offset"), lambda row: f"{row.offset:9}"),
        _Column("", 1, mark_of),
        _Column("kind", _KIND, kind_text),
        _Column("values", _VALUES, values_text),
        _Column("raw", _RAW, lambda row: spaced_hex(row.raw)),
        _Column("faults", 0, lambda row: ",".join(row.faults)),
    )


def _short(zone: tzinfo) -> Sequence[_Column]:
    """The columns on a terminal: times are short, and faults precede the bytes to stay in sight."""
    return (
        _Column(
            "time UTC" if zone == UTC else "local time",
            _CLOCK.stop - _CLOCK.start,
            lambda row: _time(row, zone)[_CLOCK],
        ),
        _Column("port", _PORT, lambda row: printable(row.port)[-_PORT:]),
        _Column("", 1, mark_of),
        _Column("kind", _KIND, lambda row: kind_text(row) if row.framed else ",".join(row.faults)),
        _Column("values", 0, _values_faults_and_bytes),
    )


def _time(row: Row, zone: tzinfo) -> str:
    return "-" if row.t_ns is None else iso_time(row.t_ns, zone)


def _values_faults_and_bytes(row: Row) -> str:
    parts = (values_text(row), ",".join(row.faults)) if row.framed else ()
    return GAP.join(filter(None, (*parts, spaced_hex(row.raw))))


class TableWriter:
    """Writes one line a row with aligned columns.

    On a terminal, lines are short, coloured, and cut at its right edge.
    """

    def __init__(self, stream: TextIO, *, ports: bool, zone: tzinfo = UTC) -> None:
        """Write to a stream; `ports` for a column with the port."""
        self._stream, self._is_short = stream, stream.isatty()
        columns = (_short if self._is_short else _full)(zone)
        self._columns = [one for one in columns if ports or one.head != "port"]
        self._has_header = False

    def __call__(self, rows: Iterable[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        for row in rows:
            if not self._has_header:
                self._has_header = True
                self._columns = self._columns[1:] if row.t_ns is None else self._columns
                self._write([one.head for one in self._columns], bold=True)
            self._write([one.cell(row) for one in self._columns], **_style_of(row))

    def _write(self, cells: Sequence[str], **style: Any) -> None:
        padded = [cell.ljust(one.width) for cell, one in zip(cells, self._columns, strict=True)]
        line = GAP.join(padded).rstrip()
        if not self._is_short:
            self._stream.write(f"{line}\n")
            return
        from fte_sniff.formats.cell_text import fit

        line = fit(line, get_terminal_size().columns).rstrip()
        line = line if os.environ.get("NO_COLOR") else click.style(line, **style)
        click.echo(line, file=self._stream)  # which a console of Windows shows in colour too


def _style_of(row: Row) -> dict[str, Any]:
    look, kind = LOOKS[row.status], row.kind
    if row.status is not Status.OK:
        return {"fg": look.color, "bold": look.bold}
    if kind is None or not kind.fields:
        return {"fg": "magenta", "bold": True}
    return {"fg": "cyan"} if kind.direction == "control" else {}


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


_OFFSETS, _BYTES, _VALUE = 5, 17, 13
_NAME: Final = max(len(field.name) for field in VALUE_FIELDS)
_BYTES_A_LINE = 6


class DissectionWriter:
    """Writes the explanation of each row, with an empty line between rows.

    On a terminal, lines are coloured and wrapped at its right edge.
    """

    def __init__(self, stream: TextIO) -> None:
        """Write to a text stream."""
        self._stream, self._between, is_screen = stream, "", stream.isatty()
        self._width = get_terminal_size().columns if is_screen else sys.maxsize
        self._is_colored = is_screen and not os.environ.get("NO_COLOR")

    def __call__(self, rows: Iterable[Row]) -> None:
        """Write the rows."""
        for row in rows:
            text = "".join(f"{line}\n" for line in _row_lines(row, self._width))
            self._stream.write(self._between + (text if self._is_colored else click.unstyle(text)))
            self._between = "\n"


def _row_lines(row: Row, width: int) -> Iterator[str]:
    yield _title(row)
    for sentence in explain(row):
        yield from _wrapped(sentence, "  ", width, LOOKS[row.status].color)
    for field in dissect(row):
        yield from _field_lines(field, width)


def _title(row: Row) -> str:
    status = click.style(f"{row.status}", fg=LOOKS[row.status].color, bold=True)
    if row.faults:
        status += f" ({','.join(row.faults)})"
    kind = kind_text(row)
    name = click.style("damage" if kind == "-" else kind, bold=True)
    when = "" if row.t_ns is None else iso_time(row.t_ns)[_CLOCK]
    way = row.port.partition(":")[2]  # of a log with several
    words = (when, way, f"offset {row.offset}", name, values_text(row), status)
    return "  ".join(filter(None, words))


def _field_lines(field: ExplainedField, width: int) -> Iterator[str]:
    look = LOOKS[status_of((field.fault,) if field.fault else ())]
    color = look.color if field.fault else None
    first, *further = [
        spaced_hex(field.raw[at : at + _BYTES_A_LINE])
        for at in range(0, len(field.raw), _BYTES_A_LINE)
    ] or ["--"]
    lead = f"  {look.mark} {_offsets_text(field.offsets):<{_OFFSETS}} {first:<{_BYTES}}"
    lead += f" {field.name:<{_NAME}} {field.value:<{_VALUE}} "
    indent = " " * len(lead)
    for text in filter(None, (field.meaning or field.note or " ", field.meaning and field.note)):
        yield from _wrapped(text, lead, width, color)
        lead = indent
    yield from (" " * 10 + group for group in further)
    for bit in field.bits:
        if bit.is_raised:
            text = f"bit {bit.number} is {bit.is_set:d}: {bit.meaning}"
            yield from _wrapped(text, indent, width, None)


def _offsets_text(offsets: range) -> str:
    if not offsets:
        return "-"
    return f"{offsets[0]}" if len(offsets) == 1 else f"{offsets[0]}-{offsets[-1]}"


def _wrapped(text: str, lead: str, width: int, color: str | None) -> Iterator[str]:
    """The lines of a text behind the lead of the first one, in a colour."""
    further = " " * len(lead)
    lines = wrap(
        translated(text),
        width,
        initial_indent=lead,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
    yield from (click.style(line, fg=color) for line in lines or [lead.rstrip()])
