"""`fte-sniff stats`: statistics over files, as text that fits a width, or as one JSON object."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from datetime import tzinfo
from functools import partial
from typing import TYPE_CHECKING, Final

import click
from rich.text import Text

from fte_sniff.analysis.motors import FLAGS_IN_ORDER, TimeText, flag_texts, from_to
from fte_sniff.cli.input_files import InputQuery, check_inputs, gap_text, input_options
from fte_sniff.cli.measuring import (
    HEAD_STYLE,
    TextTable,
    measure,
    pair_option,
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
from fte_sniff.protocol import DEFAULT_BAUD, VALUE_FIELDS, Fault, Status, iso_time, status_of
from fte_sniff.protocol.columns import LOOKS
from fte_sniff.session.stats_json import COUNTED, MOTOR, statistics_json

if TYPE_CHECKING:
    from fte_sniff.analysis.model import RowCount
    from fte_sniff.analysis.motors import AnswerStats
    from fte_sniff.analysis.statistics import EventStats, PortStats, StatisticsSummary, StreamStats
    from fte_sniff.session.inputs import InputReading


@grouped_command(
    name="stats", short_help="Statistics over files: rates, faults, silences, answers."
)
@input_options
@text_or_json_option
@pair_option
def command(query: InputQuery, form: str, pair: bool) -> None:
    """Print statistics over recordings, raw bytes or hex text, all files together.

    Duration, rows and bytes, use and silences of each line; faults by kind; rate, period, jitter
    and values of each kind of frame by motor; answer times and flags seen. With --filter, only
    matching rows are counted.

    \b
    fte-sniff stats samples/damaged.mcap
    fte-sniff stats logs/ --from -10m
    fte-sniff stats samples/clean.mcap --format json
    """
    from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary

    check_inputs(query.files)
    # A filter hides rows whose absence would be a finding.
    with_findings = form == "table" and query.filter_text is None
    setup = LineSetup(query.baud or DEFAULT_BAUD)
    summary = StatisticsSummary(setup, with_findings=with_findings)
    measured = measure(query, summary, pair=pair)
    if form == "json":
        print_json(statistics_json(summary, measured.reading))
    else:
        print_lines(partial(report_lines, summary, measured.reading))
        if summary.findings is not None and (found := summary.findings.found()):
            files = shlex.join(map(str, query.files))
            click.echo(f"\nfindings   {len(found)}; see: fte-sniff findings {files}")
    measured.finish()


_LABEL: Final = 10
STREAM: Final = "kind and motor"
_QUANTITIES: Final = tuple(field.name for field in VALUE_FIELDS if field.unit)
_MARKED: Final = "  "
_WORRY: Final = LOOKS[Status.MALFORMED]


def report_lines(
    summary: StatisticsSummary, reading: InputReading, width: int | None
) -> Iterator[Text]:
    """The lines of the report; tables take at most `width` cells, None for no limit."""
    when = _clock(summary.total, reading.source.zone)
    yield from _whole(summary, reading)
    if len(summary.sources) > 1:
        yield Text()
        yield from _files(summary, reading.source.zone).lines(width)
    streams, ports = summary.statistics.streams(None), summary.statistics.ports()
    counts = summary.statistics.tally
    for port in ports:
        yield Text()
        yield from _port(port, when)
        if len(ports) > 1:
            yield _line("  status", _statuses(counts.by_status(port.port), port.rows))
        if faults := counts.by_fault(port.port):
            yield Text()
            yield from _faults(faults, port, when).lines(width)
        if own := [stream for stream in streams if stream.port == port.port]:
            yield Text()
            yield from _streams(own, port, when, width)
    if any(one.commands or one.feedback for one in summary.answers.stats()):
        yield Text()
        yield from _motors(summary).lines(width)
        yield from _motor_notes(summary, when)


def _clock(total: RowCount, zone: tzinfo) -> TimeText:
    """Times of day in a zone, with the day before them where there is more than one."""
    ends = (total.first_ns, total.last_ns)
    days = {iso_time(t_ns, zone)[: len("2026-01-31")] for t_ns in ends if t_ns is not None}
    shown = slice(len("2026-" if len(days) > 1 else "2026-01-31T"), len("2026-01-31T12:00:00.000"))

    def text(t_ns: int | None) -> str:
        return UNKNOWN if t_ns is None else iso_time(t_ns, zone)[shown].replace("T", " ")

    return text


def _whole(summary: StatisticsSummary, reading: InputReading) -> Iterator[Text]:
    total, sources, zone = summary.total, summary.sources, reading.source.zone
    yield _line("files", printable(sources[0].name) if len(sources) == 1 else f"{len(sources):,}")
    if reading.row_filter is not None:
        of_them = f"holds for {total.rows:,} of {reading.tally.rows:,} rows"
        yield _line("filter", f"{printable(reading.row_filter.text)}  {of_them}")
    yield _line("rows", f"{total.rows:,}, {total.bytes:,} bytes")
    for selection in reading.selections:
        chosen = f"only those of {selection.rows:,} rows for which this held: "
        yield _line("selection", f"{chosen}{printable(selection.filter_text)}")
    for reason in dict.fromkeys(gap.reason for gap in reading.reported_gaps):
        own = [gap for gap in reading.reported_gaps if gap.reason == reason]
        yield _line("left out", f"{gap_text(own)}: {printable(reason)}")
    if total.first_ns is not None and total.last_ns is not None:
        yield _line("first", iso_time(total.first_ns, zone))
        span = f"{(total.duration_ns or 0) / 1e9:,.3f} s after the first"
        yield _line("last", f"{iso_time(total.last_ns, zone)}, {span}")
    elif total.rows:
        yield _line("time", "these rows have no times: no rates, no silences")
    if total.rows:
        yield _line("status", _statuses(summary.statistics.tally.by_status(), total.rows))


def _files(summary: StatisticsSummary, zone: tzinfo) -> TextTable:
    table = TextTable(["file", "rows", "bytes", "first row"])
    for source in summary.sources:
        count = source.count
        first = UNKNOWN if count.first_ns is None else iso_time(count.first_ns, zone)[:23]
        table.append([printable(source.name), f"{count.rows:,}", f"{count.bytes:,}", first])
    return table


def _statuses(counts: Mapping[Status, RowCount], rows: int) -> Text:
    """`ok 1,180 (98.3 %), ? suspect 3 (0.3 %), ! malformed 17 (1.4 %)`."""
    parts = []
    for status, count in counts.items():
        mark = "" if status is Status.OK or not count.rows else f"{LOOKS[status].mark} "
        style = LOOKS[status].style if count.rows else "default"
        parts.append(Text(f"{mark}{status} {_share(count.rows, rows)}", style))
    return Text(", ").join(parts)


def _share(count: int, whole: int) -> str:
    return f"{count:,} ({share_text(count / whole)})" if count else "0"


def _port(port: PortStats, when: TimeText) -> Iterator[Text]:
    yield _line("port", Text(printable(port.port), "bold"))
    rate = "" if port.per_s is None else f", {rate_text(port.per_s)}"
    yield _line("  rows", f"{port.rows:,}{rate}, {port.bytes:,} bytes")
    frames = ", ".join(f"{count:,} {direction}" for direction, count in port.frames.items())
    yield _line("  frames", frames)
    if (share := port.share) is not None:
        use = f"{share_text(share)} of the time used, at {port.baud:,} baud"
        yield _line("  line", use)
        yield _line("  silence", _silence(port, when))
    for number, event in enumerate(port.events):
        yield _line("" if number else "  events", _event(event, when))


def _faults(faults: Mapping[Fault, RowCount], port: PortStats, when: TimeText) -> TextTable:
    table = TextTable(["fault", "rows", "of all", "bytes", "of all", "first", "last"])
    for fault, count in faults.items():
        status = status_of((fault,))
        cells = [
            *(str(fault), f"{count.rows:,}", share_text(count.rows / port.rows)),
            *(f"{count.bytes:,}", share_text(count.bytes / max(1, port.bytes))),
            *(when(count.first_ns), when(count.last_ns)),
        ]
        table.append(cells, LOOKS[status].style, f"{LOOKS[status].mark} ")
    return table


def _silence(port: PortStats, when: TimeText) -> str:
    silences = port.silences
    if silences.longest_ns is None:
        return "never"
    half, most = (span_text(silences.percentile_ns(percent)) for percent in (50, 99))
    until = when(silences.longest_at_ns)
    return f"longest {span_text(silences.longest_ns)} until {until}; 50 % {half}, 99 % {most}"


def _event(event: EventStats, when: TimeText) -> str:
    """`line error 3 (12 in all), 12:00:01.000 to 12:00:09.000`."""
    words = f"{str(event.kind).replace('_', ' ')} {event.count:,}"
    if event.kind in COUNTED:
        words += f" ({event.total:,} in all)"
    return f"{words}, {from_to(event.first_ns, event.last_ns, when)}"


def _streams(
    streams: Sequence[StreamStats], port: PortStats, when: TimeText, width: int | None
) -> Iterator[Text]:
    """Tables of periods and values; motors and chassis have one each."""
    if port.first_ns is not None:
        yield from _periods(streams, when).lines(width)
        yield Text()
        streams = [stream for stream in streams if stream.ranges]
    of_motors = [stream for stream in streams if stream.motor is not None]
    of_all = [stream for stream in streams if stream.motor is None]
    for number, some in enumerate(filter(None, (of_motors, of_all))):
        yield from [Text()] if number else []
        yield from _values(some).lines(width)


def _periods(streams: Sequence[StreamStats], when: TimeText) -> TextTable:
    heads = ["frames", "rate", "period", "jitter", "longest", "until", "99 %"]
    table = TextTable([STREAM, *heads])
    for stream in streams:
        periods = stream.periods
        cells = [
            *(_stream_name(stream), f"{stream.count:,}", rate_text(stream.per_s)),
            *(span_text(periods.percentile_ns(50)), span_text(stream.jitter_ns)),
            *(span_text(periods.longest_ns), when(periods.longest_at_ns)),
            span_text(periods.percentile_ns(99)),
        ]
        table.append(cells, mark=_MARKED)
    return table


def _values(streams: Sequence[StreamStats]) -> TextTable:
    """The range of each quantity; a name ends in its unit, or is it."""
    names = [name for name in _QUANTITIES if any(name in stream.ranges for stream in streams)]
    table = TextTable([STREAM, "frames", *names])
    for stream in streams:
        ranges = (stream.ranges.get(name) for name in names)
        cells = (UNKNOWN if ends is None else "{} .. {}".format(*ends) for ends in ranges)
        table.append([_stream_name(stream), f"{stream.count:,}", *cells], mark=_MARKED)
    return table


def _stream_name(stream: StreamStats) -> str:
    return stream.kind.name if stream.motor is None else f"{stream.kind.name} {stream.motor}"


def _motors(summary: StatisticsSummary) -> TextTable:
    heads = ["commands", "feedback", "answered", "unanswered", "neither"]
    table = TextTable([MOTOR, *heads, "delay", "99 %", "longest"])
    for one in summary.answers.stats():
        table.append([str(one.motor), *_answers(one, summary)])
    return table


def _answers(one: AnswerStats, summary: StatisticsSummary) -> list[str]:
    counts = [f"{one.commands:,}", f"{one.feedback:,}"]
    if not summary.in_order:
        return [*counts, *[UNKNOWN] * 6]
    delays = one.delays
    unanswered = UNKNOWN if one.unanswered is None else f"{one.unanswered:,}"
    return [
        *(*counts, f"{one.pairing.answered:,}", unanswered, f"{one.neither:,}"),
        *(span_text(delays.percentile_ns(50)), span_text(delays.percentile_ns(99))),
        span_text(delays.longest_ns),
    ]


def _motor_notes(summary: StatisticsSummary, when: TimeText) -> Iterator[Text]:
    """Notes below the table of motors."""
    if not summary.in_order:
        yield Text("the inputs overlap in time: answers cannot be matched to commands")
    elif any(one.neither for one in summary.answers.stats()):
        yield Text("neither: resets; commands before the first feedback, or open where rows end")
    if not any(one.feedback for one in summary.answers.stats()):
        return
    warnings = list(flag_texts(summary.flags.stats(), when, in_order=summary.in_order))
    yield from (Text(f"{_WORRY.mark} {words}", _WORRY.style) for words in warnings)
    if not warnings:
        yield Text(FLAGS_IN_ORDER)


def _line(label: str, text: str | Text) -> Text:
    return Text.assemble((fit(label, _LABEL), HEAD_STYLE), " ", text)
