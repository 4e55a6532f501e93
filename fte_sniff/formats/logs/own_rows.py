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
from fte_sniff.formats.logs.streams import LATEST_NS, NO_TIME, LogForm, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import DAY_NS, SECOND, days_of
from fte_sniff.protocol import KINDS

_OBJECT: Final = r'\s*\{"time":[^,]*,\s*"port":'
_NAMES: Final = "time,port,offset,"
_HEADING: Final = r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw(?:\s+faults)?\s*$"
_NARROW_HEADING: Final = r"\s*time UTC\s+(?:port\s+)?kind\s+values\s*$"
_TIME: Final = r"(\d{4})-(\d\d)-(\d\d)T(\d\d):(\d\d):(\d\d)\.(\d{9})Z"
_OFFSET: Final = r"(?<!\S)\d+\s\s[ ?!~]\s\s"
_CELLS: Final = (
    rf"{_OFFSET}(?:{'|'.join(kind.name for kind in KINDS)}|-)\s{{2,}}+"
    r"(?:\d+ bytes?\s{2,}+|(?:[a-z_]+=\S++\s)++\s*+)?+"
    r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s{2,}+[a-z_,]++)?+\s*+\Z"
)
_FIX: Final = "pass the recording itself, or its rows with --format csv or jsonl"


class OwnRow(NamedTuple):
    """A row that was read back."""

    data: bytes
    begin_ns: int | None
    """When its first byte began."""
    port: str | None


class OwnLog(LogForm):
    """A log in one of these formats."""

    resolution_ns = 1
    is_certain = True

    def __init__(self, lines: Sequence[bytes] = ()) -> None:
        """A log whose first lines are known; they show its ports."""
        self._headed = False
        self._columns: list[str] = []
        self._ports = dict[str, None]()
        with suppress(InputTextError):
            for number, line in enumerate(lines, 1):
                row = self.row(line, number)
                self._ports |= {row.port: None} if row and row.port else {}

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> OwnLog | None:
        """The log, if the first line with text is one of this program's."""
        first = next((line for line in lines if line.strip()), b"").decode("utf-8", "replace")
        headings = (_OBJECT, _NAMES, _HEADING, _NARROW_HEADING)
        own = any(re.match(heading, first) for heading in headings) or re.search(_CELLS, first)
        return cls(lines) if own else None

    def ports(self, name: str) -> list[str]:
        """Those of the first rows."""
        return [*self._ports] or [name]

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        for number, line in enumerate(block.lines, block.first):
            row = self.row(line, number)
            if row is not None and row.data:
                t_ns = NO_TIME if row.begin_ns is None else row.begin_ns
                stream = streams.stream(row.port or name)
                stream.append(row.data, [len(row.data)], [number], [t_ns], first=True)

    def explain(self) -> list[str]:
        """What it is."""
        return ["rows that fte-sniff wrote"]

    def row(self, line: bytes, number: int) -> OwnRow | None:
        """The row of a line; None for headings and other lines.

        Raises:
            InputTextError: the row is cut, so that bytes may be missing.
        """
        text = line.decode("utf-8", "replace")
        if re.match(_NAMES, text):
            self._columns = text.split(",")
        elif re.match(_HEADING, text):
            self._headed = True
        elif re.match(_NARROW_HEADING, text):
            raise InputTextError(
                f"line {number}: this is fte-sniff's table as a narrow terminal shows it, which"
                f" need not hold all bytes; {_FIX}"
            )
        elif re.match(_OBJECT, text) or (self._columns and text.strip()):
            return self._of_text(text, number)
        elif row := re.search(_CELLS, text):
            return OwnRow(bytes.fromhex(row["raw"]), _begin_ns(text), None)
        elif self._headed and re.match(rf"\s*{_TIME}\s|-\s|\s*{_OFFSET}", text):
            raise InputTextError(
                f"line {number}: this row of fte-sniff's table is cut or damaged; {_FIX}"
            )
        return None

    def _of_text(self, text: str, number: int) -> OwnRow:
        try:
            if self._columns:
                row = dict(zip(self._columns, next(csv.reader([text])), strict=True))
            else:
                row = json.loads(text)
            return OwnRow(bytes.fromhex(row["raw"]), _begin_ns(row["time"] or ""), row["port"])
        except (ValueError, KeyError, TypeError, csv.Error):
            form = "CSV" if self._columns else "JSON lines"
            raise InputTextError(
                f"line {number}: this row of fte-sniff's {form} is cut or damaged; delete it"
            ) from None


def _begin_ns(text: str) -> int | None:
    found = re.search(_TIME, text)
    if found is None:
        return None
    year, month, day, hours, minutes, seconds, ns = map(int, found.groups())
    clock_s = (hours * 60 + minutes) * 60 + seconds
    begin_ns: int = days_of(year, month, day) * DAY_NS + clock_s * SECOND + ns
    return min(begin_ns, LATEST_NS)
