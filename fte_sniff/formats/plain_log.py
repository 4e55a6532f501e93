r"""Logs without any text around bytes: plain hex, and the rows that this program wrote.

Plain hex is read strictly: a typing error is refused with its position. Accepted are digits in
pairs, together or apart, a lone digit (`AA 2 2`) at the start of a line or where no byte has a
leading zero, `0x`, `\x` or `$` before or `h` after a byte, any of `, ; : - |`, brackets and quotes
between, and comments. Own rows are tables, CSV and JSON lines; they come back with their ports and
times.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Final

from fte_sniff.errors import InputTextError
from fte_sniff.formats.log_form import LATEST_NS, NO_TIME, LogForm, StreamBytes
from fte_sniff.formats.logs.evidence import Hypothesis, Lane, Placed, label_of
from fte_sniff.formats.logs.forms import Extractor
from fte_sniff.formats.logs.times import masked
from fte_sniff.formats.text_blocks import TextBlock
from fte_sniff.protocol.columns import ISO_TIME, iso_time_ns

_BLANKS: Final = bytes.maketrans(b",:;-", b"    ")
_GAP: Final = rb"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = rb"[0-9A-Fa-f]{2}"
_TOKEN: Final = (
    rb"(?s:(?:%b|\xe2\x96\xa1|(?<=%b)\.(?=%b|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)++"
    rb"|(?:0[xX]|\$|&[hH]|\\x)?(?P<digits>(?:%b)++|(?<![0-9A-Fa-f])[0-9A-Fa-f](?=%b|\Z))"
    rb"(?:[hH](?![0-9A-Za-z]))?)"
) % (_GAP, _PAIR, _GAP, _PAIR, _GAP)
"""What is between bytes, or the digits of bytes."""
_SHORT: Final = rb"(?:0[xX]|\\x)?.{0,3}"
"""A byte, perhaps with a typing error."""
_MISTAKE: Final = rb"[0-9A-Fa-f].?|.[0-9A-Fa-f]"
"""A byte with one, beside pairs of digits."""
_PREFIX: Final = (
    rb"\s*(?:[0-9A-Fa-f]{4,16}(?::|\s{2,})\s*%b\b"
    rb"|\[?[\dT -]*\d:\d\d:\d\d\]?\s+(?:AA|aa|55)\b"
    rb"|[^0-9A-Za-z]*?(?:>|<[^0-9A-Za-z]))"
) % _PAIR
"""An address, a time or an arrow before bytes."""
_FEW_BYTES: Final = 100
_CHANCE: Final = 0.005
"""Share of many bytes in frames from which on they are evidence."""
_PLAIN_HEX: Final = Extractor("plain hex", "hex editors, xxd -p, fte-sniff")
_FIX: Final = (
    "write each byte as two hex digits, as in AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"
)


def bytes_of_line(line: bytes, number: int = 1, column: int = 0) -> bytes:
    """The bytes of a line, or of a segment of a line after `column` bytes.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    found, at, padded = bytearray(), 0, re.search(rb"\b0[0-9A-Fa-f]\b", line) is not None
    for token in re.finditer(_TOKEN, line):
        is_half = padded and found and len(token[0]) == 1 and token["digits"]
        if token.start() > at or is_half:
            break
        at = token.end()
        if digits := token["digits"]:
            found += bytes.fromhex(digits.decode().zfill(2))
    if at == len(line):
        return bytes(found)
    at += re.match(rb"[0-9A-Fa-f](?!%b|\Z)" % _GAP, line[at:]) is not None  # half a byte
    before, after = (text.decode("utf-8", "replace") for text in (line[:at][-12:], line[at:]))
    raise InputTextError(
        f"not hex: {after[0]!r} in line {number}, column {column + at + 1}:"
        f" {before}>>{after[0]}<<{after[1:12]} ({_FIX})"
    )


