r"""Owns one line of a hex dump: its address, its bytes, and the text beside them.

It must not know the lines around it, which say whether the address is one; `dumps` does.

    00000010  aa 01 01 03 e8 00 00 00  00 ee 55 01 01 03 e8 00  |..........U.....|   hexdump -C
    00000010: aa01 0103 e800 0000 00ee 5501 0103 e800  ..........U.....              xxd
    000010 aa 01 01 03 e8 00 00 00 00 ee 55 01 01 03 e8 00  >..........U.....<        od -t x1z
    0x20000000 <buffer>:\t0xaa\t0x01                                                   gdb x/2xb
    0010   aa 01 01 03 e8 00 00 00 00 ee 55 01 01 03 e8 00   ..........U.....         Wireshark
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

LONGEST_LINE = 1000
"""Characters; no dump has longer lines."""

_ADDRESS = re.compile(
    r"\s*+[│|]?\s*+(?:0x)?(?P<digits>[0-9A-Fa-f]{4,16})h?(?:\s++<[\w.+]++>(?=:))?"
    r"(?P<mark>:\s*|\s*[│|]\s*|\s+|\Z)",
    re.IGNORECASE,
)
_GROUP = re.compile(
    r"(?P<gap>\s*[-┊│|]\s*|\s*)(?:0x)?(?P<digits>(?:[0-9A-Fa-f]{2}){1,8})(?![0-9A-Za-z])"
)
_BARS = {"|": "|", ">": "<", "│": "│", "[": "]"}
_MOST_BESIDE = 64
_ONE_MORE = re.compile(r"\s[0-9A-Fa-f](?:\s?[0-9A-Fa-f])*\s*")
"""Behind one space, more digits are more bytes."""
_APART = re.compile(r"[0-9A-Fa-f](?:\s\s|\t|\s*[|>│])\s*\S")


@dataclass(frozen=True, slots=True)
class DumpLine:
    """A line that can be one of a dump."""

    address: str
    """Its digits."""
    colon: bool
    gap: int
    """Spaces behind the address."""
    groups: tuple[tuple[int, int], ...]
    """The bytes' places in the line, group by group."""
    data: bytes
    shown: bool
    """Whether text beside the bytes shows the same bytes."""
    unordered: bool
    """Whether the bytes of each group may stand in the machine's order."""

    @property
    def narrow(self) -> bool:
        """Whether each group of bytes has fewer digits than the address."""
        return all(stop - start < len(self.address) for start, stop in self.groups)

    @property
    def pairs(self) -> bool:
        """Whether each byte stands by itself."""
        return all(stop - start == 2 for start, stop in self.groups)


def dump_line(text: str, at: int) -> DumpLine | None:
    """The line from `at` on as one of a dump; None where it cannot be one."""
    address = _ADDRESS.match(text, at) if len(text) <= LONGEST_LINE else None
    if address is None:
        return None
    groups = tuple(_groups(text, address.end()))
    colon = ":" in address["mark"]
    gap = len(address["mark"].strip(":\r\n"))

    def line(count: int, *, shown: bool, unordered: bool) -> DumpLine:
        data = _bytes_of(text, groups[:count])
        return DumpLine(address["digits"], colon, gap, groups[:count], data, shown, unordered)

    for count in range(len(groups), 0, -1):
        beside = text[groups[count - 1][1] :]
        plain, swapped = _readings(text, groups[:count])
        fits, swapped_fits = _shows(beside, plain), _shows(beside, swapped)
        if fits or swapped_fits:
            doubtful = swapped_fits and not (fits and _in_order(colon, groups[:count]))
            return line(count, shown=True, unordered=doubtful and plain != swapped)
    end = groups[-1][1] if groups else address.end()
    if text[end:].strip():
        return None
    bare = line(len(groups), shown=False, unordered=not _in_order(colon, groups))
    return bare if bare.colon or bare.narrow else None


def address_of(text: str, at: int) -> DumpLine | None:
    """What stands at the front of a line, as a line of a dump that has an address only."""
    address = _ADDRESS.match(text, at)
    return address and DumpLine(address["digits"], ":" in address["mark"], 0, (), b"", False, False)


def _groups(text: str, at: int) -> Iterator[tuple[int, int]]:
    while group := _GROUP.match(text, at):
        if not group["gap"] and text[at - 1 : at].strip(" \t:|│"):
            return
        at = group.end()
        yield group.span("digits")


def _bytes_of(text: str, groups: tuple[tuple[int, int], ...]) -> bytes:
    return bytes.fromhex("".join(text[start:stop] for start, stop in groups))


def _in_order(colon: bool, groups: tuple[tuple[int, int], ...]) -> bool:
    """Whether bytes stand in groups as on the wire: each by itself, or as xxd has them."""
    widest = max((stop - start for start, stop in groups), default=0)
    return widest <= (4 if colon else 2)


def _readings(text: str, groups: tuple[tuple[int, int], ...]) -> tuple[bytes, bytes]:
    """The bytes as they stand, and those of each group the other way round."""
    swapped = b"".join(bytes.fromhex(text[start:stop])[::-1] for start, stop in groups)
    return _bytes_of(text, groups), swapped


def _shows(beside: str, data: bytes) -> bool:
    """Whether the text beside the bytes is what they look like as characters."""
    if not beside[:1].isspace() and beside[:1] not in _BARS:
        return False
    if _ONE_MORE.fullmatch(beside):
        return False
    bare = beside.strip().lstrip("┊ ")
    if bare[:1] in _BARS and bare.endswith(_BARS[bare[0]]) and len(bare) > 1:
        inside = bare[1:-1]
        if bare[0] == "│":
            inside = _without_zeros(inside, data)
        for one in (inside, inside.replace("┊", "").replace("│", "")):
            if _same(one.rstrip().ljust(len(data)), data):
                return True
    spaces = len(beside) - len(beside.lstrip())
    for lead in range(min(spaces, _MOST_BESIDE), 0, -1):
        one = beside[lead:].rstrip()
        if not one or len(one) > len(data) + 1:
            continue
        if _same(one.ljust(len(data)), data) or _same((one[:8] + one[9:]).ljust(len(data)), data):
            return True
    return False


def _without_zeros(shown: str, data: bytes) -> str:
    """What hexyl shows, with a dot for the 0 that stands for a zero byte."""
    letters = shown.replace("┊", "").replace("│", "")
    zeros = (letter == "0" and not byte for letter, byte in zip(letters, data, strict=False))
    dotted = ("." if zero else letter for zero, letter in zip(zeros, letters, strict=False))
    return "".join(dotted)


def _same(shown: str, data: bytes) -> bool:
    return len(shown) == len(data) and all(map(_stands_for, shown, data))


def _stands_for(letter: str, byte: int) -> bool:
    if letter == chr(byte) and 0x20 <= byte < 0x7F:
        return True
    if 0x20 < byte < 0x7F:
        return letter == "."
    return not (letter.isascii() and letter.isalnum()) and not letter.isspace()


def text_beside(text: str, at: int) -> int | None:
    """Where text beside bytes without an address begins; None where there is none.

    Raises:
        ValueError: it may be bytes as well.
    """
    if len(text) > LONGEST_LINE or not _APART.search(text, at):
        return None
    groups = tuple(_groups(text, at))
    for count in range(len(groups), 0, -1):
        end = groups[count - 1][1]
        beside = text[end:]
        if not beside.strip() or not _shows(beside, _bytes_of(text, groups[:count])):
            continue
        if re.fullmatch(r"[\s0-9A-Fa-f]+", beside):
            raise ValueError(end + len(beside) - len(beside.lstrip()))
        return end
    return None
