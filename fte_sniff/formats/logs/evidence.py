"""Evidence for where the bytes are in a text: frames of the protocol distinguish them from chance.

The forms × separators table lists how programs write bytes. Each row is an extractor: a regular
expression for the runs of bytes in a text of lines, which are units with a separator between two.
Texts are bytes, so that offsets hold whatever the encoding around the runs.

The lines of a sample are read with every extractor. Its runs whose lines look the same before the
run form a lane. Whole frames in the bytes of lanes give the score of an extractor. Where one lane
has the bytes of two wires in turn, `Weave` separates them by their frames.
"""

from __future__ import annotations

import re
from binascii import a2b_base64, unhexlify
from bisect import bisect
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, cached_property, lru_cache
from itertools import product
from typing import Final, NamedTuple

from fte_sniff.formats.logs.times import masked
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    FTE_FORMAT,
    HEADERS,
    KINDS,
    TAIL,
    Direction,
)

_LONGEST_KNOWN: Final = 16
_MOST_KNOWN: Final = 1 << 16
"""Characters of a unit of a run whose bytes are kept, and how many are."""
_BETWEEN: Final = b" ,:-;|\t._/"
"""Characters between pairs of digits, in most logs."""


class Run(NamedTuple):
    """The bytes that an extractor reads in a text."""

    start: int
    stop: int
    data: bytes


class Extractor(NamedTuple):
    """One form with one separator."""

    name: str
    tools: str
    """Programs that write it."""
    pattern: bytes = b""
    """Of a run; compiled at the first use, because that of all patterns delays the start."""
    unit: bytes = b""
    """Of a unit of a run and the separator before it; groups are named by their kinds."""
    needs: bytes = b""
    """What a text with such runs has."""
    swaps: bool = False
    """Whether units are words whose last byte comes first."""
    masks_times: bool = True
    """Whether the first date or time of a line cannot be bytes."""

    def runs(self, text: bytes) -> Iterator[Run]:
        """The runs of a line, or of several lines."""
        bytes_of = self.bytes_of
        for found in re.finditer(self.pattern, text):
            if data := bytes_of(found[0]):
                yield Run(*found.span(), data)

    @property
    def bytes_of(self) -> BytesOf:
        """What returns the bytes of the text of a run; none if it is not a run after all."""
        return _bytes_of_runs(self.unit, self.swaps)


BytesOf = Callable[[bytes], bytes]


class _Known(dict[bytes, bytes]):
    """The bytes of the units of runs, by their text."""

    def __init__(self, bytes_of: BytesOf) -> None:
        self._bytes_of = bytes_of

    def __missing__(self, text: bytes) -> bytes:
        data = self._bytes_of(text)
        if len(text) <= _LONGEST_KNOWN and len(self) < _MOST_KNOWN:
            self[text] = data
        return data


@cache
def _bytes_of_runs(unit: bytes, swaps: bool) -> BytesOf:
    """What returns the bytes of the text of a run of units."""
    compiled, step = re.compile(unit), -1 if swaps else 1
    whole, are_digits = compiled.fullmatch, [*compiled.groupindex] == ["x"] and not swaps
    units = re.compile(re.sub(rb"[?]P<[^>]+>", b"?:", unit)).findall

    def bytes_of_unit(text: bytes) -> bytes:
        found = whole(text)
        if found is None:
            raise ValueError(text)
        return _bytes_of(found)[::step]

    known = _Known(bytes_of_unit).__getitem__

    def bytes_of(run: bytes) -> bytes:
        if are_digits:
            try:  # ten times as fast
                return unhexlify(run.translate(None, _BETWEEN))
            except ValueError:
                pass
        try:
            return b"".join(map(known, units(run)))
        except (ValueError, OverflowError):
            return b""

    return bytes_of


def _bytes_of(unit: re.Match[bytes]) -> bytes:
    name = unit.lastgroup or ""
    return _bytes_of_group(name)(unit[name])


@cache
def _bytes_of_group(name: str) -> BytesOf:
    """What returns the bytes of the text of a group."""
    kind = name[0]
    base, size = _BASES.get(kind.lower()), 1 + kind.isupper()
    if base is not None:

        def bytes_of_number(text: bytes) -> bytes:
            value = int(text, base)
            return value.to_bytes(size, "big", signed=value < 0)

        return bytes_of_number
    if kind not in _CODES:
        return _KINDS[kind]
    codes = re.compile(_expanded(_CODES[kind]).encode())
    known = _Known(lambda code: codes.sub(_bytes_of, code))

    def bytes_of_text(text: bytes) -> bytes:
        if not text.isascii():
            with suppress(UnicodeError):
                text = text.decode().encode("latin-1")
        return codes.sub(lambda code: known[code[0]], text)

    return bytes_of_text


def _expanded(pattern: str) -> str:
    """A pattern of the table: `@@` is a byte in two hexadecimal digits, `@` in one or two."""
    pattern = pattern.replace("@@", "(?P<x>[0-9A-Fa-f]{2})")
    return pattern.replace("@", "(?P<h>[0-9A-Fa-f]{1,2})(?![0-9A-Fa-f])")


