"""Go to row, time, offset."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, tzinfo
from typing import TypeAlias

from fte_sniff.analysis.time_text import ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.errors import InputTextError
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.prompt import PromptField, Take


@dataclass(frozen=True, slots=True)
class ToRow:
    """The row of that number, from 1, among those shown."""

    number: int


@dataclass(frozen=True, slots=True)
class ToTimeOfDay:
    """The first row at or after a time of the day under the cursor."""

    clock: ClockTime


@dataclass(frozen=True, slots=True)
class ToDistance:
    """The first row at or after so long from the cursor's."""

    ns: int
    """Nanoseconds; below 0 is earlier."""


@dataclass(frozen=True, slots=True)
class ToTime:
    """The first row at or after a time."""

    t_ns: int
    """Nanoseconds since 1970 UTC."""


@dataclass(frozen=True, slots=True)
class ToShare:
    """The row so far through those shown."""

    percent: float
    """0 to 100."""


@dataclass(frozen=True, slots=True)
class ToOffset:
    """The row that holds a byte of the stream that the cursor's row is of."""

    offset: int
    """Of the byte, from 0."""


Goal: TypeAlias = ToRow | ToTimeOfDay | ToDistance | ToTime | ToShare | ToOffset

SIGNS = ("+", "-")
"""What a distance begins with."""

_ROW = re.compile(r"[0-9][0-9_,]*")
_NO_UNIT = re.compile(r"[+-][0-9]+(?:\.[0-9]*)?", re.ASCII)
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]*)?) ?%", re.ASCII)
_OFFSET = re.compile(r"@ ?(0[xX][0-9a-fA-F]{1,16}|[0-9][0-9_,]{0,20})", re.ASCII)


def parse_goal(text: str, zone: tzinfo = UTC) -> Goal:
    """What a text in the field means; a date and time that name no zone are of `zone`.

    Raises:
        InputTextError: it is none of these; the message shows one of each, or the
            distance with units where it has none.
    """
    text = text.strip()
    if _ROW.fullmatch(text):
        return ToRow(int(text.replace(",", "").replace("_", "")))
    if match := _SHARE.fullmatch(text):
        return ToShare(min(100.0, float(match[1])))
    if match := _OFFSET.fullmatch(text):
        return ToOffset(int(match[1].replace(",", "").replace("_", ""), 0))
    if (t_ns := time_ns(text, zone)) is not None:
        return ToTime(t_ns)
    if (clock := clock_time(text)) is not None:
        return ToTimeOfDay(clock)
    if text[:1] in SIGNS and (ns := duration_ns(text[1:])) is not None:
        return ToDistance(-ns if text[0] == "-" else ns)
    if _NO_UNIT.fullmatch(text):
        raise InputTextError(
            _("{text} of what? say it with a unit: {text}s, {text}ms, {text}us").format(text=text)
        )
    raise InputTextError(
        _(
            "a row (1200), 50%, a time (12:00:03.5, 20:00+08:00), a distance (+2s, -50ms)"
            " or a byte (@8190)"
        )
    )


class GotoField(PromptField):
    """Asks where to go."""

    def __init__(self, take: Take) -> None:
        super().__init__(
            later("go to"),
            parse_goal,
            take,
            "1200, 50%, 12:00:03.5, +2s, -50ms, @8190",
            _("enter goes there, esc stays here"),
        )
