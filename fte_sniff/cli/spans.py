"""Owns `--from` and `--to`: from what a user writes to a span of time.

It must not know how rows are read.

    2026-01-31T12:00:05.25Z      a time, as `analysis.moments` reads it
    12:00:05                     a time of day (UTC) on the day of the first row
    +10s  +1m30s  +250ms         so long behind the first row
    -10s                         so long before the last row
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.analysis.moments import DAY_NS, clock_ns, length_ns, time_ns
from fte_sniff.errors import InputTextError, UsageError
from fte_sniff.protocol import iso_time

if TYPE_CHECKING:
    from fte_sniff.recording.span import Span

_HELP = "as 2026-01-31T12:00:05Z, 12:00:05, +10s (from the first row) or -10s (before the last)"

Times = tuple[int, int] | None


def span_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options `--from` and `--to`, as every command that reads recordings has them."""
    first = click.option(
        "--from", "since", metavar="TIME", help=f"Only rows from then on: {_HELP}."
    )
    end = click.option("--to", "until", metavar="TIME", help="Only rows before then; as --from.")
    return first(end(command))


def span_of(since: str | None, until: str | None, times: Iterable[Times]) -> Span | None:
    """The span that is asked for; None where none is.

    Args:
        since: the text of `--from`, if given.
        until: the text of `--to`, if given.
        times: first and last time of each input, nanoseconds since 1970 UTC; asked for only where
            a text is relative to them, as a log has to be read for them.

    Raises:
        InputTextError: a text is no time.
        UsageError: a time is relative and the inputs tell no times, or the span is empty.
    """
    if since is None and until is None:
        return None
    from fte_sniff.recording.span import Span

    bounds = cache(lambda: _bounds(times))
    span = Span()
    first = span.first_ns if since is None else _time(since, "--from", bounds)
    end = span.end_ns if until is None else _time(until, "--to", bounds)
    if first >= end:
        raise UsageError(f"--from {since} is not before --to {until}; nothing lies between them")
    return Span(first, end)


def _bounds(times: Iterable[Times]) -> Times:
    known = [found for found in times if found is not None]
    return (min(first for first, _ in known), max(last for _, last in known)) if known else None


def _time(text: str, option: str, bounds: Callable[[], Times]) -> int:
    wanted = text.strip()
    if wanted[:1] in ("+", "-"):
        first, last = _known(bounds(), option, text)
        length = _length(wanted[1:], option)
        return first + length if wanted[0] == "+" else last - length
    if (clock := clock_ns(wanted)) is not None:
        first, _ = _known(bounds(), option, text)
        return first - first % DAY_NS + clock
    return _absolute(wanted, option)


def _known(bounds: Times, option: str, text: str) -> tuple[int, int]:
    if bounds is None:
        raise UsageError(
            f"{option} {text}: the input tells no times; give a recording or a dated log, with rows"
        )
    return bounds


def _length(text: str, option: str) -> int:
    length = length_ns(text)
    if length is None:
        raise InputTextError(f"{option}: {text!r} is no length of time; write 10s, 1m30s or 250ms")
    return length


def _absolute(text: str, option: str) -> int:
    t_ns = time_ns(text)
    if t_ns is None:
        raise InputTextError(f"{option}: {text!r} is no time; write it {_HELP}")
    if t_ns < 0:
        raise InputTextError(f"{option}: {text!r} is before {iso_time(0)}, and so before any row")
    return t_ns
