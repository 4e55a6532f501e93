"""Owns `--from` and `--to`: from what a user writes to a span of time.

It must not know how rows are read.

    2026-01-31T12:00:05.25Z      a time, as `analysis.moments` reads it
    12:00:05  20:00:05+08:00     a time of day on the day of the first row; for `--to` the first
                                 behind `--from`, which may be on the day after
    +10s  +1m30s  +250ms         so long behind the first row
    -10s                         so long before the last row

A time without a zone is of the one that `--zone` names, UTC by default.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, time, tzinfo
from functools import cache
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.analysis.time_text import ClockTime, clock_time, length_ns, time_ns
from fte_sniff.errors import InputTextError, UsageError, quoted, shortened
from fte_sniff.protocol import iso_time

if TYPE_CHECKING:
    from fte_sniff.recording.passages import Span

_HELP = (
    "as 2026-01-31T12:00:05Z, 12:00:05, 20:00:05+08:00, +10s (from the first row) "
    "or -10s (before the last)"
)

Times = tuple[int, int] | None


def span_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options `--from` and `--to`, as every command that reads recordings has them."""
    first = click.option(
        "--from", "since", metavar="TIME", help=f"Only rows from then on: {_HELP}. See --zone."
    )
    end = click.option(
        "--to",
        "until",
        metavar="TIME",
        help="Only rows before then; as --from. A time of day is the first one behind --from.",
    )
    return first(end(command))


def span_of(
    since: str | None, until: str | None, times: Iterable[Times], zone: tzinfo | None = None
) -> Span | None:
    """The span that is asked for; None where none is.

    Args:
        since: the text of `--from`, if given.
        until: the text of `--to`, if given.
        times: first and last time of each input, nanoseconds since 1970 UTC; asked for only where
            a text is relative to them, as a log has to be read for them.
        zone: the zone of times that name none; None for UTC.

    Raises:
        InputTextError: a text is no time.
        UsageError: a time is relative and the inputs tell no times, or the span is empty.
    """
    if since is None and until is None:
        return None
    from fte_sniff.recording.passages import Span

    zone = zone or UTC
    bounds = cache(lambda: _bounds(times))
    span = Span()
    first = span.first_ns if since is None else _time(since, "--from", bounds, zone)
    if first > span.end_ns:
        raise InputTextError(
            f"--from: {quoted(since or '')} is after {iso_time(span.end_ns)}, and so after any row"
        )
    end = span.end_ns
    if until is not None:
        end = _end(until, None if since is None else first, bounds, zone)
    if since is not None and until is not None and first >= end:
        raise UsageError(
            f"--from {shortened(since)} is not before --to {shortened(until)};"
            f" nothing lies between them{_hint(since, until)}"
        )
    return Span(first, min(end, span.end_ns))


def _hint(since: str, until: str) -> str:
    if clock_time(since) is None and clock_time(until) is None:
        return ""
    return " (a time of day is one of the first row's day; write another day as 2026-01-31T12:00)"


def _bounds(times: Iterable[Times]) -> Times:
    known = [found for found in times if found is not None]
    return (min(first for first, _ in known), max(last for _, last in known)) if known else None


def _time(text: str, option: str, bounds: Callable[[], Times], zone: tzinfo) -> int:
    wanted = text.strip()
    if wanted[:1] in ("+", "-"):
        first, last = _known(bounds(), option, text)
        length = _length(wanted[1:], option)
        return first + length if wanted[0] == "+" else last - length
    if (clock := clock_time(wanted)) is not None:
        first, _ = _known(bounds(), option, text)
        return clock.on_day_of(first, zone)
    return _absolute(wanted, option, zone)


def _end(text: str, since_ns: int | None, bounds: Callable[[], Times], zone: tzinfo) -> int:
    """The time of `--to`: one of day is the first behind the beginning, if rows reach its day."""
    clock = clock_time(text)
    if clock is None:
        return _time(text, "--to", bounds, zone)
    first, last = _known(bounds(), "--to", text)
    begin = first if since_ns is None else since_ns
    end = clock.on_day_of(begin, zone)
    midnight = ClockTime(time(tzinfo=clock.of_day.tzinfo)).on_day_after(begin, zone)
    return clock.on_day_after(begin, zone) if end <= begin and midnight <= last else end


def _known(bounds: Times, option: str, text: str) -> tuple[int, int]:
    if bounds is None:
        raise UsageError(
            f"{option} {shortened(text)}: the input tells no times;"
            " give a recording or a dated log, with rows"
        )
    return bounds


def _length(text: str, option: str) -> int:
    length = length_ns(text)
    if length is None:
        raise InputTextError(
            f"{option}: {quoted(text)} is no length of time; write 10s, 1m30s or 250ms"
        )
    return length


def _absolute(text: str, option: str, zone: tzinfo) -> int:
    t_ns = time_ns(text, zone)
    if t_ns is None:
        raise InputTextError(f"{option}: {quoted(text)} is no time; write it {_HELP}")
    if t_ns < 0:
        raise InputTextError(
            f"{option}: {quoted(text)} is before {iso_time(0)}, and so before any row"
        )
    return t_ns
