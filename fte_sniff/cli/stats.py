"""`fte-sniff stats`: statistics over files, as text that fits a width, or as one JSON object."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from datetime import tzinfo
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

import click
from rich.text import Text

from fte_sniff.cli.input_files import InputQuery, check_inputs, gap_text, input_options
from fte_sniff.cli.measuring import (
    HEAD_STYLE,
    ManyFiles,
    TextTable,
    many_files_options,
    measure,
    print_json,
    print_lines,
    text_or_json_option,
)
from fte_sniff.cli.options import grouped_command
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import (
    UNKNOWN,
    fit,
    rate_text,
    share_text,
    span_text,
)
from fte_sniff.formats.looks import LOOKS
from fte_sniff.protocol import VALUE_FIELDS, Status, iso_time
from fte_sniff.protocol.columns import iso_time_ns
from fte_sniff.protocol.spec import online_bit_text
from fte_sniff.session.stats_json import MOTOR, Json, statistics_json

if TYPE_CHECKING:
    from fte_sniff.session.inputs import InputReading


@grouped_command(
    name="stats", short_help="Statistics over files: rates, faults, silences, answers."
)
@input_options
@text_or_json_option
@many_files_options
def command(
    query: InputQuery, form: str, pair: bool, jobs: int | None, cluster: str | None
) -> None:
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

    check_inputs(query.files)
    # A filter hides rows whose absence would be a finding.
    with_findings = form == "table" and query.filter_text is None
    analysis = STATISTICS_AND_FINDINGS if with_findings else statistics.ANALYSIS
    counts, measured = measure(query, analysis, ManyFiles(pair, jobs, cluster))
    numbers = statistics_json(counts, measured.reading, query.filter_text, query.baud)
    if form == "json":
        print_json(numbers)
    else:
        print_lines(partial(report_lines, numbers, measured.reading))
        if with_findings and (found := findings.find(counts).found):
            files = shlex.join(map(str, query.files))
            click.echo(f"\nfindings   {len(found)}; see: fte-sniff findings {files}")
    measured.finish(counted=numbers["rows"], filter_text=query.filter_text)


_LABEL: Final = 10
STREAM: Final = "kind and motor"
_QUANTITIES: Final = tuple(field.name for field in VALUE_FIELDS if field.unit)
_MARKED: Final = "  "
_WORRY: Final = LOOKS[Status.MALFORMED]

When: TypeAlias = Callable[[str | None], str]
"""The time of day of a time of the JSON object; a dash for None."""


def report_lines(numbers: Json, reading: InputReading, width: int | None) -> Iterator[Text]:
    """The lines of the report about the object of docs/stats.md.

    Tables take at most `width` cells, None for no limit.
    """
    zone = reading.source.zone
    when = _clock(numbers, zone)
    yield from _whole(numbers, reading)
    if len(numbers["files"]) > 1:
        yield Text()
        yield from _files(numbers, zone).lines(width)
    for port in numbers["ports"]:
        yield Text()
        yield from _port(port, when)
        if len(numbers["ports"]) > 1:
            yield _line("  status", _statuses(port["status"], port["rows"]))
        if port["faults"]:
            yield Text()
            yield from _faults(port["faults"], when).lines(width)
        if port["streams"]:
            yield Text()
            yield from _streams(port, when, width)
    if any(one["commands"] or one["feedback"] for one in numbers["motors"]):
        yield Text()
        yield from _motors(numbers).lines(width)
        yield from _motor_notes(numbers, when)


def _in_zone(time: str, zone: tzinfo) -> str:
    return iso_time(iso_time_ns(time) or 0, zone)


def _clock(numbers: Json, zone: tzinfo) -> When:
    """Times of day in a zone, with the day before them where there is more than one."""
    ends = (numbers["first_time"], numbers["last_time"])
    days = {_in_zone(time, zone)[: len("2026-01-31")] for time in ends if time is not None}
    shown = slice(len("2026-" if len(days) > 1 else "2026-01-31T"), len("2026-01-31T12:00:00.000"))

    def text(time: str | None) -> str:
        return UNKNOWN if time is None else _in_zone(time, zone)[shown].replace("T", " ")

    return text


def _whole(numbers: Json, reading: InputReading) -> Iterator[Text]:
    files, rows, zone = numbers["files"], numbers["rows"], reading.source.zone
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


def _files(numbers: Json, zone: tzinfo) -> TextTable:
    table = TextTable(["file", "rows", "bytes", "first row"])
    for one in numbers["files"]:
        first = one["first_time"]
        first = UNKNOWN if first is None else _in_zone(first, zone)[:23]
        table.append([printable(one["name"]), f"{one['rows']:,}", f"{one['bytes']:,}", first])
    return table


def _statuses(counts: Json, rows: int) -> Text:
    """`ok 1,180 (98.3 %), ? suspect 3 (0.3 %), ! malformed 17 (1.4 %)`."""
    parts = []
    for status in Status:
        count = counts[status]["rows"]
        mark = "" if status is Status.OK or not count else f"{LOOKS[status].mark} "
        style = LOOKS[status].style if count else "default"
        parts.append(Text(f"{mark}{status} {_share(count, rows)}", style))
    return Text(", ").join(parts)


def _share(count: int, whole: int) -> str:
    return f"{count:,} ({share_text(count / whole)})" if count else "0"


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


def _faults(faults: Sequence[Json], when: When) -> TextTable:
    table = TextTable(["fault", "rows", "of all", "bytes", "of all", "first", "last"])
    for one in faults:
        look = LOOKS[Status(one["status"])]
        cells = [
            *(one["fault"], f"{one['rows']:,}", share_text(one["rows_share"])),
            *(f"{one['bytes']:,}", share_text(one["bytes_share"])),
            *(when(one["first_time"]), when(one["last_time"])),
        ]
        table.append(cells, look.style, f"{look.mark} ")
    return table


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
    return f"{words}, {_from_to(event, when)}"


def _from_to(one: Json, when: When) -> str:
    """`12:00:01.000 to 12:00:09.000`; one time if both are the same."""
    first, last = one["first_time"], one["last_time"]
    return when(first) if first == last else f"{when(first)} to {when(last)}"


def _streams(port: Json, when: When, width: int | None) -> Iterator[Text]:
    """Tables of periods and values; motors and chassis have one each."""
    streams = port["streams"]
    if port["first_time"] is not None:
        yield from _periods(streams, when).lines(width)
        yield Text()
        streams = [stream for stream in streams if stream["values"]]
    of_motors = [stream for stream in streams if stream[MOTOR] is not None]
    of_all = [stream for stream in streams if stream[MOTOR] is None]
    for number, some in enumerate(filter(None, (of_motors, of_all))):
        yield from [Text()] if number else []
        yield from _values(some).lines(width)


def _periods(streams: Sequence[Json], when: When) -> TextTable:
    heads = ["frames", "rate", "period", "jitter", "longest", "until", "99 %"]
    table = TextTable([STREAM, *heads])
    for stream in streams:
        period = stream["period"]
        cells = [
            *(_stream_name(stream), f"{stream['frames']:,}", rate_text(stream["frames_per_s"])),
            *(_span(period["p50_s"]), _span(stream["jitter_s"])),
            *(_span(period["longest_s"]), when(period["longest_until"]), _span(period["p99_s"])),
        ]
        table.append(cells, mark=_MARKED)
    return table


def _values(streams: Sequence[Json]) -> TextTable:
    """The range of each quantity; a name ends in its unit, or is it."""
    names = [name for name in _QUANTITIES if any(name in one["values"] for one in streams)]
    table = TextTable([STREAM, "frames", *names])
    for stream in streams:
        ranges = (stream["values"].get(name) for name in names)
        cells = (
            UNKNOWN if ends is None else f"{ends['least']} .. {ends['greatest']}" for ends in ranges
        )
        table.append([_stream_name(stream), f"{stream['frames']:,}", *cells], mark=_MARKED)
    return table


def _stream_name(stream: Json) -> str:
    motor = stream[MOTOR]
    return str(stream["kind"]) if motor is None else f"{stream['kind']} {motor}"


def _motors(numbers: Json) -> TextTable:
    names = ["commands", "feedback", "answered", "unanswered", "neither"]
    table = TextTable([MOTOR, *names[:-1], "unknown", "delay", "99 %", "longest"])
    for one in numbers["motors"]:
        counts = (UNKNOWN if one[name] is None else f"{one[name]:,}" for name in names)
        spans = (_span(one["delay"][name]) for name in ("p50_s", "p99_s", "longest_s"))
        table.append([str(one[MOTOR]), *counts, *spans])
    return table


def _motor_notes(numbers: Json, when: When) -> Iterator[Text]:
    """Notes below the table of motors."""
    motors = numbers["motors"]
    if numbers["selections"]:
        yield Text("answers are not known: the recording has only selected rows")
    elif motors[0]["neither"] is None:
        yield Text("the inputs overlap in time: answers cannot be matched to commands")
    elif any(one["neither"] for one in motors):
        yield Text("unknown: resets; commands before the first feedback, or open where rows end")
    if not any(one["feedback"] for one in motors):
        return
    warnings = [text for one in motors for text in _flags(one, when)]
    yield from (Text(f"{_WORRY.mark} {words}", _WORRY.style) for words in warnings)
    if not warnings:
        yield Text("no ERROR bit was ever set, and every motor was always ONLINE")


def _flags(motor: Json, when: When) -> Iterator[str]:
    """A line for each flag that was raised."""
    for one in motor["error_bits"]:
        yield f"{MOTOR} {motor[MOTOR]}: ERROR bit {one['bit']} set in {_frames(one, when)}"
    if (offline := motor["offline"])["frames"]:
        text = f"{online_bit_text(motor[MOTOR])} was 0 in {_frames(offline, when)}"
        if (lost := offline["times_lost"]) is not None:
            text += f"; lost {'once' if lost == 1 else f'{lost:,} times'}"
        yield text


def _frames(seen: Json, when: When) -> str:
    """`12 frames, 12:00:01.000 to 12:00:09.000`."""
    frames = "1 frame" if seen["frames"] == 1 else f"{seen['frames']:,} frames"
    return frames if seen["first_time"] is None else f"{frames}, {_from_to(seen, when)}"


def _line(label: str, text: str | Text) -> Text:
    return Text.assemble((fit(label, _LABEL), HEAD_STYLE), " ", text)
