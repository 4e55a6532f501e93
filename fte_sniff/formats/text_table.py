"""Rows as lines of a table, and explained byte by byte; plain and coloured."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from datetime import UTC, tzinfo
from shutil import get_terminal_size
from textwrap import wrap
from typing import Any, Final, TextIO

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

GAP: Final = "  "
_CLOCK: Final = slice(len("1970-01-01T"), len("1970-01-01T12:00:00.000"))
_OFFSET: Final = 9
_PORT: Final = 14
_KIND: Final = max(len(kind.name) for kind in KINDS)
_VALUES: Final = max(
    len(" ".join(f"{field.name}={field.text(field.low)}" for field in kind.fields))
    for kind in KINDS
)
_RAW: Final = len(spaced_hex(bytes(FRAME_LENGTH)))
_NAMES: Final = ("time", "port", "offset".rjust(_OFFSET), "", "kind", "values", "raw", "faults")
_SHORT_WIDTHS: Final = (_CLOCK.stop - _CLOCK.start, _PORT, 1, _KIND, 0)


class TableWriter:
    """Writes one line a row with aligned columns.

    On a terminal, lines are coloured and cut at its right edge. There the times are short, and
    faults precede the bytes, so that they stay in sight.
    """

    def __init__(self, stream: TextIO, *, ports: bool, zone: tzinfo = UTC) -> None:
        """Write to a stream; `ports` for a column with the port."""
        self._stream, self._zone, self._is_short = stream, zone, stream.isatty()
        self._hidden = set[int]() if ports else {1}
        self._has_header = False

    def __call__(self, rows: Iterable[Row]) -> None:
        """Write the rows; there is a time column if the first row has a time."""
        for row in rows:
            if not self._has_header:
                self._has_header = True
                if row.t_ns is None:
                    self._hidden.add(0)
                self._write(self._names(), bold=True)
            self._write(self._short(row) if self._is_short else self._cells(row), **_style_of(row))

    def _names(self) -> tuple[str, ...]:
        if self._is_short:
            return ("time UTC" if self._zone == UTC else "local time", "port", "", "kind", "values")
        return _NAMES

    def _cells(self, row: Row) -> tuple[str, ...]:
        return (
            "-" if row.t_ns is None else iso_time(row.t_ns, self._zone),
            printable(row.port),
            str(row.offset).rjust(_OFFSET),
            mark_of(row),
            kind_text(row),
            values_text(row),
            spaced_hex(row.raw),
            faults_text(row.faults),
        )

    def _short(self, row: Row) -> tuple[str, ...]:
        kind, faults, raw = kind_text(row), faults_text(row.faults), spaced_hex(row.raw)
        text = GAP.join(filter(None, (values_text(row), faults, raw)))
        if not row.framed:
            kind, text = faults, raw
        clock = "" if row.t_ns is None else iso_time(row.t_ns, self._zone)[_CLOCK]
        return clock, printable(row.port)[-_PORT:], mark_of(row), kind, text

    def _write(self, cells: tuple[str, ...], **style: Any) -> None:
        full = (len(iso_time(0, self._zone)), _PORT, _OFFSET, 1, _KIND, _VALUES, _RAW, 0)
        widths = _SHORT_WIDTHS if self._is_short else full
        padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        shown = (cell for at, cell in enumerate(padded) if at not in self._hidden)
        line = GAP.join(shown).rstrip()
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

    def __call__(self, rows: Iterable[Row]) -> None:
        """Write the rows."""
        for row in rows:
            if self._has_rows:
                self._stream.write("\n")
            self._has_rows = True
            for line in _row_lines(row, self._width):
                self._stream.write((line if self._colored else click.unstyle(line)) + "\n")


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
    when = "" if row.t_ns is None else iso_time(row.t_ns)[_CLOCK]
    way = row.port.partition(":")[2]  # of a log with several
    words = (when, way, f"offset {row.offset}", name, values_text(row), status)
    return "  ".join(filter(None, words))


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
