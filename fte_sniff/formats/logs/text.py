"""Text of a log as blocks of lines; and what every kind of log makes of it, the bytes of streams.

UTF-16 and GBK become UTF-8; lines that are neither stay as they are. Colours and NUL are removed. A
line of more than 16 MB comes in segments, so that memory does not depend on the length of lines. A
block of NUL, which a power cut leaves in a file, ends a line and is reported.
"""

from __future__ import annotations

import codecs
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Final, NamedTuple

from fte_sniff.protocol import DEFAULT_BAUD

if TYPE_CHECKING:
    import re
    from datetime import date, tzinfo

    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.int64]


BLOCK_BYTES: Final = 1 << 20
"""Bytes of one read at most; a pipe or terminal returns what is available."""
LONGEST_LINE: Final = 16 << 20
"""Bytes of a line that is read as a whole; a longer one comes in segments."""
_SAMPLES: Final = 4
"""Blocks of a sample of a file."""
_SAMPLE_BYTES: Final = 10 << 10
"""Bytes of each block of a sample of a file."""
_LONGEST_SAMPLED: Final = 4096
_SNIFFED: Final = 4096
"""Bytes that show the encoding."""
_ESCAPE: Final = rb"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|[@-Z\\-_])"
"""A colour or another escape sequence."""
_LONGEST_ESCAPE: Final = 32
_FEWEST_NULS: Final = 16
"""NUL bytes in a row from which on they are a block; some programs write one after each text."""
_CONTROL: Final = rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]"
_PLAIN: Final = {"\ufeff": "", "，": ",", "：": ":", "；": ";", "\u3000": " ", "\xa0": " "}


class NulBlock(NamedTuple):
    """Consecutive NUL bytes."""

    offset: int
    """Of the first one in the stream."""
    length: int


@dataclass
class TextBlock:
    """Consecutive lines, or a segment of a very long line."""

    text: bytes
    first: int = 1
    """The number of the first line, from 1."""
    column: int | None = None
    """Of a segment: bytes of the line before it."""
    skipped: NulBlock | None = None
    """What was between it and the text before it."""

    @cached_property
    def count(self) -> int:
        """How many lines end in it."""
        return self.text.count(b"\n")

    @cached_property
    def lines(self) -> list[bytes]:
        """The lines without their ends."""
        return self.text.removesuffix(b"\n").split(b"\n") if self.text else []


def is_text(first: bytes) -> bool:
    """Whether a stream that begins so is text; raw bytes of the wire always hold control codes."""
    if _encoding_of(first) != "utf-8" or first.startswith(codecs.BOM_UTF8):
        return True
    with_digits = re.search(rb"[0-9A-Fa-f]{2}", first) and _decoded(first, "gb18030")
    return not re.search(_CONTROL, first) and bool(with_digits or _decoded(first, "utf-8"))


def _encoding_of(first: bytes) -> str:
    """The encoding: UTF-16 by its mark, or by the zeros between its letters; else utf-8."""
    first = re.split(rb"\0{%d}" % _FEWEST_NULS, first[_nuls_before(first) & ~1 :], maxsplit=1)[0]
    # The end may be within a block of NUL, too short to be one; keep the zero of the last letter.
    size = len(first.rstrip(b"\0"))
    first = first[: size + size % 2]
    for encoding, mark, low in (
        ("utf-16-le", codecs.BOM_UTF16_LE, 0),
        ("utf-16-be", codecs.BOM_UTF16_BE, 1),
    ):
        letters, high = first[low::2], first[1 - low :: 2]
        zeros = 0 not in letters and 2 * high.count(0) >= max(len(high), 1)
        if zeros or first.startswith(mark):
            return encoding
    return "utf-8"


def _lines_of(data: bytes, encoding: str) -> list[bytes]:
    """The lines of a part of a text; the first and the last may be cut."""
    text = data if encoding == "utf-8" else data.decode(encoding, "replace").encode()
    text = re.sub(rb"\0{%d,}" % _FEWEST_NULS, b"\n", text)
    return TextBlock(_clean(text)).lines


def text_blocks(stream: BinaryIO | IO[bytes]) -> Iterator[TextBlock]:
    """The lines of a stream."""
    read = getattr(stream, "read1", stream.read)
    nuls, data = 0, b""
    while len(data) - _nuls_before(data) < 4 and (more := read(BLOCK_BYTES)):
        data += more
        far = max(0, _nuls_before(data) - _FEWEST_NULS & ~1)
        nuls, data = nuls + far, data[far:]
    encoding = _encoding_of(data[: 2 * _FEWEST_NULS + _SNIFFED])
    decoder = None if encoding == "utf-8" else codecs.getincrementaldecoder(encoding)("replace")
    reads = chain([data], iter(lambda: read(BLOCK_BYTES), b"")) if data else ()
    lines = _Lines()
    for part in _parts(reads, nuls, 1 if decoder is None else 2):
        skipped = part if isinstance(part, NulBlock) else None
        text = b"" if isinstance(part, NulBlock) else part
        lines.append(text if decoder is None else decoder.decode(text, not text).encode())
        yield from lines.blocks(is_end=not text)
        if skipped is not None:
            yield TextBlock(b"", lines.number, skipped=skipped)


