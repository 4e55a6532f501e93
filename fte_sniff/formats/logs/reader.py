r"""A log as bytes: plain hex, rows that this program wrote, or a text whose layout frames decide.

Plain hex is read strictly: a typing error is refused with its position. Accepted are digits in
pairs, together or apart, a lone digit (`AA 2 2`) at the start of a line or where no byte has a
leading zero, `0x`, `\x` or `$` before or `h` after a byte, any of `, ; : - |`, brackets and quotes
between, and comments. Own rows are tables, CSV and JSON lines; they come back with their ports and
times.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from itertools import chain
from pathlib import Path
from typing import IO, BinaryIO, Final

from fte_sniff.errors import FileError, InputTextError, UsageError, quoted, unreadable
from fte_sniff.formats.logs.evidence import Extractor, Hypothesis, Lane, Placed, label_of
from fte_sniff.formats.logs.text import (
    LATEST_NS,
    LONGEST_LINE,
    NO_TIME,
    LogForm,
    LogOptions,
    NulBlock,
    StreamBytes,
    TextBlock,
    first_words,
    is_text,
    sample,
    text_blocks,
)
from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.columns import COLUMNS, ISO_TIME, ColumnType, iso_time_ns

_BLANKS: Final = bytes.maketrans(b",:;-", b"    ")
_GAP: Final = rb"[\s,;:|\-\[\](){}\"'`<>]"
_PAIR: Final = rb"[0-9A-Fa-f]{2}"
_TOKEN: Final = (
    rb"(?s:(?:%b|\xe2\x96\xa1|(?<=%b)\.(?=%b|\Z)|#.*|//.*|/\*.*?(?:\*/|\Z)|\A```.*)++"
    rb"|(?:0[xX]|\$|&[hH]|\\x)?(?P<digits>(?:%b)++|(?<![0-9A-Fa-f])[0-9A-Fa-f](?=%b|\Z))"
    rb"(?:[hH](?![0-9A-Za-z]))?)"
) % (_GAP, _PAIR, _GAP, _PAIR, _GAP)
"""What is between bytes, or the digits of bytes."""
_SHORT: Final = rb"(?:0[xX]|\\x)?.{0,3}"
"""A byte, perhaps with a typing error."""
_MISTAKE: Final = rb"[0-9A-Fa-f].?|.[0-9A-Fa-f]"
"""A byte with one, beside pairs of digits."""
_PREFIX: Final = (
    rb"\s*(?:[0-9A-Fa-f]{4,16}(?::|\s{2,})\s*%b\b"
    rb"|\[?[\dT -]*\d:\d\d:\d\d\]?\s+(?:AA|aa|55)\b"
    rb"|[^0-9A-Za-z]*?(?:>|<[^0-9A-Za-z]))"
) % _PAIR
"""An address, a time or an arrow before bytes."""
_FEW_BYTES: Final = 100
_CHANCE: Final = 0.005
"""Share of many bytes in frames from which on they are evidence."""
_PLAIN_HEX: Final = Extractor("plain hex", "hex editors, xxd -p, fte-sniff")
_FIX: Final = (
    "write each byte as two hex digits, as in AA 01 01 03 E8 00 00 00 00 EE; # starts a comment"
)


def bytes_of_line(line: bytes, number: int = 1, column: int = 0) -> bytes:
    """The bytes of a line, or of a segment of a line after `column` bytes.

    Raises:
        InputTextError: something is not hex; the message names line, column and the character.
    """
    found, at, padded = bytearray(), 0, re.search(rb"\b0[0-9A-Fa-f]\b", line) is not None
    for token in re.finditer(_TOKEN, line):
        is_half = padded and found and len(token[0]) == 1 and token["digits"]
        if token.start() > at or is_half:
            break
        at = token.end()
        if digits := token["digits"]:
            found += bytes.fromhex(digits.decode().zfill(2))
    if at == len(line):
        return bytes(found)
    at += re.match(rb"[0-9A-Fa-f](?!%b|\Z)" % _GAP, line[at:]) is not None  # half a byte
    before, after = (text.decode("utf-8", "replace") for text in (line[:at][-12:], line[at:]))
    raise InputTextError(
        f"not hex: {after[0]!r} in line {number}, column {column + at + 1}:"
        f" {before}>>{after[0]}<<{after[1:12]} ({_FIX})"
    )


class PlainLog(LogForm):
    """A log that has hex and nothing else."""

    single = True

    def __init__(self, data: bytes = b"", *, is_certain: bool = False) -> None:
        """A log whose sample has these bytes."""
        self.found = Hypothesis(_PLAIN_HEX, [Lane({b"": slice(None)}, [Placed(0, 0, data)])])
        self.rank = self.found.rank
        self.is_certain = is_certain or self.rank[1]
        self.is_chance = self.found.size >= _FEW_BYTES and self.found.share < _CHANCE

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> PlainLog | None:
        """The log, if all lines of a sample are plain, but for typing errors in short words."""
        data, is_certain = b"", False
        comments = [found[0] for line in lines if (found := re.search(rb"(?:#|//).*", line))]
        timed = sum(masked(text) != text for text in comments)
        directions = {label_of("direction", text) for text in comments} - {None}
        if len(directions) > 1 or 2 * timed > len(lines):
            return None  # they say more of the bytes than plain hex does
        for line in lines:
            if re.match(_PREFIX, line):
                return None
            try:
                data += bytes_of_line(line)
            except InputTextError:
                words = [word for word in re.split(_GAP, line) if word]
                odd = [word for word in words if not re.fullmatch(_PAIR, word)]
                short, near = (all(re.fullmatch(x, own) for own in odd) for x in (_SHORT, _MISTAKE))
                is_certain |= near and 2 * len(odd) < len(words) and odd[:1] != words[:1]
                if label_of("direction", line) or masked(line) != line or not short:
                    return None
        numbers = re.findall(rb"\w+", b" ".join(lines))
        are_decimal = all(one.isdigit() and int(one) < 256 for one in numbers)
        if are_decimal and any(len(one) == 3 for one in numbers):
            return None
        has_digits = re.search(rb"[0-9A-Fa-f]|\A\Z", b"".join(lines).strip())
        return cls(data, is_certain=is_certain) if has_digits else None

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        data = bytearray()
        try:
            data += bytearray.fromhex(block.text.translate(_BLANKS).decode("latin-1"))
        except ValueError:  # other separators, or a mistake
            for number, line in enumerate(block.lines, block.first):
                data += bytes_of_line(line, number, block.column or 0)
        finally:
            if data:
                yield StreamBytes(name, bytes(data), [len(data)], [block.first])

    def notes(self) -> list[str]:
        """That frames are missing, in a log of more than a few bytes."""
        return ["no frames found; it is read as plain hex"] if self.is_chance else []

    def explain(self) -> list[str]:
        """What it is."""
        return [str(self.found)]


_OFFSET: Final = r"(?<!\S)\d+\s\s[ ?!~]\s\s"
_NAMES: Final = [column.name for column in COLUMNS]
_CELLS: Final = {
    ColumnType.REAL: r"[\d.]*",
    ColumnType.BOOL: "(?:true|false|)",
    ColumnType.INT: r"-?\d*",
}
"""Cells of CSV by type; those of other types are words, or quoted."""
_AFTER_RAW: Final = "".join(
    "," + _CELLS.get(column.type, r"(?:\"(?:[^\"]|\"\")*\"|[^,\"]*)")
    for column in COLUMNS[_NAMES.index("raw") + 1 :]
)
"""The cells behind `raw`; a row may lack them all."""
_OWN: Final[dict[str, tuple[str, str, Callable[[str], str]]]] = {
    "table": (
        r"\s*(?:time\s+)?(?:port\s+)?offset\s+kind\s+values\s+raw\b",
        rf"\s*(?:(?P<time>{ISO_TIME})\s)?(?P<port>)(?:.*?{_OFFSET}(?:[a-z_]+|-)\s.*?\s\s"
        r"(?P<raw>[0-9A-F]{2}(?: [0-9A-F]{2})*+)(?:\s\s+[a-z_,]+)?\s*\Z"
        rf"|(?<=Z\s)|(?<=[+-]\d\d:\d\d\s)|-\s|{_OFFSET})",
        str,
    ),
    "CSV": (
        ",".join(_NAMES[: _NAMES.index("offset") + 1]) + ",",
        rf"(?=\d{{4}}-|,)(?:(?P<time>{ISO_TIME})?,(?P<port>\"(?:[^\"]|\"\")*\"|[^,]*),"
        rf".*?,(?P<raw>(?:[0-9A-F]{{2}})+)(?:{_AFTER_RAW})?\s*\Z)?",
        lambda port: port[1:-1].replace('""', '"') if port[:1] == '"' else port,
    ),
    "JSON lines": (
        r'\s*\{"time": *[^,]*, *"port":',
        rf'\s*\{{(?:"time": *(?:null|"(?P<time>{ISO_TIME})"), *'
        r'"port": *(?P<port>"(?:[^"\\]|\\.)*"),'
        r'.*"raw": *"(?P<raw>(?:[0-9A-F]{2})+)"'
        r'(?:, *"\w+": *(?:"(?:[^"\\]|\\.)*"|[^,{}"]*))*\}\s*\Z)?',
        json.loads,
    ),
}
"""How own rows in a format begin, each row, and its port; a row without `raw` is cut."""


class OwnLog(LogForm):
    """Rows that this program wrote."""

    resolution_ns = 1
    is_certain = True

    def __init__(self, what: str, lines: Sequence[bytes]) -> None:
        """Rows in a format, of which the first lines are known."""
        self._what, self._first = what, TextBlock(b"\n".join(lines))

    @classmethod
    def by_sample(cls, lines: Sequence[bytes]) -> OwnLog | None:
        """The log, if the first line with text is one of this program's."""
        line = next((line for line in lines if line.strip()), b"").decode("utf-8", "replace")
        if re.search("[g-z]", line) is None:
            return None  # kinds and statuses have such letters; the patterns are slow to compile
        for what, (heading, row, _) in _OWN.items():
            found = re.match(row, line)
            if re.match(heading, line) or (found and found["raw"]):
                return cls(what, lines)
        return None

    def ports(self, name: str) -> list[str]:
        """Those of the first rows."""
        ports = dict[str, None]()
        with suppress(InputTextError):
            ports.update((row.port, None) for row in self.read(self._first, name))
        return [*ports] or [name]

    def read(self, block: TextBlock, name: str) -> Iterator[StreamBytes]:
        """See `LogForm`."""
        _, row, port_of = _OWN[self._what]
        streams = defaultdict[str, list[tuple[bytes, int, int]]](list)
        try:
            for number, line in enumerate(block.lines, block.first):
                found = re.match(row, line.decode("utf-8", "replace"))
                if found is None:
                    continue
                begin_ns = iso_time_ns(found["time"]) if found["time"] else NO_TIME
                if not found["raw"] or begin_ns is None:
                    raise InputTextError(
                        f"line {number}: this row of fte-sniff's {self._what} is cut or damaged;"
                        " pass the recording itself, or its rows with --format csv or jsonl"
                    )
                own = bytes.fromhex(found["raw"]), number, min(begin_ns, LATEST_NS)
                streams[port_of(found["port"]) or name].append(own)
        finally:
            for port, rows in streams.items():
                data, order, times = zip(*rows, strict=True)
                yield StreamBytes(port, b"".join(data), [*map(len, data)], order, times, first=True)

    def explain(self) -> list[str]:
        """What it is."""
        return [f"rows that fte-sniff wrote as {self._what}"]


