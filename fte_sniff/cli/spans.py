"""Owns `--from` and `--to`: from what a user writes to a span of time.

It must not know how rows are read.

    2026-01-31T12:00:05.25Z      a time in UTC, or with a zone as +08:00; without one it is UTC
    12:00:05                     a time of day (UTC) on the day of the first row
    +10s  +1m30s  +250ms         so long behind the first row
    -10s                         so long before the last row
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.errors import InputTextError, UsageError
from fte_sniff.protocol import iso_time

if TYPE_CHECKING:
    from fte_sniff.recording.span import Span

_SECOND = 1_000_000_000
_UNITS = {
    "ms": _SECOND // 1000,
    "us": 1000,
    "ns": 1,
    "h": 3600 * _SECOND,
    "m": 60 * _SECOND,
    "s": _SECOND,
}
_LENGTH = re.compile(rf"(\d+(?:\.\d*)?|\.\d+)({'|'.join(_UNITS)})", re.IGNORECASE)
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}(\.\d+)?)?")
_DAY = 24 * 3600 * _SECOND
_FRACTION = re.compile(r"\.(\d+)")
_HELP = "as 2026-01-31T12:00:05Z, 12:00:05, +10s (from the first row) or -10s (before the last)"

Times = tuple[int, int] | None


def span_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options `--from` and `--to`, as every command that reads recordings has them."""
    first = click.option(
        "--from", "since", metavar="TIME", help=f"Only rows from then on: {_HELP}."
    )
    end = click.option("--to", "until", metavar="TIME", help="Only rows before then; as --from.")
    return first(end(command))


def span_of(since: str | None, until: str | None, times: Sequence[Times]) -> Span | None:
    """The span that is asked for; None where none is.

    Args:
        since: the text of `--from`, if given.
        until: the text of `--to`, if given.
        times: first and last time of each input, nanoseconds since 1970 UTC.

    Raises:
        InputTextError: a text is no time.
        UsageError: a time is relative and the inputs tell no times, or the span is empty.
    """
    if since is None and until is None:
        return None
    from fte_sniff.recording.span import Span

    known = [found for found in times if found is not None]
    bounds = (min(first for first, _ in known), max(last for _, last in known)) if known else None
    span = Span()
    first = span.first_ns if since is None else _time(since, "--from", bounds)
    end = span.end_ns if until is None else _time(until, "--to", bounds)
    if first >= end:
        raise UsageError(f"--from {since} is not before --to {until}; nothing lies between them")
    return Span(first, end)


def _time(text: str, option: str, bounds: Times) -> int:
    wanted = text.strip()
    if wanted[:1] in ("+", "-"):
        first, last = _known(bounds, option, text)
        length = _length(wanted[1:], option)
        return first + length if wanted[0] == "+" else last - length
    if _CLOCK.fullmatch(wanted):
        first, _ = _known(bounds, option, text)
        return _clock(wanted, option, first)
    return _absolute(wanted, option)


def _known(bounds: Times, option: str, text: str) -> tuple[int, int]:
    if bounds is None:
        raise UsageError(
            f"{option} {text}: the input tells no times; give a recording that has rows"
        )
    return bounds


def _length(text: str, option: str) -> int:
    place, total = 0, 0.0
    for found in _LENGTH.finditer(text):
        if found.start() != place:
            break
        total += float(found[1]) * _UNITS[found[2].lower()]
        place = found.end()
    if not text or place != len(text):
        raise InputTextError(f"{option}: {text!r} is no length of time; write 10s, 1m30s or 250ms")
    return round(total)


def _clock(text: str, option: str, first_ns: int) -> int:
    whole, fraction = _split(text)
    hours, minutes, seconds = (*map(int, whole.split(":")), 0)[:3]
    if hours > 23 or minutes > 59 or seconds > 59:
        raise InputTextError(f"{option}: {text!r} is no time of day; write 12:00:05")
    day = first_ns - first_ns % _DAY
    return day + (hours * 3600 + minutes * 60 + seconds) * _SECOND + fraction


def _absolute(text: str, option: str) -> int:
    whole, fraction = _split(text)
    try:
        when = datetime.fromisoformat(whole)
    except ValueError:
        raise InputTextError(f"{option}: {text!r} is no time; write it {_HELP}") from None
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    seconds = int((when - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds())
    if seconds < 0:
        raise InputTextError(f"{option}: {text!r} is before {iso_time(0)}, and so before any row")
    return seconds * _SECOND + fraction


def _split(text: str) -> tuple[str, int]:
    """The text without its fraction of a second, and that in nanoseconds."""
    found = _FRACTION.search(text)
    if found is None:
        return text, 0
    return text.replace(found[0], "", 1), int(found[1][:9].ljust(9, "0"))
