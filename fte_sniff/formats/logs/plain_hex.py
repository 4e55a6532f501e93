r"""Hex without any text around it, read strictly: a typing error is refused with its position.

Accepted: digits in pairs, together or apart, a lone digit that stands by itself (`AA 2 2`), `0x`,
`\x` or `$` before or `h` after a byte, any of `, ; : - |`, brackets and quotes between, comments.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.chance import frames_in
from fte_sniff.formats.logs.labels import direction_of, label_of
from fte_sniff.formats.logs.streams import LogForm, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol import FRAME_LENGTH

_PLAIN: Final = bytes.maketrans(b",:;-", b"    ")
_GAP: Final = rb"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = rb"[0-9A-Fa-f]{2}"
_TOKEN: Final = (
    rb"(?s)(?:%b|\xe2\x96\xa1|(?<=%b)\.(?=%b)|\.(?=%b|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)+"
    rb"|(?:0[xX]|\$|&[hH])?(?P<pairs>(?:%b)+)(?:[hH](?![0-9A-Za-z]))?"
    rb"|\\x(?P<escape>%b)(?![0-9A-Fa-f])"
    rb"|(?:0[xX]|\$|&[hH])?(?<![0-9A-Fa-f])(?P<lone>[0-9A-Fa-f])(?=%b|\Z)"
) % (_GAP, _PAIR, _PAIR, _GAP, _PAIR, _PAIR, _GAP)
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
    try:
        bytes_of_line(line, 0)
    except InputTextError:
        return False
    return re.match(_ADDRESS, line) is None


def is_mistyped(line: bytes) -> bool:
    """Whether a line looks like plain hex with a typing error, and not like other text."""
    wrong = [token for token in re.split(rb"%b+" % _GAP, line) if not is_plain(token)]
    other = direction_of(line) or re.match(_ADDRESS, line) or masked(line) != line
    return not other and max(map(len, wrong), default=9) <= _LONGEST_MISTAKE


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
            elif not is_mistyped(line):
                return None
            names += b":" in line or b"-" in line  # a network address, a UUID, a date
        plain = cls(data)
        return None if not plain.frames and names > max(2, len(lines) // 2) else plain

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        try:
            data = bytearray.fromhex(block.text.translate(_PLAIN).decode("latin-1"))
        except ValueError:
            data = bytearray()
        try:
            for number, line in enumerate(() if data else block.lines, block.first):
                data += bytes_of_line(line, number, block.column * (number == block.first))
        finally:
            if data:
                streams.stream(name).append(bytes(data), [len(data)], [block.first])

    def notes(self) -> list[str]:
        """That there are no frames, in a log of more than a few bytes."""
        few = self.frames or self.size < _FEW_BYTES
        return [] if few else ["no frames found; it is read as plain hex"]

    def explain(self) -> list[str]:
        """What it is."""
        return [f"plain hex: {self.frames:,} frames in {self.size:,} bytes of the sample"]
