"""Owns rows as this program writes them for people and as JSON lines, read back.

It must not know what the bytes are. A row's time is when its first byte began, and where it has
none, the time of the row before does not hold for it. CSV has a heading: `comma_rows` reads it.

    time                               offset     kind    values       raw                   faults
    2026-01-31T12:00:00.000090150Z          0     reset                AA 00 00 00 00 00 00 ... EE
    {"time":"2026-01-31T12:00:00.000090150Z","port":"a",...,"raw":"AA0000000000000000EE"}
"""

from __future__ import annotations

import re
from dataclasses import replace

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.line_head import lone_stamp
from fte_sniff.formats.logs.line_time import Stamp
from fte_sniff.formats.logs.own_lines import OwnLine
from fte_sniff.protocol import KINDS

UNTIMED = Stamp()
"""Of a row that has no time."""

_HEADING = re.compile(r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw(?:\s+faults)?\s*")
_NARROW_HEADING = re.compile(r"\s*time UTC\s+(?:port\s+)?kind\s+values\s*")
_TIME = re.compile(r"\s*(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{9}Z)\s")
_CELLS = re.compile(
    r"(?<!\S)\d+\s\s[ ?!~]\s\s"
    rf"(?:{'|'.join(kind.name for kind in KINDS)}|-)\s{{2,}}+"
    r"(?:\d+ bytes?\s{2,}+|(?:[a-z_]+=\S++\s)++\s*+)?+"
    r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s{2,}+[a-z_,]++)?+\s*+\Z"
)
"""From the offset on."""
_BEGUN = re.compile(rf"(?:{_TIME.pattern}|-\s)|\s*+\d+\s\s[ ?!~]\s\s")
_OBJECT = re.compile(
    r"\s*\{\s*\"time\":\s*(?:null|\"(?P<time>[^\"]*)\"),\s*\"port\":.*"
    r"\"raw\":\s*\"(?P<raw>(?:[0-9A-F]{2})*)\"\s*\}\s*"
)
_OBJECT_BEGINS = '{"time":'
_WAY_OUT = "pass the recording itself, or its rows with --format csv or jsonl"


def begun_at(text: str) -> Stamp:
    """The time of a row's first byte, as this program writes it."""
    stamp = lone_stamp(text)
    return UNTIMED if stamp is None else replace(stamp, of_first_byte=True)


class WrittenRows:
    """Reads tables and JSON lines of this program."""

    def __init__(self) -> None:
        """No line is read yet."""
        self._headed = False

    def own_line(self, text: str, number: int) -> OwnLine | None:
        """What a row holds; None where a line is none.

        Raises:
            InputTextError: rows of a table are cut, so that bytes may be missing.
        """
        if text.lstrip().startswith(_OBJECT_BEGINS):
            return _of_object(text, number)
        if "  " not in text:
            return None
        if _HEADING.fullmatch(text):
            self._headed = True
            return OwnLine("")
        if _NARROW_HEADING.fullmatch(text):
            raise InputTextError(
                f"line {number}: this is fte-sniff's table as a narrow terminal shows it, which"
                f" need not hold all bytes; {_WAY_OUT}"
            )
        if row := _CELLS.search(text):
            time = _TIME.match(text)
            return _own(time[1] if time else "", row["raw"])
        if self._headed and _BEGUN.match(text):
            raise InputTextError(
                f"line {number}: this row of fte-sniff's table is cut or damaged; {_WAY_OUT}"
            )
        return None


def _of_object(text: str, number: int) -> OwnLine:
    row = _OBJECT.fullmatch(text)
    if row is None:
        raise InputTextError(
            f"line {number}: this row of fte-sniff's JSON lines is cut or damaged; delete it"
        )
    return _own(row["time"] or "", row["raw"])


def _own(time: str, raw: str) -> OwnLine:
    return OwnLine("", begun_at(time), data=bytes.fromhex(raw))
