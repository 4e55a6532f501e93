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
from fte_sniff.formats.text_blocks import TextBlock, first_words, is_text, sample, text_blocks

_SAMPLE_LINES: Final = tuple(2**power for power in range(12))
"""Lines of a sample of a stream."""


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

    @property
    def position(self) -> int:
        """Bytes of its file that were read so far; 0 of a stream, and after the end."""
        return 0 if self._file is None or self._file.closed else self._file.tell()

    def again(self) -> LogReader:
        """The same log from its start; raises UsageError if it can be read only once."""
        if not self.is_file:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        return LogReader(self.name, self.options)

    def read(self) -> Iterator[Iterator[StreamBytes]]:
        """Read the bytes once, a block of lines at a time; raises FileError."""
        form = self.form
        with self._located():
            for block in self._blocks():
                yield form.read(block, self.name)

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

    def _decided(self, lines: Sequence[bytes]) -> LogForm:
        """What the log is, by a sample: the kind with the most frames.

        Raises:
            FileError: it is no text.
            InputTextError: there are no bytes in it.
        """
        options, plain = self.options, None
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
            raise FileError(f"{self.where}holds no text; if it holds raw bytes, add --input raw")
        if best is None and not options.whole:
            return PlainLog()  # which names the first character that is no hex
        if best is None or (options.whole and best.is_chance):
            raise InputTextError(_nothing_found(lines))
        return best


def _nothing_found(lines: Sequence[bytes]) -> str:
    """What to say of a text without frames."""
    pairs = re.compile(rb"[0-9A-Fa-f]{2}(?![0-9A-Za-z])")
    like = max(lines, key=lambda line: len(pairs.findall(line)), default=b"")
    shown = quoted(like[:80].decode("utf-8", "replace").strip())
    return (
        f"no frames found in {len(lines):,} line{'' if len(lines) == 1 else 's'}, in any form of"
        f" writing bytes; the most byte-like line is {shown};"
        " --form and --input-regex say where the bytes are"
    )
