"""`fte-sniff stats`: statistics over files, as text or as one JSON object."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from datetime import tzinfo
from typing import TYPE_CHECKING, Final, TypeAlias

import click
from rich.text import Text

from fte_sniff.analysis.table import MOTOR, QUANTITIES
from fte_sniff.cli.input_files import InputQuery, gap_text, input_options
from fte_sniff.cli.measuring import (
    HEAD_STYLE,
    finish,
    measure,
    print_json,
    print_lines,
    table_lines,
    text_or_json_option,
)
from fte_sniff.cli.options import grouped_command
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import UNKNOWN, fit, rate_text, share_text, span_text
from fte_sniff.formats.looks import LOOKS
from fte_sniff.protocol.columns import iso_time, iso_time_ns
from fte_sniff.protocol.spec import Status
from fte_sniff.session.stats_json import Json, statistics_json

if TYPE_CHECKING:
    from fte_sniff.session.inputs import InputReading


@grouped_command(
    name="stats", short_help="Statistics over files: rates, faults, silences, answers."
)
@input_options(many=True)
@text_or_json_option
def command(query: InputQuery, form: str) -> None:
    """Print statistics over recordings, raw bytes or hex text, all files together.

    Duration, rows and bytes, use and silences of each line; faults by kind; rate, period, jitter
    and values of each kind of frame by motor; answer times and flags seen. With --filter, only
    matching rows are counted.

    \b
    fte-sniff stats samples/damaged.mcap
    fte-sniff stats logs/ --from -10m
    fte-sniff stats samples/clean.mcap --format json
    """
    from fte_sniff.analysis import findings, statistics
    from fte_sniff.session.measured import STATISTICS_AND_FINDINGS

    # A filter hides rows whose absence would be a finding.
    with_findings = form == "table" and query.filter_text is None
    analysis = STATISTICS_AND_FINDINGS if with_findings else statistics.ANALYSIS
    counts, reading = measure(query, analysis)
    numbers = statistics_json(counts, reading, query.filter_text, query.baud)
    if form == "json":
        print_json(numbers)
    else:
        print_lines(report_lines(numbers, reading))
        if with_findings and (found := findings.find(counts).found):
            files = shlex.join(map(str, query.files))
            click.echo(f"\nfindings   {len(found)}; see: fte-sniff findings {files}")
    finish(reading)


_LABEL: Final = 10

When: TypeAlias = Callable[[str | None], str]
"""The time of day of a time of the JSON object; a dash for None."""

Columns: TypeAlias = Sequence[tuple[str, Callable[[Json, When], str]]]
"""Heads, and the text of their cells for an object."""


def report_lines(numbers: Json, reading: InputReading) -> Iterator[Text]:
    """The lines of the report about the object of docs/stats.md."""
    when, ports = _clock(numbers, reading.zone), numbers["ports"]
    yield from _whole(numbers, reading)
    if len(numbers["files"]) > 1:
        yield from _table(_FILES, numbers["files"], when)
    for port in ports:
        yield Text()
        yield from _port(port, when)
        if len(ports) > 1:
            yield _line("  status", _statuses(port["status"], port["rows"]))
        styles = [LOOKS[Status(one["status"])].style for one in port["faults"]]
        yield from _table(_FAULTS, port["faults"], when, styles)
        streams, has_times = port["streams"], port["first_time"] is not None
        yield from _table(_PERIODS, streams if has_times else [], when)
        for is_motor in (True, False):
            own = [one for one in streams if (one[MOTOR] is not None) is is_motor]
            own = [one for one in own if one["values"] or not has_times]
            yield from _table(_values(own), own, when)
    if any(one["commands"] or one["feedback"] for one in numbers["motors"]):
        bad = [one["error_bits"] or one["offline"]["frames"] for one in numbers["motors"]]
        styles = [LOOKS[Status.MALFORMED].style if one else "" for one in bad]
        yield from _table(_MOTORS, numbers["motors"], when, styles)
        yield from _motor_notes(numbers)


def _table(
    columns: Columns, objects: Sequence[Json], when: When, styles: Sequence[str] = ()
) -> Iterator[Text]:
    """An empty line and a table of objects, if there are any."""
    if objects:
        rows = [[text(one, when) for _, text in columns] for one in objects]
        yield Text()
        yield from table_lines([head for head, _ in columns], rows, styles)


def _in_zone(time: str, zone: tzinfo) -> str:
    return iso_time(iso_time_ns(time) or 0, zone)


def _clock(numbers: Json, zone: tzinfo) -> When:
    """Times of day in a zone, with the day before them where there is more than one."""
    ends = filter(None, map(numbers.get, _ENDS))
    days = {_in_zone(time, zone)[: len("2026-01-31")] for time in ends}
    shown = slice(len("2026-" if len(days) > 1 else "2026-01-31T"), len("2026-01-31T12:00:00.000"))

    def text(time: str | None) -> str:
        return UNKNOWN if time is None else _in_zone(time, zone)[shown].replace("T", " ")

    return text


def _whole(numbers: Json, reading: InputReading) -> Iterator[Text]:
    files, rows, zone = numbers["files"], numbers["rows"], reading.zone
    yield _line("files", printable(files[0]["name"]) if len(files) == 1 else f"{len(files):,}")
    if numbers["filter"] is not None:
        of_them = f"holds for {rows:,} of {numbers['rows_read']:,} rows"
        yield _line("filter", f"{printable(numbers['filter'])}  {of_them}")
    yield _line("rows", f"{rows:,}, {numbers['bytes']:,} bytes")
    for selection in numbers["selections"]:
        chosen = f"only those of {selection['rows_read']:,} rows for which this held: "
        yield _line("selection", f"{chosen}{printable(selection['filter'])}")
    for reason in dict.fromkeys(gap.reason for gap in reading.reported_gaps):
        own = [gap for gap in reading.reported_gaps if gap.reason == reason]
        yield _line("left out", f"{gap_text(own)}: {printable(reason)}")
    if numbers["first_time"] is not None:
        yield _line("first", _in_zone(numbers["first_time"], zone))
        span = f"{numbers['duration_s']:,.3f} s after the first"
        yield _line("last", f"{_in_zone(numbers['last_time'], zone)}, {span}")
    elif rows:
        yield _line("time", "these rows have no times: no rates, no silences")
    if rows:
        yield _line("status", _statuses(numbers["status"], rows))


def _statuses(counts: Json, rows: int) -> Text:
    """`ok 1,180 (98.3 %), ? suspect 3 (0.3 %), ! malformed 17 (1.4 %)`."""
    parts = []
    for status, look in LOOKS.items():
        if not (count := counts[status]["rows"]):
            parts.append(Text(f"{status} 0"))
            continue
        text = f"{look.mark} {status} {count:,} ({share_text(count / rows)})"
        parts.append(Text(text.strip(), look.style))
    return Text(", ").join(parts)


def _span(seconds: float | None) -> str:
    return span_text(None if seconds is None else seconds * 1e9)


def _port(port: Json, when: When) -> Iterator[Text]:
    yield _line("port", Text(printable(port["port"]), "bold"))
    rate = "" if port["rows_per_s"] is None else f", {rate_text(port['rows_per_s'])}"
    yield _line("  rows", f"{port['rows']:,}{rate}, {port['bytes']:,} bytes")
    frames = ", ".join(f"{count:,} {direction}" for direction, count in port["frames"].items())
    yield _line("  frames", frames)
    if (share := port["line_use"]) is not None:
        use = f"{share_text(share)} of the time used, at {port['baud']:,} baud"
        yield _line("  line", use)
        yield _line("  silence", _silence(port["silences"], when))
    for number, event in enumerate(port["events"]):
        yield _line("" if number else "  events", _event(event, when))


def _silence(silences: Json, when: When) -> str:
    if silences["longest_s"] is None:
        return "never"
    half, most = _span(silences["p50_s"]), _span(silences["p99_s"])
    until = when(silences["longest_until"])
    return f"longest {_span(silences['longest_s'])} until {until}; 50 % {half}, 99 % {most}"


def _event(event: Json, when: When) -> str:
    """`line error 3 (12 in all), 12:00:01.000 to 12:00:09.000`."""
    words = f"{event['event'].replace('_', ' ')} {event['count']:,}"
    if event["total"] is not None:
        words += f" ({event['total']:,} in all)"
    return f"{words}, {' to '.join(dict.fromkeys(when(event[at]) for at in _ENDS))}"


_ENDS: Final = ("first_time", "last_time")


def _count(name: str) -> tuple[str, Callable[[Json, When], str]]:
    """The column of a count."""
    return name, lambda one, _: UNKNOWN if one[name] is None else f"{one[name]:,}"


_FILES: Final[Columns] = (
    ("file", lambda one, _: printable(one["name"])),
    *map(_count, ("rows", "bytes")),
    ("first row", lambda one, when: when(one["first_time"])),
)
_FAULTS: Final[Columns] = (
    ("  fault", lambda one, _: f"{LOOKS[Status(one['status'])].mark} {one['fault']}"),
    _count("rows"),
    ("of all", lambda one, _: share_text(one["rows_share"])),
    _count("bytes"),
    ("of all", lambda one, _: share_text(one["bytes_share"])),
    ("first", lambda one, when: when(one["first_time"])),
    ("last", lambda one, when: when(one["last_time"])),
)
_STREAM: Final[Columns] = (
    ("  kind and motor", lambda one, _: f"  {one['kind']} {one[MOTOR] or ''}".rstrip()),
    _count("frames"),
)
_PERIODS: Final[Columns] = (
    *_STREAM,
    ("rate", lambda one, _: rate_text(one["frames_per_s"])),
    ("period", lambda one, _: _span(one["period"]["p50_s"])),
    ("jitter", lambda one, _: _span(one["jitter_s"])),
    ("longest", lambda one, _: _span(one["period"]["longest_s"])),
    ("until", lambda one, when: when(one["period"]["longest_until"])),
    ("99 %", lambda one, _: _span(one["period"]["p99_s"])),
)
_MOTORS: Final[Columns] = (
    (MOTOR, lambda one, _: str(one[MOTOR])),
    *map(_count, ("commands", "feedback", "answered", "unanswered")),
    ("unknown", _count("neither")[1]),
    ("delay", lambda one, _: _span(one["delay"]["p50_s"])),
    ("99 %", lambda one, _: _span(one["delay"]["p99_s"])),
    ("longest", lambda one, _: _span(one["delay"]["longest_s"])),
    ("ERROR bits", lambda one, _: " ".join(str(bit["bit"]) for bit in one["error_bits"]) or "–"),
    ("offline", lambda one, _: f"{one['offline']['frames']:,}"),
)


def _values(streams: Sequence[Json]) -> Columns:
    """The columns of the range of each quantity; a name ends in its unit, or is it."""

    def text(name: str) -> Callable[[Json, When], str]:
        ends = "{least} .. {greatest}"
        return lambda one, _: ends.format_map(one["values"][name]) if name in one["values"] else "–"

    names = [name for name in QUANTITIES if any(name in one["values"] for one in streams)]
    return (*_STREAM, *((name, text(name)) for name in names))


def _motor_notes(numbers: Json) -> Iterator[Text]:
    """Notes below the table of motors."""
    motors = numbers["motors"]
    if numbers["selections"]:
        yield Text("answers are not known: the recording has only selected rows")
    elif motors[0]["neither"] is None:
        yield Text("the inputs overlap in time: answers cannot be matched to commands")
    elif any(one["neither"] for one in motors):
        yield Text("unknown: resets; commands before the first feedback, or open where rows end")
    if any(one["offline"]["frames"] for one in motors):
        yield Text("offline: frames in which the bit of ONLINE that is taken as the motor's is 0")


def _line(label: str, text: str | Text) -> Text:
    return Text.assemble((fit(label, _LABEL), HEAD_STYLE), " ", text)