def _unnamed(pattern: str) -> str:
    return f"(?:{re.sub(r'[?]P<[^>]+>', '?:', _expanded(pattern))})"


_CONTROLS: Final = (
    "NUL|SOH|STX|ETX|EOT|ENQ|ACK|BEL|BS|HT|LF|VT|FF|CR|SO|SI|DLE|DC1|DC2|DC3|DC4|NAK|SYN|ETB|CAN"
    "|EM|SUB|ESC|FS|GS|RS|US|SP|DEL|TAB|NL|NULL"
)
_VALUES: Final = dict(zip(_CONTROLS.split("|"), (*range(33), 127, 9, 10, 0), strict=True))
_LETTERS: Final = bytes.maketrans(b"abtnvfre0s", b"\a\b\t\n\v\f\r\x1b\0 ")
_BASES: Final = {"h": 16, "d": 10, "o": 8, "b": 2}
"""By the first letter of a group of a number, its base; a capital letter is a word of two bytes."""
_CODES: Final = {
    "t": r"\\(?:x\{?|u00)@@(?:(?<=\{..)\})?|\\(?P<o>[0-3]?[0-7]{1,2})|\\(?P<e>.)",
    "u": r"\\(?P<d>\d{1,3})|\\(?P<e>.)",
    "v": r"\\@@|\\(?P<e>[a-z\\])",
    "w": rf"[\[<{{(](?:(?:0x)?@@|(?P<n>{_CONTROLS}))[\]>}})]",
}
"""By kind of form, the patterns of bytes that are not characters, in a text of characters."""
_URL_SAFE: Final = bytes.maketrans(b"-_", b"+/")
_KINDS: Final[dict[str, BytesOf]] = {
    "x": unhexlify,
    "q": lambda text: a2b_base64(text.translate(_URL_SAFE)),
    "n": lambda name: bytes([_VALUES[name.decode()]]),
    "e": lambda letter: letter.translate(_LETTERS),
    "c": bytes,
}
"""By the first letter of a group that is not a number: how its text becomes bytes."""


_NO_CODE: Final = r"!-')-;=-Z\]-z|}~"
"""Characters that begin no code."""


def _text_with(kind: str) -> str:
    """A text with codes, from the word with the first to that with the last of them."""
    code = _unnamed(_CODES[kind])
    word = rf"(?:[{_NO_CODE}]++|(?!{code})[!-~])*+"
    words = rf"(?:[ {_NO_CODE}]++|(?!{code})[ -~])*+"
    return rf"(?<![!-~])(?P<{kind}>{word}{code}(?:{words}{code})*+{word})"


