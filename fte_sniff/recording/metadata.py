"""Port facts, recorded gaps and selection as MCAP metadata."""

from __future__ import annotations

import platform
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Final

from fte_sniff.protocol import iso_time

PROGRAM = "fte-sniff"
"""This program's name, with which the library string of its files begins."""

OF_A_PART = ("part", "previous")
"""The names of what a file says of its place among the files of a capture."""


@dataclass(frozen=True, slots=True)
class PortFacts:
    """One port of a recording."""

    name: str
    """As in the rows' `port`; may hold text from outside, so show it, never obey it."""
    baud: int | None = None
    """Bits per second on the line; None where nobody said."""


def library_name() -> str:
    """Who writes the file, for its header: `fte-sniff 1.2.3`."""
    return f"{PROGRAM} {version(PROGRAM)}"


def host_facts(start_ns: int) -> dict[str, str]:
    """The facts about this host and its clock that belong into a recording started at `start_ns`.

    Args:
        start_ns: when the capture began, nanoseconds since 1970 UTC.
    """
    clock = time.get_clock_info("time")
    return {
        "start": iso_time(start_ns),
        "host": platform.node(),
        "platform": platform.platform(),
        "python": platform.python_version(),
        "clock": f"{clock.implementation}, resolution {clock.resolution:g} s",
        "time": "when the row's first byte began on the wire, from the read's return, UTC",
    }


def recording_facts(ports: tuple[PortFacts, ...], facts: Mapping[str, str]) -> dict[str, str]:
    """The file's Metadata record: who wrote it, the caller's `facts`, and each port."""
    found = {"library": library_name(), **facts}
    for number, port in enumerate(ports, 1):
        found[f"port.{number}.name"] = port.name
        found[f"port.{number}.baud"] = "" if port.baud is None else str(port.baud)
    return found


def is_next_part(before: Mapping[str, str], facts: Mapping[str, str]) -> bool:
    """Whether a file is of the same capture as another, and the next that was recorded.

    Args:
        before: what the other says about itself.
        facts: what it says.
    """
    same = all(before.get(name) == facts.get(name) for name in ("start", "host"))
    first, second = before.get("part", "1"), facts.get("part", "1")
    numbered = all(part.isascii() and part.isdecimal() for part in (first, second))
    return bool(same and facts.get("start") and numbered and int(first) + 1 == int(second))


GAP_NAME: Final = f"{PROGRAM}.gap"
"""The name of the metadata record that tells which rows before this file were not recorded."""

LEFT_OUT_NAME: Final = f"{PROGRAM}.left-out"
"""The name of the metadata record that tells which rows came and are not in this file."""

_TIME: Final = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{9})Z", re.ASCII)
_MOST_DIGITS: Final = 18


@dataclass(frozen=True, slots=True)
class RecordedGap:
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

    def within(self, first_ns: int | None, last_ns: int | None) -> RecordedGap | None:
        """The part between two times, both included; None for no bound, and for no part.

        How many rows lie in a part is not known.
        """
        first = self.first_ns if first_ns is None else max(first_ns, self.first_ns)
        last = self.last_ns if last_ns is None else min(last_ns, self.last_ns)
        if (first, last) == (self.first_ns, self.last_ns):
            return self
        return RecordedGap(None, first, last, self.reason) if first <= last else None


def gap_of(name: str, told: Mapping[str, str]) -> RecordedGap | None:
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
    return RecordedGap(int(rows) if rows else None, first, last, told.get("reason", ""))


def _ns(text: str | None) -> int | None:
    found = _TIME.fullmatch(text or "")
    if found is None:
        return None
    try:
        seconds = datetime.fromisoformat(found[1]).replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None
    return int(seconds) * 1_000_000_000 + int(found[2])


SELECTION_NAME: Final = f"{PROGRAM}.selection"
"""The name of the metadata record that tells that the file is a selection."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Only rows for which a filter holds are there; between them others came."""

    filter_text: str
    """Text from the file, so show it, never obey it."""
    rows: int
    """How many rows there were before the filter."""

    def told(self) -> dict[str, str]:
        """As a recording holds it."""
        return {"filter": self.filter_text, "rows": str(self.rows)}


def selection_of(name: str, told: Mapping[str, str]) -> Selection | None:
    """What a metadata record tells; None where it tells of no selection."""
    text, rows = told.get("filter", ""), told.get("rows", "")
    if name != SELECTION_NAME or not text:
        return None
    if not (rows.isascii() and rows.isdecimal() and len(rows) <= _MOST_DIGITS):
        return None
    return Selection(text, int(rows))