_SAMPLE_LINES: Final = tuple(2**power for power in range(12))
"""Lines of a sample of a stream."""
_AT_ONCE: Final = 64
"""Lines of the first one, if they are there: enough to be certain."""


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
        size = 0
        for least in _SAMPLE_LINES:
            if least <= size:
                continue
            while len(lines) < least and (block := next(blocks, None)):
                seen.append(block)
                lines += map(first_words, block.lines[: _SAMPLE_LINES[-1]])
            size = max(least, min(len(lines), _AT_ONCE))
            yield lines[:size], len(lines) < least or least == _SAMPLE_LINES[-1]

    def explain(self) -> Iterator[str]:
        """Where it has its bytes, times and directions; of a refused log, what comes near.

        Raises:
            FileError: it cannot be read.
            InputTextError: it is refused.
        """
        try:
            yield from self.form.explain()
        except InputTextError:
            from fte_sniff.formats.logs.layout import candidates

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
        from fte_sniff.formats.logs.layout import EvidenceLog

        written_ns = Path(self.name).stat().st_mtime_ns if self.is_file else None
        blocks = self._file_blocks if self.is_file else lambda: iter(())
        found = EvidenceLog.by_sample(lines, options, self.name, written_ns, blocks)
        best = max(filter(None, (plain, found)), key=lambda one: one.rank, default=None)
        if best is None and not is_text(b"\n".join(lines)):
            raise FileError(f"{self.where}{_not_text(lines)}")
        if best is None and not options.whole:
            return PlainLog()  # which names the first character that is not hex
        if best is None or (options.whole and best.is_chance):
            raise InputTextError(_nothing_found(lines))
        return best


def _nothing_found(lines: Sequence[bytes]) -> str:
    """What to say of a text without frames."""
    from fte_sniff.formats.logs.layout import likely_form

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
