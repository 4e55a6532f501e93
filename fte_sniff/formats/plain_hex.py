r"""Hex without any other text, as people paste it and as hex editors write it.

It is read strictly: a typing error is refused with its position. Accepted are digits in pairs,
together or apart, `0x`, `\x` or `$` before or `h` after a byte, any of `, ; : - |`, brackets and
quotes between, and comments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from fte_sniff.errors import InputTextError

_BLANKS: Final = str.maketrans(",:;-", "    ")
_GAP: Final = r"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = r"[0-9A-Fa-f]{2}"
_BETWEEN: Final = rf"(?:{_GAP}|(?<={_PAIR})\.(?={_PAIR}|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)++"
_TOKEN: Final = re.compile(
    rf"(?s:{_BETWEEN}|(?:0[xX]|\$|&[hH]|\\x)?((?:{_PAIR})++)(?:[hH](?![0-9A-Za-z]))?)"
)
"""What is between bytes, or the digits of bytes."""
_OTHER: Final = re.compile(
    rf"\s*[0-9A-Fa-f]{{4,16}}(?::|\s{{2,}})\s*{_PAIR}\b|[^0-9A-Za-z]*?(?:>|<[^0-9A-Za-z])"
    r"|.*[\"']\s*:"
)
"""An address or an arrow before the first byte, or a name in JSON: lines of a log."""
_FIX: Final = (
    "write each byte as two hex digits, as in AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"
)


def plain_hex(text: str, first: int = 1) -> Iterator[bytes]:
    """The bytes of a text whose first line has the number `first`, up to a mistake.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    try:
        yield bytes.fromhex(text.translate(_BLANKS))
    except ValueError:  # other signs between bytes, or a mistake
        for number, line in enumerate(text.splitlines(), first):
            yield _bytes_of_line(line, number)


def is_hex_line(line: str) -> bool:
    """Whether a line is hex without a mistake, a comment, or blank."""
    try:
        return not _OTHER.match(line) and _bytes_of_line(line, 1) is not None
    except InputTextError:
        return False


def has_typing_errors(line: str) -> bool:
    """Whether a line that is not hex has only words that are as short as those of hex."""
    return not _OTHER.match(line) and all(len(word) <= len("0xA") for word in re.split(_GAP, line))


def _bytes_of_line(line: str, number: int) -> bytes:
    found, at = bytearray(), 0
    while token := _TOKEN.match(line, at):
        at = token.end()
        found += bytes.fromhex(token[1] or "")
    if at == len(line):
        return bytes(found)
    at += re.match(rf"[0-9A-Fa-f](?!{_GAP}|\Z)", line[at:]) is not None  # half a byte
    raise InputTextError(
        f"not hex: {line[at]!r} in line {number}, column {at + 1}:"
        f" {line[:at][-12:]}>>{line[at]}<<{line[at + 1 : at + 12]} ({_FIX})"
    )