class PlainLog(LogForm):
    """A log that has hex and nothing else."""

    single = True

    def __init__(self, data: bytes = b"", *, is_certain: bool = False) -> None:
        """A log whose sample has these bytes."""
        self.found = Hypothesis(_PLAIN_HEX, [Lane({b"": slice(None)}, [Placed(0, 0, data)])])
        self.rank = self.found.rank
        self.is_certain = is_certain or self.rank[1]
        self.is_chance = self.found.size >= _FEW_BYTES and self.found.share < _CHANCE

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> PlainLog | None:
        """The log, if all lines of a sample are plain, but for typing errors in short words."""
        data, is_certain = b"", False
        comments = [found[0] for line in lines if (found := re.search(rb"(?:#|//).*", line))]
        timed = sum(masked(text) != text for text in comments)
        directions = {label_of("direction", text) for text in comments} - {None}
        if len(directions) > 1 or 2 * timed > len(lines):
            return None  # they say more of the bytes than plain hex does
        for line in lines:
            if re.match(_PREFIX, line):
                return None
            try:
                data += bytes_of_line(line)
            except InputTextError:
                words = [word for word in re.split(_GAP, line) if word]
                odd = [word for word in words if not re.fullmatch(_PAIR, word)]
                short, near = (all(re.fullmatch(x, own) for own in odd) for x in (_SHORT, _MISTAKE))
                is_certain |= near and 2 * len(odd) < len(words) and odd[:1] != words[:1]
                if label_of("direction", line) or masked(line) != line or not short:
                    return None
        numbers = re.findall(rb"\w+", b" ".join(lines))
        are_decimal = all(one.isdigit() and int(one) < 256 for one in numbers)
        if are_decimal and any(len(one) == 3 for one in numbers):
            return None
        has_digits = re.search(rb"[0-9A-Fa-f]|\A\Z", b"".join(lines).strip())
        return cls(data, is_certain=is_certain) if has_digits else None

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        data = bytearray()
        try:
            data += bytearray.fromhex(block.text.translate(_BLANKS).decode("latin-1"))
        except ValueError:  # other separators, or a mistake
            for number, line in enumerate(block.lines, block.first):
                data += bytes_of_line(line, number, block.column or 0)
        finally:
            if data:
                yield StreamBytes(name, bytes(data), [len(data)], [block.first])

    def notes(self) -> list[str]:
        """That frames are missing, in a log of more than a few bytes."""
        return ["no frames found; it is read as plain hex"] if self.is_chance else []

    def explain(self) -> list[str]:
        """What it is."""
        return [str(self.found)]


_OFFSET: Final = r"(?<!\S)\d+\s\s[ ?!~]\s\s"
_OWN: Final[dict[str, tuple[str, str, Callable[[str], str]]]] = {
    "table": (
        r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw\b",
        rf"\s*(?:(?P<time>{ISO_TIME})\s)?(?P<port>)(?:.*?{_OFFSET}(?:[a-z_]+|-)\s.*?\s\s"
        r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s\s+[a-z_,]+)?\s*\Z"
        rf"|(?<=Z\s)|(?<=[+-]\d\d:\d\d\s)|-\s|{_OFFSET})",
        str,
    ),
    "CSV": (
        "time,port,offset,",
        rf"(?=\d{{4}}-|,)(?:(?P<time>{ISO_TIME})?,(?P<port>\"(?:[^\"]|\"\")*\"|[^,]*),"
        r".*,(?P<raw>(?:[0-9A-F]{2})+)(?:,[\d.]*,(?:true|false|),\d?)?\s*\Z)?",
        lambda port: port[1:-1].replace('""', '"') if port[:1] == '"' else port,
    ),
    "JSON lines": (
        r'\s*\{"time": *[^,]*, *"port":',
        rf'\s*\{{(?:"time": *(?:null|"(?P<time>{ISO_TIME})"), *'
        r'"port": *(?P<port>"(?:[^"\\]|\\.)*"),'
        r'.*"raw": *"(?P<raw>(?:[0-9A-F]{2})+)"(?:, *"[a-z_]+": *[^,{}"]*)*\}\s*\Z)?',
        json.loads,
    ),
}
"""How own rows in a format begin, each row, and its port; a row without `raw` is cut."""


class OwnLog(LogForm):
    """Rows that this program wrote."""

    resolution_ns = 1
    is_certain = True

    def __init__(self, what: str, lines: Sequence[bytes]) -> None:
        """Rows in a format, of which the first lines are known."""
        self._what, self._first = what, TextBlock(b"\n".join(lines))

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> OwnLog | None:
        """The log, if the first line with text is one of this program's."""
        line = next((line for line in lines if line.strip()), b"").decode("utf-8", "replace")
        for what, (heading, row, _) in _OWN.items():
            found = re.match(row, line)
            if re.match(heading, line) or (found and found["raw"]):
                return cls(what, lines)
        return None

    def ports(self, name: str) -> list[str]:
        """Those of the first rows."""
        ports = dict[str, None]()
        with suppress(InputTextError):
            ports.update((row.port, None) for row in self.read(self._first, name))
        return [*ports] or [name]

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        _, row, port_of = _OWN[self._what]
        streams = defaultdict[str, list[tuple[bytes, int, int]]](list)
        try:
            for number, line in enumerate(block.lines, block.first):
                found = re.match(row, line.decode("utf-8", "replace"))
                if found is None:
                    continue
                begin_ns = iso_time_ns(found["time"]) if found["time"] else NO_TIME
                if not found["raw"] or begin_ns is None:
                    raise InputTextError(
                        f"line {number}: this row of fte-sniff's {self._what} is cut or damaged;"
                        " pass the recording itself, or its rows with --format csv or jsonl"
                    )
                own = bytes.fromhex(found["raw"]), number, min(begin_ns, LATEST_NS)
                streams[port_of(found["port"]) or name].append(own)
        finally:
            for port, rows in streams.items():
                data, order, times = zip(*rows, strict=True)
                yield StreamBytes(port, b"".join(data), [*map(len, data)], order, times, first=True)

    def explain(self) -> list[str]:
        """What it is."""
        return [f"rows that fte-sniff wrote as {self._what}"]
