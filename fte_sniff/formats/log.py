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
from binascii import a2b_base64
from collections import Counter, defaultdict
from collections.abc import Callable, ItemsView, Iterable, Iterator, Sequence
from functools import lru_cache, partial
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from fte_sniff.errors import FileError, InputTextError, encodable, quoted
from fte_sniff.formats.log_text import LONGEST_LINE, text_blocks
from fte_sniff.formats.log_times import LogClock, LogOptions
from fte_sniff.formats.plain_hex import has_typing_errors, is_hex_line, plain_hex
from fte_sniff.platform import is_silent
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import FRAME_LENGTH, HEADERS, KINDS, TAIL, Direction

# Forms of bytes


class Form(NamedTuple):
    """A form in which programs write bytes."""

    name: str
    run: re.Pattern[str]
    """Consecutive bytes; the first group, if any, is the sign between two of them."""
    bytes_of: Callable[[str], bytes]
    """Reads a run; raises ValueError if it is not one."""


_PAIR: Final = re.compile(r"(?:0[xX]|16#|&[hH])?([0-9A-Fa-f]{2})")
_NUMBERS: Final = re.compile(r"-?[0-9A-Fa-f]+(?!x)")


def _hex(run: str) -> bytes:
    try:
        return bytes.fromhex(run)
    except ValueError:
        return bytes.fromhex("".join(_PAIR.findall(run)))


def _numbers(base: int, run: str) -> bytes:
    values = [int(number, base) for number in _NUMBERS.findall(run)]
    return bytes([value + 256 if -129 < value < 0 else value for value in values])