def _nuls_before(data: bytes) -> int:
    return len(data) - len(data.lstrip(b"\0"))


def _parts(reads: Iterable[bytes], nuls: int, unit: int) -> Iterator[bytes | NulBlock]:
    """What is read, and blocks of NUL between; at the end `b""`.

    Args:
        reads: the stream behind its first `nuls` bytes, which are NUL.
        nuls: how many they are.
        unit: bytes of a code unit; those of a block are whole units.
    """
    at = nuls
    for data in reads:
        begin = 0
        if nuls >= _FEWEST_NULS and data[:1] != b"\0":
            yield NulBlock(at - nuls, nuls)
            data, at, nuls = b"\0" * (at % unit) + data, at - at % unit, 0
        runs = re.finditer(rb"\A\0+|\0{%d,}|\0+\Z" % _FEWEST_NULS, data)
        for run in runs if b"\0" in data else ():  # the search is slow
            was_block = run.start() == 0 and nuls >= _FEWEST_NULS
            nuls = len(run[0]) + (nuls if run.start() == 0 else 0)
            if nuls >= _FEWEST_NULS:
                stop = run.start() + (0 if was_block else (at + run.start()) % unit)
                if begin < stop:
                    yield data[begin:stop]
                begin = run.end()
                if begin < len(data):
                    yield NulBlock(at + begin - nuls, nuls)
                    begin -= (at + begin) % unit
        at += len(data)
        nuls = nuls if data.endswith(b"\0") else 0
        if begin < len(data):
            yield data[begin:]
    if nuls >= _FEWEST_NULS:
        yield NulBlock(at - nuls, nuls)
    yield b""


class _Lines:
    """Cuts a text into blocks of whole lines, or segments of a very long one."""

    def __init__(self) -> None:
        self.number = 1
        """Of the first line that is not in a block."""
        self._column: int | None = None
        self._pending = b""

    def append(self, text: bytes) -> None:
        """Append text as UTF-8."""
        self._pending += text

    def blocks(self, *, is_end: bool) -> Iterator[TextBlock]:
        """The blocks up to the last complete line; at the end of a text, all of it."""
        while self._pending:
            pending, column = self._pending, self._column
            end = len(pending) if is_end else _end_of_lines(pending)
            is_cut = not end and len(pending) >= LONGEST_LINE
            if is_cut:
                end, column = _end_of_words(pending), column or 0
            elif end and column is not None:  # the end of a very long line is a segment too
                end = pending.find(b"\n") + 1 or end
            if not end:
                return
            text = _clean(pending[:end])
            is_open = not text.endswith(b"\n")
            yield (block := TextBlock(text + b"\n" * (is_open and not is_cut), self.number, column))
            self.number += block.count - (is_open and not is_cut)
            self._column = column + end if is_cut and column is not None else None
            self._pending = pending[end:]


def sample(path: Path) -> list[bytes]:
    """Lines of evenly spaced blocks of a file, without what is cut; all of a small one."""
    found, size = list[bytes](), path.stat().st_size
    with path.open("rb") as file:
        first = _skip_nuls(file)
        encoding = _encoding_of(file.read(_SNIFFED))
        file.seek(0)
        if size <= _SAMPLES * _SAMPLE_BYTES:
            return _lines_of(file.read(), encoding)
        last = _SAMPLES - 1
        for number in range(_SAMPLES):
            at = first + max(0, size - first - _SAMPLE_BYTES) * number // last
            file.seek(at & ~1)  # even, for UTF-16
            _skip_nuls(file)
            lines = _lines_of(file.read(_SAMPLE_BYTES), encoding)
            if len(lines) > 2:
                lines = lines[number > 0 : len(lines) - (number < last)]
            elif number and lines:  # within a very long line
                lines[:1] = lines[0].split(None, 1)[-1:]
            found += map(first_words, lines)
    return found


def _skip_nuls(file: BinaryIO) -> int:
    """Skip NUL bytes, an even number of them; returns the offset."""
    at = file.tell()
    while data := file.read(BLOCK_BYTES):
        nuls = _nuls_before(data)
        at += nuls
        if nuls < len(data):
            break
    return file.seek(at & ~1)


def first_words(line: bytes) -> bytes:
    """The first words of a long line."""
    end = line.rfind(b" ", 0, _LONGEST_SAMPLED) if len(line) > _LONGEST_SAMPLED else -1
    return line[: end if end > 0 else _LONGEST_SAMPLED]