_EDGE: Final = "(?!(?<=[0-9A-Za-z])[0-9A-Za-z])"
"""Not within a word."""
_GROUP: Final = "(?P<x>(?:[0-9A-Fa-f]{2})++)"
_BYTE: Final = (
    r"(?<![\w.])(?<!\d:)(?P<d>25[0-5]|2[0-4]\d|[01]?\d{1,2}|-(?:12[0-8]|1[01]\d|\d{1,2}))"
    r"(?!\w|[.:]\d|\"\s*:)"
)
"""Of -128 to 255: a counter beside the bytes is one of them only up to there."""
_UNPADDED: Final = "(?!0[0-9A-Fa-f])@"
_ANY: Final = r"[^0-9A-Za-z\\$%&#\r\n]{0,4}+"
_STRING: Final = r"[bu]?(?:\"(?P<t>(?:[^\"\\\n]|\\.)*+)\"|'(?P<t1>(?:[^'\\\n]|\\.)*+)')"
_OD_CELL: Final = r" (?P<o>[0-3][0-7]{2})|  \\(?P<e>[0abtnvfr])|   (?P<c>[ -~])"
_TOGETHER: Final = "(?<=[0-9A-F]{2})(?=[0-9A-F]{2})|(?<=[0-9a-f]{2})(?=[0-9a-f]{2})"
"""Between digits in one case; mixed case is a word."""
_FORMS: Final = (
    ("hex pairs, spaces", "@@", " ", "SSCOM, CoolTerm, Docklight, socat -x, most terminals"),
    ("hex pairs, halves", "@@", " {1,2}(?:(?:-|┊) )?|-",
     "hexdump -C, WinHex, hexyl, GtkTerm, DEBUG.EXE, .NET"),
    ("hex pairs, commas", "@@", " ?, ?", "Modbus tools, Serial Studio, CSV exports"),
    ("hex pairs, colons", "@@", ":", "ESPHome, HHD Serial Monitor, tshark"),
    ("hex pairs, dashes", "@@", " ?- ?", "C# BitConverter, modbus_tk"),
    ("hex pairs, cells", "@@", r"\t| ?[;|] ?|(?:</?[a-z]\w*>)++",
     "spreadsheets, LabVIEW, HTerm, PulseView, tables in Markdown, HTML and XML"),
    ("hex pairs, points", "@@", "[._/]", "Cisco consoles, Verilog test benches, PLC consoles"),
    ("hex digits", r"(?:0[xX]|\\x)?@@", _TOGETHER, "Tasmota, logcat, candump, MQTT, SQL"),
    ("unpadded hex, spaces", _UNPADDED, " {1,2}", "HTerm, AccessPort, Arduino"),
    ("unpadded hex, commas", _UNPADDED, " ?, ?", "JavaScript toString(16)"),
    ("unpadded hex, dashes", _UNPADDED, " ?- ?", "Java toHexString"),
    ("0x before each byte", r"0[xX]@[}'\"#]?+", _ANY,
     "C, Rust, Saleae Logic, Wireshark C arrays, CoolTerm"),
    (r"\x before each byte", r"(?:\\+(?:x\{?|u00)|U\+00)@@\}?+(?![0-9A-Fa-f])", _ANY,
     "shells, jq, printf, JavaScript, JSON"),
    ("a sign before each byte", r"(?:#?\$|%|&[hH]|8'h|(?:(?:B#)?16)?#)@#?+", _ANY,
     "Pascal, HTerm, URLs, Visual Basic, Verilog, Docklight scripts, IEC 61131, Erlang"),
    (r"\ before each byte", r"\\@@(?![0-9A-Fa-f])", _ANY, "LabVIEW"),
    ("x before each byte", r"[xXhH]['\"]?@['\"]?+", _ANY, "VHDL, SQL, WaveForms"),
    ("h after each byte", "0?@@[hH]", "[ ,;]{0,3}", "assemblers, YAT, HTerm"),
    ("hex in brackets", r"[\[<({\"'](?:0[xX])?@[\]>)}\"']", "[ ,;]{0,2}",
     "RealTerm, libmodbus, Termite, Hercules, slsnif, Tcl, lists of strings in JSON and Python"),
    ("decimal in brackets", r"[!-~]?[\[<({](?P<d>\d{3})[\]>)}]", " ?", "Bray's Terminal, slsnif"),
    ("decimal, spaces", _BYTE, r"[ \t]+", "MATLAB, Go, NumPy, RealTerm"),
    ("decimal, commas", _BYTE, r"[ \t]*,[ \t]*(?:\"\d+\" ?: ?)?",
     "Java, Python, ROS, Node-RED, JSON of a Uint8Array"),
    ("decimal, semicolons or dashes", _BYTE, " ?; ?|-", "spreadsheets, Docklight"),
    ("octal", "(?P<o>[0-3][0-7]{2})", "[ ,]{1,2}", "od -b, hexdump -b"),
    ("binary", "(?:0b)?(?P<b>[01]{4}_?[01]{4})", r"(?: \(0x..\))?[ ,;]{0,2}", "xxd -b, ESPHome"),
    ("octal words", "(?P<O>[0-7]{6})", " {1,5}", "od"),
    ("decimal words", r"(?P<D>-?\d{1,5})", " {1,5}", "od -d, hexdump -d"),
    ("hex words", _GROUP, " ", "xxd, usbmon, LabVIEW, od -x, hexdump, xxd -e"),
    ("hex words, columns", _GROUP, " {2,5}", "hexdump -x, od -x of macOS"),
    ("0x words", "0[xX](?P<x>[0-9A-Fa-f]{4})", "[ ,;]{1,2}", "debuggers, arrays of uint16_t"),
    ("base64", r"(?<![\w+/-])(?P<q>(?:[\w+/-]{4})*[\w+/-]{2}(?:==|[\w+/-][\w+/=-]))(?![\w+/=-])",
     "", "JSON of MQTT and of clouds"),
    ("quoted escapes", _STRING, " ?", "Python, C, Qt, strace, JSON"),
    ("quoted decimal escapes", _STRING.replace("<t", "<u"), " ?", "Lua, Haskell"),
    ("text with escapes", _text_with("t"), "", "journalctl, logs of C strings without quotes"),
    ("text with hex escapes", _text_with("v"), "", "LabVIEW"),
    ("text with codes in brackets", _text_with("w"), "",
     "minicom, interceptty, DSView, Docklight, Bray's Terminal, Termite, Hercules, YAT"),
    ("a character in each line",
     r"(?<![^,;\t\n])'?(?:(?:\\x|[\[<]|0x)@@[\]>]?|\\(?P<e>[a-z0])|(?P<c>[ -~]))'?(?![^,;\t\n])",
     "", "DSView, Saleae Logic in ASCII"),
    ("characters of od -c", _OD_CELL, "", "od -c, hexdump -c"),
)  # fmt: skip
"""Name, unit, separator, programs."""


def _extractors() -> Iterator[Extractor]:
    units = set[str]()
    for name, unit, separator, tools in _FORMS:
        one, between = _unnamed(unit), f"(?:{separator})"
        several = unit in units or separator == _TOGETHER
        run = f"{_EDGE}{one}(?:{between}{one})*+{_EDGE}".encode()
        part = f"{between}?(?:{_expanded(unit)})".encode()
        needs = f"{one}(?:{between}{one}){{3}}".encode() if several else b""
        units.add(unit)
        for order in (", big endian", ", little endian") if "words" in name else ("",):
            swaps, masks = order == ", little endian", name != "hex pairs, colons"
            yield Extractor(name + order, tools, run, part, needs, swaps, masks)


EXTRACTORS: Final = tuple(_extractors())
"""All of them; earlier ones are preferred where the evidence is equal."""


