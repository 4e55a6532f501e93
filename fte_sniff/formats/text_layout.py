"""Cells of a text table: row texts, widths and order; needs neither polars nor rich."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, tzinfo
from functools import cache

from fte_sniff.errors import printable
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    Frame,
    Row,
    Status,
    faults_text,
    iso_time,
    spaced_hex,
)
from fte_sniff.protocol.look import LOOKS

ORDER_MARK = "~"
"""The mark of an `ok` row whose order with rows of another port is uncertain."""

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
_NARROW_WIDTHS = (PORT_WIDTH, 1, KIND_WIDTH, 0)


@cache
def time_width(zone: tzinfo) -> int:
    """The characters of every time in a zone."""
    return len(iso_time(0, zone))


@dataclass(frozen=True, slots=True)
class TextLayout:
    """The cells of all lines of one output, padded to their widths; the last may be empty."""

    times: bool
    ports: bool
    zone: tzinfo = UTC
    """Zone of the times."""

    @property
    def time_width(self) -> int:
        """The characters of a time."""
        return time_width(self.zone)

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

    @property
    def width(self) -> int:
        """Columns of the line of a frame without faults."""
        header = self.header()
        return sum(map(len, header)) + len(GAP) * len(header)

    def narrow_header(self) -> list[str]:
        """The names above the cells for a narrow terminal."""
        time = "time UTC" if self.zone == UTC else "local time"
        return self._padded((_CLOCK_WIDTH, *_NARROW_WIDTHS), time, "port", "", "kind", "values")

    def narrow_cells(self, row: Row) -> list[str]:
        """The cells of a row for a narrow terminal: no offset, and the faults before the bytes."""
        kind, faults, raw = kind_text(row), faults_text(row.faults), spaced_hex(row.raw)
        text = GAP.join(filter(None, (values_text(row), faults, raw)))
        if not isinstance(row, Frame):
            kind, text = faults, raw
        clock = "" if row.t_ns is None else iso_time(row.t_ns, self.zone)[_CLOCK]
        port = printable(row.port)[-PORT_WIDTH:]
        cells = (clock, port, mark_of(row), kind, text)
        return self._padded((_CLOCK_WIDTH, *_NARROW_WIDTHS), *cells)

    def _padded(self, widths: tuple[int, ...], *cells: str) -> list[str]:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        if not self.ports:
            del padded[1]
        if not self.times:
            del padded[0]
        return padded


def mark_of(row: Row) -> str:
    """One character for the status of a row, or an uncertain order."""
    if row.order_uncertain and row.status is Status.OK:
        return ORDER_MARK
    return LOOKS[row.status].mark


def kind_text(row: Row) -> str:
    """The name of the row's kind, or a dash."""
    kind = row.kind if isinstance(row, Frame) else None
    return kind.name if kind else "-"


def values_text(row: Row) -> str:
    """The row's values: `motor=1 rpm=1000 error=0x00 online=0x0F`; of damage, its length."""
    if not isinstance(row, Frame):
        return f"{len(row.raw)} byte{'s' if len(row.raw) != 1 else ''}"
    kind = row.kind
    if kind is None:
        return f"cmd=0x{row.cmd:02X}"
    return " ".join(f"{field.name}={field.text(field.read(row.raw))}" for field in kind.fields)
