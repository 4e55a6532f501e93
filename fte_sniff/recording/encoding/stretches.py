"""Owns what a recording says of rows that came and are not in it: how many, from when to when, why.

It must not know who left them out. A record that makes no sense says nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from fte_sniff.protocol import iso_time
from fte_sniff.recording.encoding.facts import PROGRAM

GAP_NAME: Final = f"{PROGRAM}.gap"
"""The name of the metadata record that tells which rows before this file were not recorded."""

LEFT_OUT_NAME: Final = f"{PROGRAM}.left-out"
"""The name of the metadata record that tells which rows came and are not in this file."""

_TIME: Final = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{9})Z", re.ASCII)
_MOST_DIGITS: Final = 18


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows that stood one behind the other, and are not there."""

    rows: int | None
    """At least 1; None where nobody knows how many, if any."""
    first_ns: int
    """Time of the first of them, or from which on they may be missing; ns since 1970 UTC."""
    last_ns: int
    reason: str
    """Text from the file, so show it, never obey it."""

    def told(self) -> dict[str, str]:
        """As a recording holds it."""
        return {
            "rows": "" if self.rows is None else str(self.rows),
            "from": iso_time(self.first_ns),
            "to": iso_time(self.last_ns),
            "reason": self.reason,
        }

    def within(self, first_ns: int | None, last_ns: int | None) -> Stretch | None:
        """The part between two times, both included; None for no bound, and for no part.

        How many rows lie in a part is not known.
        """
        first = self.first_ns if first_ns is None else max(first_ns, self.first_ns)
        last = self.last_ns if last_ns is None else min(last_ns, self.last_ns)
        if (first, last) == (self.first_ns, self.last_ns):
            return self
        return Stretch(None, first, last, self.reason) if first <= last else None


def stretch_of(name: str, told: Mapping[str, str]) -> Stretch | None:
    """What a metadata record tells; None where it tells of no rows."""
    if name not in (GAP_NAME, LEFT_OUT_NAME):
        return None
    rows, first, last = told.get("rows", ""), _ns(told.get("from")), _ns(told.get("to"))
    if rows and not (rows.isascii() and rows.isdecimal() and len(rows) <= _MOST_DIGITS):
        return None
    if rows and not int(rows):
        return None
    if first is None or last is None or last < first:
        return None
    return Stretch(int(rows) if rows else None, first, last, told.get("reason", ""))


def _ns(text: str | None) -> int | None:
    found = _TIME.fullmatch(text or "")
    if found is None:
        return None
    try:
        seconds = datetime.fromisoformat(found[1]).replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    return int(seconds) * 1_000_000_000 + int(found[2])
