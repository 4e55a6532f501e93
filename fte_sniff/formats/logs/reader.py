"""A log as rows: plain hex, rows that this program wrote, or a text whose layout frames decide."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Final

from fte_sniff.errors import FileError, InputTextError, UsageError, quoted, unreadable
from fte_sniff.formats.logs.evidence import chance_level, frames_in
from fte_sniff.formats.logs.log_form import LogForm, StreamBytes
from fte_sniff.formats.logs.plain import OwnLog, PlainLog, bytes_of_line, is_plain
from fte_sniff.formats.logs.text import (
    TextBlock,
    TextBlocks,
    encoding_of,
    lines_of,
    looks_like_text,
)
from fte_sniff.protocol import DEFAULT_BAUD

if TYPE_CHECKING:
    from datetime import date, tzinfo


Note = Callable[[str], None]

_CHECKED_AT: Final = (1, 2, 4, 8, 16, 32, 128, 600, 2400)
"""Lines of a stream after which it is decided what it is, if they show it."""
_EARLY_FRAMES: Final = 8
_LEAST_EVIDENCE: Final = 32
"""Lines that show more than plain hex."""
_SAMPLE_BYTES: Final = 10 << 10
"""Bytes of each of the four blocks of a sample."""
_LONGEST_SAMPLED: Final = 4096


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
    baud: int = DEFAULT_BAUD
    """Bits per second, for the time that bytes take."""


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
        self.name, self.options = name, options or LogOptions()
        self._stream = stream
        self.where = f"{name}: " if where is None else where
        self._blocks: Callable[[], Iterator[TextBlock]] = self._file_blocks
        self._form: LogForm | None = None
        self._file: BinaryIO | None = None

    @property
    def position(self) -> int:
        """Bytes of its file that were read so far; 0 of a stream, and after the end."""
        return 0 if self._file is None or self._file.closed else self._file.tell()

    @property
    def ports(self) -> list[str]:
        """The ports of its rows; reads the first lines."""
        return self.form.ports(self.name)

    def again(self) -> LogReader:
        """The same log from its start; raises UsageError if it can be read only once."""
        if not self.is_file:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        return LogReader(self.name, self.options)

    def explain(self) -> list[str]:
        """The form, lanes, times and directions of the log, one line each."""
        return self.form.explain()

    def read(self) -> Iterator[Iterator[StreamBytes]]:
        """Read the bytes once, a block of lines at a time; raises FileError."""
        form = self.form
        try:
            for block in self._blocks():
                yield form.read(block, self.name)
        except OSError as error:
            raise unreadable(Path(self.name), error) from error

    @property
    def is_file(self) -> bool:
        """Whether it can be read again."""
        return self._stream is None and Path(self.name).is_file()

    def _file_blocks(self) -> Iterator[TextBlock]:
        with Path(self.name).open("rb") as self._file:
            yield from TextBlocks(self._file)

    @property
    def form(self) -> LogForm:
        """What it is; reads the first lines.

        Raises:
            FileError: it cannot be read.
            InputTextError: no bytes are found in it.
        """
        try:
            self._form = self._form or self._prepare()
        except InputTextError as error:
            raise InputTextError(f"{self.where}{error}") from error
        except OSError as error:
            raise unreadable(Path(self.name), error) from error
        return self._form

    def _prepare(self) -> LogForm:
        path = Path(self.name)
        if self.is_file:
            return self._decided(_sample(path), path.stat().st_mtime_ns)
        self._stream = self._stream or path.open("rb")
        blocks, seen, lines = iter(TextBlocks(self._stream)), list[TextBlock](), list[bytes]()
        self._blocks = lambda: chain(seen, blocks)
        checks = list(_CHECKED_AT)
        for block in blocks:
            seen.append(block)
            lines += [line[:_LONGEST_SAMPLED] for line in block.lines[: checks[-1] - len(lines)]]
            while checks and len(lines) >= checks[0]:
                first = lines[: checks.pop(0)]
                form: LogForm | None = self._decided_at_sight(first)
                many = len(first) >= _LEAST_EVIDENCE
                with suppress(InputTextError, FileError):
                    form = self._decided(first, None) if many else form
                    if form and (form.is_certain or (many and form.frames >= _EARLY_FRAMES)):
                        return form
            if not checks:
                break
        return self._decided(lines, None)

    def _decided_at_sight(self, lines: Sequence[bytes]) -> OwnLog | PlainLog | None:
        """The log, if its lines are this program's, or hex and nothing else."""
        if self.options.form is not None or self.options.pattern is not None:
            return None
        return OwnLog.by_sample(lines) or PlainLog.by_sample(lines)

    def _is_chance(self, plain: PlainLog) -> bool:
        """Whether plain hex has no frames in the sample, and few in the first block."""
        if not (self.options.whole and plain.is_chance):
            return False
        block = next(iter(self._file_blocks()), None) if self.is_file else None
        digits = re.sub(rb"[^0-9A-Fa-f]", b"", block.text if block else b"")
        data = bytes.fromhex(digits[: len(digits) & ~1].decode())
        return len(frames_in(data)) <= 2 * chance_level(data) + 2

    def _decided(self, lines: Sequence[bytes], written_ns: int | None) -> LogForm:
        """What the log is, by a sample.

        Raises:
            FileError: it is no text.
            InputTextError: there are no bytes in it.
        """
        plain = self._decided_at_sight(lines)
        if plain is not None and plain.is_certain:
            return plain
        from fte_sniff.formats.logs.evidence_log import EvidenceLog

        blocks = self._file_blocks if self.is_file else lambda: iter(())
        found = EvidenceLog.by_sample(lines, self.options, self.name, written_ns, blocks)
        if isinstance(plain, PlainLog) and not (
            found and found.better_than(plain.frames, plain.size)
        ):
            if self._is_chance(plain):
                raise InputTextError(
                    f"no frames found in {plain.size:,} bytes of plain hex, which is chance;"
                    ' --form "hex pairs" or "hex digits" reads it all the same'
                )
            return plain
        if found is None and not looks_like_text(b"\n".join(lines)):
            raise FileError(f"{self.where}holds no text; if it holds raw bytes, add --input raw")
        if found is None:
            raise InputTextError(f"no frames found{_nothing_found(lines, self.options)}")
        return found


