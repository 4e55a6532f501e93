"""A log as bytes: plain hex, rows that this program wrote, or a text whose layout frames decide."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from itertools import chain
from pathlib import Path
from typing import IO, BinaryIO, Final

from fte_sniff.errors import FileError, InputTextError, UsageError, quoted, unreadable
from fte_sniff.formats.log_form import LogForm, LogOptions, StreamBytes
from fte_sniff.formats.plain_log import OwnLog, PlainLog
from fte_sniff.formats.text_blocks import (
    LONGEST_LINE,
    NulBlock,
    TextBlock,
    first_words,
    is_text,
    sample,
    text_blocks,
)

_SAMPLE_LINES: Final = tuple(2**power for power in range(12))
"""Lines of a sample of a stream."""


class _Skipped:
    """What was skipped while a log was read, in the memory of one block of it."""

    def __init__(self) -> None:
        self._first: NulBlock | None = None
        self._blocks = self._bytes = 0

    def append(self, block: NulBlock) -> None:
        """Append a block of NUL."""
        self._first = self._first or block
        self._blocks += 1
        self._bytes += block.length

    def notes(self) -> Iterator[str]:
        """What was skipped, in a line."""
        if self._first is not None:
            offset, length = self._first
            one = f"{length:,} NUL bytes at offset {offset:,} are skipped"
            several = (
                f"{self._blocks:,} blocks of NUL bytes are skipped, {self._bytes:,} bytes in all,"
                f" the first {length:,} at offset {offset:,}"
            )
            cause = "a power cut leaves them in files that were being written"
            yield f"{one if self._blocks == 1 else several}; {cause}"


class LogReader:
    """The bytes of a log, whose kind is decided by its first lines and a sample of the others."""

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
        self._sampled: Sequence[bytes] = ()
        """The lines that show what it is."""
        self._skipped = _Skipped()
        self._long_line: int | None = None
        """The number of the first line that came in segments."""

    @property
    def position(self) -> int:
        """Bytes of its file that were read so far; 0 of a stream, and after the end."""
        return 0 if self._file is None or self._file.closed else self._file.tell()

    def again(self) -> LogReader:
        """This log from its start; raises UsageError if it can be read only once."""
        if not self.is_file:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        return LogReader(self.name, self.options)

    def read(self) -> Iterator[Iterator[StreamBytes] | None]:
        """Read the bytes once, a block of lines at a time; None where some may be missing.

        Raises FileError.
        """
        form = self.form
        with self._located():
            for block in self._blocks():
                if block.skipped is not None:
                    self._skipped.append(block.skipped)
                    yield None
                    continue
                if block.column is not None and self._long_line is None:
                    self._long_line = block.first
                yield form.read(block, self.name)
            yield form.rest(self.name)

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        return [*self._skipped.notes(), *self.form.notes()]

    def nothing_read(self) -> FileError:
        """The error of a log that was read without finding a byte."""
        if self._long_line is not None:
            long = f"line {self._long_line:,} is longer than {LONGEST_LINE >> 20} MB"
            return FileError(
                f"{self.where}{long}, and such a line is read only if it is plain hex;"
                " write each record on a line of its own"
            )
        for skipped in self._skipped.notes():
            return FileError(f"{self.where}holds no bytes to decode; {skipped}")
        return FileError(f"{self.where}is empty; there is nothing to decode")

    @property
    def is_file(self) -> bool:
        """Whether it can be read again."""
        return self._stream is None and Path(self.name).is_file()

    def _file_blocks(self) -> Iterator[TextBlock]:
        with Path(self.name).open("rb") as self._file:
            yield from text_blocks(self._file)

    @contextmanager
    def _located(self) -> Iterator[None]:
        """Name the log in messages of errors."""
        try:
            yield
        except InputTextError as error:
            raise InputTextError(f"{self.where}{error}") from error
        except OSError as error:
            raise unreadable(Path(self.name), error) from error

    @property
    def form(self) -> LogForm:
        """What it is, by the first sample that is certain, or the last; reads the first lines.

        Raises:
            FileError: it cannot be read.
            InputTextError: no bytes are found in it.
        """
        with self._located():
            for lines, is_last in self._samples() if self._form is None else ():
                with nullcontext() if is_last else suppress(InputTextError, FileError):
                    form = self._decided(lines)
                    if is_last or form.is_certain:
                        self._form = form
                        break
        assert self._form is not None
        return self._form

    def _samples(self) -> Iterator[tuple[list[bytes], bool]]:
        """Growing samples of the lines, and whether each is the last."""
        path = Path(self.name)
        if self.is_file:
            yield sample(path), True
            return
        self._stream = self._stream or path.open("rb")
        blocks, seen, lines = text_blocks(self._stream), list[TextBlock](), list[bytes]()
        self._blocks = lambda: chain(seen, blocks)
        for count in _SAMPLE_LINES:
            while len(lines) < count and (block := next(blocks, None)):
                seen.append(block)
                lines += map(first_words, block.lines[: _SAMPLE_LINES[-1]])
            yield lines[:count], len(lines) < count or count == _SAMPLE_LINES[-1]

    def explain(self) -> Iterator[str]:
        """Where it has its bytes, times and directions; of a refused log, what comes near.

        Raises:
            FileError: it cannot be read.
            InputTextError: it is refused.
        """
        try:
            yield from self.form.explain()
        except InputTextError:
            from fte_sniff.formats.logs.evidence_log import candidates

            yield from candidates(self._sampled)
            raise

    def _decided(self, lines: Sequence[bytes]) -> LogForm:
        """What the log is, by a sample: the kind with the most frames.

        Raises:
            FileError: it is not text.
            InputTextError: no bytes are in it.
        """
        options, plain, self._sampled = self.options, None, lines
        if options.form is None and options.pattern is None:
            plain = OwnLog.by_sample(lines) or PlainLog.by_sample(lines)
            if plain is not None and plain.is_certain:
                return plain
        from fte_sniff.formats.logs.evidence_log import EvidenceLog

        written_ns = Path(self.name).stat().st_mtime_ns if self.is_file else None
        blocks = self._file_blocks if self.is_file else lambda: iter(())
        found = EvidenceLog.by_sample(lines, options, self.name, written_ns, blocks)
        best = max(filter(None, (plain, found)), key=lambda one: one.rank, default=None)
        if best is None and not is_text(b"\n".join(lines)):
            raise FileError(f"{self.where}{_not_text(lines)}")
        if best is None and not options.whole:
            return PlainLog()  # which names the first character that is no hex
        if best is None or (options.whole and best.is_chance):
            raise InputTextError(_nothing_found(lines))
        return best


def _nothing_found(lines: Sequence[bytes]) -> str:
    """What to say of a text without frames."""
    from fte_sniff.formats.logs.evidence_log import likely_form

    nothing = (
        f"no frames found in {len(lines):,} line{'' if len(lines) == 1 else 's'}, in any form of"
        " writing bytes;"
    )
    if like := likely_form(lines):
        name = like.extractor.name
        return (
            f'{nothing} {like.size:,} bytes of its first lines are in the form "{name}", so the'
            f' baud rate or the protocol may be another; --form "{name}" reads them anyway'
        )
    pairs = re.compile(rb"[0-9A-Fa-f]{2}(?![0-9A-Za-z])")
    like_bytes = max(lines, key=lambda line: len(pairs.findall(line)), default=b"")
    shown = quoted(like_bytes[:80].decode("utf-8", "replace").strip())
    return (
        f"{nothing} the most byte-like line is {shown};"
        " --form and --input-regex say where the bytes are"
    )


def _not_text(lines: Sequence[bytes]) -> str:
    """What to say of a file that is not text, or has bytes as characters in its text."""
    data = b"\n".join(lines)
    words = sum(map(len, re.findall(rb"[ -~]{4,}", data)))
    replaced = "\ufffd".encode()
    if len(lines) > 1 and data.count(replaced) > len(lines):
        return (
            "holds \ufffd where a program could not show bytes as characters, so they are lost;"
            " record again with a display of hex"
        )
    if len(lines) > 1 and 4 * words > len(data):
        return (
            "holds bytes as characters among text, which cannot be separated; record again with a"
            " display of hex, or add --input raw to read all of it as bytes"
        )
    return "holds no text; if it holds raw bytes, add --input raw"
