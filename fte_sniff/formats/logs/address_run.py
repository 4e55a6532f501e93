"""Owns which address follows which in a hex dump, whatever base the addresses are written in.

It must not know what stands on the lines beside them, nor what becomes of a line that does not
follow.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from fte_sniff.formats.logs.dump_line import DumpLine

_FORMATS = {16: "x", 8: "o", 10: "d"}
"""The bases that programs write addresses in, and how each is written."""
_DIGITS_OF_OD = 7
"""Its addresses are octal, or decimal with -A d."""
_MOST_MISSED = 1 << 20
"""Bytes; a larger step is no dump that goes on."""
_BEGUN_ADDRESS = re.compile(r"\s*(?P<digits>[0-9A-Fa-f]{1,15})\s*")

_FIRST_ADDRESS = re.compile(r"\s*(?P<zeros>0{4,16}):?\s*[0-9A-Fa-f]?\s*")


@dataclass(frozen=True, slots=True)
class AddressRun:
    """A dump under way: its last line, and what that line's address says of the next one."""

    last: DumpLine
    starts: Mapping[int, int]
    """The address of the last line, by each base that all lines up to it can be written in."""
    repeats: bool = False
    """Whether a * says that more lines like the last one are left out."""

    @classmethod
    def begun(cls, line: DumpLine) -> AddressRun:
        """A dump that begins with that line."""
        values = {base: _value(line.address, base) for base in _FORMATS}
        return cls(line, {base: value for base, value in values.items() if value is not None})

    def repeating(self) -> AddressRun:
        """The same behind a *."""
        return replace(self, repeats=True)

    def with_line(self, line: DumpLine) -> AddressRun | None:
        """The dump up to that line; None where it does not follow the last one."""
        size = len(self.last.data)
        found = {}
        for base, start in self.starts.items():
            address = _value(line.address, base)
            rise = -1 if address is None else address - start
            repeated = self.repeats and rise > size and rise % size == 0
            if address is not None and (rise == size or repeated):
                found[base] = address
        return AddressRun(line, found) if found else None

    def left_out_before(self, after: AddressRun) -> int | None:
        """How many lines like the last one a * stands for, before the last one of `after`.

        None where the bases that the addresses can be written in do not agree on it.
        """
        usual = (8, 10) if len(self.last.address) == _DIGITS_OF_OD else (16,)
        likely = [base for base in after.starts if base in usual] or list(after.starts)
        if self.repeats and len({after.starts[base] for base in likely}) > 1:
            return None
        base = likely[0]
        return (after.starts[base] - self.starts[base]) // len(self.last.data) - 1

    def begins_again(self, text: str, at: int) -> bool:
        """Whether the text is the first address of such a dump, and no byte behind it."""
        zeros = _FIRST_ADDRESS.fullmatch(text, at)
        return zeros is not None and len(zeros["zeros"]) == len(self.last.address)

    def misses_lines(self, line: DumpLine) -> bool:
        """Whether a line with an address only ends a dump that has more lines than there are."""
        if line.data or len(line.address) != len(self.last.address):
            return False
        rises = (
            (_value(line.address, base) or 0) - start - len(self.last.data)
            for base, start in self.starts.items()
        )
        return any(0 < rise <= _MOST_MISSED for rise in rises)

    def begins_next(self, text: str, at: int) -> bool:
        """Whether the text is the next address, but for digits that are missing behind it."""
        begun = _BEGUN_ADDRESS.fullmatch(text, at)
        width = len(self.last.address)
        if begun is None or len(begun["digits"]) >= width:
            return False
        if self.repeats:
            return True
        nexts = (
            format(start + len(self.last.data), _FORMATS[base])
            for base, start in self.starts.items()
        )
        return any(one.zfill(width).startswith(begun["digits"].lower()) for one in nexts)


def _value(digits: str, base: int) -> int | None:
    try:
        return int(digits, base)
    except ValueError:
        return None
