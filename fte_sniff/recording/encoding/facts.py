"""Owns what a recording says about itself: its ports, the host, the clock, the protocol.

It must not know how a file stores it.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version

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
