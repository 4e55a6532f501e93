"""Arguments and options of commands that read files: which files, and which of their rows."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields, replace
from datetime import UTC, tzinfo
from functools import partial, wraps
from io import BufferedReader, FileIO
from pathlib import Path
from select import select
from typing import TYPE_CHECKING, Any, Final
from weakref import finalize

import click

from fte_sniff.analysis.time_text import SECOND_NS, day_of, time_ns, zone_of
from fte_sniff.cli.options import (
    FileName,
    Seconds,
    all_of,
    filter_option,
    is_port_name,
    line_speed_option,
    row_filter,
    span_options,
    time_range,
)
from fte_sniff.errors import (
    FileError,
    FilterError,
    InputTextError,
    UsageError,
    printable,
    quoted,
    unreadable,
)
from fte_sniff.formats.input_kind import (
    KIND_OF_SUFFIX,
    InputKind,
    clocked,
    kind_of_content,
    kind_of_file,
    raw_chunks,
    raw_stream_chunks,
)
from fte_sniff.platform import POSIX
from fte_sniff.protocol import DEFAULT_BAUD, iso_time
from fte_sniff.session.following import DEFAULT_IDLE_S, Following
from fte_sniff.session.inputs import (
    STDIN_NAME,
    Input,
    InputReading,
    LogInput,
    ParquetInput,
    Progress,
    RecordingInput,
)
from fte_sniff.session.save import is_same_file

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.formats.log_form import LogOptions
    from fte_sniff.session.file_jobs import FileJob, Model

STDIN = Path("-")


def _files_argument(*, required: bool) -> Callable[..., Any]:
    argument: Callable[..., Any] = click.argument(
        "files",
        nargs=-1,
        required=required,
        metavar="FILE..." if required else "[FILE]...",
        type=FileName(),
    )
    return argument


_READING = all_of(
    click.option(
        "--input",
        "kind",
        type=click.Choice([kind.value for kind in InputKind]),
        callback=lambda _context, _option, word: InputKind(word) if word else None,
        help="What the files contain, if their names do not show it.",
    ),
    click.option(
        "--topic",
        metavar="NAME",
        help="For MCAP files of other programs: the topic with the serial bytes.",
    ),
    click.option(
        "--date",
        "day",
        metavar="DATE",
        help="For logs with only a time of day, or dates such as 2/8/2026: the date of the first,"
        " such as 2026-01-31.  [default: that of the file]",
    ),
    click.option(
        "--zone",
        metavar="ZONE",
        help="Your time zone, such as Asia/Shanghai, +08:00 or local (of this machine): of times in"
        " tables, CSV and reports, and of those in logs, --from, --to and filters that name none."
        "  [default: UTC]",
    ),
    click.option(
        "--start",
        metavar="TIME",
        help="When the seconds of a log, or bytes without times, began, such as"
        " 2026-01-31T12:00:00Z; bytes without times follow each other at the baud.",
    ),
    click.option(
        "--samplerate",
        type=click.IntRange(min=1),
        metavar="HZ",
        help="For logs of sigrok with sample numbers: samples per second, which make them times.",
    ),
    click.option(
        "--form",
        "log_form",
        metavar="NAME",
        help="How a log writes bytes, as --explain names it, such as 'hex pairs, spaces'.",
    ),
    click.option(
        "--input-regex",
        "pattern",
        metavar="REGEX",
        help="For a log that is not recognised: a regular expression of its lines, with the groups"
        " (?P<data>...) and perhaps (?P<time>...) and (?P<dir>...).",
    ),
    line_speed_option,
)

_READING_OPTIONS: Final = {
    str(option.name): option.opts[-1] for option in click.command()(_READING(lambda: None)).params
}
"""The options that decide how inputs are read, by their names in `InputQuery`."""

_OPTIONS = all_of(
    _READING,
    click.option(
        "--explain", is_flag=True, help="Show where logs have bytes, times and directions; no rows."
    ),
    filter_option,
    span_options,
)


_FOLLOW_OPTIONS = all_of(
    click.option(
        "--follow",
        is_flag=True,
        help="Read a recording while another program writes it, and its next files, until the"
        " writer ends.",
    ),
    click.option(
        "--idle",
        "idle_s",
        type=Seconds(min=0, min_open=True),
        metavar="S",
        help="With --follow, where the file system has no locks: end when nothing was written for"
        f" S seconds.  [default: {DEFAULT_IDLE_S:g}]",
    ),
)


def follow_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--follow` and `--idle`; below `input_options`, which passes them as `following`."""
    with_options: Callable[..., Any] = _FOLLOW_OPTIONS(command)
    return with_options