def _sample(path: Path) -> list[bytes]:
    """Lines of four blocks of a file, without what is cut; all of a small one."""
    size = path.stat().st_size
    with path.open("rb") as file:
        encoding = encoding_of(file.read(_LONGEST_SAMPLED))
        file.seek(0)
        if size <= 4 * _SAMPLE_BYTES:
            return lines_of(file.read(), encoding)
        sample: list[bytes] = []
        for number in range(4):
            file.seek((size - _SAMPLE_BYTES) * number // 3 & ~1)  # even, for UTF-16
            lines = lines_of(file.read(_SAMPLE_BYTES), encoding)
            if len(lines) > 2:
                lines = lines[number > 0 : len(lines) - (number < 3)]
            elif number and len(lines) < 2:
                continue  # within a very long line
            sample += [line[:_LONGEST_SAMPLED] for line in lines]
    return sample


def _nothing_found(lines: Sequence[bytes], options: LogOptions) -> str:
    """What to say of a text without frames."""
    number = next((n for n, line in enumerate(lines, 1) if not is_plain(line)), 1)
    if not options.form and (number > 1 or len(lines) == 1):
        try:
            bytes_of_line(b"".join(lines[number - 1 : number]), number)
        except InputTextError as error:
            return f"; {error}"
    like = max(
        lines,
        key=lambda line: len(re.findall(rb"[0-9A-Fa-f]{2}(?![0-9A-Za-z])", line)),
        default=b"",
    )
    shown = quoted(like[:80].decode("utf-8", "replace").strip())
    count = f"{len(lines):,} line" + ("" if len(lines) == 1 else "s")
    return (
        f" in {count}, in any form of writing bytes; the most byte-like line is {shown};"
        " --form and --input-regex say where the bytes are"
    )