def _octal(run: str) -> bytes:
    """Bytes have three digits; words of two bytes have six."""
    tokens = run.split()
    return b"".join(int(token, 8).to_bytes(len(token) // 3, "little") for token in tokens)


def _escaped(run: str) -> bytes:
    text = "".join(re.split(r"\"\"|''", run.removeprefix("b")[1:-1])).replace("\\u00", "\\x")
    return codecs.escape_decode(text.encode("latin-1"))[0]


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
    rf"(?=[0-9A-Fa-f\\$%#&xXhH]){_BYTE}(?:({_SIGN}){_BYTE}(?!(?!\1){_SIGN}{_BYTE})"
    rf"(?:(?:\1| ?- ?| [|┊] ){_BYTE}| {{2}}{_BYTE}(?!\S))*+)?"
)
"""Bytes with one sign between them; in the middle of a line of a dump there is another."""
_DECIMALS: Final = rf"{_DECIMAL}(?:(?: +{_DECIMAL})++|(?:, *{_DECIMAL})++|(?:[;\t] ?{_DECIMAL})++)?"
_STRINGS: Final = r"b?(?:(?:\"(?:[^\"\\\n]|\\.)*\")++|(?:'(?:[^'\\\n]|\\.)*')++)"
FORMS: Final = tuple(
    Form(name, re.compile(rf"(?<![0-9A-Za-z\\$%#])(?>{run}){_END}(?![\\$%#]\w)"), bytes_of)
    for name, run, bytes_of in (
        ("hex pairs", _PAIRS, _hex),
        ("hex digits", rf"(?:0[xX]|\\x)?(?:{_GROUP}(?: {_GROUP})++|(?:[0-9A-Fa-f]{{2}})++)", _hex),
        ("unpadded hex", rf"{_SHORT}(?:(,? |,){_SHORT})*+", partial(_numbers, 16)),
        ("decimal", _DECIMALS, partial(_numbers, 10)),
        ("octal", rf"(?:{_OCTAL}(?: {_OCTAL})*+|{_OCTAL_WORD}(?: {_OCTAL_WORD})*+)", _octal),
        ("binary", rf"[01]{{8}}{_END}(?: [01]{{8}}{_END})*+", partial(_numbers, 2)),
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
_COUNT: Final = re.compile(r"(?<![\w.:])\d+(?![\w.:])|\s+")
"""A number of its own, such as that of a record, which changes from line to line."""
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


class Entry(NamedTuple):
    """A run of data in a line."""

    data: bytes
    way: str
    """`tx`, `rx`, the word that a regular expression found, or nothing."""
    before: str
    """The text before the data; the time in it is a line feed."""
    time: re.Match[str] | None


class Heading(NamedTuple):
    """The lines without data above a line."""

    way: str = ""
    text: str = ""
    time: re.Match[str] | None = None


Style = re.Pattern[str] | None
Found = Sequence[tuple[Entry, Heading]]
Lane = tuple[str, str]
"""What runs with data have in common: the last word before them, and the sign between two bytes."""
_FEW: Final = 4
"""Bytes of a run from which on it is not a number by accident."""
_MOST_BEFORE, _MOST_BEHIND = 4, 2
"""Bytes beside the data of each run, at most, such as a length before or a checksum behind it."""
_MANY: Final = 5
"""Runs that show it."""
_COST: Final = 0.05
"""Of a byte outside frames; about this share of the bytes must be in frames."""


def _score(data: bytes) -> float:
    """Bytes in whole frames count for a reader, bytes outside frames against it."""
    in_frames = FRAME_LENGTH * len(_FRAME.findall(data))
    return in_frames - _COST * (len(data) - in_frames)


def _cut(runs: Sequence[bytes]) -> slice:
    """Which bytes of each run are data: without what is beside the frame in most runs."""
    frames = ((run, _FRAME.search(run)) for run in runs)
    beside = Counter((one.start(), len(run) - one.end()) for run, one in frames if one)
    (before, behind), number = max(beside.items(), key=itemgetter(1), default=((0, 0), 0))
    is_cut = before <= _MOST_BEFORE and behind <= _MOST_BEHIND and 2 * number > len(runs) > _MANY
    return slice(before or None, -behind or None) if is_cut else slice(None)


def _are_twins(one: bytes, other: bytes) -> bool:
    """Whether two lanes have the same data; one may lack the end."""
    shorter, longer = sorted((one, other), key=len)
    return 2 * len(shorter) > len(longer) and longer.startswith(shorter)


def _is_last(text: str, end: int) -> bool:
    """Whether a run that ends there is not a key, and no word is behind it in its line."""
    return not (text.startswith(":", end) or _LETTERS.search(text, end))


Label = Callable[[Entry, Heading], str]
"""What names the wire of data, by the data and the headings above."""
_WAY_BESIDE: Final[Label] = lambda entry, above: entry.way  # noqa: E731
_WAY_ABOVE: Final[Label] = lambda entry, above: entry.way or above.way  # noqa: E731
_NAME_BESIDE: Final[Label] = lambda entry, above: _COUNT.sub("0", entry.before.strip())  # noqa: E731
_NAME_ABOVE: Final[Label] = lambda entry, above: _COUNT.sub("0", above.text)  # noqa: E731
_MOST_NAMES: Final = 8
_WAY_OF: Final = {HEADERS[Direction.CONTROL]: "tx", HEADERS[Direction.FEEDBACK]: "rx"}
"""By header of a frame."""


def _ways_of_names(found: Found, label: Label) -> dict[str, str]:
    """The ways of labels, if with each are frames of one direction only; else nothing."""
    heads = {name: {*map(itemgetter(0), _FRAME.findall(own))} for name, own in _by(found, label)}
    are_pure = len(heads) <= _MOST_NAMES and all(len(own) == 1 for own in heads.values())
    if not are_pure or set[int]().union(*heads.values()) != _WAY_OF.keys():
        return {}
    return {name: _WAY_OF[min(own)] for name, own in heads.items()}


def _by(found: Found, label: Label) -> ItemsView[str, bytes]:
    """The data by its labels."""
    data = defaultdict[str, bytes](bytes)
    for entry, above in found:
        data[label(entry, above)] += entry.data
    return data.items()


class LineReader:
    """How lines with bytes in a form are read, as the first ones show; keeps the headings."""

    def __init__(self, form: Form, lines: Sequence[str], style: Style, pattern: Style) -> None:
        """Decide which lanes have data, and whether times and ways are beside or above them."""
        self.form, self._style, self._pattern = form, style, pattern
        self._cuts: dict[Lane, slice] = {}
        """By lane with frames, which bytes of a run are data: none if another lane has them too."""
        self._has_words_behind = False
        """Whether words may be behind a short run."""
        self._above, self._heads, self._has_ways, self._stamps = Heading(), True, True, 0
        self._skipped, self._example = 0, ""
        if pattern is None:
            self._learn_lanes(lines)
        self._learn_wires([*self._entries(lines)])
        self._above, self._skipped, self._example = Heading(), 0, ""

    # Lanes

    def _learn_lanes(self, lines: Iterable[str]) -> None:
        lanes, all_data = defaultdict[Lane, list[bytes]](list), list[bytes]()
        for text, _ in map(self._masked, lines):
            for run in self.form.run.finditer(text):
                lane, data = self._lane(text, run), self._bytes(run)
                lanes[lane].append(data)
                is_last = _is_last(text, run.end())
                self._has_words_behind |= not is_last and _FRAME.search(data) is not None
        for lane, runs in lanes.items():
            if _FRAME.search(data := b"".join(runs)):
                is_twin = any(_are_twins(data, other) for other in all_data)
                self._add(lane, slice(0) if is_twin else _cut(runs))
                all_data.append(data)

    def _add(self, lane: Lane, cut: slice) -> None:
        for one in (lane, (lane[0], "")):  # a single byte has no sign
            self._cuts.setdefault(one, cut)

    def _masked(self, line: str) -> tuple[str, re.Match[str] | None]:
        """The line without its time."""
        text = line.rstrip()
        if time := self._style and self._style.search(text):
            text = f"{text[: time.start()]}\n{text[time.end() :]}"
        return text, time

    def _lane(self, text: str, run: re.Match[str]) -> Lane:
        before = text[max(0, run.start() - _LONGEST_WORD) : run.start()]
        return _word(before.translate(_ZEROS)), run[run.lastindex or 0] if run.lastindex else ""

    def _bytes(self, run: re.Match[str]) -> bytes:
        try:
            return self.form.bytes_of(run[0])
        except ValueError:
            return b""

    # Lines

    def _entries(self, lines: Iterable[str]) -> Iterator[tuple[Entry, Heading]]:
        """The data of lines, and the headings above."""
        for line in lines:
            text, time = self._masked(line)
            found = self._parsed(text, time) if self._pattern is None else self._groups(line)
            for entry in found:
                yield entry, self._above
            if not found and not (self._heads and self._is_heading(text, time)) and text:
                self._skipped += 1
                self._example = self._example or line

    def _is_heading(self, text: str, time: re.Match[str] | None) -> bool:
        """Whether a line without data has a time or names a way, for the lines below."""
        self._stamps += time is not None
        way, above = way_in(text), self._above
        self._above = Heading(way or above.way, text or above.text, time or above.time)
        return way != "" or time is not None

    def _parsed(self, text: str, time: re.Match[str] | None) -> list[Entry]:
        found, stop, way = list[Entry](), 0, ""
        for run in self.form.run.finditer(text):
            if data := self._data(text, run):
                before = text[stop : run.start()][-_LONGEST_BEFORE:]
                way = way_in(before) or way if self._has_ways else ""
                found.append(Entry(data, way, before, time))
                stop = run.end()
        if found and self._has_ways and not way:
            way = way_in(text[stop : stop + _LONGEST_BEFORE])
            return [entry._replace(way=way) for entry in found]
        return found

    def _data(self, text: str, run: re.Match[str]) -> bytes:
        """The data of a run; its lane has data from its first whole frame on."""
        lane = self._lane(text, run)
        cut = self._cuts.get(lane)
        if cut is None:
            is_long = run.end() - run.start() >= FRAME_LENGTH
            if not is_long or not _FRAME.search(self._bytes(run)):
                return b""
            self._add(lane, cut := slice(None))
        data = self._bytes(run)
        if len(data) < _FEW and not (self._has_words_behind or _is_last(text, run.end())):
            return b""
        return data[cut]

    def _groups(self, line: str) -> list[Entry]:
        """The data in the groups of the user's regular expression."""
        if self._pattern is None or (match := self._pattern.search(line)) is None:
            return []
        groups = match.groupdict()
        data = b"".join(map(self._bytes, self.form.run.finditer(groups["data"] or "")))
        way = groups.get("dir") or ""
        time = self._style and self._style.search(groups.get("time") or "")
        return [Entry(data, way_in(way) or way, way, time)] if data else []

    # Wires

    def _learn_wires(self, found: Found) -> None:
        stamps = sum(entry.time is not None for entry, _ in found)
        are_beside = 0 < len(found) <= 2 * stamps
        self._times_above = not are_beside and 0 < self._stamps <= 2 * len(found)
        self.has_times = are_beside or self._times_above
        are_above = 2 * sum(entry.way != "" for entry, _ in found) < len(found)
        self._way = label = _WAY_ABOVE if are_above else _WAY_BESIDE
        if len({label(*one) for one in found} - {""}) <= 1:
            named = ((one, _ways_of_names(found, one)) for one in (_NAME_BESIDE, _NAME_ABOVE))
            label, names = next(filter(itemgetter(1), named), (_WAY_BESIDE, {}))
            self._has_ways = False
            self._way = lambda entry, above: names.get(label(entry, above), "")
        self._heads = self._times_above or label in (_WAY_ABOVE, _NAME_ABOVE)
        self.wires = dict(_by(found, self._way))
        """The data of the first lines, by their ways."""
        self.score = sum(map(_score, self.wires.values()))
        self.has_frames = self.score > 0

    def read(self, block: str) -> Iterator[tuple[str, re.Match[str] | None, bytes]]:
        """The way, the time and the data of each line with data."""
        for entry, above in self._entries(block.split("\n")):
            time = (entry.time or above.time) if self._times_above else entry.time
            yield self._way(entry, above), time, entry.data

    def nearest(self, lines: Iterable[str]) -> tuple[int, str]:
        """The bytes in lines whose lanes have no frames, and how to say it, with two of them."""
        size, examples = 0, list[str]()
        for text, _ in map(self._masked, lines):
            data = max(map(self._bytes, self.form.run.finditer(text)), key=len, default=b"")
            if len(data) >= _FEW:
                size += len(data)
                examples.append(quoted(text.strip()[:40]))
        return size, f"{self.form.name} ({size:,} bytes, {', '.join(examples[:2])})"

    def notes(self) -> Iterator[str]:
        """What is not read, one line each; complete after reading."""
        if self._skipped:
            example = quoted(self._example.strip()[:80])
            yield f"lines without bytes: {self._skipped:,}, for example {example}"
        if any(cut not in (slice(None), slice(0)) for cut in self._cuts.values()):
            yield "bytes beside each frame, such as a length or a checksum, are left out"


class PlainReader:
    """Reads plain hex."""

    has_times, has_frames = False, True  # it needs no frames
    wires: Final = {"": b""}

    def __init__(self, lines: Iterable[str]) -> None:
        """Find the frames in the first lines without a mistake."""
        self.score = _score(b"".join(plain_hex("\n".join(filter(is_hex_line, lines)))))
        self._number = 1

    def read(self, block: str) -> Iterator[tuple[str, None, bytes]]:
        """No way, no time and the bytes; raises InputTextError at a mistake."""
        first, self._number = self._number, self._number + block.count("\n")
        return (("", None, data) for data in plain_hex(block, first))


# The log

_SAMPLES: Final = 200, 2_000, 20_000
"""Lines that decide how a log is read; more only if they hold no frames."""
_LONGEST_SAMPLED: Final = 4096
"""Characters of each of them."""


class Log:
    """The chunks of a log."""

    def __init__(
        self, name: str, options: LogOptions | None = None, stream: BinaryIO | None = None
    ) -> None:
        """A log to read once, from a stream or the file of that name.

        Raises:
            FileError: the file cannot be read.
            InputTextError: no frames are found in its first lines.
        """
        self.name, self.options = encodable(name), options or LogOptions()
        self._path, blocks = Path(name), text_blocks(stream or Path(name))
        seen, lines = list[str](), list[str]()
        for count in _SAMPLES:
            while len(lines) < count and (block := next(blocks, "")):
                seen.append(block)
                lines += [line[:_LONGEST_SAMPLED] for line in block.removesuffix("\n").split("\n")]
                if is_silent(stream) and self._has_frames(lines):
                    break  # fewer lines decide, as with `tail -f`
            if self._has_frames(lines[:count]) or len(lines) <= count:
                break
        self._blocks = chain(seen, blocks)
        if not self._reader.has_frames:
            raise InputTextError(f"{self.name}: {_reason(lines[:count], self._readers)}")

    @property
    def ports(self) -> list[str]:
        """The ports of the first lines."""
        return [*map(self._port, self._reader.wires)]

    def _port(self, way: str) -> str:
        return f"{self.name}:{way}" if way else self.name

    def _has_frames(self, lines: Sequence[str]) -> bool:
        """Choose the best reader of lines; whether they, plain hex or not, are enough for it."""
        self.clock, pattern = LogClock(lines, self._path, self.options), self.options.pattern
        self._readers = [LineReader(form, lines, self.clock.style, pattern) for form in FORMS]
        best = max(self._readers, key=lambda one: one.score)
        self._reader: LineReader | PlainReader = best
        if pattern is None and _is_plain(lines) and not _are_lost("\n".join(lines)):
            plain = PlainReader(lines)
            self._reader = best if best.has_frames and plain.score < best.score else plain
        return self._reader.has_frames

    def chunks(self) -> Iterator[Chunk]:
        """The bytes of each line, with the time of the line or of the heading above it.

        A chunk without bytes says that the next ones are not there yet.

        Raises:
            InputTextError: something in plain hex is not hex.
            FileError: a line is too long.
        """
        is_timed, unfinished = self._reader.has_times, False
        for block in self._blocks:
            if unfinished and isinstance(self._reader, LineReader):
                what = f"has a line longer than {LONGEST_LINE >> 20} MB that is not plain hex"
                raise FileError(f"{self.name}: {what}; write each record on a line")
            unfinished = not block.endswith("\n")
            try:
                for way, time, data in self._reader.read(block):
                    t_ns = self.clock.time_ns(time) if is_timed else None
                    yield Chunk(self._port(way), t_ns, data, is_late=is_timed, at_once=is_timed)
            except InputTextError as error:
                raise InputTextError(f"{self.name}: {error}") from error
            yield Chunk(self.name, None, b"")

    def notes(self) -> Iterator[str]:
        """What is not read, one line each; complete after reading."""
        if isinstance(self._reader, LineReader):  # plain hex is read without remainder
            yield from self._reader.notes()


_LOST: Final = re.compile(r"(?i)\bFF ?FD\b|\bEF ?BF ?BD\b|\ufffd")
"""U+FFFD, which programs write for what is not a character; as hex, or itself."""


def _are_lost(text: str) -> bool:
    """Whether many bytes of a text were replaced."""
    return 100 * len(_LOST.findall(text)) > len(text)


def _is_plain(lines: Sequence[str]) -> bool:
    """Whether lines are plain hex, perhaps with typing errors in a few of them."""
    wrong = [line for line in lines if not is_hex_line(line)]
    return 10 * len(wrong) < len(lines) + 10 and all(map(has_typing_errors, wrong))


_IN_ANY_TEXT: Final = ("quoted escapes", "base64")
"""Forms whose runs are found in texts without bytes."""


def _reason(lines: Sequence[str], readers: Iterable[LineReader]) -> str:
    """Why a text is refused; without frames, the two forms that come nearest."""
    if _are_lost("\n".join(lines)):
        return (
            "it holds no text, or its program replaced bytes from 80 on, AA and EE among them, by"
            " U+FFFD, so they are lost; record again as raw bytes, or with a display of hex"
        )
    near = [one.nearest(lines) for one in readers if one.form.name not in _IN_ANY_TEXT]
    near.sort(key=lambda one: -one[0])
    shown = " or as ".join(text for size, text in near[:2] if size)
    form = f"it could be read as {shown}; check the baud" if shown else "no bytes in any form"
    return f"no frames in lines 1 to {len(lines):,}; {form}; --input-regex says where the bytes are"
