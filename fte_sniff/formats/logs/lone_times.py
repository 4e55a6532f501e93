"""Owns whether a line is nothing but a time, or the beginning of one, so that it holds no bytes.

It must not know what a time means. In a log whose lines have times, what reads like the beginning
of what stands before their bytes is one. Elsewhere `12:00:00` can be three bytes with colons
between them; the lines around it show whether bytes are written so.

    [14:03:22.123]收←◆55 01 01 03 E8 00 00 00 0F EE
    [14:03:22.65                                       the log ends here
"""

from __future__ import annotations

import re
from enum import Enum

_WHOLE = re.compile(
    r"(?P<begun>[\[(<{]\s*)?"
    r"(?:(?:[01]?\d|2[0-3]):[0-5]\d:[0-5]\d(?P<cut>[.,]\d{0,9})?|\d{4}-[01]\d-[0-3]\d)"
)
_FIRST = frozenset("0123456789[(<{")
_DIGITS = re.compile(r"\d+")
_SENT = re.compile(r"T(?=X|\Z)")
_BETWEEN = re.compile(r"(?<![0-9A-Za-z])[0-9A-Fa-f]{2}([:-])[0-9A-Fa-f]{2}(?![0-9A-Za-z])")
_LONGEST = 64
_MORE_DIGITS = 3
"""That times have which are written as short as they can be."""


class Kind(Enum):
    """What a line is."""

    BYTES = "bytes"
    """Or something else that is no time."""
    TIME = "time"
    CUT = "cut"
    """The beginning of a time."""
    CUT_IF_LAST = "cut if last"
    """The beginning of a time if nothing comes behind it; else bytes."""
    UNTOLD = "untold"
    """A time, unless bytes on the next line have colons too, or there is none."""


class LoneTimes:
    """Tells such lines by what has been seen of the log."""

    def __init__(self) -> None:
        """Nothing has been seen."""
        self._head = ""
        """What stood before the bytes of the latest line, or above them."""
        self._latest, self._latest_at = "", 0
        """The latest line with bytes, and where they begin."""
        self.each_timed = True
        """Whether each line with bytes has had a time on it."""

    def see_head(self, text: str) -> None:
        """Take note of what stands before bytes, or above them."""
        self._head = text

    def see_bytes(self, text: str, at: int = 0, *, timed: bool) -> None:
        """Take note of a line with bytes from `at` on, which has a time of its own or has none."""
        self._latest, self._latest_at = text, at
        self.each_timed = self.each_timed and timed

    def begins_head(self, text: str) -> bool:
        """Whether the text is like the beginning of what stands before other lines' bytes."""
        if not self._head or len(text) > len(self._head) + _MORE_DIGITS:
            return False
        return _shape(self._head).startswith(_shape(text))

    def kind_of(self, text: str) -> Kind:
        """What a line without a whole head is."""
        bare = text.strip().rstrip(",;")
        if len(bare) > _LONGEST:
            return Kind.BYTES
        if self.begins_head(bare):
            if bare.isdecimal():
                longest = _DIGITS.match(self._head)
                few = longest is not None and len(bare) <= len(longest.group())
                return Kind.CUT_IF_LAST if few and self.each_timed else Kind.BYTES
            return Kind.CUT if self.each_timed or not self._like_latest(bare) else Kind.BYTES
        if bare[:1] not in _FIRST or not (whole := _WHOLE.fullmatch(bare)):
            return Kind.BYTES
        if whole["cut"] or whole["begun"] is not None:
            return Kind.CUT
        if not self._latest and not self._head:
            return Kind.UNTOLD
        return Kind.BYTES if self._like_latest(bare) else Kind.TIME

    def _like_latest(self, text: str) -> bool:
        return like(text, self._latest[self._latest_at :])


def like(text: str, other: str) -> bool:
    """Whether another line has the same sign between its bytes, so that both are bytes."""
    found = _BETWEEN.search(other)
    return found is not None and text[:1].isdecimal() and found[1] in text


def _shape(text: str) -> str:
    """The text with other digits and directions as if they were the same."""
    same = _SENT.sub("R", _DIGITS.sub("0", text.strip()))
    return same.replace(">", "<").replace("Outgoing", "Incoming")
