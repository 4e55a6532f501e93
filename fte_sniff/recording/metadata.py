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

from fte_sniff.protocol import Gap, GapKind, iso_time

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

_GAP_KINDS: Final = {GAP_NAME: GapKind.WRITE_ERROR, LEFT_OUT_NAME: GapKind.LEFT_OUT}
_TIME: Final = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\.(\d{9})Z", re.ASCII)
_MOST_DIGITS: Final = 18


def gap_to_metadata(gap: Gap) -> dict[str, str]:
    """The items of a gap's metadata record; the times of the gap are known."""
    assert gap.start_ns is not None
    assert gap.end_ns is not None
    return {
        "rows": "" if gap.rows is None else str(gap.rows),
        "from": iso_time(gap.start_ns),
        "to": iso_time(gap.end_ns),
        "reason": gap.reason,
    }


def gap_from_metadata(name: str, items: Mapping[str, str]) -> Gap | None:
    """The gap in a metadata record; None if the record is of another sort or makes no sense."""
    kind = _GAP_KINDS.get(name)
    rows, start, end = items.get("rows", ""), _ns(items.get("from")), _ns(items.get("to"))
    if kind is None or start is None or end is None or end < start:
        return None
    if rows and (not _is_number(rows) or not int(rows)):
        return None
    return Gap(kind, int(rows) if rows else None, start, end, items.get("reason", ""))


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS


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
    if not _is_number(rows):
        return None
    return Selection(text, int(rows))