def _following_of(options: dict[str, Any]) -> dict[str, Any]:
    """The options, with `following` in place of those of `follow_options`; None without."""
    if "follow" not in options:
        return options
    follow, idle_s = options.pop("follow"), options.pop("idle_s")
    if idle_s is not None and not follow:
        raise UsageError("--idle is for --follow; add it, or leave --idle out")
    following = Following(idle_s or DEFAULT_IDLE_S) if follow else None
    return {"following": following, **options}


def input_options(
    command: Callable[..., Any] | None = None, *, required: bool = True
) -> Callable[..., Any]:
    """Add FILE... and the options that select its rows; the command receives them as `query`.

    Without `required` there may be no file.
    """
    if command is None:
        return partial(input_options, required=required)

    @wraps(command)
    def with_query(*, explain: bool, **options: Any) -> Any:
        query = InputQuery(**{one.name: options.pop(one.name) for one in fields(InputQuery)})
        options = _following_of(options)
        return query.explain() if explain else command(query=query, **options)

    with_options: Callable[..., Any] = _files_argument(required=required)(_OPTIONS(with_query))
    return with_options


@dataclass(frozen=True, slots=True)
class InputQuery:
    """The inputs of a command, how to read them, and which of their rows are wanted."""

    files: tuple[Path, ...]
    kind: InputKind | None = None
    """What they contain; None to decide by name or content."""
    topic: str | None = None
    """For MCAP files, the topic with serial bytes; None for recordings."""
    day: str | None = None
    """For hex logs, the date of the first time."""
    zone: str | None = None
    """The zone of times in text, and of times that name none; None for UTC."""
    start: str | None = None
    """When the seconds of a log, or its bytes, began."""
    log_form: str | None = None
    """The form in which a log writes bytes."""
    pattern: str | None = None
    samplerate: int | None = None
    """Samples per second, which make sample numbers in a log times."""
    baud: int | None = None
    """Bits per second of every line; None for that of the recordings, else the default."""
    filter_text: str | None = None
    """A filter that the rows match, as typed: its times may be in the zone; None for all."""
    since: str | None = None
    """The first time, as `--from` takes it."""
    until: str | None = None
    """The time after the last, as `--to` takes it."""

    def log_options(self) -> LogOptions:
        """The options of a log; raises InputTextError if one is invalid."""
        from fte_sniff.formats.log_form import LogOptions

        day = None if self.day is None else day_of(self.day)
        pattern = None if self.pattern is None else _pattern_of(self.pattern)
        given = (day, self.zone_given(), self.start_ns(), self.log_form, pattern)
        return LogOptions(*given, samplerate=self.samplerate, baud=self.baud or DEFAULT_BAUD)

    def _check_log_options(self) -> None:
        """Raise InputTextError if a given option is invalid, even if no log is read."""
        given = self.day, self.zone, self.start, self.log_form, self.pattern
        if any(one is not None for one in given):
            self.log_options()

    def start_ns(self) -> int | None:
        """The time of `--start`, nanoseconds since 1970 UTC, or None; raises InputTextError."""
        if self.start is None:
            return None
        t_ns = time_ns(self.start.strip(), self.zone_given() or UTC)
        if t_ns is None or t_ns < 0:
            raise InputTextError(
                f"--start: {quoted(self.start)} is not a time from 1970 on; write it as"
                " 2026-01-31T12:00:00Z"
            )
        return t_ns

    def explain(self) -> None:
        """Print where logs have their bytes, times and directions."""
        for path in self.paths():
            one = _opened(path, self)
            if isinstance(one, LogInput):
                for line in one.explain():
                    click.echo(printable(f"{path}: {line}"))

    def zone_given(self) -> tzinfo | None:
        """The zone of `--zone`, or None; raises InputTextError for an unknown zone."""
        return None if self.zone is None else zone_of(self.zone)

    def view_command(self, span_ns: tuple[int, int] | None, filter_text: str) -> str:
        """The command that shows the rows of these inputs that a filter selects in a span."""
        words = ["fte-sniff", "view", *map(str, self.files)]
        for name, option in _READING_OPTIONS.items():
            if (given := getattr(self, name)) is not None:
                words += [option, str(given)]
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
        return [path for named in self.files for path in _expanded(named)]

    def read(
        self,
        row_filter: RowFilter | None,
        limit: int | None = None,
        progress: Progress | None = None,
        following: Following | None = None,
        *,
        facts: bool = False,
        readings: bool = False,
    ) -> InputReading:
        """Open the inputs; the arguments are those of `InputReading`.

        With `following`, the one input is a recording that another program writes.

        Raises:
            FileError: no file can be read; one of several is reported, and the others are read.
            UsageError: the content of a file is unknown, or does not fit the options.
            InputTextError: a time, date or zone is invalid.
        """

        def opened(path: Path) -> Input:
            if following is not None:
                return following.open(self._followed(path))
            return _opened(path, self)

        self._check_log_options()
        progress, unreadable = progress or Progress(), list[FileError]()
        inputs = [one for _, one in self._each(opened, progress, unreadable)]
        times = (_times_of(one, progress) for one in inputs)
        span = time_range(self.since, self.until, times, self.zone_given())
        found = InputReading(
            inputs,
            span,
            row_filter,
            limit,
            self.baud,
            unreadable,
            progress,
            facts=facts,
            readings=readings,
            zone=self.zone_given() or UTC,
        )
        if following is not None:
            progress.step = f"following {inputs[0].name}"
        return found

    def _each(
        self, opened: Callable[[Path], Input], progress: Progress, unreadable: list[FileError]
    ) -> Iterator[tuple[Path, Input]]:
        """Open the inputs; errors of some are added to `unreadable`, and raised if all have one."""
        for path in (paths := self.paths()):
            progress.step = f"opening {path}"
            try:
                yield path, opened(path)
            except FileError as error:
                unreadable.append(error)
        if len(unreadable) == len(paths):
            raise unreadable[0]

    def _followed(self, path: Path) -> Path:
        """The path; raises UsageError if it is one of several, or cannot grow."""
        if len(self.paths()) > 1 or path == STDIN or self.topic is not None:
            raise UsageError(
                "--follow needs one recording; the next files of its capture follow by themselves"
            )
        if self.kind not in (None, InputKind.MCAP):
            raise UsageError("--follow reads recordings only; leave --input out")
        return path

    def jobs(
        self, make_model: Callable[[], Model], progress: Progress
    ) -> tuple[list[FileJob[Model]], InputReading]:
        """A job for each file, by first times, and a reading to which their results are added.

        Only an input that can be read once stays open. Raises as `read`.
        """
        from fte_sniff.session.file_jobs import FileJob

        self._check_log_options()
        wanted = self.row_filter()
        filter_text = None if wanted is None else wanted.text
        opened = partial(_opened, query=replace(self, files=()))
        found: list[tuple[int | None, FileJob[Model]]] = []
        unreadable, several = list[FileError](), len(self.paths()) > 1
        for path, one in self._each(opened, progress, unreadable):
            source = path if path.is_file() else one
            job = FileJob(source, opened, make_model, None, filter_text, self.baud, size=one.size)
            found.append((one.first_ns if several else None, job))
        found.sort(key=lambda one: (one[0] is None, one[0] or 0))
        jobs = [job for _, job in found]
        times = (_times_of(job.open(), progress) for job in jobs)
        span = time_range(self.since, self.until, times, self.zone_given())
        if span is not None:
            jobs = [replace(job, span=span) for job in jobs]
        progress.expect([job.size for job in jobs])
        zone = self.zone_given() or UTC
        return jobs, InputReading(
            [], span, wanted, None, self.baud, unreadable, progress, zone=zone
        )


