"""Click options and parameter types that several commands share.

`--from` and `--to` take these forms; a time without a zone is in the zone of `--zone` (UTC):

    2026-01-31T12:00:05.25Z      a date and time, see `analysis.time_text`
    12:00:05  20:00:05+08:00     a time of day on the date of the first row; for `--to` the first
                                 after `--from`, possibly on the next day
    +10s  +1m30s  +250ms         this long after the first row
    -10s                         this long before the last row
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, time, tzinfo
from decimal import Decimal
from functools import cache, reduce
from math import isfinite, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.analysis.time_text import SECOND_NS, ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.cli.completion import complete_filter
from fte_sniff.errors import InputTextError, UsageError, printable, quoted, reason_of, shortened
from fte_sniff.platform import POSIX
from fte_sniff.protocol import DEFAULT_BAUD, iso_time

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter
    from fte_sniff.analysis.statistics import LineSetup
    from fte_sniff.cli.settings import Settings
    from fte_sniff.recording.reading_pass import TimeRange


_HELP = (
    "as 2026-01-31T12:00:05Z, 12:00:05, 20:00:05+08:00, +10s (from the first row) "
    "or -10s (before the last)"
)

Times = tuple[int, int | None] | None


Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def all_of(*options: Decorator) -> Decorator:
    """A decorator that gives a command these options, in this order."""
    return lambda command: reduce(lambda made, option: option(made), reversed(options), command)


span_options = all_of(
    click.option(
        "--from", "since", metavar="TIME", help=f"Only rows from this time on: {_HELP}. See --zone."
    ),
    click.option(
        "--to",
        "until",
        metavar="TIME",
        help="Only rows before this time; as --from. A time of day is the first one after --from.",
    ),
)


def time_range(
    since: str | None, until: str | None, times: Iterable[Times], zone: tzinfo | None = None
) -> TimeRange | None:
    """The time range of `--from` and `--to`; None without either.

    Args:
        since: the text of `--from`, if given.
        until: the text of `--to`, if given.
        times: first and last time of each input, nanoseconds since 1970 UTC; the last is None if it
            is not known before reading. Read only for relative times, because a log must be read
            completely for them.
        zone: the zone of times that name none; None for UTC.

    Raises:
        InputTextError: a text is not a time.
        UsageError: a time is relative and the inputs have no times, or the range is empty.
    """
    if since is None and until is None:
        return None
    from fte_sniff.recording.reading_pass import TimeRange

    zone = zone or UTC
    bounds = cache(lambda: _bounds(times))
    span = TimeRange()
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
            f" no row is between them{_hint(since, until)}"
        )
    return TimeRange(first, min(end, span.end_ns))


def _hint(since: str, until: str) -> str:
    if clock_time(since) is None and clock_time(until) is None:
        return ""
    return " (a time of day is one of the first row's day; write another day as 2026-01-31T12:00)"


def _bounds(times: Iterable[Times]) -> Times:
    known = [found for found in times if found is not None]
    if not known:
        return None
    ends = [last for _, last in known if last is not None]
    return min(first for first, _ in known), max(ends) if len(ends) == len(known) else None


def _time(text: str, option: str, bounds: Callable[[], Times], zone: tzinfo) -> int:
    wanted = text.strip()
    if wanted[:1] in ("+", "-"):
        first, last = _known(bounds(), option, text)
        length = _length(wanted[1:], option)
        if wanted[0] == "+":
            return first + length
        if last is None:
            raise UsageError(
                f"{option} {shortened(text)}: the last time of the input is not known before it is"
                " read; write the time in full, or from the first row, as +10s"
            )
        return last - length
    if (clock := clock_time(wanted)) is not None:
        first, _ = _known(bounds(), option, text)
        return clock.on_day_of(first, zone)
    return _absolute(wanted, option, zone)


def _end(text: str, since_ns: int | None, bounds: Callable[[], Times], zone: tzinfo) -> int:
    """The time of `--to`; a time of day is the first after the start, if rows reach that date."""
    clock = clock_time(text)
    if clock is None:
        return _time(text, "--to", bounds, zone)
    first, last = _known(bounds(), "--to", text)
    begin = first if since_ns is None else since_ns
    end = clock.on_day_of(begin, zone)
    midnight = ClockTime(time(tzinfo=clock.of_day.tzinfo)).on_day_after(begin, zone)
    return (
        clock.on_day_after(begin, zone)
        if end <= begin and (last is None or midnight <= last)
        else end
    )


def _known(bounds: Times, option: str, text: str) -> tuple[int, int | None]:
    if bounds is None:
        raise UsageError(
            f"{option} {shortened(text)}: the input has no times; set with --start when its bytes"
            " began, or give a recording or a dated log, with rows"
        )
    return bounds


def _length(text: str, option: str) -> int:
    length = duration_ns(text)
    if length is None:
        raise InputTextError(
            f"{option}: {quoted(text)} is not a duration; write 10s, 1m30s or 250ms"
        )
    return length


def _absolute(text: str, option: str, zone: tzinfo) -> int:
    t_ns = time_ns(text, zone)
    if t_ns is None:
        raise InputTextError(f"{option}: {quoted(text)} is not a time; write it {_HELP}")
    if t_ns < 0:
        raise InputTextError(
            f"{option}: {quoted(text)} is before {iso_time(0)}, and so before any row"
        )
    return t_ns


def _explain(context: click.Context, _option: click.Parameter, text: str | None) -> str | None:
    if text is None or text.strip().lower() != "help" or context.resilient_parsing:
        return text
    from fte_sniff.analysis.filter.terms import FILTER_HELP

    click.echo(FILTER_HELP)
    return context.exit()


filter_option = click.option(
    "--filter",
    "filter_text",
    metavar="EXPR",
    is_eager=True,
    callback=_explain,
    shell_complete=complete_filter,
    help="Only rows that match: motor = 1 AND rpm > 500. '--filter help' explains the language.",
)


alert_option = click.option(
    "--alert",
    "alert_text",
    metavar="EXPR",
    shell_complete=complete_filter,
    help="Ring the bell, at most once per second, when rows match: error != 0.",
)
"""The `--alert` option; its value goes to `alert_of`."""


DEFAULT_ADDRESS: Final = "127.0.0.1:8765"
"""Where viewers look if the user names no other."""


def _host_and_port(text: str, option: str) -> tuple[str, int]:
    """Host and port of `HOST:PORT` or `PORT`; raises UsageError for other texts."""
    name, colon, number = text.rpartition(":")
    is_number = number.isdecimal() and number.isascii() and int(number) < 1 << 16
    if is_number and (colon or number == text):
        return name, int(number)
    example = "--udp 127.0.0.1:9870"
    if option == "--serve":
        example = f"--serve {DEFAULT_ADDRESS}, or --serve alone at the end"
    raise UsageError(f"{option} {printable(text)} is not HOST:PORT or PORT; write {example}")


def _checked(context: click.Context, _option: click.Parameter, text: str | None) -> str | None:
    """Refuse a port or file behind `--serve`, which click takes as its value."""
    if text is not None and not context.resilient_parsing:
        _host_and_port(text, "--serve")
    return text


serve_option = click.option(
    "--serve",
    is_flag=False,
    callback=_checked,
    flag_value=DEFAULT_ADDRESS,
    metavar="[[HOST:]PORT]",
    help=f"Serve the rows to viewers over WebSocket, by default at {DEFAULT_ADDRESS}.",
)
"""The `--serve` option."""


def network_option(allowed: str) -> Decorator:
    """The `--network` option, which allows these options to use a network."""
    return click.option(
        "--network",
        is_flag=True,
        help=f"Allow {allowed} to use a network: anyone there can read.",
    )


def address_of(text: str, option: str, *, network: bool) -> tuple[str, int]:
    """The address of `HOST:PORT` or `PORT`; without a host this machine, IPv6 in brackets.

    Raises UsageError if it is not valid, or is another machine and `network` is false.
    """
    import ipaddress
    import socket

    name, number = _host_and_port(text, option)
    shown = f"{option} {printable(text)}"
    try:
        found = socket.getaddrinfo(name.strip("[]") or "127.0.0.1", number)
    except (OSError, UnicodeError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else "it is not a name"
        raise UsageError(f"{shown}: the host is not known ({reason})") from None
    host = str(found[0][4][0])
    if not network and not ipaddress.ip_address(host.partition("%")[0]).is_loopback:
        raise UsageError(
            f"{shown} is not this machine: anyone in that network could read; add --network if they"
            " may"
        )
    return host, number


def row_filter(text: str | None, zone: tzinfo | None = None) -> RowFilter | None:
    """The filter of `--filter`, if it was given; raises FilterError if it is invalid.

    `zone` is that of times that name none; None for UTC.
    """
    if text is None:
        return None
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(text, zone)


def alert_of(text: str | None, zone: tzinfo | None = None) -> Alert | None:
    """The alert of `--alert`, if it was given; raises FilterError as `row_filter`."""
    wanted = row_filter(text, zone)
    if wanted is None:
        return None
    from fte_sniff.analysis.filter.row_filter import Alert

    return Alert(wanted)


DROPPED_ROWS = "Rows that the screen keeps; older rows leave the screen, never the file."
REREAD_ROWS = (
    "Rows that the screen keeps in memory; older rows of recordings are read again when "
    "needed, older rows of raw bytes and hex text leave the screen."
)


def keep_rows_option(default: int, meaning: str = DROPPED_ROWS) -> Decorator:
    """The `--keep-rows` option; a row takes about 60 bytes of memory."""
    return click.option(
        "--keep-rows",
        type=click.IntRange(min=1),
        default=default,
        show_default=True,
        metavar="N",
        help=meaning,
    )


def output_options(help_text: str, *, required: bool = False) -> Decorator:
    """The options `--output` and `--force`."""
    return all_of(
        click.option("-o", "--output", type=FileName(), required=required, help=help_text),
        click.option("--force", is_flag=True, help="Overwrite the output file if it exists."),
    )


def require_pseudo_terminals(command: str, instead: str) -> None:
    """Raise UsageError, with another way, on a system without pseudo-terminals."""
    if not POSIX:
        raise UsageError(
            f"{command} needs pseudo-terminals, which Windows does not have: use it in WSL; "
            f"{instead}"
        )


_PORT_NAME = re.compile(
    r"/dev/(tty.+|pts/[0-9]+|cu\..+|serial/.+)|COM[0-9]+|[a-z0-9]+://.*", re.IGNORECASE
)


def is_port_name(name: str) -> bool:
    """Whether a name is that of a serial device, a terminal, or a URL of a port."""
    if name == "/dev/stdin" or name.startswith("/dev/fd/"):
        return False
    return any(_PORT_NAME.fullmatch(one) for one in (name, os.path.realpath(name)))


class FileName(click.Path):
    """A file name, existing or not; not empty, because an empty path is the current folder."""

    def __init__(self) -> None:
        # Not readable: a file that cannot be read has an error of its own.
        super().__init__(path_type=Path, readable=False)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; fails for an empty name and a URL."""
        if not str(value):
            self.fail("the name is empty.", param, ctx)
        if "://" in str(value):
            self.fail(f"{value} is a port, not a file; `fte-sniff live` captures it.", param, ctx)
        return super().convert(value, param, ctx)


