"""Port facts, recorded gaps and selections as MCAP metadata."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from typing import Final, NamedTuple

from fte_sniff.protocol.columns import iso_time, iso_time_ns
from fte_sniff.protocol.items import Gap, GapKind

PROGRAM: Final = "fte-sniff"
"""The start of the header's library string, and the name of the file's own metadata record."""


@dataclass(frozen=True, slots=True)
class PortFacts:
    """One port of a recording."""

    name: str
    """As in the rows' `port`; may contain text from outside."""
    baud: int | None = None
    """Bits per second; None if unknown."""


@cache
def library_name() -> str:
    """The library string of the header: `fte-sniff 1.2.3`."""
    return f"{PROGRAM} {version(PROGRAM)}"


def host_facts(start_ns: int) -> dict[str, str]:
    """Metadata about this host at `start_ns`, nanoseconds since 1970 UTC."""
    return {"start": iso_time(start_ns), "host": platform.node()}


def recording_facts(ports: Sequence[PortFacts], facts: Mapping[str, str]) -> dict[str, str]:
    """The file's own metadata record: its library, the caller's `facts`, and each port."""
    found = {"library": library_name(), **facts}
    for number, port in enumerate(ports, 1):
        found[f"port.{number}.name"] = port.name
        found[f"port.{number}.baud"] = "" if port.baud is None else str(port.baud)
    return found


_MOST_DIGITS: Final = 18


def number_in(text: str) -> int | None:
    """The number in a text from a file; None if it is not one."""
    is_number = text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS
    return int(text) if is_number else None


class Part(NamedTuple):
    """One file of a capture."""

    start: str
    host: str
    number: int
    """From 1."""


def part_of(facts: Mapping[str, str]) -> Part | None:
    """Which file of a capture has these facts; None if they do not show it."""
    start, number = facts.get("start"), number_in(facts.get("part", "1"))
    return Part(start, facts.get("host", ""), number) if start and number is not None else None


GAP_NAME: Final = f"{PROGRAM}.gap"
"""The metadata record of a gap before this file: rows that could not be recorded."""

LEFT_OUT_NAME: Final = f"{PROGRAM}.left-out"
"""The metadata record of a gap in this file: rows that were left out."""

_GAP_KINDS: Final = {GAP_NAME: GapKind.WRITE_ERROR, LEFT_OUT_NAME: GapKind.LEFT_OUT}


def gap_to_metadata(gap: Gap) -> dict[str, str]:
    """The items of a gap's metadata record; both times must be known."""
    assert gap.start_ns is not None
    assert gap.end_ns is not None
    return {
        "rows": "" if gap.rows is None else str(gap.rows),
        "from": iso_time(gap.start_ns),
        "to": iso_time(gap.end_ns),
        "reason": gap.reason,
    }


def gap_from_metadata(name: str, items: Mapping[str, str]) -> Gap | None:
    """The gap in a metadata record; None if the record is of another kind or invalid."""
    kind, rows = _GAP_KINDS.get(name), number_in(items.get("rows", ""))
    start, end = iso_time_ns(items.get("from", "")), iso_time_ns(items.get("to", ""))
    if kind is None or start is None or end is None or end < start:
        return None
    return Gap(kind, rows or None, start, end, items.get("reason", ""))


SELECTION_NAME: Final = f"{PROGRAM}.selection"
"""The metadata record of a file with only the rows that pass a filter."""


@dataclass(frozen=True, slots=True)
class Selection:
    """The filter that was applied to the rows of a file."""

    filter_text: str
    """May contain text from outside."""
    rows: int
    """Rows before the filter."""

    def to_metadata(self) -> dict[str, str]:
        """The items of its metadata record."""
        return {"filter": self.filter_text, "rows": str(self.rows)}


def selection_from_metadata(name: str, items: Mapping[str, str]) -> Selection | None:
    """The selection in a metadata record; None if the record is of another kind or invalid."""
    text, rows = items.get("filter", ""), number_in(items.get("rows", ""))
    return Selection(text, rows) if name == SELECTION_NAME and text and rows is not None else None
