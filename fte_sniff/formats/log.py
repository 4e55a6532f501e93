r"""A text log of another program as chunks of bytes.

    [12:00:01.345] RX: 55 01 01 03 E8 00 00 00 0F EE
     ----time----  way ------------data-------------

Runs of bytes in a line are its data, the first time in it is when they were read, and a word such
as TX or RX names the wire. A line without data is a heading: its time and its way hold for the
lines below. The first lines decide the form of the bytes, and the *lanes* that hold data: a lane is
the word before the bytes, with the sign between two of them. Where no frame is, there are no data:

    RX: 55 01 01 03 E8 00 00 00 0F EE   address: 3f fb 42 80
    --- lane, with frames                        lane without

`--input-regex` reads what no form fits. `plain_hex` reads hex without any other text.
"""

from __future__ import annotations

import codecs
import re
import select
from binascii import a2b_base64
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import chain, product
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, NoReturn

from fte_sniff.errors import FileError, InputTextError, quoted, unreadable
from fte_sniff.formats.known_files import refuse_results
from fte_sniff.formats.log_text import LogText, too_long
from fte_sniff.formats.log_times import LogClock, LogOptions, style_of
from fte_sniff.formats.plain_hex import is_hex_line, is_plain_hex, plain_hex, plain_pieces
from fte_sniff.platform import POSIX
from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    Chunk,
    Direction,
    byte_time_ns,
)
from fte_sniff.protocol.spec import KINDS, TAIL

# Forms of bytes


class Form(NamedTuple):
    """A form in which programs write bytes."""

    name: str
    run: re.Pattern[str]
    """Consecutive bytes; the first group, if any, is the sign between two of them."""
    bytes_of: Callable[[str], bytes]
    """Reads a run; raises ValueError if it is not one."""

    @property
    def is_numeric(self) -> bool:
        """Whether its runs are not found in any text."""
        return self.name not in ("quoted escapes", "base64")


_PAIR: Final = re.compile(r"(?:0[xX]|16#|&[hH])?([0-9A-Fa-f]{2})")


_DIGITS: Final = re.compile(r"-?\d+")


def _hex(run: str) -> bytes:
    try:
        return bytes.fromhex(run)
    except ValueError:
        return bytes.fromhex("".join(_PAIR.findall(run)))


def _unpadded(run: str) -> bytes:
    return bytes(int(token, 16) for token in re.findall(r"[0-9A-Fa-f]+", run.replace("0x", "")))


def _decimal(run: str) -> bytes:
    values = [*map(int, _DIGITS.findall(run))]
    if min(values) < 0:
        values = [value % 256 if value >= -128 else value for value in values]
    return bytes(values)


def _octal(run: str) -> bytes:
    tokens = run.split()
    size = 2 if len(tokens[0]) > len("377") else 1
    return b"".join(int(token, 8).to_bytes(size, "little") for token in tokens)


def _bits(run: str) -> bytes:
    return bytes(int(token, 2) for token in run.split())


_UNESCAPE: Final[Callable[[bytes], tuple[bytes, int]]] = codecs.escape_decode


def _escaped(run: str) -> bytes:
    text = "".join(re.split(r"\"\"|''", run.removeprefix("b")[1:-1])).replace("\\u00", "\\x")
    return _UNESCAPE(text.encode("latin-1"))[0]


