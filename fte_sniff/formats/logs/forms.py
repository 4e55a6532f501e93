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
from functools import partial
from typing import Final, NamedTuple


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
    cut: slice = slice(None)
    """Which numbers of a run are data; others are an offset before or a checksum after them."""

    def runs(self, text: bytes) -> Iterator[Run]:
        """The runs of a line, or of several lines."""
        decoded, bytes_of = re.compile(self.unit).sub, _swapped if self.swaps else _bytes_of
        for found in re.finditer(self.pattern, text):
            with suppress(ValueError, OverflowError):
                if data := decoded(bytes_of, found[0])[self.cut]:
                    yield Run(*found.span(), data)


def _bytes_of(unit: re.Match[bytes]) -> bytes:
    kind = unit.lastgroup or ""
    return _KINDS[kind[0]](unit[kind])


def _swapped(unit: re.Match[bytes]) -> bytes:
    return _bytes_of(unit)[::-1]


def _number(base: int, size: int, digits: bytes) -> bytes:
    value = int(digits, base)
    return value.to_bytes(size, "big", signed=value < 0)


def _text(code: str, text: bytes) -> bytes:
    with suppress(UnicodeError):
        text = text.decode().encode("latin-1")
    return re.sub(_expanded(code).encode(), _bytes_of, text)


def _expanded(pattern: str) -> str:
    """A pattern of the table: `@@` is a byte in two hexadecimal digits, `@` in one or two."""
    pattern = re.sub("@@", lambda at: f"(?P<x{at.start()}>[0-9A-Fa-f]{{2}})", pattern)
    return pattern.replace("@", "(?P<h>[0-9A-Fa-f]{1,2})(?![0-9A-Fa-f])")


def _unnamed(pattern: str) -> str:
    return f"(?:{re.sub(r'[?]P<[^>]+>', '?:', _expanded(pattern))})"


_CONTROLS: Final = dict(
    zip(
        b"NUL SOH STX ETX EOT ENQ ACK BEL BS HT LF VT FF CR SO SI DLE DC1 DC2 DC3 DC4 NAK SYN ETB"
        b" CAN EM SUB ESC FS GS RS US SP DEL TAB NL NULL".split(),
        bytes((*range(33), 127, 9, 10, 0)),
        strict=True,
    )
)
_LETTERS: Final = bytes.maketrans(b"abtnvfre0s", b"\a\b\t\n\v\f\r\x1b\0 ")
_ESCAPE: Final = r"\\(?:x\{?|u00)@@(?:(?<=\{..)\})?|\\(?P<o>[0-3]?[0-7]{1,2})|\\(?P<e>.)"
_DECIMAL_ESCAPE: Final = r"\\(?P<d>\d{1,3})|\\(?P<e>.)"
_HEX_ESCAPE: Final = r"\\@@|\\(?P<e>[a-z\\])"
_CODE: Final = rf"[\[<{{(](?:(?:0x)?@@|(?P<n>{b'|'.join(_CONTROLS).decode()}))[\]>}})]"
_KINDS: Final[dict[str, Callable[[bytes], bytes]]] = {
    "x": unhexlify,
    "h": partial(_number, 16, 1),
    "d": partial(_number, 10, 1),
    "o": partial(_number, 8, 1),
    "b": partial(_number, 2, 1),
    "D": partial(_number, 10, 2),
    "O": partial(_number, 8, 2),
    "q": urlsafe_b64decode,
    "n": lambda name: bytes([_CONTROLS[name]]),
    "e": lambda letter: letter.translate(_LETTERS),
    "c": bytes,
    "t": partial(_text, _ESCAPE),
    "u": partial(_text, _DECIMAL_ESCAPE),
    "v": partial(_text, _HEX_ESCAPE),
    "w": partial(_text, _CODE),
}
"""How a group becomes bytes, by the first letter of its name."""


def _text_with(code: str, kind: str) -> str:
    """The pattern of words with a code, from the first to the last of them."""
    one = _unnamed(code)
    word = rf"(?:(?!{one})[!-~])*+"
    return rf"(?<![!-~])(?P<{kind}>{word}{one}(?:(?:(?!{one})[ -~])*+{one})*+{word})"


