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
from fte_sniff.formats.logs.labels import direction_of
from fte_sniff.formats.logs.streams import BYTE_NS, LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.protocol import FRAME_LENGTH

_LINES: Final = re.compile(
    rb"(?:[0-9A-Fa-f]{2}(?:[ \t,:-][0-9A-Fa-f]{2})*+[ \t,:-]?(?:\r?\n|\Z))++"
)
_NO_DIGITS: Final = b" \t,:-\r\n"
_WORD: Final = re.compile(
    rb"(?:0[xX]|(?P<escape>\\x)|\$|&[hH])?(?P<digits>[0-9A-Fa-f]+)(?:[hH](?![0-9A-Za-z]))?"
)
_BETWEEN: Final = re.compile(
    rb"(?:[\s,;:|\-\[\](){}\"'`<>]++|\xe2\x96\xa1|\xef\xbb\xbf|\.(?=\s|\Z|[\])}\"'])"
    rb"|(?<=[0-9a-fA-F]{2})\.(?=[0-9a-fA-F]{2}))+"
)
_COMMENT: Final = re.compile(rb"#.*|//.*|/\*.*?(?:\*/|\Z)|\A\s*```.*", re.DOTALL)
_NAME: Final = re.compile(rb"\s*[0-9A-Fa-f]{2,12}([:-][0-9A-Fa-f]{2,12})+\s*|.*\d:\d\d:\d\d.*")
"""A network address, a UUID, a date."""
_TOKEN: Final = re.compile(rb"[^\s,;:|\-\[\](){}\"'`<>]+")
_ADDRESS: Final = re.compile(
    rb"\s*(?:[0-9A-Fa-f]{4,16}(?::|\s{2,})\s*[0-9A-Fa-f]{2}\b"
    rb"|[\[(]?(?:[\d-]{8,10}[ T])?\d\d?:\d\d:\d\d[\])]?\s\s*(?:AA|aa|55)\b)"
)
"""An address or a time before bytes."""
_CERTAIN: Final = 0.95
_FEW_BYTES: Final = 100
_LONGEST_MISTAKE: Final = 3
_FIX: Final = "write bytes as hex digits, like AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"


def bytes_of_lines(text: bytes) -> bytes | None:
    """The bytes of a block of plain lines with a character between pairs; None if it is not one."""
    if _LINES.fullmatch(text) is None:
        return None
    return bytes.fromhex(text.translate(None, _NO_DIGITS).decode())


def bytes_of_line(line: bytes, number: int, column: int = 0) -> bytes:
    """The bytes of a line.

    Args:
        line: the line, or a segment of a very long one.
        number: its number, for messages.
        column: bytes of the line before this segment.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    bare = _COMMENT.sub(_blank, line) if _COMMENT.search(line) else line
    found, at = bytearray(), 0
    while at < len(bare):
        if between := _BETWEEN.match(bare, at):
            at = between.end()
        elif word := _WORD.match(bare, at):
            found += _bytes_of_word(word, line, number, column)
            at = word.end()
        else:
            raise _not_hex(line, number, column, at, "is no hex digit")
    return bytes(found)


def _blank(comment: re.Match[bytes]) -> bytes:
    return b" " * len(comment[0])


def _bytes_of_word(word: re.Match[bytes], line: bytes, number: int, column: int) -> bytes:
    digits, end = word["digits"], word.end()
    apart = end == len(word.string) or _BETWEEN.match(word.string, end) is not None
    if word["escape"] and len(digits) > 2:
        at = word.start("digits") + 2
        raise _not_hex(line, number, column, at, "stands after a complete escape")
    if len(digits) == 1 and apart:
        return bytes([int(digits, 16)])
    if len(digits) % 2:
        # An odd number of digits may simply end in a character that is no digit: point at that one.
        if not apart:
            raise _not_hex(line, number, column, end, "is no hex digit")
        raise _not_hex(line, number, column, end - 1, "has no second digit to make a byte")
    return bytes.fromhex(digits.decode())


def _not_hex(line: bytes, number: int, column: int, at: int, why: str) -> InputTextError:
    before, after = (
        text.decode("utf-8", "replace") for text in (line[max(0, at - 12) : at], line[at:])
    )
    return InputTextError(
        f"not hex: {after[0]!r} {why}, line {number}, column {column + at + 1}:"
        f" {before}>>{after[0]}<<{after[1:12]} ({_FIX})"
    )


def is_plain(line: bytes) -> bool:
    """Whether a line has hex and nothing else, or nothing at all."""
    if _ADDRESS.match(line):
        return False
    try:
        bytes_of_line(line, 0)
    except InputTextError:
        return False
    return True


def is_mistyped(line: bytes) -> bool:
    """Whether a line looks like plain hex with a typing error, and not like other text."""
    if direction_of(line) or _ADDRESS.match(line):
        return False
    wrong = [token for token in _TOKEN.findall(line) if not is_plain(token)]
    return bool(wrong) and all(len(token) <= _LONGEST_MISTAKE for token in wrong)


class PlainLog:
    """A log that has hex and nothing else."""

    resolution_ns = 1

    def __init__(self, data: bytes, start_ns: int | None) -> None:
        self.frames, self.size = len(frames_in(data)), len(data)
        self._start_ns = start_ns
        self._size = 0

    @classmethod
    def by_sample(cls, lines: Sequence[bytes], start_ns: int | None) -> PlainLog | None:
        """The log, if all lines of a sample are plain, but for typing errors."""
        data = bytearray()
        for line in lines:
            try:
                data += bytes_of_line(line, 0)
            except InputTextError:
                if not is_mistyped(line):
                    return None
            if _ADDRESS.match(line):
                return None
        plain = cls(bytes(data), start_ns)
        names = sum(_NAME.fullmatch(line) is not None for line in lines)
        return None if not plain.frames and names > max(2, len(lines) // 2) else plain

    @property
    def certain(self) -> bool:
        """Whether almost all bytes are in frames, so that no other reading is better."""
        return 0 < _CERTAIN * self.size <= FRAME_LENGTH * self.frames

    def ports(self, name: str) -> list[str]:
        """The name of the log."""
        return [name]

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """See `LogForm`."""
        data = bytes_of_lines(block.text)
        if data is None:
            found = bytearray()
            try:
                for number, line in enumerate(block.lines, block.first):
                    found += bytes_of_line(
                        line, number, block.column if number == block.first else 0
                    )
            finally:
                self._append(bytes(found), block.first, streams, name)
        else:
            self._append(data, block.first, streams, name)

    def _append(self, data: bytes, line: int, streams: LogStreams, name: str) -> None:
        if data:
            self._size += len(data)
            start_ns = self._start_ns
            t_ns = None if start_ns is None else start_ns + self._size * BYTE_NS
            streams[name].append(data, line, t_ns)

    def notes(self) -> list[str]:
        """That there are no frames, in a log of more than a few bytes."""
        if self.frames or self.size < _FEW_BYTES:
            return []
        return ["no frames found in the first lines; it is read as plain hex"]

    def explain(self) -> list[str]:
        """What it is."""
        return [f"plain hex: {self.frames:,} frames in {self.size:,} bytes of the sample"]