_END: Final = r"(?![0-9A-Za-z])"
_BYTE: Final = rf"(?:0[xX]|16#|&[hH]|[\\$%#]{{0,2}}[xXhH]?)[0-9A-Fa-f]{{2}}[hH#]?{_END}"
_SIGN: Final = r"(?:[,;]? {1,2}|[,;:.|/_\t-]| \| |[>\])}] ?[<\[({]|['\"],? ?['\"]|(?=[\\$%#]))"
_SHORT: Final = rf"(?:0[xX])?[0-9A-Fa-f]{{1,2}}{_END}"
_SIX: Final = "[A-Za-z0-9+/]"
_PADDED: Final = rf"{_SIX}{{2}}==|{_SIX}{{3}}="
_GROUP: Final = rf"(?:[0-9A-Fa-f]{{2}}){{1,4}}{_END}"
_OCTAL: Final = rf"[0-3][0-7]{{2}}{_END}"
_OCTAL_WORD: Final = rf"[01][0-7]{{5}}{_END}"
_DECIMAL: Final = rf"-?\d{{1,3}}{_END}"
_PAIRS: Final = (
    rf"{_BYTE}(?:({_SIGN}){_BYTE}(?!(?!\1){_SIGN}{_BYTE})"
    rf"(?:(?:\1| ?- ?| [|┊] ){_BYTE}| {{2}}{_BYTE}(?!\S))*+)?"
)
"""Bytes with one sign between them; in the middle of a line of a dump there is another."""
_DECIMALS: Final = rf"{_DECIMAL}(?:(?: +{_DECIMAL})++|(?:, *{_DECIMAL})++|(?:[;\t] ?{_DECIMAL})++)?"
_STRINGS: Final = r"b?(?:(?:\"(?:[^\"\\\n]|\\.)*\")++|(?:'(?:[^'\\\n]|\\.)*')++)"
FORMS: Final = tuple(
    Form(name, re.compile(rf"(?<![0-9A-Za-z\\$%#])(?>{run}){_END}(?![\\$%#]\w)"), bytes_of)
    for name, run, bytes_of in (
        ("hex pairs", _PAIRS, _hex),
        ("hex digits", r"(?:0[xX]|\\x)?(?:[0-9A-Fa-f]{2})++", _hex),
        ("hex groups", rf"{_GROUP}(?: {_GROUP})*+", _hex),
        ("unpadded hex", rf"{_SHORT}(?:(,? |,){_SHORT})*+", _unpadded),
        ("decimal", _DECIMALS, _decimal),
        ("octal", rf"(?:{_OCTAL}(?: {_OCTAL})*+|{_OCTAL_WORD}(?: {_OCTAL_WORD})*+)", _octal),
        ("binary", rf"[01]{{8}}{_END}(?: [01]{{8}}{_END})*+", _bits),
        ("quoted escapes", _STRINGS, _escaped),
        ("base64", rf"(?:(?:{_SIX}{{4}})++(?:{_PADDED})?|{_PADDED})", a2b_base64),
    )
)  # fmt: skip
"""All of them; an earlier one is preferred where the evidence is equal."""

_STARTS: Final = b"|".join(
    b"%b[%b]" % (re.escape(bytes([kind.header])), b"".join(b"\\x%02x" % cmd for cmd in kind.cmds))
    for kind in KINDS
)
_FRAME: Final = re.compile(
    b"(?s)(?:%b).{%d}%b" % (_STARTS, FRAME_LENGTH - 3, re.escape(bytes([TAIL])))
)

# Words around the bytes

_SENT: Final = (
    r"(?:tx|out|outgoing|send|sent|transmit|write|wrote|written|onwrite|request|host|master)"
)
_RECEIVED: Final = (
    r"(?:rx|in|incoming|recv|receive|received|read|onread|reply|response|answer|device|slave)"
)
_WAY: Final = re.compile(
    rf"(?i)(?<![a-z])(?:(?P<tx>{_SENT})|(?P<rx>{_RECEIVED}))(?![a-z])"
    r"|(?P<tx2>发送|发|写|→|[-=]>|>>+|(?:(?<=\W)|^)>(?= ))"
    r"|(?P<rx2>接收|收|读|←|<[-=]|<<+|(?:(?<=\W)|^)<(?= ))"
)
_NUMBER: Final = re.compile(r"\b[0-9A-Fa-f]*\d[0-9A-Fa-f]*\b|\d+")
_ZEROS: Final = str.maketrans("123456789", "0" * 9)
_LETTERS: Final = re.compile(r"[^\W\d_]{2}")
_LONGEST_BEFORE: Final = 200
"""Characters before a run that may name its way."""
_LONGEST_WORD: Final = 12


@lru_cache(8192)
def way_in(text: str) -> str:
    """The way that a text names: `tx`, `rx` or nothing."""
    way = _WAY.search(text)
    return way.lastgroup[:2] if way and way.lastgroup else ""


@lru_cache(8192)
def _word(before: str) -> str:
    """The end of the last word before a run; numbers are 0, and ways are W."""
    words = _WAY.sub("W", before).rsplit(None, 2)
    last = words[-1:] if re.search(r"\w", "".join(words[-1:])) else words[-2:]
    return _NUMBER.sub("0", " ".join(last))


