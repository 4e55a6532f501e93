"""Owns what a pattern of bytes means in a filter: `%` is any bytes, `_` any one hex digit.

It must not know where the pattern stands. Bytes are compared as their hex digits, and a pattern of
digits alone would also be found between them: `AA 01` in `02 0A A0 10`.
"""

from __future__ import annotations

import re

_BYTES = re.compile(r"%*(?:[0-9A-F_]{2}%*)*")


def is_of_whole_bytes(pattern: str) -> bool:
    """Whether the digits of a pattern, which has no spaces, are two a byte."""
    return _BYTES.fullmatch(pattern) is not None


def whole_bytes(pattern: str) -> tuple[str, str]:
    """The sign and the text by which SQL asks for a pattern of whole bytes.

    Rows are of whole bytes too: where all stands at their ends, LIKE cannot slip by half a one.
    """
    parts = re.split("%+", pattern)
    if not any(parts[1:-1]):
        return "LIKE", pattern
    return "~", f"^{'(?:..)*'.join(parts).replace('_', '.')}$"
