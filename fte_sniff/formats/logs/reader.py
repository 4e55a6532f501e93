"""A log as rows: plain hex, rows that this program wrote, or a text whose layout frames decide."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Final, Protocol

from fte_sniff.errors import FileError, InputTextError, UsageError, quoted, unreadable
from fte_sniff.formats.logs.own_rows import OwnLog
from fte_sniff.formats.logs.plain_hex import PlainLog, bytes_of_line, is_plain
from fte_sniff.formats.logs.text import (
    TextBlock,
    TextBlocks,
    encoding_of,
    lines_of,
    looks_like_text,
)

if TYPE_CHECKING:
    from datetime import date, tzinfo

    from fte_sniff.formats.logs.streams import LogStreams, Rows

Note = Callable[[str], None]

_MORE_LINES: Final = 2400
_CHECKED_AT: Final = (1, 2, 4, 8, 16, 32, 128, 600)
"""Lines of a stream after which it is decided what it is, if they show it."""
_EARLY_FRAMES: Final = 8
_LEAST_EVIDENCE: Final = 32
"""Lines that show more than plain hex."""
_RAW: Final = "add --input raw"
_BYTE_LIKE: Final = re.compile(rb"[0-9A-Fa-f]{2}(?![0-9A-Za-z])")
_SAMPLE_BYTES: Final = 40 << 10
"""Bytes of the first sample, at most; eight times as many if they do not decide."""
_LONGEST_SAMPLED: Final = 4096
_BLOCKS: Final = 4


@dataclass(frozen=True, slots=True)
class LogOptions:
    """What the user says of a log."""

    day: date | None = None
    """The date of the first time that has none."""
    zone: tzinfo | None = None
    """Of times without one; None for UTC."""
    start_ns: int | None = None
    """When the seconds of the log, or its bytes, began."""
    form: str | None = None
    """The extractor."""
    pattern: re.Pattern[bytes] | None = None
    """A regular expression with the groups `data`, and perhaps `time` and `dir`."""
    whole: bool = True
    """Whether the text is a log; else a paste, of which a part may be bytes."""


class LogForm(Protocol):
    """A kind of log, and what reading it has shown."""

    resolution_ns: int
    """Of its times."""
    frames: int
    """In the sample."""

    def ports(self, name: str) -> list[str]:
        """The ports of its rows, as far as the sample shows."""
        ...

    def read(self, block: TextBlock, streams: LogStreams, name: str) -> None:
        """Append the bytes of a block to the streams; raises InputTextError."""
        ...

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        ...

    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
        ...


class LogReader:
    """The rows of a log, whose format is decided by its first lines and a sample of the others."""

    def __init__(
        self,
        name: str,
        options: LogOptions | None = None,
        stream: BinaryIO | IO[bytes] | None = None,
        where: str | None = None,
    ) -> None:
        """A log.

        Args:
            name: of the file, and the port of its rows.
            options: what the user says of it.
            stream: it is read from there, once; None to open the file of that name.
            where: what messages begin with; None for the name and a colon.
        """
        self.name = name
        self.options = options or LogOptions()
        self._stream = stream
        self._where = f"{name}: " if where is None else where
        self._blocks: Iterator[TextBlock] | None = None
        self._form: LogForm | None = None
        self._file: BinaryIO | None = None

    @property
    def position(self) -> int:
        """Bytes of its file that were read so far; 0 of a stream, and after the end."""
        return 0 if self._file is None or self._file.closed else self._file.tell()

    @property
    def ports(self) -> list[str]:
        """The ports of its rows; reads the first lines."""
        form = self._prepared()
        return form.ports(self.name)

    @property
    def first_ns(self) -> int | None:
        """The time of the first row that has one, for which its start is read once more.

        None if no row near the start has one, or the log can be read only once.
        """
        if not self._can_be_read_again:
            return None
        rows = next(LogReader(self.name, self.options).rows(lambda _note: None), [])
        return next((row.t_ns for row in rows if row.t_ns is not None), None)

    @property
    def _can_be_read_again(self) -> bool:
        return self._stream is None and Path(self.name).is_file()

    @property
    def times(self) -> tuple[int, int] | None:
        """The earliest and latest time of its rows, for which it is read once more.

        Raises:
            UsageError: it can be read only once.
        """
        if not self._can_be_read_again:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        first = last = None
        try:
            for rows in LogReader(self.name, self.options).rows(lambda _note: None):
                if isinstance(rows, list):
                    known = [row.t_ns for row in rows if row.t_ns is not None]
                else:
                    known = rows.t_ns[rows.timed].tolist()
                if known:
                    first = min(known) if first is None else min(first, *known)
                    last = max(known) if last is None else max(last, *known)
        except InputTextError:
            pass  # reported when the rows are read
        return None if first is None or last is None else (first, last)

    def explain(self) -> list[str]:
        """The form, lanes, times and directions of the log, one line each."""
        return self._prepared().explain()

    def rows(self, note: Note) -> Iterator[Rows]:
        """Read the rows once; note at the end how the log was read.

        Raises:
            FileError: it cannot be read, or is empty.
            InputTextError: no bytes are found in it, or something in plain hex is not hex.
        """
        from fte_sniff.formats.logs.streams import LogStreams

        try:
            form = self._prepared()
            streams = LogStreams(form.resolution_ns)
            failed: InputTextError | None = None
            try:
                with self._opened() as blocks:
                    for block in blocks:
                        form.read(block, streams, self.name)
                        yield from streams.drain()
            except InputTextError as error:
                failed = error
            yield from streams.drain(final=True)
            if failed is not None:
                raise failed
        except InputTextError as error:
            raise InputTextError(f"{self._where}{error}") from error
        except OSError as error:
            raise unreadable(Path(self.name), error) from error
        if not len(streams):
            raise FileError(f"{self._where}is empty; there is nothing to decode")
        for text in (*streams.notes(ends=self.options.whole), *form.notes()):
            note(f"{self._where}{text}")

    @contextmanager
    def _opened(self) -> Iterator[Iterator[TextBlock]]:
        if self._blocks is not None:
            yield self._blocks
            return
        with Path(self.name).open("rb") as self._file:
            yield iter(TextBlocks(self._file))

    def _prepared(self) -> LogForm:
        if self._form is None:
            try:
                self._form = self._prepare()
            except OSError as error:
                raise unreadable(Path(self.name), error) from error
        return self._form

    def _prepare(self) -> LogForm:
        path = Path(self.name)
        if self._stream is None and path.is_file():
            with path.open("rb") as file:
                lines = _sample(file, path.stat().st_size)
            form = self._decided(lines, path.stat().st_mtime_ns)
        else:
            self._stream = self._stream or path.open("rb")
            form = self._decided_by_stream(self._stream)
        return form

    def _decided_by_stream(self, stream: BinaryIO | IO[bytes]) -> LogForm:
        """What a stream is, by as many of its first lines as show it."""
        blocks = iter(TextBlocks(stream))
        seen: list[TextBlock] = []
        lines: list[bytes] = []
        checks = list(_CHECKED_AT)
        form = None
        for block in blocks:
            seen.append(block)
            lines += [line[:_LONGEST_SAMPLED] for line in block.lines[: _MORE_LINES - len(lines)]]
            while form is None and checks and len(lines) >= checks[0]:
                form = self._decided_early(lines[: checks.pop(0)])
            if form is not None or len(lines) >= _MORE_LINES:
                break
        self._blocks = chain(seen, blocks)
        return form or self._decided(lines, None)

    def _decided_early(self, lines: list[bytes]) -> LogForm | None:
        if len(lines) < _LEAST_EVIDENCE:
            plain = self._decided_at_sight(lines)
            return plain if plain is not None and plain.certain else None
        try:
            form = self._decided(lines, None)
        except (InputTextError, FileError):
            return None
        return form if form.frames >= _EARLY_FRAMES else None

    def _decided_at_sight(self, lines: Sequence[bytes]) -> OwnLog | PlainLog | None:
        """The log, if its lines are this program's, or hex and nothing else."""
        if self.options.form is not None or self.options.pattern is not None:
            return None
        own = OwnLog()
        if own.recognise(lines):
            return own
        return PlainLog.by_sample(lines, self.options.start_ns)

    def _decided(self, lines: Sequence[bytes], written_ns: int | None) -> LogForm:
        """What the log is, by a sample.

        Raises:
            FileError: it is no text.
            InputTextError: there are no bytes in it.
        """
        options = self.options
        plain = self._decided_at_sight(lines)
        if isinstance(plain, OwnLog) or (plain is not None and plain.certain):
            return plain
        from fte_sniff.formats.logs.evidence_log import EvidenceLog

        found = EvidenceLog.by_sample(lines, options, self.name, written_ns)
        if plain is not None and (found is None or not found.better_than(plain.frames, plain.size)):
            return plain
        if found is None:
            if not looks_like_text(b"\n".join(lines)):
                raise FileError(f"{self._where}holds no text; if it holds raw bytes, {_RAW}")
            raise InputTextError(nothing_found(lines, options))
        return found


