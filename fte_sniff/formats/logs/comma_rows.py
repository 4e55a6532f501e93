"""Owns rows with a heading and commas between: what analysers export, and this program's own.

It must not know what the bytes are.

    Time [s],Value,Parity Error,Framing Error        Saleae Logic 1, Kingst
    0.000019680000000,0xAA,,
    name,type,start_time,duration,data               Saleae Logic 2
    "Async Serial","data",0.0006025,2.375e-05,0xAA
    Id,Time[ns],1:UART: RX/TX                        DSView
    1,7604710080.00,AA
    time,port,offset,length,...,faults,raw           fte-sniff decode --format csv
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fte_sniff.errors import InputTextError, quoted
from fte_sniff.formats.logs.line_head import lone_stamp
from fte_sniff.formats.logs.own_lines import OwnLine
from fte_sniff.formats.logs.written_rows import begun_at

_CELL = re.compile(r"\s*(?:\"(?P<inside>(?:[^\"]|\"\")*)\"|(?P<bare>[^,\"]*?))\s*(?:,|\Z)")
_TIMES = ("time [s]", "time[s]", "start_time", "time[ns]", "time")
_VALUES = ("raw", "value", "data")
_UART = re.compile(r"(?:\d+:)?uart.*\b(?:rx|tx)\b.*", re.IGNORECASE)
_ERRORS = ("parity error", "framing error", "error")
_BYTE = re.compile(r"0x[0-9A-Fa-f]{2}|[0-9A-Fa-f]{2}|\d{1,3}")
_RAW = re.compile(r"(?:[0-9A-Fa-f]{2})*")


@dataclass(frozen=True, slots=True)
class _Columns:
    """Which column holds what, counted from 0."""

    count: int
    value: int
    raw: bool
    """Whether its values are bytes by the row, in hex: this program's own."""
    time: int | None
    name: int | None
    """Of the decoder, where several may stand in one file."""
    kind: int | None
    errors: tuple[int, ...]


class CommaRows:
    """Reads the rows below a heading."""

    def __init__(self, note: Callable[[str], None]) -> None:
        """No heading is read yet; `note` is told of errors on the wire."""
        self._note = note
        self._columns: _Columns | None = None
        self._name: str | None = None
        self._told = False

    def own_line(self, text: str, number: int) -> OwnLine | None:
        """What a line holds; None where it is no such row.

        Raises:
            InputTextError: its value is no byte, or it is of another wire, or cut short.
        """
        if "," not in text or (self._columns is None and text.lstrip()[:1] not in "TtnNIi\"'"):
            return None
        cells = _cells(text)
        if cells is None:
            return None
        found = _columns_of([text[start:stop].lower() for start, stop in cells])
        if found is not None:
            self._columns = found
            return OwnLine("")
        if self._columns is None:
            return None
        return self._row(text, cells, self._columns, number)

    def _row(
        self, text: str, cells: Sequence[tuple[int, int]], columns: _Columns, number: int
    ) -> OwnLine:
        if len(cells) < columns.count:
            raise InputTextError(
                f"line {number}: has {len(cells)} of {columns.count} columns, so it is cut short;"
                " delete it"
            )
        texts = [text[start:stop] for start, stop in cells]
        if columns.kind is not None and texts[columns.kind] != "data":
            return OwnLine("")
        self._check_name(columns, texts, number)
        start, stop = cells[columns.value]
        if not (_RAW if columns.raw else _BYTE).fullmatch(text[start:stop]):
            raise InputTextError(
                f"line {number}: {quoted(text[start:stop])} is no byte in hex; export again with"
                " hexadecimal values"
            )
        if not self._told and any(texts[place] for place in columns.errors):
            self._told = True
            self._note(f"line {number}: an error on the wire, as the analyser says")
        if columns.raw and columns.time is not None:
            raw = bytes.fromhex(text[start:stop])
            return OwnLine("", begun_at(texts[columns.time]), data=raw)
        stamp = None if columns.time is None else lone_stamp(texts[columns.time])
        return OwnLine(" " * start + text[start:stop], stamp)

    def _check_name(self, columns: _Columns, texts: Sequence[str], number: int) -> None:
        if columns.name is None:
            return
        name = texts[columns.name]
        if self._name not in (None, name):
            raise InputTextError(
                f"line {number}: {quoted(name)} is another wire than {quoted(self._name or '')}"
                " above; export one at a time"
            )
        self._name = name


def _cells(text: str) -> list[tuple[int, int]] | None:
    """Where the text of each cell stands, without its quotation marks; None if it is no row."""
    found, at = [], 0
    while at <= len(text):
        cell = _CELL.match(text, at)
        if cell is None:
            return None
        found.append(cell.span("bare" if cell["inside"] is None else "inside"))
        if cell.end() == len(text) and not text[: cell.end()].endswith(","):
            break
        at = cell.end()
        if at == len(text):
            found.append((at, at))
            break
    return found


def _columns_of(names: Sequence[str]) -> _Columns | None:
    """The columns that a heading names; None where it is none."""

    def place(*wanted: str) -> int | None:
        return next((names.index(name) for name in wanted if name in names), None)

    time = place(*_TIMES)
    value = place(*_VALUES)
    if value is None:
        value = next((at for at, name in enumerate(names) if _UART.fullmatch(name)), None)
    if time is None or value is None:
        return None
    errors = tuple(at for at, name in enumerate(names) if name in _ERRORS)
    raw = names[value] == "raw"
    logic_2 = names[:2] == ["name", "type"]
    name, kind = (0, 1) if logic_2 else (None, None)
    return _Columns(len(names), value, raw, time, name, kind, () if raw else errors)