def _times_of(one: Input, progress: Progress) -> tuple[int, int | None] | None:
    progress.step = f"looking for the first and last time in {one.name}"
    return one.times


def _pattern_of(text: str) -> re.Pattern[str]:
    """The expression of `--input-regex`; raises InputTextError if it has no group `data`."""
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise InputTextError(f"--input-regex: {quoted(text)}: {error}") from None
    if "data" not in pattern.groupindex:
        raise InputTextError("--input-regex: needs a group for the bytes, (?P<data>...)")
    return pattern


def check_inputs(files: Sequence[Path], output: Path | None = None) -> None:
    """Refuse an invalid list of inputs before anything is opened.

    Raises UsageError if one is a port or a filter, if standard input is named twice, or the output
    is one of the inputs.
    """
    for path in files:
        if is_port_name(str(path)):
            live = f"fte-sniff live {shlex.quote(str(path))}"
            raise UsageError(f"{path} is a port, not a file; `{live}` captures it")
        if _is_filter(str(path)) and not path.exists():
            raise UsageError(
                f"no such file: {quoted(str(path))}; a filter is an option: --filter"
                f" {shlex.quote(str(path))}"
            )
    if files.count(STDIN) > 1:
        raise UsageError("'-' is standard input, which can be read once; name it once")
    for path in files:
        if output is not None and is_same_file(path, output):
            raise UsageError(f"{output} is an input, and would be lost; name another file with -o")


