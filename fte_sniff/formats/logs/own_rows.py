"""Rows that this program wrote: tables, CSV and JSON lines, read back with their ports and times.

time                               offset     kind    values       raw                   faults
2026-01-31T12:00:00.000090150Z          0     reset                AA 00 00 00 00 00 00 ... EE
time,port,offset,length,...,faults,raw
{"time":"2026-01-31T12:00:00.000090150Z","port":"a",...,"raw":"AA0000000000000000EE"}
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, NamedTuple

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.streams import LATEST_NS, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import SECOND, days_of
from fte_sniff.protocol import KINDS

_HEADING: Final = re.compile(
    r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw(?:\s+faults)?\s*"
)
_NARROW_HEADING: Final = re.compile(r"\s*time UTC\s+(?:port\s+)?kind\s+values\s*")
_TIME: Final = re.compile(r"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)\.(\d{9})Z")
_CELLS: Final = re.compile(
    r"(?<!\S)\d+\s\s[ ?!~]\s\s"
    rf"(?:{'|'.join(kind.name for kind in KINDS)}|-)\s{{2,}}+"
    r"(?:\d+ bytes?\s{2,}+|(?:[a-z_]+=\S++\s)++\s*+)?+"
    r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s{2,}+[a-z_,]++)?+\s*+\Z"
)
"""From the offset on."""
_BEGUN: Final = re.compile(rf"(?:\s*{_TIME.pattern}\s|-\s)|\s*+\d+\s\s[ ?!~]\s\s")
_FIX: Final = "pass the recording itself, or its rows with --format csv or jsonl"


class OwnRow(NamedTuple):
    """A row that was read back."""

    data: bytes
    begin_ns: int | None
    """When its first byte began."""
    port: str | None


class OwnLog:
    """A log in one of these formats."""

    resolution_ns = 1
    frames = 1 << 20
    """The format of the lines decides, not frames."""
    certain = True

    def __init__(self) -> None:
        """No line is read yet."""
        self._headed = False
        self._columns: list[str] = []
        self._ports: list[str] = []

    def recognise(self, lines: Sequence[bytes]) -> bool:
        """Whether the first line with text is one of this program's; finds the ports."""
        if not self._is_own(lines):
            return False
        sampled = OwnLog()
        rows = []
        with suppress(InputTextError):
            rows = [sampled.row(line, number) for number, line in enumerate(lines, 1)]
        self._ports = list(dict.fromkeys(row.port for row in rows if row and row.port))
        return True

    @staticmethod
    def _is_own(lines: Sequence[bytes]) -> bool:
        first = next((line for line in lines if line.strip()), b"").decode("utf-8", "replace")
        return bool(
            re.match(r'\{"time":[^,]*,\s*"port":', first)
            or _HEADING.fullmatch(first)
            or _NARROW_HEADING.fullmatch(first)
            or _CELLS.search(first)
            or first.startswith("time,port,offset,")
        )

    def ports(self, name: str) -> list[str]:
        """Those of the first rows."""
        return self._ports or [name]

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        for number, line in enumerate(block.lines, block.first):
            row = self.row(line, number)
            if row is not None and row.data:
                streams[row.port or name].append(row.data, number, row.begin_ns, first=True)

    def notes(self) -> list[str]:
        """None."""
        return []

    def explain(self) -> list[str]:
        """What it is."""
        return ["rows that fte-sniff wrote"]

    def row(self, line: bytes, number: int) -> OwnRow | None:
        """The row of a line; None for headings and other lines.

        Raises:
            InputTextError: the row is cut, so that bytes may be missing.
        """
        text = line.decode("utf-8", "replace")
        if text.lstrip().startswith('{"time":') and self._is_own([line]):
            return _of_object(text, number)
        if text.startswith("time,port,offset,"):
            self._columns = text.split(",")
            return None
        if self._columns:
            return self._of_cells(text, number) if text.strip() else None
        if _HEADING.fullmatch(text):
            self._headed = True
            return None
        if _NARROW_HEADING.fullmatch(text):
            raise InputTextError(
                f"line {number}: this is fte-sniff's table as a narrow terminal shows it, which"
                f" need not hold all bytes; {_FIX}"
            )
        if row := _CELLS.search(text):
            return OwnRow(bytes.fromhex(row["raw"]), _begin_ns(text), None)
        if self._headed and _BEGUN.match(text):
            raise InputTextError(
                f"line {number}: this row of fte-sniff's table is cut or damaged; {_FIX}"
            )
        return None

    def _of_cells(self, text: str, number: int) -> OwnRow:
        cells = dict(zip(self._columns, next(csv.reader([text])), strict=False))
        if len(cells) < len(self._columns):
            raise InputTextError(
                f"line {number}: has {len(cells)} of {len(self._columns)} columns, so it is cut"
                " short; delete it"
            )
        return _own(cells["raw"], cells["time"], cells["port"], number)


def _of_object(text: str, number: int) -> OwnRow:
    try:
        row = json.loads(text)
        return _own(row["raw"], row["time"] or "", row["port"], number)
    except (ValueError, KeyError, TypeError):
        raise InputTextError(
            f"line {number}: this row of fte-sniff's JSON lines is cut or damaged; delete it"
        ) from None


def _own(raw: str, time: str, port: str, number: int) -> OwnRow:
    try:
        return OwnRow(bytes.fromhex(raw), _begin_ns(time), port)
    except ValueError:
        raise InputTextError(
            f"line {number}: {raw[:40]!r} is no byte in hex; this row of fte-sniff's CSV is damaged"
        ) from None


def _begin_ns(text: str) -> int | None:
    found = _TIME.search(text)
    if found is None:
        return None
    year, month, day, hours, minutes, seconds, ns = map(int, found.groups())
    days: int = days_of(year, month, day)
    clock_s = (hours * 60 + minutes) * 60 + seconds
    return min((days * 86_400 + clock_s) * SECOND + ns, LATEST_NS)