WIRES: Final = ("tx", "rx")
"""Their labels: that of control frames first."""
_HEADERS: Final = (HEADERS[Direction.CONTROL], HEADERS[Direction.FEEDBACK])
_WHOLE: Final = 20.0
_NOISE: Final = -4.0
_TWICE: Final = -2.0
"""Scores of a whole frame, a byte outside frames, and two bytes of one wire while both send."""
_BEHIND: Final = 24.0
"""How much less than the best score a reading is dropped at."""
_CLEAR: Final = 16.0
"""How much less the others' scores are if one reading is clearly the best."""
_MOST_READINGS: Final = 48
_LONGEST_UNDECIDED: Final = 1000
"""Bytes that wait at most until one reading is clearly the best."""


class _WirePath(NamedTuple):
    """The wires of the last bytes of a reading."""

    before: _WirePath | None
    wire: int


class _WireReading(NamedTuple):
    """A reading of the bytes so far."""

    score: float
    path: _WirePath | None


_State = tuple[int, int, int]
"""Bytes of the frame that each wire sends, 0 for none, and the wire of the last byte."""


@cache
def _legal(wire: int) -> tuple[frozenset[int], ...]:
    """The legal values of each byte of the frames of a wire."""
    own = [FTE_FORMAT.legal_bytes(kind) for kind in KINDS]
    own = [legal for legal in own if legal[0] and legal[0][0] == _HEADERS[wire]]
    every = frozenset(range(256))
    first = [frozenset(value for legal in own for value in (legal[at] or every)) for at in range(3)]
    return (*first, *[every] * (FRAME_LENGTH - 4), frozenset([TAIL]))


class Weave:
    """Decides to which of two wires each byte belongs, by the frames that then are whole."""

    def __init__(self) -> None:
        self._readings: dict[_State, _WireReading] = {(0, 0, 0): _WireReading(0.0, None)}
        self._size = 0
        """Bytes that are not decided."""

    def push(self, data: bytes, *, final: bool = False) -> bytes:
        """Append bytes; the wires, 0 or 1, of the bytes that are decided now, in their order."""
        decided = bytearray()
        for byte in data:
            self._readings = self._after(byte)
            self._size += 1
            state, best = max(self._readings.items(), key=lambda own: own[1].score)
            near = sum(own.score > best.score - _CLEAR for own in self._readings.values())
            is_clear = near == 1 and state[:2] == (0, 0)
            if is_clear or self._size >= _LONGEST_UNDECIDED:
                decided += self._decide(state, best)
        if final and self._size:
            decided += self._decide(*max(self._readings.items(), key=lambda own: own[1].score))
        return bytes(decided)

    def _decide(self, state: _State, best: _WireReading) -> bytes:
        wires, path = bytearray(), best.path
        while path is not None:
            wires.append(path.wire)
            path = path.before
        self._readings, self._size = {state: _WireReading(0.0, None)}, 0
        return bytes(wires[::-1])

    def _after(self, byte: int) -> dict[_State, _WireReading]:
        """The readings with one more byte, the best of each state."""
        readings = dict[_State, _WireReading]()
        for state, reading in self._readings.items():
            for after, gain in _steps(state, byte):
                score = reading.score + gain
                if after not in readings or readings[after].score < score:
                    readings[after] = _WireReading(score, _WirePath(reading.path, after[2]))
        least = max(own.score for own in readings.values()) - _BEHIND
        kept = {state: own for state, own in readings.items() if own.score >= least}
        if len(kept) > _MOST_READINGS:
            best = sorted(kept.items(), key=lambda own: -own[1].score)[:_MOST_READINGS]
            kept = dict(best)
        return kept


def _steps(state: _State, byte: int) -> Iterator[tuple[_State, float]]:
    """What a state may be after a byte, and the gain of score."""
    *seen, last = state
    for wire in (0, 1):
        if byte in _legal(wire)[seen[wire]]:
            is_twice = wire == last and seen[0] > 0 and seen[1] > 0
            sizes = [*seen]
            sizes[wire] = (seen[wire] + 1) % FRAME_LENGTH
            gain = (_WHOLE if sizes[wire] == 0 else 0.0) + (_TWICE if is_twice else 0.0)
            yield (sizes[0], sizes[1], wire), gain
    yield state, _NOISE
    for wire in (0, 1):  # the frame that it was is none
        if seen[wire]:
            sizes = [*seen]
            sizes[wire] = 0
            yield (sizes[0], sizes[1], wire), _NOISE * (1 + seen[wire])


def unwoven(data: bytes) -> tuple[bytes, bytes]:
    """The bytes of each wire."""
    wires = Weave().push(data, final=True)
    pairs = [*zip(data, wires, strict=True)]
    control, feedback = (bytes(byte for byte, own in pairs if own == wire) for wire in (0, 1))
    return control, feedback