def _is_filter(text: str) -> bool:
    """Whether a text that names no file is a filter."""
    if not re.search(r"[=<>]|\s(IS|IN|LIKE|BETWEEN)\s", text, re.IGNORECASE):
        return False
    try:
        return row_filter(text) is not None
    except FilterError:
        return False


def _in_quotes(text: str) -> str:
    """A filter as a word of a shell: in double quotes if it has single ones."""
    is_plain = "'" in text and not any(one in text for one in '"$`\\!')
    return f'"{text}"' if is_plain else shlex.quote(text)


def _expanded(named: Path) -> list[Path]:
    """The file, a folder's recordings, or a pattern's matches."""
    try:
        if named == STDIN or named.is_file():
            return [named]
        from fte_sniff.recording.reader import files_of

        return list(files_of(named))
    except OSError as error:
        raise unreadable(named, error) from error


def _opened(path: Path, query: InputQuery) -> Input:
    if query.topic is not None:
        return _topic(path, query.topic)
    with ExitStack() as opened:
        stream = _stream_of(path)
        if stream is not None:
            opened.enter_context(stream)
        one = _input_of(path, stream, query)
        # Not at exit: a thread that waits for the next bytes of a pipe would delay it.
        finalize(one, opened.pop_all().close).atexit = False
    return one


def _input_of(path: Path, stream: BufferedReader | None, query: InputQuery) -> Input:
    name = STDIN_NAME if path == STDIN else str(path)
    kind = query.kind or (kind_of_file(path) if stream is None else _kind_of(stream, name))
    if kind is InputKind.MCAP:
        from fte_sniff.recording.reader import RecordingReader

        return RecordingInput(RecordingReader(Path(name), stream))
    if kind is InputKind.PARQUET:
        from fte_sniff.formats.parquet import ParquetRows

        if stream is not None:
            raise UsageError(f"{name}: parquet is not read in sequence; name a file")
        return ParquetInput(ParquetRows(path), name)
    if kind is InputKind.RAW:
        chunks = raw_chunks(path) if stream is None else raw_stream_chunks(stream, name)
        timed = clocked(chunks, query.start_ns(), query.baud)
        return LogInput(timed, name, lambda: stream is not None, query.start_ns, query.baud)
    from fte_sniff.formats.log_reader import LogReader

    return LogInput(LogReader(name, query.log_options(), stream), name)


class _Waiting(FileIO):
    """A pipe; Ctrl-C ends the wait for its next bytes.

    With polars, the system continues a read after a signal, so that Python does not notice it.
    """

    def readinto(self, buffer: WriteableBuffer, /) -> int | None:
        if POSIX:  # on Windows only sockets can be selected
            select([self], [], [])
        return super().readinto(buffer)


def _stream_of(path: Path) -> BufferedReader | None:
    """Standard input or a pipe, which can be read once; None for a file."""
    if path == STDIN:
        return BufferedReader(_Waiting(sys.stdin.fileno(), closefd=False))
    return BufferedReader(_Waiting(path)) if path.is_fifo() else None


def _kind_of(stream: BufferedReader, name: str) -> InputKind:
    return KIND_OF_SUFFIX.get(Path(name).suffix.lower()) or kind_of_content(stream.peek(1))


def _topic(path: Path, topic: str) -> Input:
    if path == STDIN or kind_of_file(path) is not InputKind.MCAP:
        raise UsageError(f"{path}: --topic is for MCAP files; leave it out")
    from fte_sniff.recording.foreign_topic import topic_chunks

    def first_ns() -> int | None:
        return next((chunk.t_ns for chunk in topic_chunks(path, topic)), None)

    return LogInput(topic_chunks(path, topic), topic, first_ns=first_ns)