class Line(NamedTuple):
    """What a line of a log holds; a heading has no data."""

    data: bytes = b""
    time: re.Match[str] | None = None
    way: str = ""
    """`tx`, `rx`, the word that a regular expression found, or nothing; nothing for a heading."""
    before: str = ""
    """The text before the data, or that of a heading; its time is a line feed."""


Lane = tuple[str, str]
"""What runs with data have in common: the last word before them, and the sign between two bytes."""


class Run(NamedTuple):
    """Consecutive bytes in a line."""

    lane: Lane
    data: bytes
    start: int
    end: int


class LineReader:
    """Reads lines whose bytes have a form."""

    def __init__(self, form: Form, lines: Sequence[str], pattern: re.Pattern[str] | None) -> None:
        """A reader; the first lines show which lanes have data, and the style of the times."""
        self.form, self._pattern = form, pattern
        self._style = style_of(lines) if pattern is None else _style_of_groups(pattern, lines)
        self._cuts: dict[Lane, slice] = {}
        """By lane with data, which bytes of a run are data."""
        self._twins = set[Lane]()
        """Lanes whose data are in another lane too."""
        self._ends = set[tuple[str, bool]]()
        """By word, whether something may be behind a short run."""
        self.has_ways = True
        """Whether words name the ways of lines."""
        if pattern is None:
            self._learn(lines)

    def read(self, text: str) -> list[Line]:
        """What a line holds: its runs with data, or itself as a heading."""
        if self._pattern is not None:
            return [self._read_groups(text, self._pattern)]
        text, time = self._masked(text)
        found, stop, way = list[Line](), 0, ""
        for run in self._runs(text):
            if self._is_data(run, text):
                before = text[max(stop, run.start - _LONGEST_BEFORE) : run.start]
                way = way_in(before) or way if self.has_ways else ""
                found.append(Line(run.data[self._cuts[run.lane]], time, way, before))
                stop = run.end
        if not found:
            return [Line(b"", time, "", text)]
        if self.has_ways and not way and (way := way_in(text[stop : stop + _LONGEST_BEFORE])):
            return [line._replace(way=way) for line in found]
        return found

    def _masked(self, line: str) -> tuple[str, re.Match[str] | None]:
        """The line without its time."""
        text = line.rstrip()
        time = self._style.search(text) if self._style else None
        if time is not None:
            text = f"{text[: time.start()]}\n{text[time.end() :]}"
        return text, time

    def _runs(self, text: str) -> Iterator[Run]:
        has_sign = self.form.run.groups > 0
        for found in self.form.run.finditer(text):
            start, end = found.span()
            try:
                data = self.form.bytes_of(found[0])
            except ValueError:
                continue
            if data:
                before = text[start - _LONGEST_WORD if start > _LONGEST_WORD else 0 : start]
                sign = found[1] or "" if has_sign else ""
                yield Run((_word(before.translate(_ZEROS)), sign), data, start, end)

    def _is_data(self, run: Run, text: str) -> bool:
        """Whether the lane of a run has data; it has from its first whole frame on."""
        if run.lane not in self._cuts:
            is_new = len(run.data) >= FRAME_LENGTH and run.lane not in self._twins
            if not is_new or not _FRAME.search(run.data):
                return False
            self._add(run.lane, slice(None))
        return len(run.data) >= _FEW or (run.lane[0], _is_last(run, text)) in self._ends

    def _add(self, lane: Lane, cut: slice) -> None:
        for one in (lane, (lane[0], "")):  # a single byte has no sign
            self._cuts.setdefault(one, cut)

    def _learn(self, lines: Sequence[str]) -> None:
        lanes, all_data = defaultdict[Lane, list[tuple[bool, Run]]](list), list[bytes]()
        wires = defaultdict[tuple[Lane, str], bytes](bytes)
        for line in lines:
            text, _ = self._masked(line)
            for run in self._runs(text):
                lanes[run.lane].append((_is_last(run, text), run))
                wires[run.lane, way_in(text[: run.start])] += run.data
        with_frames = {lane for (lane, _), data in wires.items() if _FRAME.search(data)}
        for lane, runs in lanes.items():
            data = b"".join(run.data for _, run in runs)
            if lane not in with_frames:
                continue
            if any(_are_twins(data, other) for other in all_data):
                self._twins.add(lane)
                continue
            all_data.append(data)
            self._add(lane, _best_cut([run.data for _, run in runs]))
            ends = Counter(is_last for is_last, run in runs if len(run.data) >= _FEW)
            ends = ends or Counter(is_last for is_last, _ in runs)
            self._ends |= {(lane[0], end) for end, n in ends.items() if 3 * n >= ends.total()}

    def nearest(self, lines: Iterable[str]) -> tuple[int, str]:
        """The bytes in lines whose lanes have no frames, and how to say it, with two of them."""
        size, examples = 0, list[str]()
        for line in lines:
            data = max((len(run.data) for run in self._runs(self._masked(line)[0])), default=0)
            if data >= _FEW:
                size += data
                examples.append(quoted(line.strip()[:40]))
        return size, f"{self.form.name} ({size:,} bytes, {', '.join(examples[:2])})"

    def notes(self) -> Iterator[str]:
        """What is not read though it is beside the data, one line each."""
        if any(cut != slice(None) for cut in self._cuts.values()):
            yield (
                "the same bytes before or behind the frames of each line, such as a length or a"
                " checksum, are left out"
            )

    def _read_groups(self, line: str, pattern: re.Pattern[str]) -> Line:
        found = pattern.search(line)
        if found is None:
            return Line()
        groups = found.groupdict()
        data = b"".join(run.data for run in self._runs(groups["data"] or ""))
        stamp, way = groups.get("time") or "", groups.get("dir") or ""
        time = self._style.search(stamp) if self._style else None
        return Line(data, time, way_in(way) or way, way)


