"""Owns how people write times, wherever they may: in filters, in `--from`, on the screen.

It must not know rows, nor which day a time of day is of: who asks says that.

    2026-01-31T12:00:05.25Z      a time in UTC, or with a zone as +08:00; without one it is UTC
    2026-01-31 12:00, 2026-01-31 the same in fewer words: a date alone is its midnight
    12:00:05.25, 12:00           a time of day, UTC
    10s, 1m30s, 250ms, 1.5h      a length of time: h, m or min, s, ms, us, ns
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from typing import Final

SECOND_NS: Final = 1_000_000_000
DAY_NS: Final = 86_400 * SECOND_NS

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_ISO: Final = re.compile(
    r"([0-9]{4}-[0-9]{2}-[0-9]{2})"
    r"(?:[T ]([0-9]{2}:[0-9]{2}(?::[0-9]{2})?)(?:\.([0-9]{1,9}))?\ ?(Z|[+-][0-9]{2}:?[0-9]{2})?)?"
)
_CLOCK: Final = re.compile(r"([0-9]{1,2}):([0-9]{2})(?::([0-9]{2})(?:\.([0-9]{1,9}))?)?Z?")
_UNITS: Final = {
    "ms": SECOND_NS // 1000,
    "us": 1000,
    "ns": 1,
    "h": 3600 * SECOND_NS,
    "min": 60 * SECOND_NS,
    "m": 60 * SECOND_NS,
    "s": SECOND_NS,
}
_PART: Final = rf"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)({'|'.join(_UNITS)})"
_PARTS: Final = re.compile(_PART, re.IGNORECASE)
_LENGTH: Final = re.compile(f"(?:{_PART})+", re.IGNORECASE)


def time_ns(text: str) -> int | None:
    """A time with its date as nanoseconds since 1970 UTC; None where the text is none.

    Up to nine digits of a second are read.
    """
    match = _ISO.fullmatch(text.strip())
    if match is None:
        return None
    day, clock, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(f"{day}T{clock or '00:00'}{zone or 'Z'}")
    except ValueError:
        return None
    return (moment - _EPOCH) // timedelta(seconds=1) * SECOND_NS + _fraction_ns(fraction)


def clock_ns(text: str) -> int | None:
    """A time of day as nanoseconds since midnight UTC; None where the text is none."""
    match = _CLOCK.fullmatch(text.strip())
    if match is None:
        return None
    hours, minutes, seconds = (int(match[place] or 0) for place in (1, 2, 3))
    if hours > 23 or minutes > 59 or seconds > 59:
        return None
    return (hours * 3600 + minutes * 60 + seconds) * SECOND_NS + _fraction_ns(match[4])


def length_ns(text: str) -> int | None:
    """A length of time in nanoseconds; None where the text is none."""
    if not _LENGTH.fullmatch(text):
        return None
    parts = _PARTS.findall(text)
    return sum(int(Decimal(number) * _UNITS[unit.lower()]) for number, unit in parts)


def _fraction_ns(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0"))
