"""Column widths and order of a text table; needs no polars."""

from __future__ import annotations

from dataclasses import dataclass

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

STATUS_MARK = {Status.OK: " ", Status.SUSPECT: "?", Status.MALFORMED: "!"}
"""One character that says the status without colour."""

ORDER_MARK = "~"
"""The character of a row in order whose place among another port's rows is not certain."""

GAP = "  "
"""What stands between two cells."""

KIND_WIDTH = max(len(kind.name) for kind in KINDS)
TIME_WIDTH = len(iso_time(0))
VALUES_WIDTH = max(
    len(" ".join(f"{field.name}={field.text(field.low)}" for field in kind.fields))
    for kind in KINDS
)
OFFSET_WIDTH = 9
_CLOCK_WIDTH = len("12:00:00.000")
PORT_WIDTH = 14
RAW_WIDTH = len(spaced_hex(bytes(FRAME_LENGTH)))


@dataclass(frozen=True, slots=True)
class TextLayout:
    """Which of the optional cells the lines of one output have."""

    times: bool
    """Whether the input has times."""
    ports: bool
    """Whether there is more than one port to tell apart."""

    def header(self) -> tuple[str, ...]:
        """The names above the cells, padded as the cells are."""
        return self._padded(
            "time", "port", "offset".rjust(OFFSET_WIDTH), " ", "kind", "values", "raw", "faults"
        )

    def cells(self, row: Row) -> tuple[str, ...]:
        """The row's cells, padded to their widths; the last, which may be empty, is not padded."""
        return self._padded(
            "-" if row.t_ns is None else iso_time(row.t_ns),
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
        """Columns that the whole line of an ordinary frame takes, with two between the cells."""
        header = self.header()
        return sum(map(len, header)) + 2 * len(header)

    def narrow_header(self) -> tuple[str, ...]:
        """The names above `narrow_cells`, padded as those are."""
        return self._narrow("time UTC", "port", " ", "kind", "values")

    def narrow_cells(self, row: Row) -> tuple[str, ...]:
        """The row for a narrow terminal: no offset, and what is wrong before the bytes."""
        clock = "" if row.t_ns is None else iso_time(row.t_ns)[11 : 11 + _CLOCK_WIDTH]
        kind, faults = kind_text(row), faults_text(row.faults)
        told = "  ".join(filter(None, (values_text(row), faults, spaced_hex(row.raw))))
        if not isinstance(row, Frame):
            kind, told = faults, spaced_hex(row.raw)
        return self._narrow(clock, printable(row.port), mark_of(row), kind, told)

    def _narrow(self, clock: str, port: str, mark: str, kind: str, told: str) -> tuple[str, ...]:
        times = (clock.ljust(_CLOCK_WIDTH),) if self.times else ()
        ports = (port[-PORT_WIDTH:].ljust(PORT_WIDTH),) if self.ports else ()
        return (*times, *ports, mark, kind.ljust(KIND_WIDTH), told)

    def _padded(  # one parameter a cell, in the order of the line
        self,
        time: str,
        port: str,
        offset: str,
        mark: str,
        kind: str,
        values: str,
        raw: str,
        faults: str,
    ) -> tuple[str, ...]:
        times = (time.ljust(TIME_WIDTH),) if self.times else ()
        ports = (port.ljust(PORT_WIDTH),) if self.ports else ()
        values = values.ljust(VALUES_WIDTH)
        return (
            *times,
            *ports,
            offset,
            mark,
            kind.ljust(KIND_WIDTH),
            values,
            raw.ljust(RAW_WIDTH),
            faults,
        )


def mark_of(row: Row) -> str:
    """One character that says what there is to mind about a row; a space where there is nothing."""
    if row.order_uncertain and row.status is Status.OK:
        return ORDER_MARK
    return STATUS_MARK[row.status]


def kind_text(row: Row) -> str:
    """The row's kind, or a dash where header and CMD name none."""
    kind = row.kind if isinstance(row, Frame) else None
    return kind.name if kind else "-"


def values_text(row: Row) -> str:
    """The row's values as people read them: `motor=1 rpm=1000 error=0x00 online=0x0F`."""
    if not isinstance(row, Frame):
        return f"{len(row.raw)} byte{'s' if len(row.raw) != 1 else ''}"
    kind = row.kind
    if kind is None:
        return f"cmd=0x{row.cmd:02X}"
    return " ".join(f"{field.name}={field.text(field.read(row.raw))}" for field in kind.fields)