NUMBER_TOKEN: Final = re.compile(
    rb"(?<![A-Za-z])(?:0[xX])?[0-9A-Fa-f]*\d[0-9A-Fa-f]*(?:[.:\-][0-9A-Fa-f]*\d[0-9A-Fa-f]*)*"
    rb"|\b[0-9A-F]{2}\b|\b[0-9a-f]{2}\b"
)
GOES_ON: Final = re.compile(
    rb"-[0-9A-Fa-f]{2}-|: ?[^\s.+\xe2]| [^\w\s.+]{0,2}[A-Za-z]{3}|[ ,;\t]+\d{3,}(?![\w.:-])"
)
"""After a run that is a part of something else: of words, or of numbers."""
_BLANK: Final = re.compile(rb"\s+")
_COLUMN_GAP: Final = re.compile(rb" {8,}")
_FRAME_SCORE: Final = 10.0
_OUTSIDE_SCORE: Final = -0.05
_LANE_SCORE: Final = -2.0
_LEAST_SHARE: Final = 0.05
_LEAST_SHARE_CUT: Final = 0.8
"""Of the bytes of lanes, how many are in frames; the same if numbers are left out."""
_ALMOST_ALL: Final = 0.95
_FEW_LANES: Final = 4
"""Lanes from which on it is tried whether only common words make them."""
RECORD_BORDER: Final = rb"\}\s*,?\s*(?=\{)|\]\s*,\s*(?=\[)|</\w+>|;"
"""Between two records in a line."""
LIKE_BYTES: Final = 4
"""Bytes of a run from which on it is not a number by accident."""
_LEAST_COMMON: Final = 1 / 8
"""Of the runs, how many have a word before them that may make their lane."""
_MOST_UNWOVEN: Final = 4000
_LEAST_HEADERS: Final = 0.01
"""Bytes of a lane that show whether they are of two wires, and how many are headers of each."""
_LOOSE: Final = 1.1
"""How much better the frames must be if only common words make lanes."""
_SAME: Final = 0.9
_FEW_DIFFERENT: Final = 3
"""Of the runs of a lane, how many are those of another if it repeats them, and are different."""
_LONGEST_KEY: Final = 100
"""Characters before a run that make its lane."""
_MOST_COLUMNS: Final = 8
"""Runs of a line with the same text between them that may be columns; more are records."""
_MOST_LANES: Final = 48
_CUTS: Final = [slice(first, -last or None) for first, last in product(range(5), range(3))][1:]
"""Without offsets before the data of each run, and a count or sum after them."""
_SENT: Final = (
    r"(?i:(?<![a-z])(?:tx\d?|txd|out(?:going|put)?|transmit(?:ted)?|wrote|request|host|master|pc"
    r"|dte|t(?=\s?:)|(?:on|serial)?_?(?:send|sent|writ(?:e|es|ten|ing)))(?![a-z]))"
    r"|[a-z](?:Send|Sent|Write)|发[送出]?|写入?"
)
_RECEIVED: Final = (
    r"(?i:(?<![a-z])(?:rx\d?|rxd|in(?:coming|put)?|reply|response|device|slave|mcu|controller|dce"
    r"|r(?=\s?:)|(?:on|serial)?_?(?:recv|receiv(?:e|es|ed|ing)|reads?|reading))(?![a-z]))"
    r"|on(?:New)?Data|[a-z](?:Recv|Receiv|Read)|接?收到?|读取?"
)
_PATTERNS: Final = {
    "port": r"(?<![A-Za-z])(?:/dev/)?((?i:com\d+|tty[a-z]*\d+|cu\.[\w-]+|us?art[-_ ]?\d+"
    r"|serial\d+|ch(?:annel)?[-_ ]?\d+|port[-_ ]?\d+|peer\d+))(?![A-Za-z0-9])",
    "word": rf"(?P<tx>{_SENT})|(?P<rx>{_RECEIVED})",
    "arrow": r"</?[A-Za-z!?][^<>]*>|[/\"'?]>|(?P<tx>[→⇒►▶]|[=-]>|>+)|(?P<rx>[←⇐◄◀]|<[=-]|<+(?!\w))",
}
"""Of labels, by their kind; tags of XML are not arrows."""


@cache
def _pattern(length: int) -> re.Pattern[bytes]:
    """Of frames, if they had this length."""
    starts = [
        b"".join(b"[%b]" % re.escape(one) if one else b"." for one in legal[:3])
        for legal in map(FTE_FORMAT.legal_bytes, KINDS)
    ]
    return re.compile(rb"(?s)(?:%b).{%d}\x%02x" % (b"|".join(starts), length - 4, TAIL))


def frames_in(data: bytes) -> list[bytes]:
    """The whole frames in these bytes, from left to right."""
    return _pattern(FRAME_LENGTH).findall(data)


@lru_cache(maxsize=64)
def _frames_of_wires(data: bytes) -> list[bytes]:
    """The whole frames of two wires whose bytes are in turn in these bytes, if they may be."""
    headers = [data.count(header) for header in HEADERS.values()]
    if len(data) < 2 * FRAME_LENGTH or min(headers) < _LEAST_HEADERS * len(data):
        return []
    return [frame for own in unwoven(data) for frame in frames_in(own)]


def are_known(frames: Sequence[bytes], others: Sequence[bytes]) -> bool:
    """Whether almost all of these frames are among others."""
    return (Counter(frames) - Counter(others)).total() <= 0.1 * len(frames)


