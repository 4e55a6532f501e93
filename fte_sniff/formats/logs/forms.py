"""The forms × separators table: how programs write bytes, each combination as an extractor.

An extractor is a regular expression, made from a row of the table, for the runs of bytes in a text
of lines: units with a separator between two. Texts are bytes, so that offsets hold whatever the
encoding around the runs.
"""

from __future__ import annotations

import re
from base64 import urlsafe_b64decode
from binascii import unhexlify
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from typing import Final, NamedTuple

_LONGEST_KNOWN: Final = 16
_MOST_KNOWN: Final = 1 << 16
"""Characters of a piece of a run whose bytes are kept, and how many are."""


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
    """The bytes of the pieces of runs, by their text."""

    def __init__(self, bytes_of: BytesOf) -> None:
        super().__init__()
        self._bytes_of = bytes_of

    def __missing__(self, text: bytes) -> bytes:
        data = self._bytes_of(text)
        if len(text) <= _LONGEST_KNOWN and len(self) < _MOST_KNOWN:
            self[text] = data
        return data


def _by_pieces(
    bytes_of_piece: BytesOf,
    searched: Callable[[bytes], tuple[bytes, bytes | None]],
    *,
    is_hex: bool = False,
) -> BytesOf:
    """What returns the bytes of a text by those of its pieces, without a search for them.

    Pieces of a log mostly begin with the same character, so that a text can be split there.

    Args:
        bytes_of_piece: raises ValueError if it is not a whole one.
        searched: the bytes of a text by a search, and the character that pieces may begin with;
            none if a text is one piece, None to search the next text too.
        is_hex: whether the texts are pairs of hexadecimal digits and what separates them; where
            that is always one character, the digits without it are the bytes.
    """
    mark: bytes | None = None
    are_digits = False
    first_pieces = _Known(bytes_of_piece)
    following = _Known(lambda piece: bytes_of_piece((mark or b"") + piece))

    def bytes_of(text: bytes) -> bytes:
        nonlocal mark, are_digits
        if mark is not None:
            try:
                if are_digits:
                    return unhexlify(text.replace(mark, b""))
                if not mark:
                    is_short = len(text) <= _LONGEST_KNOWN
                    return first_pieces[text] if is_short else bytes_of_piece(text)
                first, *others = text.split(mark)
                data = first_pieces[first] if first else b""
                return data + b"".join(map(following.__getitem__, others))
            except (ValueError, OverflowError):
                pass
        was = mark
        data, mark = searched(text)
        if mark != was:
            following.clear()
        are_digits = is_hex and text.replace(mark or b"", b"").lower() == data.hex().encode()
        return data

    return bytes_of


@cache
def _bytes_of_runs(unit: bytes, swaps: bool) -> BytesOf:
    """What returns the bytes of the text of a run of units."""
    unnamed = re.sub(rb"[?]P<[^>]+>", b"?:", unit)
    compiled = re.compile(unit)
    units, whole, step = re.compile(unnamed).findall, compiled.fullmatch, -1 if swaps else 1
    kinds = [name[0] for name in compiled.groupindex]
    if unit.startswith(_NO_SEPARATOR) and len(kinds) == 1 and kinds[0] in _CODES:
        return _bytes_of_codes(kinds[0])  # a run is one text

    def bytes_of_unit(text: bytes) -> bytes:
        found = whole(text)
        if found is None:
            raise ValueError(text)
        return _bytes_of(found)[::step]

    def searched(run: bytes) -> tuple[bytes, bytes | None]:
        texts = units(run)
        begin = texts[1][:1] if len(texts) > 1 else b""
        try:
            return b"".join(map(known, texts)), b"" if begin.isalnum() else begin
        except (ValueError, OverflowError):
            return b"", None

    known = _Known(bytes_of_unit).__getitem__
    return _by_pieces(bytes_of_unit, searched, is_hex=kinds == ["x"] and not swaps)


@cache
def _bytes_of_codes(kind: str) -> BytesOf:
    """What returns the bytes of a text with codes of a kind."""
    codes = re.compile(_expanded(_CODES[kind]).encode())

    def bytes_of_piece(text: bytes) -> bytes:
        if text[:1] in _BEFORE_CODES and not codes.match(text):
            raise ValueError(text)
        return codes.sub(_bytes_of, text)

    def searched(text: bytes) -> tuple[bytes, bytes | None]:
        first = codes.search(text)
        return codes.sub(_bytes_of, text), first[0][:1] if first else None

    return _by_pieces(bytes_of_piece, searched)


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
    bytes_of_codes = _bytes_of_codes(kind)

    def bytes_of_text(text: bytes) -> bytes:
        if not text.isascii():
            with suppress(UnicodeError):
                text = text.decode().encode("latin-1")
        return bytes_of_codes(text)

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
_BEFORE_CODES: Final = (b"\\", b"[", b"<", b"{", b"(")
_KINDS: Final[dict[str, BytesOf]] = {
    "x": unhexlify,
    "q": urlsafe_b64decode,
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


_NO_SEPARATOR: Final = b"(?:)?"
"""How the pattern of a unit begins if nothing separates units."""


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