def _style_of_groups(pattern: re.Pattern[str], lines: Iterable[str]) -> re.Pattern[str] | None:
    """The style of the times that a regular expression finds in lines."""
    found = (one.groupdict().get("time") for line in lines if (one := pattern.search(line)))
    return style_of([text for text in found if text], alone=True)


def _is_last(run: Run, text: str) -> bool:
    """Whether a run is not a key, and no word is behind it in its line."""
    return not (text.startswith(":", run.end) or _LETTERS.search(text, run.end))


_FEW: Final = 4
"""Bytes of a run from which on it is not a number by accident."""


_CUTS: Final = [slice(a or None, -b or None) for a, b in product(range(5), range(3))]
"""What may be beside the data of each run: up to four bytes before, and two behind them."""
_MANY: Final = 5
"""Runs that show it."""
_CLEAN: Final = 0.8
"""Of the bytes between them, how many are in frames."""


def _best_cut(runs: Sequence[bytes]) -> slice:
    """Which bytes of each run are data: the most with the most frames."""
    best, most = slice(None), _score(len(_FRAME.findall(b"".join(runs))), sum(map(len, runs)))
    for cut in _CUTS[1:] if len(runs) >= _MANY else ():
        data = b"".join(run[cut] for run in runs)
        frames = len(_FRAME.findall(data))
        if FRAME_LENGTH * frames >= _CLEAN * len(data) and _score(frames, len(data)) > most:
            best, most = cut, _score(frames, len(data))
    return best


def _are_twins(one: bytes, other: bytes) -> bool:
    """Whether two lanes have the same data; one may lack the end."""
    shorter, longer = sorted((one, other), key=len)
    return 2 * len(shorter) > len(longer) and longer.startswith(shorter)


def _score(frames: int, size: int) -> float:
    """Frames count for a reading, bytes outside frames against it."""
    return 10 * frames - 0.05 * (size - FRAME_LENGTH * frames)


# Headings and ways


class Heading(NamedTuple):
    """The lines without data above a line."""

    way: str = ""
    text: str = ""
    time: re.Match[str] | None = None
    is_new: bool = False
    """Whether no data was below the time so far."""

    def under(self, line: Line) -> Heading:
        """The headings below a line without data."""
        way, text = way_in(line.before) or self.way, line.before.strip() or self.text
        if line.time is None:
            return self._replace(way=way, text=text)
        return Heading(way, text, line.time, is_new=True)


def _numberless(text: str) -> str:
    return _NUMBER.sub("0", text)


_NAMES: Final[Sequence[Callable[[Line, Heading], str]]] = (
    lambda line, above: line.before.strip(),
    lambda line, above: _numberless(line.before.strip()),
    lambda line, above: above.text,
    lambda line, above: _numberless(above.text),
)
"""Texts that may name a wire, by a line and the headings above it."""
_MOST_NAMES: Final = 8