def _decoded(data: bytes, encoding: str) -> bytes | None:
    """The text as UTF-8, whose end may be cut; None if it has another encoding."""
    with suppress(UnicodeDecodeError):
        return codecs.getincrementaldecoder(encoding)().decode(data).encode()
    return None


def _clean(data: bytes) -> bytes:
    """Lines as UTF-8, without colours and NUL, with plain commas, colons and line ends."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    data = _without_escapes(data.replace(b"\0", b""))
    if data.isascii():
        return data
    if _decoded(data, "utf-8") is None:
        lines = data.splitlines(keepends=True)
        data = b"".join(_decoded(x, "utf-8") or _decoded(x, "gb18030") or x for x in lines)
    for character, plain in _PLAIN.items():
        data = data.replace(character.encode(), plain.encode())
    return data


def _without_escapes(data: bytes) -> bytes:
    """Remove escape sequences from one part after another; each takes memory while it is found."""
    if b"\x1b" not in data:
        return data
    parts, begin = list[bytes](), 0
    while begin < len(data):
        stop = begin + _SNIFFED * _LONGEST_ESCAPE
        last = data.rfind(b"\x1b", stop - _LONGEST_ESCAPE, stop)
        stop = last if last > begin else stop
        parts.append(re.sub(_ESCAPE, b"", data[begin:stop]))
        begin = stop
    return b"".join(parts)


def _end_of_lines(data: bytes) -> int:
    """Where the last complete line ends; a carriage return at the end may be half of a line end."""
    return max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1


def _end_of_words(data: bytes) -> int:
    """Where a very long line can be cut: between two words, or two pairs of digits."""
    word = re.search(rb"[0-9A-Za-z]*\Z", data[-64:])
    size = len(word[0]) if word else 0
    return len(data) - size if size < 64 else len(data) & ~1


LATEST_NS: Final = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
NO_TIME: Final = -(2**63)


class LogOptions(NamedTuple):
    """What the user says of a log."""

    day: date | None = None
    """The date of the first time that has none."""
    zone: tzinfo | None = None
    """Of times without one; None for UTC."""
    start_ns: int | None = None
    """When the seconds of the log, or its bytes, began."""
    form: str | None = None
    """The extractor."""
    pattern: re.Pattern[str] | None = None
    """A regular expression with the groups `data`, and perhaps `time` and `dir`."""
    whole: bool = True
    """Whether the text is a log; else a paste, of which a part may be bytes."""
    samplerate: int | None = None
    """Samples per second of a logic analyser, whose numbers are then times."""
    baud: int = DEFAULT_BAUD
    """Bits per second, for the time that bytes take."""


class StreamBytes(NamedTuple):
    """Bytes of consecutive lines of one stream of a log."""

    port: str
    data: bytes
    sizes: Sequence[int] | Array = ()
    """How many bytes are of each line."""
    order: Sequence[int] | Array = ()
    """Numbers that rise with the lines; none if the log is one stream without times."""
    times: Sequence[int] | Array | None = None
    """The times of the lines, nanoseconds since 1970 or `NO_TIME`; None if none has one."""
    gaps: Sequence[int] = ()
    """Offsets in the bytes where the log leaves out others, so that no frame goes on."""
    first: bool = False
    """Whether the first byte of a line began at its time; else the last one had arrived."""
    label: str | None = None
    """Of the stream: a direction, which its frames can contradict, or any other."""


class LogForm(ABC):
    """A kind of log: how blocks of lines become the bytes of streams."""

    resolution_ns: int | None = None
    """Of its times; None if it has none."""
    single: bool = False
    """Whether its rows have one port, whatever it says of directions."""
    rank: tuple[int, bool] = 0, False
    """Whole frames in its sample, and whether there is almost nothing else."""
    is_certain: bool = False
    """Whether its sample shows that no other kind of log is better."""
    is_chance: bool = False
    """Whether there are too few frames in its sample."""

    share: float | None = None
    """Of the bytes in its sample, how many are in frames; None where frames do not decide."""

    def ports(self, name: str) -> list[str]:
        """The ports of its rows, as far as the sample shows."""
        return [name]

    @property
    def is_one_stream(self) -> bool:
        """Whether its bytes follow each other, in one stream without times."""
        return self.single and self.resolution_ns is None

    @abstractmethod
    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """The bytes of a block of the log of this name; raises InputTextError after the others."""

    def rest(self, name: str) -> Iterator[StreamBytes]:
        """The bytes that waited for a time below them, at the end of the log."""
        del name
        return iter(())

    def notes(self) -> list[str]:
        """How it was read, one line each."""
        return []

    @abstractmethod
    def explain(self) -> list[str]:
        """The form, lanes, times and directions, one line each."""
