"""Commands that read files: names of files, which rows, the inputs, and what is reported of them.

`--from` and `--to` take these forms; a time without a zone is in the zone of `--zone` (UTC):

    2026-01-31T12:00:05.25Z      a date and time, see `analysis.time_text`
    12:00:05  20:00:05+08:00     a time of day on the first day
    +10s  +1m30s  +250ms         this long after the start of the recording
    -10s                         this long before its end
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, date, tzinfo
from functools import cache, partial, wraps
from io import BufferedReader
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.analysis.time_text import (
    SECOND_NS,
    clock_time,
    day_of,
    duration_ns,
    time_ns,
    zone_of,
)
from fte_sniff.cli.completion import complete_filter
from fte_sniff.cli.options import Decorator, all_of, in_group
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import (
    FileError,
    InputTextError,
    UsageError,
    encodable,
    printable,
    quoted,
    shortened,
    unreadable,
)
from fte_sniff.platform import POSIX
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import Chunk, Gap
from fte_sniff.protocol.rows import END_NS
from fte_sniff.protocol.spec import DEFAULT_BAUD, FRAME_LENGTH, Status, status_of
from fte_sniff.session.following import Follower, followed
from fte_sniff.session.framing import raw_chunks, timed
from fte_sniff.session.inputs import (
    STDIN_NAME,
    SUFFIXES,
    Input,
    InputKind,
    InputReading,
    chunk_input,
    input_kind,
    recording_input,
)
from fte_sniff.session.save import is_same_file

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.analysis.tally import Tally
    from fte_sniff.recording.reader import TimeRange
    from fte_sniff.session.notes import Notes

STDIN = Path("-")

_FIRST: Final = 4096
"""Bytes that show the format of a file."""

# Names of files

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
        """The path; fails for an empty name and a port."""
        if not str(value):
            self.fail("the name is empty", param, ctx)
        if "://" in str(value) or (isinstance(param, click.Argument) and is_port_name(str(value))):
            self.fail(f"{value} is a port, not a file; `fte-sniff live` captures it", param, ctx)
        return super().convert(value, param, ctx)


def output_options(help_text: str, *, required: bool = False) -> Decorator:
    """The options `--output` and `--force`."""
    return all_of(
        click.option("-o", "--output", type=FileName(), required=required, help=help_text),
        click.option("--force", is_flag=True, help="Overwrite the output file if it exists."),
    )


# Which rows: filter and times


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
    help="Only rows that match: motor = 1 AND rpm > 500. The filter 'help' explains the language.",
)


def row_filter(text: str | None, zone: tzinfo | None = None) -> RowFilter | None:
    """The filter of `--filter`, if it was given; raises FilterError if it is invalid.

    `zone` is that of times that name none; None for UTC.
    """
    if text is None:
        return None
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(text, zone)


_HELP = (
    "as 2026-01-31T12:00:05Z, 12:00:05, 20:00:05+08:00, +10s (from the start) or -10s (before the"
    " end)"
)

Times = tuple[int, int] | None
"""The first and the last time of an input, see `time_range`."""


span_options = all_of(
    click.option(
        "--from", "since", metavar="TIME", help=f"Only rows from this time on: {_HELP}. See --zone."
    ),
    click.option("--to", "until", metavar="TIME", help="Only rows before this time; as --from."),
)


def time_range(
    since: str | None, until: str | None, times: Iterable[Times], zone: tzinfo
) -> TimeRange | None:
    """The time range of `--from` and `--to`; None without either.

    Args:
        since: the text of `--from`, if given.
        until: the text of `--to`, if given.
        times: first and last time of each input, nanoseconds since 1970 UTC. Read only for
            relative times, because a log must be read completely for them.
        zone: the zone of times that name none.

    Raises:
        InputTextError: a text is not a time.
        UsageError: a time is relative and the inputs have no times, or the range is empty.
    """
    from fte_sniff.recording.reader import EVERYTHING, TimeRange

    if since is None and until is None:
        return None
    bounds = cache(lambda: _bounds(times))
    first = 0 if since is None else _time(since, "--from", zone, bounds)
    end = EVERYTHING.end_ns if until is None else _time(until, "--to", zone, bounds)
    if first >= end:
        raise UsageError(
            f"no row is between --from {shortened(since or '1970')} and --to"
            f" {shortened(until or '2262')}; a time of day is one of the first day: write another"
            " day as 2026-01-31T12:00"
        )
    return TimeRange(first, end)


def _bounds(times: Iterable[Times]) -> Times:
    known = [found for found in times if found is not None]
    return (min(known)[0], max(last for _, last in known)) if known else None


def _time(text: str, option: str, zone: tzinfo, bounds: Callable[[], Times] = lambda: None) -> int:
    """A time in full; a relative one needs the bounds of the inputs."""
    wanted = text.strip()
    sign, clock = wanted[:1], clock_time(wanted)
    length = duration_ns(wanted[1:]) if sign in ("+", "-") else None
    if clock is None and length is None:
        found = time_ns(wanted, zone)
        if found is None:
            raise InputTextError(f"{option}: {quoted(text)} is not a time; write it {_HELP}")
        if not 0 <= found < END_NS:
            raise InputTextError(f"{option}: {shortened(text)} is out of range: 1970 to 2262")
        return found
    if (known := bounds()) is None:
        raise UsageError(
            f"{option} {shortened(text)}: the input has no times, or they are not known before it"
            " is read; write a time in full, or set with --start when its bytes began"
        )
    if clock is not None:
        return clock.on_day_of(known[0], zone)
    return known[0] + (length or 0) if sign == "+" else known[1] - (length or 0)


# The inputs


def _pattern_of(text: str) -> re.Pattern[str]:
    """The expression of `--input-regex`; raises InputTextError if it has no group `data`."""
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise InputTextError(f"--input-regex: {quoted(text)}: {error}") from None
    if "data" not in pattern.groupindex:
        raise InputTextError("--input-regex: needs a group for the bytes, (?P<data>...)")
    return pattern


_READING = in_group(
    "Logs of other programs",
    click.option(
        "--input",
        "kind",
        type=click.Choice([kind.value for kind in InputKind]),
        callback=lambda _context, _option, word: InputKind(word) if word else None,
        help="What the files contain, if their names do not show it.",
    ),
    click.option(
        "--topic",
        "topics",
        metavar="NAME",
        multiple=True,
        help="For MCAP files of other programs: the topic with the serial bytes; several are"
        " several wires.",
    ),
    click.option(
        "--date",
        "day",
        type=day_of,
        metavar="DATE",
        help="For logs with only a time of day, or dates such as 2/8/2026: the date of the first,"
        " such as 2026-01-31.  [default: that of the file]",
    ),
    click.option(
        "--start",
        metavar="TIME",
        help="When the seconds of a log, or bytes without times, began, such as"
        " 2026-01-31T12:00:00Z; bytes without times follow each other at the baud.",
    ),
    click.option(
        "--input-regex",
        "pattern",
        type=_pattern_of,
        metavar="REGEX",
        help="For a log that is not recognised: a regular expression of its lines, with the groups"
        " (?P<data>...) and perhaps (?P<time>...) and (?P<dir>...).",
    ),
    click.option(
        "-b",
        "--baud",
        type=click.IntRange(min=1),
        metavar="N",
        help=f"Bits/s of every line; overrides the recording's.  [default: {DEFAULT_BAUD}]",
    ),
)

_MANY_FILES = in_group(
    "Many files",
    click.option(
        "--pair",
        is_flag=True,
        help="The files are wires of one line, recorded at the same time.",
    ),
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Processes that read the files of several captures.  [default: 1]",
    ),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Read the files on a Dask cluster, such as tcp://192.168.0.9:8786; its workers see the"
        " same files.",
    ),
)

_ZONE = click.option(
    "--zone",
    metavar="ZONE",
    help="Your time zone, such as Asia/Shanghai, +08:00 or local (of this machine): of times in"
    " tables, CSV and reports, and of those in logs, --from, --to and filters that name none."
    "  [default: UTC]",
)

_READING_OPTIONS: Final = {
    str(option.name): option.opts[-1]
    for option in click.command()(all_of(_READING, _ZONE)(lambda: None)).params
}
"""The options that decide how inputs are read, by their names in `InputQuery`."""

follow_option = click.option(
    "--follow",
    "following",
    is_flag=True,
    help="Read a recording while another program writes it, and its next files, until the writer"
    " ends.",
)


def input_options(
    *, required: bool = True, filters: bool = True, many: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add FILE... and the options that select its rows; the command receives them as `query`.

    Without `required` there may be no file; without `filters` there is no `--filter`; with `many`
    there are options for many files.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_query(**options: Any) -> Any:
            known = {one.name for one in fields(InputQuery)} & options.keys()
            query = InputQuery(**{name: options.pop(name) for name in known})
            if query.files.count(STDIN) > 1:
                raise UsageError("'-' is standard input, which can be read once; name it once")
            output = options.get("output")
            if output is not None and any(is_same_file(path, output) for path in query.files):
                raise UsageError(
                    f"{output} is an input, and would be lost; name another file with -o"
                )
            return command(query=query, **options)

        rows = (filter_option, span_options) if filters else (span_options,)
        return all_of(
            click.argument(
                "files",
                nargs=-1,
                required=required,
                metavar="FILE..." if required else "[FILE]...",
                type=FileName(),
            ),
            in_group("Rows", *rows, _ZONE),
            _READING,
            *([_MANY_FILES] if many else []),
        )(with_query)

    return decorate


@dataclass(frozen=True, slots=True)
class InputQuery:
    """The inputs of a command, how to read them, and which of their rows are wanted."""

    files: tuple[Path, ...]
    kind: InputKind | None = None
    """What they contain; None to decide by name or content."""
    topics: tuple[str, ...] = ()
    """For MCAP files, the topics with serial bytes; none for recordings."""
    day: date | None = None
    """For hex logs, the date of the first time."""
    zone: str | None = None
    """The zone of times in text, and of times that name none; None for UTC."""
    start: str | None = None
    """When the seconds of a log, or its bytes, began."""
    pattern: re.Pattern[str] | None = None
    baud: int | None = None
    """Bits per second of every line; None for that of the recordings, else the default."""
    filter_text: str | None = None
    """A filter that the rows match, as typed: its times may be in the zone; None for all."""
    since: str | None = None
    """The first time, as `--from` takes it."""
    until: str | None = None
    """The time after the last, as `--to` takes it."""
    pair: bool = False
    """Whether the files are wires of one line."""
    jobs: int | None = None
    """Processes that read them; None for this one."""
    cluster: str | None = None
    """Address of the Dask cluster that reads them."""

    def start_ns(self) -> int | None:
        """The time of `--start`, nanoseconds since 1970 UTC, or None; raises InputTextError."""
        return None if self.start is None else _time(self.start, "--start", self._zone)

    def zone_given(self) -> tzinfo | None:
        """The zone of `--zone`, or None; raises InputTextError for an unknown zone."""
        return None if self.zone is None else zone_of(self.zone)

    @property
    def _zone(self) -> tzinfo:
        return self.zone_given() or UTC

    def view_command(self, span_ns: tuple[int, int] | None, filter_text: str) -> str:
        """The command that shows the rows of these inputs that a filter selects in a span."""
        words = ["fte-sniff", "view", *map(str, self.files)]
        for name, option in _READING_OPTIONS.items():
            given = getattr(self, name)
            for value in given if isinstance(given, tuple) else (given,):
                words += [] if value is None else [option, str(getattr(value, "pattern", value))]
        if span_ns is not None:
            # Whole seconds around the span are shorter, and show what was before.
            first, last = span_ns[0] // SECOND_NS, span_ns[1] // SECOND_NS + 1
            times = [f"{iso_time(second * SECOND_NS)[:19]}Z" for second in (first, last)]
            words += ["--from", times[0], "--to", times[1]]
        command = shlex.join(words)
        return f"{command} --filter {_in_quotes(filter_text)}" if filter_text else command

    def row_filter(self) -> RowFilter | None:
        """The compiled filter; raises FilterError."""
        return row_filter(self.filter_text, self.zone_given())

    def paths(self) -> list[Path]:
        """The files, the recordings of folders, and the matches of patterns; `-` is stdin.

        Raises FileError if a folder or a pattern has none.
        """
        from fte_sniff.session.files import files_of

        found = ([one] if one == STDIN else files_of(one) for one in self.files)
        return list(chain.from_iterable(found))

    def read(self, follower: Follower | None = None) -> InputReading:
        """Open the inputs; `follower` reads the one input, if another program writes it.

        Raises:
            FileError: no file can be read; one of several is reported, and the others are read.
            UsageError: the content of a file is unknown, or does not fit the options.
            InputTextError: a time, date or zone is invalid.
        """
        inputs, unreadable = list[Input](), list[FileError]()
        for path in self.paths():
            try:
                inputs.append(_opened(path, self) if follower is None else followed(follower))
            except FileError as error:
                unreadable.append(error)
        if not inputs:
            raise unreadable[0]
        return InputReading(
            inputs,
            time_range(self.since, self.until, (one.times() for one in inputs), self._zone),
            baud=self.baud,
            is_pair=self.pair,
            zone=self._zone,
            unreadable=unreadable,
        )

    def follower(self) -> Follower:
        """Open the one input, which another program writes.

        Raises UsageError if it is one of several, or cannot grow, and FileError.
        """
        from fte_sniff.recording.reader import Recording

        path, *others = self.paths()
        if others or path == STDIN or self.topics or self.kind not in (None, InputKind.MCAP):
            raise UsageError(
                "--follow needs one recording; the next files of its capture follow by themselves"
            )
        return Follower(Recording(path, is_growing=True))


def _in_quotes(text: str) -> str:
    """A filter as a word of a shell: in double quotes if it has single ones."""
    is_plain = "'" in text and not any(one in text for one in '"$`\\!')
    return f'"{text}"' if is_plain else shlex.quote(text)


def _opened(path: Path, query: InputQuery) -> Input:
    name, stream = encodable(str(path)), None
    if path == STDIN:
        name, stream = STDIN_NAME, _stdin()
    first = stream.peek(1) if stream else _first_bytes(path)
    if not first:
        raise FileError(f"{name} is empty; there is nothing to read")
    kind = query.kind or input_kind(name, first)
    baud, start_ns = query.baud or DEFAULT_BAUD, query.start_ns()
    if kind is InputKind.MCAP:
        if stream is not None:
            raise UsageError(f"{name} is a recording; save it to a file, and name that")
        if query.topics:
            from fte_sniff.recording.foreign_topic import topic_chunks

            topics = partial(topic_chunks, path, query.topics)
            return chunk_input(", ".join(query.topics), topics(), topics, ports=query.topics)
        from fte_sniff.recording.reader import Recording

        return recording_input(Recording(path))
    if query.topics:
        raise UsageError(f"{path}: --topic is for MCAP files; leave it out")
    if kind is InputKind.RAW:

        def chunks() -> Iterator[Chunk]:
            return timed(raw_chunks(stream or path, name), start_ns, baud)

        if stream is not None:
            return chunk_input(name, chunks(), baud=baud)
        count = path.stat().st_size // FRAME_LENGTH
        is_guess = query.kind is None and path.suffix.lower() not in SUFFIXES[kind]
        return chunk_input(name, chunks(), chunks, baud, count=count, is_guess=is_guess)
    from fte_sniff.formats.log import Log
    from fte_sniff.formats.log_times import LogOptions

    given = (query.day, query.zone_given(), start_ns, query.pattern)
    options = LogOptions(*given)
    log = Log(STDIN_NAME if stream else str(path), options, stream)
    again = tuple if stream else lambda: timed(Log(str(path), options).chunks(), start_ns, baud)
    return chunk_input(
        name,
        timed(log.chunks(), start_ns, baud),
        again,
        baud,
        ports=log.ports,
        notes=lambda: (*log.notes(), *log.clock.notes()),
    )


def _stdin() -> BufferedReader:
    """Standard input; Ctrl-C ends the wait for its next bytes."""
    if POSIX:
        import polars  # noqa: F401  # its handler of Ctrl-C makes the system read on

        signal.siginterrupt(signal.SIGINT, True)
    return open(sys.stdin.fileno(), "rb", closefd=False)


def _first_bytes(path: Path) -> bytes:
    """Bytes that show the format. Raises FileError, and UsageError for a pipe."""
    if path.is_fifo():
        raise UsageError(f"{path} is a pipe; read it as '-', standard input")
    try:
        with path.open("rb") as file:
            return file.read(_FIRST)
    except OSError as error:
        raise unreadable(path, error) from error


# What is reported

ENOUGH_ROWS = 5
"""This many damaged rows without a frame point to a wrong setup."""


def summary(tally: Tally, reading: InputReading | None = None, zone: tzinfo = UTC) -> str:
    """Summary of all rows: `512 rows, 3 malformed (0.6 %: truncated 2, noise 1), 10.2 s from ...`.

    With `reading`, whose rows the tally counts, it reports their gaps. `zone` is that of the times.
    """
    if reading is not None and reading.written == reading.limit:
        return f"stopped at the limit: {tally.rows:,} rows read so far, {reading.written:,} written"
    parts = [f"{tally.rows:,} row{'s' if tally.rows != 1 else ''}"]
    if reading is not None and reading.written != tally.rows:
        parts[0] += f" read, {reading.written:,} written"
    parts += [
        text for status in (Status.SUSPECT, Status.MALFORMED) if (text := _share(tally, status))
    ]
    if len(parts) == 1 and tally.rows:
        parts.append("nothing malformed")
    if tally.times is not None:
        first_ns, last_ns = tally.times
        parts.append(f"{(last_ns - first_ns) / 1e9:,.3f} s from {iso_time(first_ns, zone)}")
    gaps = reading.reported_gaps if reading is not None else []
    advice = explain_no_frames(tally, reading)
    lacking = f"; {gap_text(gaps)} left out when recorded" if gaps else ""
    return ", ".join(parts) + lacking + (advice and f"; {advice}")


def gap_text(gaps: Sequence[Gap]) -> str:
    """`893 rows in 2 gaps`; `893 rows or more`, or `rows`, if the size of a gap is unknown."""
    rows = sum(gap.rows or 0 for gap in gaps)
    more = " or more" if any(gap.rows is None for gap in gaps) else ""
    known = f"{rows:,} rows{more}" if rows else "rows"
    return f"{known} in {len(gaps):,} gap{'s' * (len(gaps) != 1)}"


def explain_no_frames(tally: Tally, reading: InputReading | None = None) -> str:
    """Why rows or frames are missing, or what to check; empty otherwise."""
    if tally.rows >= ENOUGH_ROWS and not tally.frames:
        return "no frame found: check the controller, the baud rate and the polarity"
    if tally.rows:
        hides = reading is not None and not reading.written and reading.row_filter
        return f"none of them matches the filter: {printable(hides.text)}" if hides else ""
    if reading is not None and (reading.notes or reading.reported_gaps):
        return ""  # they name the reason
    if reading is not None and reading.selections:
        wanted = " and ".join(printable(one.filter_text) for one in reading.selections)
        return f"nothing was selected when the recording was written: {wanted}"
    return "nothing came: check the wire, the ground and the baud rate"


def print_saved(notes: Notes) -> None:
    """Print where the notes of a view are."""
    for path in notes.written:
        print_err(f"notes are in {path}")


def print_notes(reading: InputReading) -> None:
    """Print what is wrong with the inputs, one line each, on standard error."""
    for note in reading.notes:
        print_err(f"fte-sniff: {note}")


def exit_if_unreadable(reading: InputReading) -> None:
    """Exit with the code of a file error if one of several inputs could not be read."""
    if reading.unreadable:
        sys.exit(FileError.exit_code)


def _share(tally: Tally, status: Status) -> str:
    count = tally.by_status[status]
    if not count:
        return ""
    faults = ", ".join(
        f"{fault} {rows:,}"
        for fault, rows in tally.by_fault.items()
        if status_of((fault,)) is status
    )
    return f"{count:,} {status} ({count / tally.rows:.2%}: {faults})"