def _sample(file: BinaryIO, size: int) -> list[bytes]:
    """Lines of four blocks of a file, without what is cut; all of a small one."""
    encoding = encoding_of(file.read(_LONGEST_SAMPLED))
    part = _SAMPLE_BYTES // _BLOCKS
    if size <= _SAMPLE_BYTES:
        file.seek(0)
        return lines_of(file.read(), encoding)
    sample: list[bytes] = []
    for number in range(_BLOCKS):
        file.seek((size - part) * number // (_BLOCKS - 1) & ~1)  # even, for UTF-16
        found = lines_of(file.read(part), encoding)
        whole = found[1:] if number and len(found) > 2 else found
        if number < _BLOCKS - 1 and len(whole) > 1:
            whole = whole[:-1]
        sample += [line[:_LONGEST_SAMPLED] for line in whole]
    return sample


def pattern_of(text: str) -> re.Pattern[bytes]:
    """The regular expression of `--input-regex`.

    Raises:
        InputTextError: it is none, or has no group `data`.
    """
    try:
        pattern = re.compile(text.encode())
    except re.error as error:
        raise InputTextError(f"--input-regex: {quoted(text)}: {error}") from None
    if "data" not in pattern.groupindex:
        raise InputTextError("--input-regex: needs a group for the bytes, (?P<data>...)")
    return pattern


def nothing_found(lines: Sequence[bytes], options: LogOptions) -> str:
    """What to say of a text without frames."""
    wrong = next((n for n, line in enumerate(lines, 1) if not is_plain(line)), None)
    if (
        wrong is not None
        and all(is_plain(line) for line in lines[: wrong - 1])
        and not options.form
    ):
        try:
            bytes_of_line(lines[wrong - 1], wrong)
        except InputTextError as error:
            if wrong > 1 or len(lines) == 1:
                return f"no frames found; {error}"
    like = sorted(lines, key=lambda line: -len(_BYTE_LIKE.findall(line)))[:1]
    shown = like[0][:80].decode("utf-8", "replace").strip() if like else ""
    count = f"{len(lines):,} line" + ("" if len(lines) == 1 else "s")
    return (
        f"no frames found in {count}, in any form of writing bytes; the most byte-like line is"
        f" {quoted(shown)}; --form and --input-regex say where the bytes are"
    )
