r"""Logs without any text around bytes: plain hex, and the rows that this program wrote.

Plain hex is read strictly: a typing error is refused with its position. Accepted are digits in
pairs, together or apart, a lone digit by itself (`AA 2 2`), `0x`, `\x` or `$` before or `h` after a
byte, any of `, ; : - |`, brackets and quotes between, and comments. Own rows are tables, CSV and
JSON lines; they come back with their ports and times.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from typing import Final

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.evidence import direction_of, frames_in, label_of
from fte_sniff.formats.logs.log_form import LATEST_NS, NO_TIME, LogForm, StreamBytes
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import SECOND, masked
from fte_sniff.protocol import FRAME_LENGTH, KINDS

_BLANKS: Final = bytes.maketrans(b",:;-", b"    ")
_GAP: Final = rb"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = rb"[0-9A-Fa-f]{2}"
_TOKEN: Final = (
    rb"(?s)(?:%b|\xe2\x96\xa1|(?<=%b)\.(?=%b|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)+"
    rb"|(?:0[xX]|\$|&[hH])?(?P<pairs>(?:%b)+)(?:[hH](?![0-9A-Za-z]))?"
    rb"|\\x(?P<escape>%b)(?![0-9A-Fa-f])"
    rb"|(?:0[xX]|\$|&[hH])?(?<![0-9A-Fa-f])(?P<lone>[0-9A-Fa-f])(?=%b|\Z)"
) % (_GAP, _PAIR, _GAP, _PAIR, _PAIR, _GAP)
"""What is between bytes, or bytes."""
_ADDRESS: Final = (
    rb"\s*(?:[0-9A-Fa-f]{4,16}(?::|\s{2,})\s*%b\b"
    rb"|\[?(?:[\d-]{8,10}[ T])?\d\d?:\d\d:\d\d\]?\s+(?:AA|aa|55)\b)"
) % _PAIR
"""An address or a time before bytes."""
_CERTAIN: Final = 0.95
_FEW_BYTES: Final = 100
_MANY_BYTES: Final = 1000
_LONGEST_MISTAKE: Final = 3
_FIX: Final = "write bytes as hex digits, like AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"


def bytes_of_line(line: bytes, number: int, column: int = 0) -> bytes:
    """The bytes of a line, or of a segment of a line after `column` bytes.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    found, at = bytearray(), 0
    for token in re.finditer(_TOKEN, line):
        if token.start() > at:
            break
        at = token.end()
        if token.lastgroup is not None:
            found += bytes.fromhex(token[token.lastgroup].decode().zfill(2))
    if at == len(line):
        return bytes(found)
    why = "is no hex digit"
    if re.match(rb"[0-9A-Fa-f](?:%b|\Z)" % _GAP, line[at:]):
        why = "has no second digit to make a byte"
    elif re.match(rb"[0-9A-Fa-f]", line[at:]):
        at += 1  # an odd number of digits ends in a character that is no digit
    before, after = (text.decode("utf-8", "replace") for text in (line[:at][-12:], line[at:]))
    raise InputTextError(
        f"not hex: {after[0]!r} {why}, line {number}, column {column + at + 1}:"
        f" {before}>>{after[0]}<<{after[1:12]} ({_FIX})"
    )


def is_plain(line: bytes) -> bool:
    """Whether a line has hex and nothing else, or nothing at all."""
    with suppress(InputTextError):
        bytes_of_line(line, 0)
        return re.match(_ADDRESS, line) is None
    return False


def _is_mistyped(line: bytes) -> bool:
    """Whether a line looks like plain hex with a typing error, and not like other text."""
    wrong = [len(token) for token in re.split(rb"%b+" % _GAP, line) if not is_plain(token)]
    other = direction_of(line) or re.match(_ADDRESS, line) or masked(line) != line
    return not other and max(wrong, default=9) <= _LONGEST_MISTAKE