@lru_cache(maxsize=4096)
def label_of(kind: str, text: bytes) -> str | None:
    """The last `word`, `arrow` or `port` in a text, or the `first word`.

    `direction` is a word or an arrow, `both` a port with one, and `given` all the text.
    """
    readable = text.decode("utf-8", "replace")
    if kind == "given":
        return label_of("direction", text) or readable.strip(" \x01").lower()
    if kind == "both":
        port, direction = label_of("port", text), label_of("direction", text)
        return f"{port}-{direction}" if port and direction else None
    if kind == "direction":
        return label_of("word", text) or label_of("arrow", text)
    pattern = _PATTERNS[kind.removeprefix("first ")]
    every = re.finditer(pattern, readable)
    found = [
        one.lastgroup or one[1].lower() for one in every if one.lastgroup or one.re.groups == 1
    ]
    return found[0 if kind == "first word" else -1] if found else None


@lru_cache(maxsize=4096)
def without_labels(text: bytes) -> str:
    """The text without directions and ports."""
    readable = text.decode("utf-8", "replace")
    for pattern in _PATTERNS.values() if readable else ():  # they are slow to compile
        readable = re.sub(pattern, "", readable)
    return readable


@lru_cache(maxsize=8192)
def folded(text: bytes) -> bytes:
    """The text with each number as 0, and white space as one space; a column is apart."""
    text = NUMBER_TOKEN.sub(b"0", _COLUMN_GAP.sub(b" ~ ", text))
    return _BLANK.sub(b" ", text) if text.strip(b" ") else b""


Common = frozenset[bytes]


@lru_cache(maxsize=8192)
def _loose(key: bytes, common: Common | None) -> bytes:
    """A key in which words that are not common differ only in how many numbers they have."""
    if common is None:
        return key
    words = re.split(rb"(\s+)", key)
    words[::2] = [
        word if word in common or not word else b"*" + b"0" * word.count(b"0")
        for word in words[::2]
    ]
    return b"".join(words)


def _common_words(keys: Iterable[bytes]) -> Common:
    """The words that many of the runs with these keys have before them."""
    every = [{*key.split()} for key in keys]
    count = Counter(word for words in every for word in words)
    return frozenset(word for word, own in count.items() if own > _LEAST_COMMON * len(every))


def _ends(key: str) -> tuple[list[str], list[str]]:
    """The first and the last word of a key."""
    words = key.split()
    return words[:1], words[-1:]


def runs_in_lanes(
    text: bytes, runs: Iterable[Run], common: Common | None = None
) -> Iterator[tuple[Run, bytes]]:
    """Runs of a text with the keys of their lanes.

    The key is what is before a run in its line, with earlier runs as numbers, and whether words
    follow at once. In a line of many records, that is the same for each of them, because the same
    text is between them. If only some words are `common`, such as where names or characters are
    beside the bytes, the others are equal.
    """
    before, end, last, repeated = b"", 0, b"", 0
    for run in runs:
        if line := text.rfind(b"\n", end, run.start) + 1:
            before, end, last, repeated = b"", line, b"", 0
        between, after = folded(text[end : run.start]), text[run.stop : run.stop + 8]
        is_record = between == last and repeated >= _MOST_COLUMNS
        key = _loose((before if is_record else before + between)[-_LONGEST_KEY:], common)
        yield run, key + "…".encode() if GOES_ON.match(after) else key
        if len(run.data) >= LIKE_BYTES:
            repeated = repeated + 1 if between == last else 0
            before, end, last = key if repeated >= _MOST_COLUMNS else key + b"0", run.stop, between
        elif run.start - end > _LONGEST_KEY:
            before, end = key, run.start


class Placed(NamedTuple):
    """The bytes of a run in a sample."""

    start: int
    record: int
    """The number of its record, which is a line or a part of it."""
    data: bytes