_BEGIN: Final = r"(?:(?![0-9A-Za-z])|(?<![0-9A-Za-z]))"
_END: Final = r"(?:(?<![0-9A-Za-z])|(?![0-9A-Za-z]))"
"""Where no word goes on."""
_GROUP: Final = "(?P<x>(?:[0-9A-Fa-f]{2})++)"
_BYTE: Final = (
    r"(?<![\w.])(?<!\d:)(?P<d>25[0-5]|2[0-4]\d|[01]?\d{1,2}|-(?:12[0-8]|1[01]\d|\d{1,2}))"
    r"(?!\w|[.:]\d|\"\s*:)"
)
"""Of -128 to 255: a counter beside the bytes is one of them only up to there."""
_ANY: Final = r"[^0-9A-Za-z\\$%&#\r\n]{0,4}+"
_STRING: Final = r"[bu]?(?:\"(?P<t>(?:[^\"\\\n]|\\.)*+)\"|'(?P<t1>(?:[^'\\\n]|\\.)*+)')"
_CELL: Final = (
    r"(?<![^,;\t])(?:'?\\x@@'?|[\[<]@@[\]>]|'0x@@'|'?\\(?P<e>[abtnvfr0])'?|'(?P<c>.)'"
    r"|(?P<c1>[ -~]))(?![^,;\t\n])"
)
_OD_CELL: Final = r" (?P<o>[0-3][0-7]{2})|  \\(?P<e>[0abtnvfr])|   (?P<c>[ -~])"
_BASE64: Final = r"(?<![\w+/-])(?P<q>(?:Q{4})*Q{2}(?:==|Q=|Q{2}))(?![\w+/=-])".replace(
    "Q", r"[\w+/-]"
)
_TOGETHER: Final = "(?<=[0-9A-F]{2})(?=[0-9A-F]{2})|(?<=[0-9a-f]{2})(?=[0-9a-f]{2})"
"""Between digits in one case; mixed case is a word."""
_NONE: Final = "(?!)"
_FORMS: Final = (
    ("hex pairs, spaces", "@@", " ", "SSCOM, CoolTerm, Docklight, socat -x, most terminals"),
    ("hex pairs, halves", "@@", " {1,2}(?:(?:-|┊) )?|-",
     "hexdump -C, WinHex, hexyl, GtkTerm, DEBUG.EXE, .NET"),
    ("hex pairs, commas", "@@", " ?, ?", "Modbus tools, Serial Studio, CSV exports"),
    ("hex pairs, colons", "@@", ":", "ESPHome, HHD Serial Monitor, tshark"),
    ("hex pairs, dashes", "@@", " ?- ?", "C# BitConverter, modbus_tk"),
    ("hex pairs, cells", "@@", r"\t| ?[;|] ?",
     "spreadsheets, LabVIEW, HTerm, PulseView, Markdown tables"),
    ("hex pairs, points", "@@", "[._/]", "Cisco consoles, Verilog test benches, PLC consoles"),
    ("hex pairs, tags", "@@", r"(?:</?[a-z]\w*>)++", "tables in HTML and XML"),
    ("hex digits", r"(?:0[xX]|\\x)?@@", _TOGETHER, "Tasmota, logcat, candump, MQTT, SQL"),
    ("hex words", _GROUP, " ", "xxd, usbmon, LabVIEW, od -x, hexdump, xxd -e"),
    ("hex words, columns", _GROUP, " {2,5}", "hexdump -x, od -x of macOS"),
    ("unpadded hex", "@", " {1,2}| ?[,-] ?",
     "HTerm, AccessPort, Arduino, JavaScript toString(16), Java toHexString"),
    ("0x before each byte", r"0[xX]@[}'\"#]?+", _ANY,
     "C, Rust, Saleae Logic, Wireshark C arrays, CoolTerm"),
    (r"\x before each byte", r"(?:\\+(?:x\{?|u00)|U\+00)@@\}?+(?![0-9A-Fa-f])", _ANY,
     "shells, jq, printf, JavaScript, JSON"),
    ("a sign before each byte", r"(?:#?\$|%|&[hH]|8'h|(?:(?:B#)?16)?#)@#?+", _ANY,
     "Pascal, HTerm, URLs, Visual Basic, Verilog, Docklight scripts, IEC 61131, Erlang"),
    ("x before each byte", r"[xXhH]['\"]?@['\"]?+", _ANY, "VHDL, SQL, WaveForms"),
    ("h after each byte", "0?@@[hH]", "[ ,;]{0,3}", "assemblers, YAT, HTerm"),
    ("hex in brackets", r"[\[<({\"'](?:0[xX])?@[\]>)}\"']", "[ ,;]{0,2}",
     "RealTerm, libmodbus, Termite, Hercules, slsnif, Tcl, lists of strings in JSON and Python"),
    ("decimal in brackets", r"[!-~]?[\[<({](?P<d>\d{3})[\]>)}]", " ?", "Bray's Terminal, slsnif"),
    ("decimal, spaces", _BYTE, r"[ \t]+", "MATLAB, Go, NumPy, RealTerm"),
    ("decimal, commas", _BYTE, r"[ \t]*,[ \t]*", "Java, Python, ROS, Node-RED"),
    ("decimal, semicolons", _BYTE, " ?; ?", "spreadsheets"),
    ("decimal, dashes", _BYTE, "-", "Docklight"),
    ("decimal, keys", _BYTE, r" ?, ?\"\d+\" ?: ?", "JSON of a Uint8Array"),
    ("octal", "(?P<o>[0-3][0-7]{2})", "[ ,]{1,2}", "od -b, hexdump -b"),
    ("binary", "(?:0b)?(?P<b>[01]{4}_?[01]{4})", "[ ,;]{0,2}", "xxd -b, FPGA logs"),
    ("octal words", "(?P<O>[0-7]{6})", " {1,5}", "od"),
    ("decimal words", r"(?P<D>-?\d{1,5})", " {1,5}", "od -d, hexdump -d"),
    ("0x words", "0[xX](?P<x>[0-9A-Fa-f]{4})", "[ ,;]{1,2}", "debuggers, arrays of uint16_t"),
    ("base64", _BASE64, _NONE, "JSON of MQTT and of clouds"),
    ("quoted escapes", _STRING, " ?", "Python, C, Qt, strace, JSON"),
    ("quoted decimal escapes", _STRING.replace("<t", "<u"), " ?", "Lua, Haskell"),
    ("text with escapes", _text_with(_ESCAPE, "t"), _NONE,
     "journalctl, logs of C strings without quotes"),
    ("text with hex escapes", _text_with(_HEX_ESCAPE, "v"), _NONE, "LabVIEW"),
    ("text with codes in brackets", _text_with(_CODE, "w"), _NONE,
     "minicom, interceptty, DSView, Docklight, Bray's Terminal, Termite, Hercules, YAT"),
    ("a character in each line", _CELL, _NONE, "DSView, Saleae Logic in ASCII"),
    ("characters of od -c", _OD_CELL, "", "od -c, hexdump -c"),
)  # fmt: skip
"""Name, unit, separator, programs."""


def _extractors() -> Iterator[Extractor]:
    units = set[str]()
    for name, unit, separator, tools in _FORMS:
        one, between = _unnamed(unit), f"(?:{separator})"
        several = unit in units or separator == _TOGETHER
        run = f"{_BEGIN}{one}(?:{between}{one})*+{_END}".encode()
        part = f"{between}?(?:{_expanded(unit)})".encode()
        needs = f"{one}(?:{between}{one}){{3}}".encode() if several else b""
        units.add(unit)
        for order in (", big endian", ", little endian") if "words" in name else ("",):
            swaps, masks = order == ", little endian", name != "hex pairs, colons"
            yield Extractor(name + order, tools, run, part, needs, swaps, masks)


EXTRACTORS: Final = tuple(_extractors())
"""All of them; earlier ones are preferred where the evidence is equal."""