class PlainLog(LogForm):
    """A log that has hex and nothing else."""

    single = True

    def __init__(self, data: bytes) -> None:
        self.frames, self.size = len(frames_in(data)), len(data)
        self.is_chance = not self.frames and self.size >= _MANY_BYTES
        self.is_certain = 0 < _CERTAIN * self.size <= FRAME_LENGTH * self.frames

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> PlainLog | None:
        """The log, if all lines of a sample are plain, but for typing errors."""
        data, names = b"", 0
        heads = (re.findall(rb"\A[^0-9A-Fa-f]*.{0,2}", line) for line in lines)
        if any(label_of("arrow", head) for found in heads for head in found):
            return None
        for line in lines:
            if is_plain(line):
                data += bytes_of_line(line, 0)
            elif not _is_mistyped(line):
                return None
            names += b":" in line or b"-" in line  # a network address, a UUID, a date
        plain = cls(data)
        return None if not plain.frames and names > max(2, len(lines) // 2) else plain

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        data = bytearray()
        with suppress(ValueError):
            data += bytearray.fromhex(block.text.translate(_BLANKS).decode("latin-1"))
        try:
            for number, line in enumerate(() if data else block.lines, block.first):
                data += bytes_of_line(line, number, block.column * (number == block.first))
        finally:
            if data:
                yield StreamBytes(name, bytes(data), [len(data)], [block.first])

    def notes(self) -> list[str]:
        """That there are no frames, in a log of more than a few bytes."""
        few = self.frames or self.size < _FEW_BYTES
        return [] if few else ["no frames found; it is read as plain hex"]

    def explain(self) -> list[str]:
        """What it is."""
        return [f"plain hex: {self.frames:,} frames in {self.size:,} bytes of the sample"]


_OBJECT: Final = r'\s*\{"time":[^,]*,\s*"port":'
_NAMES: Final = "time,port,offset,"
_HEADING: Final = {"kind", "values"}
_HEADINGS: Final = {*_HEADING, "time", "UTC", "port", "offset", "raw", "faults"}
_TIME: Final = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{9}Z"
_OFFSET: Final = r"(?<!\S)\d+\s\s[ ?!~]\s\s"
_CELLS: Final = (
    rf"{_OFFSET}(?:{'|'.join(kind.name for kind in KINDS)}|-)\s{{2,}}+"
    r"(?:\d+ bytes?\s{2,}+|(?:[a-z_]+=\S++\s)++\s*+)?+"
    r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s{2,}+[a-z_,]++)?+\s*+\Z"
)


class OwnLog(LogForm):
    """Rows that this program wrote."""

    resolution_ns = 1
    is_certain = True

    def __init__(self, lines: Sequence[bytes] = ()) -> None:
        """A log whose first lines are known; they show its ports."""
        self._headed, self._columns, self._ports = False, list[str](), dict[str, None]()
        with suppress(InputTextError):
            for _, _, port in self._rows(lines, 1):
                self._ports |= {port: None} if port else {}

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> OwnLog | None:
        """The log, if the first line with text is one of this program's."""
        first = next((line for line in lines if line.strip()), b"").decode("utf-8", "replace")
        rows = re.match(_OBJECT, first) or re.search(_CELLS, first) or first.startswith(_NAMES)
        return cls(lines) if rows or _HEADING <= {*first.split()} <= _HEADINGS else None

    def ports(self, name: str) -> list[str]:
        """Those of the first rows."""
        return [*self._ports] or [name]

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        for number, (data, t_ns, port) in enumerate(self._rows(block.lines, block.first)):
            lines = [block.first + number]
            yield StreamBytes(port or name, data, [len(data)], lines, [t_ns], first=True)

    def explain(self) -> list[str]:
        """What it is."""
        return ["rows that fte-sniff wrote"]

    def _rows(self, lines: Sequence[bytes], first: int) -> Iterator[tuple[bytes, int, str | None]]:
        """The bytes of rows, when they began, and their ports; InputTextError if one is cut."""
        for number, text in enumerate((line.decode("utf-8", "replace") for line in lines), first):
            what, words, cells = "table", {*text.split()}, re.search(_CELLS, text)
            try:
                if text.startswith(_NAMES):
                    self._columns = text.split(",")
                elif _HEADING <= words <= _HEADINGS:
                    self._headed = True
                    if "raw" not in words:
                        what = "table, as a narrow terminal shows it,"
                        raise ValueError
                elif self._columns and text.strip():
                    what = "CSV"
                    own = dict(zip(self._columns, next(csv.reader([text])), strict=True))
                    yield bytes.fromhex(own["raw"]), _begin_ns(own["time"]), own["port"]
                elif re.match(_OBJECT, text):
                    what = "JSON lines"
                    own = json.loads(text)
                    yield bytes.fromhex(own["raw"]), _begin_ns(own["time"] or ""), own["port"]
                elif cells:
                    yield bytes.fromhex(cells["raw"]), _begin_ns(text), None
                elif self._headed and re.match(rf"\s*{_TIME}\s|-\s|\s*{_OFFSET}", text):
                    raise ValueError
            except (ValueError, KeyError, TypeError, csv.Error):
                raise InputTextError(
                    f"line {number}: this row of fte-sniff's {what} is cut or damaged; pass the"
                    " recording itself, or its rows with --format csv or jsonl"
                ) from None


def _begin_ns(text: str) -> int:
    found = re.search(_TIME, text)
    if found is None:
        return NO_TIME
    second = int(datetime.fromisoformat(f"{found[0][:19]}+00:00").timestamp())
    return min(second * SECOND + int(found[0][20:29]), LATEST_NS)