class Layout:
    """Which lines have times and ways, decided by the first lines; keeps the headings."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self._above, found, stamps = Heading(), list[tuple[Line, Heading]](), 0
        for line in lines:
            if line.data:
                found.append((line, self._above))
                self._above = self._above._replace(is_new=False)
            else:
                stamps += line.time is not None
                self._above = self._above.under(line)
        own_times = sum(line.time is not None for line, _ in found)
        times_in_lines = 0 < len(found) <= 2 * own_times
        new_times = sum(above.is_new for _, above in found)
        self._times_above = not times_in_lines and 0 < stamps <= 2 * new_times
        self.has_times = times_in_lines or self._times_above
        self._ways_above = 2 * sum(bool(line.way) for line, _ in found) < len(found)
        self._names = dict[str, str]()
        self.has_words = True
        """Whether words name the ways of lines."""
        self.has_words = len({self._way(*one) for one in found} - {""}) > 1
        self._name_of = next(filter(partial(self._are_names, found), _NAMES), _NAMES[0])
        self.wires = defaultdict[str, bytes](bytes)
        """The data of the first lines, by their ways."""
        for line, above in found:
            self.wires[self._way(line, above)] += line.data
        self._above = Heading()
        self._uses_headings = (
            self._times_above or bool(self._names) or (self.has_words and self._ways_above)
        )

    def is_heading(self, line: Line) -> bool:
        """Observe a line; whether the lines below it have their time or way from it."""
        if line.data or not self._uses_headings:
            return False
        self._above = self._above.under(line)
        by_name = bool(self._names) and self._name_of in _NAMES[2:]
        has_way = self.has_words and self._ways_above and bool(way_in(line.before))
        return (self._times_above and line.time is not None) or has_way or by_name

    def place(self, line: Line) -> tuple[str, re.Match[str] | None]:
        """The way and the time of a line with data; a line without a time has none."""
        time = line.time or (self._above.time if self._times_above else None)
        return self._way(line, self._above), time

    def _way(self, line: Line, above: Heading) -> str:
        if self.has_words:
            return line.way or (above.way if self._ways_above else "")
        return self._names.get(self._name_of(line, above), "") if self._names else ""

    def _are_names(
        self, found: Sequence[tuple[Line, Heading]], name_of: Callable[[Line, Heading], str]
    ) -> bool:
        """Whether a text names the wires: with each are frames of one direction only."""
        data = defaultdict[str, bytes](bytes)
        for line, above in () if self.has_words else found:
            data[name_of(line, above)] += line.data
        if not 2 <= len(data) <= _MOST_NAMES:
            return False
        heads = {name: {one[0] for one in _FRAME.findall(own)} for name, own in data.items()}
        are_pure = all(len(own) == 1 for own in heads.values())
        if are_pure and set.union(*heads.values()) == _WAY_OF.keys():
            self._names = {name: _WAY_OF[min(own)] for name, own in heads.items()}
        return bool(self._names)


_WAY_OF: Final = {HEADERS[Direction.CONTROL]: "tx", HEADERS[Direction.FEEDBACK]: "rx"}
"""By header of a frame."""


# The log


class Evidence(NamedTuple):
    """What a form finds in the first lines."""

    frames: int
    size: int
    reader: LineReader
    layout: Layout

    @property
    def score(self) -> float:
        """Compares forms."""
        return _score(self.frames, self.size)

    @classmethod
    def of(cls, form: Form, lines: Sequence[str], pattern: re.Pattern[str] | None) -> Evidence:
        """That of a form."""
        reader = LineReader(form, lines, pattern)
        layout = Layout(chain.from_iterable(map(reader.read, lines)))
        reader.has_ways = layout.has_words
        frames = sum(len(_FRAME.findall(data)) for data in layout.wires.values())
        return cls(frames, sum(map(len, layout.wires.values())), reader, layout)


_SAMPLES: Final = 200, 2_000, 20_000
"""Lines that decide how a log is read; more only if they hold no frames."""
_SILENT_S: Final = 1.0
"""A pipe that is silent so long, seconds, is decided by fewer lines, if they hold frames."""
_LONGEST_SAMPLED: Final = 4096
"""Characters of each of them."""
_LEAST_SHARE: Final = 0.05
"""Of the bytes of a form in frames."""


class Log:
    """The chunks of a log."""

    def __init__(
        self, name: str, options: LogOptions | None = None, stream: BinaryIO | None = None
    ) -> None:
        """A log to read once, from a stream or the file of that name.

        Raises:
            FileError: the file cannot be read, or holds results of this program.
            InputTextError: no frames are found in its first lines.
        """
        self.name, self.options = name, options or LogOptions()
        self._text = LogText()
        self._file: BinaryIO | None = None
        self._stream = stream
        self._blocks = self._text.blocks(stream) if stream else self._blocks_of(Path(name))
        self._size, self._skipped, self._example = 0, 0, ""
        first = self._decide()
        self._clock = LogClock(first, name, self.options)

    @property
    def is_plain(self) -> bool:
        """Whether it is hex without any other text."""
        return self._evidence is None

    @property
    def ports(self) -> list[str]:
        """The ports of the first lines."""
        if self._evidence is None:
            return [self.name]
        return [self._port(way) for way in self._evidence.layout.wires] or [self.name]

    @property
    def position(self) -> int:
        """Bytes of its file that were read; 0 of a stream, and after the end."""
        return 0 if self._file is None or self._file.closed else self._file.tell()

    def _blocks_of(self, path: Path) -> Iterator[str]:
        try:
            with path.open("rb") as self._file:
                yield from self._text.blocks(self._file)
        except OSError as error:
            raise unreadable(path, error) from error

    def _port(self, way: str) -> str:
        return f"{self.name}:{way}" if way else self.name

    def _decide(self) -> list[str]:
        """Decide how to read it, by its first lines, which are returned."""
        seen, lines, self._evidence = list[str](), list[str](), None
        for count in _SAMPLES:
            while len(lines) < count and (block := next(self._blocks, "")):
                refuse_results(self.name, block if not seen else "")
                seen.append(block)
                lines += [line[:_LONGEST_SAMPLED] for line in block.removesuffix("\n").split("\n")]
                if self._is_silent() and _have_frames(self._readings(lines)):
                    break
            first = lines[:count]
            found = self._readings(first)
            if _have_frames(found) or len(lines) <= count:
                break
        self._blocks = chain(seen, self._blocks)
        if not any(map(str.strip, lines)):
            raise FileError(f"{self.name} is empty; there is nothing to read")
        if found is not None:
            self._evidence = found[0]
            if found[0].frames * FRAME_LENGTH <= _LEAST_SHARE * found[0].size:
                self._refuse(first, found)
        return first

    def _is_silent(self) -> bool:
        """Whether a pipe has nothing more to read for now, as with `tail -f`."""
        if self._stream is None or not POSIX:
            return False
        try:
            return not select.select([self._stream], [], [], _SILENT_S)[0]
        except (OSError, ValueError):  # not a pipe, but bytes in memory
            return False

    def _refuse(self, lines: Sequence[str], found: Sequence[Evidence]) -> NoReturn:
        text = "\n".join(lines)
        if _are_lost(self._text.first) or _are_lost(text.encode("utf-8", "replace"), _LOST_AS_HEX):
            raise InputTextError(
                f"{self.name}: the program that wrote it replaced bytes from 80 on, AA and EE among"
                " them, by U+FFFD, so they are lost; record again as raw bytes, or with a display"
                " of hex"
            )
        if self._text.is_text:
            raise InputTextError(f"{self.name}: {_nothing_found(lines, found)}")
        raise FileError(
            f"{self.name}: holds no text; if it holds raw bytes, add --input raw; if the tool wrote"
            " bytes as characters among text, record again with its display of hex"
        )

    def _readings(self, lines: Sequence[str]) -> list[Evidence] | None:
        """The evidence of all forms, the best first; None if it is plain hex."""
        pattern = self.options.pattern
        found = [Evidence.of(form, lines, pattern) for form in FORMS]
        found.sort(key=lambda one: -one.score)
        return None if pattern is None and _is_plain(lines, found[0]) else found

    def chunks(self) -> Iterator[Chunk]:
        """The bytes of each line, with the time of the line or of the heading above it.

        A chunk without bytes says that the next ones are not there yet.

        Raises:
            InputTextError: something in plain hex is not hex.
            FileError: a line is too long.
        """
        number, unfinished = 1, False
        for block in self._blocks:
            if self._evidence is None:
                yield from self._plain_chunks(block, number)
            elif unfinished:
                raise too_long(self.name, number)
            else:
                yield from self._chunks_of(block, self._evidence)
            yield Chunk(self.name, None, b"")
            number, unfinished = number + block.count("\n"), not block.endswith("\n")

    def _plain_chunks(self, block: str, number: int) -> Iterator[Chunk]:
        try:
            for data in plain_pieces(block, number):
                yield self._untimed(self.name, data)
        except InputTextError as error:
            raise InputTextError(f"{self.name}: {error}") from error

    def _chunks_of(self, block: str, evidence: Evidence) -> Iterator[Chunk]:
        reader, layout, clock = evidence.reader, evidence.layout, self._clock
        for text in block.split("\n"):
            for line in reader.read(text):
                if not line.data:
                    if not layout.is_heading(line) and text and not text.isspace():
                        self._skipped += 1
                        self._example = self._example or text
                    continue
                way, time = layout.place(line)
                if layout.has_times:
                    t_ns = clock.time_ns(time)
                    yield Chunk(self._port(way), t_ns, line.data, is_late=True, at_once=True)
                else:
                    yield self._untimed(self._port(way), line.data)

    def _untimed(self, port: str, data: bytes) -> Chunk:
        """A chunk of a log without times; with a start, its bytes follow each other at the baud."""
        start_ns = self.options.start_ns
        self._size += len(data)
        t_ns = None
        if start_ns is not None:
            t_ns = start_ns + self._size * byte_time_ns(self.options.baud)
        return Chunk(port, t_ns, data)

    def notes(self) -> Iterator[str]:
        """What is not read, one line each; complete after reading."""
        example = quoted(self._example.strip()[:80])
        if self._skipped == 1:
            yield f"one line holds no bytes: {example}"
        elif self._skipped:
            yield f"{self._skipped:,} lines hold no bytes, for example {example}"
        if self._text.nul_bytes:
            yield (
                f"{self._text.nul_bytes:,} NUL bytes are skipped; a power cut leaves them in files"
                " that were being written"
            )

        if self._evidence is not None:
            yield from self._evidence.reader.notes()

    def time_notes(self) -> Iterator[str]:
        """What its times lack, one line each; complete after reading."""
        yield from self._clock.notes()


_LOST: Final = re.compile("\ufffd".encode())
_LOST_AS_HEX: Final = re.compile(rb"(?i)\bFF ?FD\b|\bEF ?BF ?BD\b")
"""U+FFFD, which programs write for what is not a character."""


def _are_lost(text: bytes, replaced: re.Pattern[bytes] = _LOST) -> bool:
    """Whether many bytes of a text were replaced."""
    return 100 * len(replaced.findall(text)) > len(text)


def _have_frames(found: Sequence[Evidence] | None) -> bool:
    """Whether lines, plain hex or not, are enough to decide how to read them."""
    return found is None or found[0].frames > 0


def _is_plain(lines: Sequence[str], best: Evidence) -> bool:
    """Whether lines are plain hex, and no form has better evidence."""
    if not is_plain_hex(lines):
        return False
    if not best.frames:
        return not _are_lost("\n".join(lines).encode(), _LOST_AS_HEX)
    data = plain_hex("\n".join(line for line in lines if is_hex_line(line)))
    return _score(len(_FRAME.findall(data)), len(data)) >= best.score


def _nothing_found(lines: Sequence[str], found: Sequence[Evidence]) -> str:
    """What to say of a text without frames: what comes near."""
    nothing = f"no frames found in {len(lines):,} line{'' if len(lines) == 1 else 's'}"
    numeric = (one.reader for one in found if one.reader.form.is_numeric)
    near = sorted((reader.nearest(lines) for reader in numeric), key=lambda one: -one[0])
    shown = " or as ".join(text for size, text in near[:2] if size)
    if not shown:
        return f"{nothing}, and no bytes in any form; --input-regex says where the bytes are"
    return (
        f"{nothing}; it could be read as {shown}; check the baud of the recording, or say with"
        " --input-regex where the bytes are"
    )