class Lane:
    """Runs whose lines look the same before the run; or several such lanes that make frames."""

    def __init__(self, cuts: Mapping[bytes, slice], runs: list[Placed]) -> None:
        self.cuts = cuts
        """By the text before the runs, which numbers of a run are data."""
        self.runs = sorted(runs)
        self.data = b"".join([run.data for run in self.runs])
        self.frames = frames_in(self.data)
        self.outside = len(self.data) - FRAME_LENGTH * len(self.frames)
        in_frames, outside = _FRAME_SCORE * len(self.frames), _OUTSIDE_SCORE * self.outside
        self.score = in_frames + outside + _LANE_SCORE * len(cuts)

    @cached_property
    def different(self) -> set[bytes]:
        """The bytes of its runs."""
        return {run.data for run in self.runs}

    @cached_property
    def in_records(self) -> set[tuple[int, bytes]]:
        """Record and bytes of its runs."""
        return {(run.record, run.data) for run in self.runs}

    @cached_property
    def number_records(self) -> list[int]:
        """The records of its runs that may be numbers by accident."""
        return [run.record for run in self.runs if len(run.data) < LIKE_BYTES]

    @cached_property
    def sizes(self) -> set[int]:
        """How many bytes its runs have."""
        return {len(run.data) for run in self.runs}

    @cached_property
    def starts(self) -> list[int]:
        """Where its runs begin."""
        return [run.start for run in self.runs]

    def cut(self) -> Lane:
        """The lane without numbers that are not data, if 80 % of the others are in frames."""
        found = [self]
        for cut in _CUTS if self.outside >= len(self.runs) > 1 else ():
            data = b"".join([run.data[cut] for run in self.runs])
            if FRAME_LENGTH * len(frames_in(data)) > _LEAST_SHARE_CUT * len(data):
                own = [run._replace(data=run.data[cut]) for run in self.runs]
                found.append(Lane(dict.fromkeys(self.cuts, cut), own))
        return max(found, key=lambda lane: lane.score)

    @cached_property
    def labels(self) -> set[str | None]:
        """What is before the runs."""
        return {label_of(kind, key) for kind in _PATTERNS for key in self.cuts}

    def repeats(self, other: Lane) -> bool:
        """Whether it has the bytes of another a second time.

        That is so if they are in the same records, or if they have the same direction and port and
        are the frames of the other, or each run is that of the other before or after it.
        """
        if len(self.different) <= _FEW_DIFFERENT or self.different.isdisjoint(other.different):
            return False
        records = other.in_records
        if self._mostly((run.record, run.data) in records for run in self.runs):
            return True
        if not self.labels <= other.labels:
            return False
        if len({*self.frames}) > _FEW_DIFFERENT and are_known(self.frames, other.frames):
            return True
        return any(self._follows(other, step) for step in (-1, 0))

    def _follows(self, other: Lane, step: int) -> bool:
        """Whether almost each run is that of another lane before it (-1) or after it (0)."""
        starts, runs, found = other.starts, other.runs, set[int]()

        def is_that(run: Placed) -> bool:
            at = bisect(starts, run.start) + step
            is_same = 0 <= at < len(starts) and run.data == runs[at].data
            if is_same:
                found.add(at)
            return is_same

        return self._mostly(map(is_that, self.runs)) and len(found) >= _SAME * len(self.runs)

    def _mostly(self, same: Iterable[bool]) -> bool:
        """Whether almost all of its runs are the same; it stops at one too many that is not."""
        others = 0
        for one in same:
            others += not one
            if len(self.runs) - others < _SAME * len(self.runs):
                return False
        return True

    def differs_from(self, other: Lane) -> list[bool]:
        """Whether another word, or other numbers, are before its runs."""
        own, its = next(iter(self.cuts)), next(iter(other.cuts))
        return [own.split()[-1:] != its.split()[-1:], own.count(b"0") != its.count(b"0")]

    def joined(self, other: Lane) -> Iterator[Lane]:
        """Both as one lane, but not if numbers of one are beside those of the other.

        Where each run is one byte, two numbers of the other are a character and its byte.
        """
        beside = sum(map({*self.number_records}.__contains__, other.number_records))
        if 2 * beside <= min(len(self.runs), len(other.runs)):
            yield Lane({**self.cuts, **other.cuts}, self.runs + other.runs)
        if (self.sizes, other.sizes) == ({1}, {2}):
            runs = [run._replace(data=run.data[1:]) for run in other.runs]
            yield Lane({**self.cuts, **dict.fromkeys(other.cuts, slice(1, None))}, self.runs + runs)


class Hypothesis:
    """An extractor with the lanes that hold bytes."""

    def __init__(
        self,
        extractor: Extractor,
        lanes: Sequence[Lane],
        common: Common | None = None,
        repeated: Iterable[Lane] = (),
    ) -> None:
        self.extractor, self.lanes, self.common = extractor, lanes, common
        self.is_woven = False
        """Whether bytes of two wires are in one lane."""
        self.frames = [frame for lane in lanes for frame in lane.frames]
        self.score = sum(lane.score for lane in lanes) / (1 if common is None else _LOOSE)
        self.size = sum(len(lane.data) for lane in lanes)
        self.share = FRAME_LENGTH * len(self.frames) / max(self.size, 1)
        """Of the bytes, how many are in frames."""
        self.rank = len(self.frames), self.share >= _ALMOST_ALL
        """Whole frames, and whether there is almost nothing else."""
        self.cuts: dict[str, slice] = {}
        """By the text before the runs, without labels, which numbers of a run are data."""
        self._cuts: dict[bytes, slice | None] = {key: None for one in repeated for key in one.cuts}
        for lane in lanes:
            self._cuts |= lane.cuts
            for key, cut in lane.cuts.items():
                self.cuts.setdefault(without_labels(key), cut)

    def unwoven(self) -> Hypothesis:
        """This hypothesis, or one of two wires if its bytes are those of two wires in turn."""
        lane = self.lanes[0] if len(self.lanes) == 1 else None
        if self.share >= _ALMOST_ALL or lane is None or lane.sizes != {1}:
            return self
        data = lane.data[:_MOST_UNWOVEN]
        frames = _frames_of_wires(data)
        if FRAME_LENGTH * len(frames) < _LEAST_SHARE_CUT * len(data):
            return self
        found = Hypothesis(self.extractor, self.lanes, self.common)
        found.is_woven, found.frames = True, frames
        found.share = FRAME_LENGTH * len(frames) / len(data)
        found.score = _FRAME_SCORE * found.share * len(lane.data) / FRAME_LENGTH
        found.rank = len(frames), found.share >= _ALMOST_ALL
        return found

    def cut_of(self, key: bytes, size: int) -> slice | None:
        """Which numbers of a run of this lane and `size` are data; None if it is another lane.

        A number that is left out is not in the run where it is too large for a byte.
        """
        words = without_labels(key)
        if self.common is not None and key not in self._cuts and words not in self.cuts:
            ends = _ends(words)  # between them are words or characters that are rare
            return next((cut for own, cut in self.cuts.items() if _ends(own) == ends), None)
        if key in self._cuts or words in self.cuts or size < LIKE_BYTES:
            return self._cuts.get(key, self.cuts.get(words))
        before, missing = words.removesuffix("…"), 0
        while (cut := self.cuts.get(before, self.cuts.get(before.strip()))) is None:
            shorter = re.sub(r"0[ ,;\t]+$", "", before)
            if shorter == before:
                return None
            before, missing = shorter, missing + 1
        first, last = (cut.start or 0) - missing, (cut.stop or 0) + words.endswith("…")
        return slice(first, last or None) if first >= 0 >= last else None

    @property
    def accepted(self) -> bool:
        """Whether there are more frames than by chance."""
        return not self.fault

    @property
    def fault(self) -> str:
        """Why it is not accepted; empty if it is."""
        if not self.frames:
            return "no whole frame"
        if self.share < _LEAST_SHARE:
            return f"only {self.share:.1%} of its bytes are in frames"
        patterns = [_pattern(length) for length in (7, 8, 9, 11, 12, 13)]
        wrong = sum(len(one.findall(lane.data)) for one in patterns for lane in self.lanes)
        if len(self.frames) < 2 * wrong / len(patterns):
            return f"{wrong} patterns of {len(patterns)} wrong lengths, so its frames are chance"
        return ""

    def __str__(self) -> str:
        found = f"frames: {len(self.frames)}, bytes: {self.size:,}, lanes: {len(self.cuts)}"
        return f'"{self.extractor.name}", {found}, score: {self.score:.1f}'


