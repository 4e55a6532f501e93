r"""Hex without any other text, as people paste it and as hex editors write it.

It is read strictly: a typing error is refused with its position. Accepted are digits in pairs,
together or apart, a lone digit (`AA 2 2`) at the start of a line or where no byte has a leading
zero, `0x`, `\x` or `$` before or `h` after a byte, any of `, ; : - |`, brackets and quotes between,
and comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Final

from fte_sniff.errors import InputTextError

_BLANKS: Final = str.maketrans(",:;-", "    ")
_GAP: Final = r"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = r"[0-9A-Fa-f]{2}"
_TOKEN: Final = re.compile(
    rf"(?s:(?:{_GAP}|(?<={_PAIR})\.(?={_PAIR}|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)++"
    rf"|(?:0[xX]|\$|&[hH]|\\x)?(?P<digits>(?:{_PAIR})++|(?<![0-9A-Fa-f])[0-9A-Fa-f](?={_GAP}|\Z))"
    r"(?:[hH](?![0-9A-Za-z]))?)"
)
"""What is between bytes, or the digits of bytes."""
_PREFIX: Final = re.compile(
    rf"\s*[0-9A-Fa-f]{{4,16}}(?::|\s{{2,}})\s*{_PAIR}\b|[^0-9A-Za-z]*?(?:>|<[^0-9A-Za-z])"
)
"""The address of a line of a dump, or an arrow, before its first byte."""
_KEY: Final = re.compile(r"[\"']\s*:")
"""The end of a name in JSON."""
_WORD: Final = re.compile(r"(?i)\b(?:tx|rx|in|out)\b|[^\x00-\x7f]|[<>]\W*[<>]|->|<-|\d:\d\d:")
"""A direction or a time."""
_FIX: Final = (
    "write each byte as two hex digits, as in AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"
)


def plain_hex(text: str, first: int = 1) -> bytes:
    """The bytes of a text whose first line has the number `first`.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    try:
        return bytes.fromhex(text.translate(_BLANKS))
    except ValueError:  # other signs between bytes, or a mistake
        lines = text.splitlines()
        return b"".join(_bytes_of_line(line, number) for number, line in enumerate(lines, first))


def plain_pieces(text: str, first: int = 1) -> Iterator[bytes]:
    """The bytes of a text, or of its lines up to a mistake; see `plain_hex`."""
    try:
        yield plain_hex(text, first)
    except InputTextError:
        for number, line in enumerate(text.splitlines(), first):
            yield _bytes_of_line(line, number)


def is_plain_hex(lines: Sequence[str]) -> bool:
    """Whether lines are hex, perhaps with typing errors in a few of them."""
    wrong = [line for line in lines if not is_hex_line(line)]
    return 10 * len(wrong) < len(lines) + 10 and all(map(_has_typing_errors, wrong))


def is_hex_line(line: str) -> bool:
    """Whether a line is hex without a mistake, a comment, or blank."""
    if _PREFIX.match(line) or _KEY.search(line):
        return False
    try:
        _bytes_of_line(line, 1)
    except InputTextError:
        return False
    return True


def _has_typing_errors(line: str) -> bool:
    """Whether the words of a line are as short as those of hex."""
    words = [word for word in re.split(_GAP, line) if word]
    return not (_WORD.search(line) or _KEY.search(line)) and all(
        len(word) <= len("0xA") for word in words
    )


def _bytes_of_line(line: str, number: int) -> bytes:
    found, at, padded = bytearray(), 0, re.search(r"\b0[0-9A-Fa-f]\b", line) is not None
    for token in _TOKEN.finditer(line):
        is_half = padded and found and len(token[0]) == 1 and token["digits"]
        if token.start() > at or is_half:
            break
        at = token.end()
        if digits := token["digits"]:
            found += bytes.fromhex(digits.zfill(2))
    if at == len(line):
        return bytes(found)
    at += re.match(rf"[0-9A-Fa-f](?!{_GAP}|\Z)", line[at:]) is not None  # half a byte
    raise InputTextError(
        f"not hex: {line[at]!r} in line {number}, column {at + 1}:"
        f" {line[:at][-12:]}>>{line[at]}<<{line[at + 1 : at + 12]} ({_FIX})"
    )