DURATION_EXAMPLE: Final = "a time; use for example 100ms, 10s, 5min or 1h"
"""The end of the error for a text that is not a duration."""


def parse_seconds(text: str) -> float | None:
    """Seconds of `100ms`, `10s`, `5min`, `1h` or `2d`; infinity if they are too many for a float.

    None for other texts.
    """
    found = duration_ns(text)
    return None if found is None else float(Decimal(found) / SECOND_NS)


class Seconds(click.FloatRange):
    """A duration: seconds, or a number with a unit; infinity is allowed, NaN is not."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The seconds; fails for other texts and out of range."""
        parsed = parse_seconds(value) if isinstance(value, str) else None
        try:
            seconds = float(value if parsed is None else parsed)
        except ValueError:
            self.fail(f"{value!r} is not {DURATION_EXAMPLE}.", param, ctx)
        seconds = float(super().convert(seconds, param, ctx))
        if isnan(seconds):
            self.fail(f"{value!r} is not a number of seconds.", param, ctx)
        return seconds


class _Positive(click.FloatRange):
    """A finite number above 0."""

    name = "number"

    def __init__(self) -> None:
        super().__init__(min=0, min_open=True)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value!r} is not a number above 0.", param, ctx)
        return number


units_options = all_of(
    click.option(
        "--resolution",
        type=_Positive(),
        metavar="N",
        help="Pulses in one turn of a motor: shows positions in turns too.",
    ),
    click.option(
        "--gear-ratio",
        type=_Positive(),
        metavar="N",
        help="Turns of a motor in one turn of its output; 1 by default.",
    ),
)
"""The options `--resolution` and `--gear-ratio`, which show positions in turns too."""

line_speed_option = click.option(
    "-b",
    "--baud",
    type=click.IntRange(min=1),
    help=f"Bits/s of every line; overrides the recording's.  [default: {DEFAULT_BAUD}]",
)
"""The `--baud` option of commands that read files; it overrides the baud of a recording, and gives
bytes without times a clock."""


def line_setup(
    settings: Settings,
    ports: Sequence[str],
    resolution: float | None,
    gear_ratio: float | None,
    baud: int = DEFAULT_BAUD,
) -> LineSetup:
    """The line setup from the options, with the settings of the ports as defaults.

    Raises UsageError if the settings of the ports differ, or a gear ratio has no resolution.
    """
    if resolution is None:
        resolution = settings.default(ports, "resolution")
    if resolution is not None and gear_ratio is None:
        gear_ratio = settings.default(ports, "gear-ratio")
    if resolution is None and gear_ratio is not None:
        raise UsageError("--gear-ratio makes turns of pulses only together with --resolution")
    from fte_sniff.analysis.statistics import LineSetup

    return LineSetup(baud, resolution, 1.0 if gear_ratio is None else gear_ratio)