def hypotheses(
    lines: Sequence[bytes], extractors: Iterable[Extractor], needed: bytes = bytes([TAIL])
) -> list[Hypothesis]:
    """What extractors whose runs have the needed bytes find in lines, the best score first."""
    text, found = b"\n".join(lines), list[Hypothesis]()
    texts = text, masked(text)
    for one in extractors:
        text = texts[one.masks_times]
        runs = list(one.runs(text)) if re.search(one.needs, text) else []
        if not any(needed in run.data for run in runs):
            runs = []
        border = rb"\n" if text.count(b"\n") > _FEW_LANES else RECORD_BORDER + rb"|\n"
        borders = [found.start() for found in re.finditer(border, text)] if runs else []
        placed = [Placed(run.start, bisect(borders, run.start), run.data) for run in runs]
        keys = [key for _, key in runs_in_lanes(text, runs)]
        best = _hypothesis(one, keys, placed, None)
        if len({*keys}) > _FEW_LANES:
            common = _common_words(keys)
            loosened = [key for _, key in runs_in_lanes(text, runs, common)]
            if len({*loosened}) < len({*keys}):  # else the lanes are the same
                loose = _hypothesis(one, loosened, placed, common)
                best = max(best, loose, key=lambda own: own.score)
        found.append(best.unwoven())
    return sorted(found, key=lambda one: -one.score)


def _hypothesis(
    extractor: Extractor, keys: Iterable[bytes], runs: Iterable[Placed], common: Common | None
) -> Hypothesis:
    """The best lanes for runs with these keys."""
    lanes = dict[bytes, list[Placed]]()
    for key, run in zip(keys, runs, strict=True):
        lanes.setdefault(key, []).append(run)
    whole = [Lane({key: slice(None)}, own) for key, own in lanes.items()]
    cut = [lane.cut() for lane in whole]
    choices = [_chosen(own) for own in ((whole,) if cut == whole else (whole, cut))]
    return max(
        (Hypothesis(extractor, own, common, repeated) for own, repeated in choices),
        key=lambda own: own.score,
    )


def _chosen(lanes: Iterable[Lane]) -> tuple[list[Lane], list[Lane]]:
    """Choose lanes greedily, each alone or joined with a chosen one, for the best score.

    Lanes that repeat a chosen one are the second list. Of two that repeat each other, the first
    in the text is chosen.
    """
    most = sorted(lanes, key=lambda lane: (-len(lane.frames), -len(lane.data)))[:_MOST_LANES]
    first = list[Lane]()
    for lane in sorted(most, key=lambda lane: lane.runs[:1]):
        first += [] if any(lane.repeats(one) for one in first) else [lane]
    most[1:] = sorted(most[1:], key=lambda lane: lane.differs_from(most[0]))
    repeated = [lane for lane in most if lane not in first]
    most = [lane for lane in most if lane in first]
    chosen = most[:1]
    for lane in most[1:]:
        if any(lane.repeats(one) for one in chosen):
            repeated.append(lane)
            continue
        choices = [chosen, [*chosen, lane]]
        for at, own in enumerate(chosen):
            choices += [[*chosen[:at], one, *chosen[at + 1 :]] for one in own.joined(lane)]
        chosen = max(choices, key=lambda choice: sum(one.score for one in choice))
    return chosen, repeated
