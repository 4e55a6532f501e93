"""`fte-sniff stats`: statistics over files, as text or as one JSON object."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import tzinfo
from typing import TYPE_CHECKING, Final, TypeAlias

from rich.text import Text

from fte_sniff.analysis.table import MOTOR
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
from fte_sniff.i18n import _, translated
from fte_sniff.protocol.columns import iso_time, iso_time_ns
from fte_sniff.protocol.spec import Direction, Status
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
    from fte_sniff.analysis.statistics import ANALYSIS

    counts, reading = measure(query, ANALYSIS)
    numbers = statistics_json(counts, reading, query.filter_text, query.baud)
    if form == "json":
        print_json(numbers)
    else:
        print_lines(report_lines(numbers, reading))
    finish(reading)


_LABEL: Final = 10
_ENDS: Final = ("first_time", "last_time")

When: TypeAlias = Callable[[str | None], str]
"""The time of day of a time of the JSON object; a dash for None."""

Columns: TypeAlias = Sequence[tuple[str, Callable[[Json, When], str]]]
"""Heads, and the text of their cells for an object."""


def report_lines(numbers: Json, reading: InputReading) -> Iterator[Text]:
    """The lines of the report about the object of docs/stats.md."""
    when, files, motors = _clock(numbers, reading.zone), numbers["files"], numbers["motors"]
    streams, is_timed = _of_ports(numbers, "streams"), numbers["first_time"] is not None
    tables: list[tuple[Columns, Sequence[Json]]] = [
        (_FILES, files if len(files) > 1 else []),
        (_PORTS, numbers["ports"]),
        (_EVENTS, _of_ports(numbers, "events")),
        (_FAULTS, _of_ports(numbers, "faults")),
        (_PERIODS, streams if is_timed else []),
        (_VALUES, [one for one in streams if one["values"] or not is_timed]),
        (_MOTORS, motors if any(one["commands"] or one["feedback"] for one in motors) else []),
    ]
    yield from _whole(numbers, reading)
    for columns, objects in tables:
        if objects:
            rows = [[text(one, when) for _, text in columns] for one in objects]
            yield Text()
            yield from table_lines([head for head, __ in columns], rows)
    if numbers["selections"]:
        yield Text(_("answers are not known: the recording has only selected rows"))
    elif motors[0]["neither"] is None:
        yield Text(_("the inputs overlap in time: answers cannot be matched to commands"))


def _of_ports(numbers: Json, key: str) -> list[Json]:
    """The objects of all ports, with the name of theirs as `of` if there are several."""
    ports = numbers["ports"]
    names = [f" of {printable(port['port'])}" if len(ports) > 1 else "" for port in ports]
    return [{**one, "of": of} for port, of in zip(ports, names, strict=True) for one in port[key]]


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
        last, seconds = _in_zone(numbers["last_time"], zone), numbers["duration_s"]
        yield _line("last", f"{last}, {seconds:,.3f} s after the first")
    elif rows:
        yield _line("time", _("these rows have no times: no rates, no silences"))
    if rows:
        counts = {status: numbers["status"][status]["rows"] for status in LOOKS}
        words = [f"{one} {count:,} ({share_text(count / rows)})" for one, count in counts.items()]
        yield _line("status", ", ".join(words))


def _line(label: str, text: str) -> Text:
    return Text.assemble((fit(_(label), _LABEL), HEAD_STYLE), " ", translated(text))


def _span(seconds: float | None) -> str:
    return span_text(None if seconds is None else seconds * 1e9)


def _values(stream: Json, when: When) -> str:
    """`rpm -300 .. 1000, pulses 0 .. 5000`."""
    ends = stream["values"].items()
    return ", ".join(f"{name} {one['least']} .. {one['greatest']}" for name, one in ends)


def _motor(one: Json, when: When) -> str:
    bad = one["error_bits"] or one["offline"]["frames"]
    return f"{LOOKS[Status.MALFORMED if bad else Status.OK].mark} {one[MOTOR]}"


def _count(name: str, head: str = "") -> tuple[str, Callable[[Json, When], str]]:
    """The column of a count."""
    return head or name, lambda one, _: UNKNOWN if one[name] is None else f"{one[name]:,}"


def _time(name: str, head: str) -> tuple[str, Callable[[Json, When], str]]:
    """The column of a time."""
    return head, lambda one, when: when(one[name])


_FILES: Final[Columns] = (
    ("file", lambda one, _: printable(one["name"])),
    *map(_count, ("rows", "bytes")),
    _time("first_time", "first row"),
)
_PORTS: Final[Columns] = (
    ("port", lambda one, _: printable(one["port"])),
    *map(_count, ("rows", "bytes")),
    ("rate", lambda one, _: rate_text(one["rows_per_s"])),
    ("control", lambda one, _: f"{one['frames'][Direction.CONTROL]:,}"),
    ("feedback", lambda one, _: f"{one['frames'][Direction.FEEDBACK]:,}"),
    ("line use", lambda one, _: share_text(one["line_use"])),
    _count("baud"),
    ("silence", lambda one, _: _span(one["silences"]["longest_s"])),
    ("until", lambda one, when: when(one["silences"]["longest_until"])),
)
_EVENTS: Final[Columns] = (
    ("event", lambda one, _: one["event"].replace("_", " ") + one["of"]),
    _count("count"),
    _count("total"),
    *map(_time, _ENDS, ("first", "last")),
)
_FAULTS: Final[Columns] = (
    ("  fault", lambda one, _: f"{LOOKS[Status(one['status'])].mark} {one['fault']}{one['of']}"),
    _count("rows"),
    ("of all", lambda one, _: share_text(one["rows_share"])),
    _count("bytes"),
    ("of all", lambda one, _: share_text(one["bytes_share"])),
    *map(_time, _ENDS, ("first", "last")),
)
_STREAM: Final[Columns] = (
    ("kind and motor", lambda one, _: f"{one['kind']} {one[MOTOR] or ''}".rstrip() + one["of"]),
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
_VALUES: Final[Columns] = (*_STREAM, ("values", _values))
_MOTORS: Final[Columns] = (
    ("  motor", _motor),
    *map(_count, ("commands", "feedback", "answered", "unanswered")),
    _count("neither", "unknown"),
    ("delay", lambda one, _: _span(one["delay"]["p50_s"])),
    ("99 %", lambda one, _: _span(one["delay"]["p99_s"])),
    ("longest", lambda one, _: _span(one["delay"]["longest_s"])),
    ("ERROR bits", lambda one, _: " ".join(str(bit["bit"]) for bit in one["error_bits"]) or "–"),
    ("offline", lambda one, _: f"{one['offline']['frames']:,}"),
)
