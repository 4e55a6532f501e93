"""A search: a filter whose rows are not shown alone but gone to, one after the other."""

from __future__ import annotations

import re
from typing import Final

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.errors import FilterError, InputTextError, printable

HEX: Final = "hex:"
"""Prefix of a search for bytes only."""

_BYTES: Final = re.compile(r"(?:[0-9a-f]{2} ?)+")
_NIBBLES: Final = re.compile(r"(?:[0-9a-f?]{2} ?)+")


def parse_search(typed: str) -> RowFilter:
    """The filter of bytes, of a filter, or of a word; InputTextError if not hex follows `HEX`."""
    line = " ".join(typed.split()).lower()
    digits = line.removeprefix(HEX).strip()
    if line.startswith(HEX) and not _NIBBLES.fullmatch(digits):
        raise InputTextError(
            "'{digits}' is not hex: two digits a byte, as in hex:AA ?? 03",
            digits=printable(digits),
        )
    if line.startswith(HEX) or _BYTES.fullmatch(line):
        pairs = re.findall("..", digits.replace(" ", ""))
        test = f"raw LIKE '%{' '.join(pairs).replace('?', '_')}%'"
        return RowFilter.parse(test)
    try:
        return RowFilter.parse(typed)
    except FilterError:
        word = re.sub(r"[%_']", "_", line)
        names = ("kind", "faults", "port")
        test = " OR ".join(f"{name} LIKE '%{word}%'" for name in names)
        return RowFilter.parse(test)
