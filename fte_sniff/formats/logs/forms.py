"""The forms × separators table: how programs write bytes, each combination as an extractor.

An extractor is a regular expression, generated from the table, for the runs of bytes in a text of
lines. Texts are bytes, so that offsets hold whatever the encoding around the runs. In the table,
`@` is a hexadecimal digit, and the group of a unit has the digits of one number.
"""

from __future__ import annotations

import re
from base64 import b64decode
from binascii import unhexlify
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, NamedTuple


class Run(NamedTuple):
    """The bytes that an extractor reads in a text."""

    start: int
    stop: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Extractor:
    """One form with one separator."""

    name: str
    tools: str
    """Programs that write it."""
    pattern: bytes
    """Of a run; compiled at the first use, because that of all patterns delays the start."""
    decode: Callable[[bytes], bytes]
    size: int = 1
    """Bytes of each number; 0 if the runs have no numbers."""
    masks_times: bool = True
    """Whether the first date or time of a line cannot be bytes."""
    text_beside: bool = False
    """Whether a column of characters may follow the bytes."""
    needs: bytes = b""
    """What a text with such runs has, if single bytes are not enough to tell them from others."""

    @property
    def columnar(self) -> bool:
        """Whether each byte is two hexadecimal digits."""
        return self.decode is _hex

    def runs(self, text: bytes) -> Iterator[Run]:
        """The runs of a line, or of several lines."""
        for found in re.finditer(self.pattern, text):
            start, stop = found.span()
            try:
                if self.text_beside and b"  " in found[0]:
                    stop = self._before_text(text, start, stop)
                data = self.decode(text[start:stop])
            except (ValueError, OverflowError):
                continue
            if data:
                yield Run(start, stop, data)

    def _before_text(self, text: bytes, start: int, stop: int) -> int:
        """Where a run ends: before a column that shows its bytes as characters."""
        end = text.find(b"\n", stop)
        line = text[start : len(text) if end < 0 else end]
        for gap in re.finditer(rb"  ", line[: stop - start]):
            data, shown = self.decode(line[: gap.start()]), line[gap.end() :].strip(b" |\r\t")
            if len(data) - 2 <= len(shown) <= len(data) + 2 and all(
                character == byte or not 0x21 <= byte <= 0x7E
                for character, byte in zip(shown, data, strict=False)
            ):
                return start + gap.start()
        return stop


def _hex(run: bytes) -> bytes:
    return unhexlify(run.translate(None, _NO_HEX))


def _reversed_words(run: bytes) -> bytes:
    return b"".join(unhexlify(digits)[::-1] for digits in run.split())


def _numbers(
    unit: bytes, base: int, size: int, order: Literal["little", "big"], run: bytes
) -> bytes:
    values = [int(digits, base) for digits in re.findall(unit, run)]
    signed = min(values) < 0
    if size == 1 and not signed:
        return bytes(values)
    return b"".join(value.to_bytes(size, order, signed=signed) for value in values)


def _text(code: bytes, run: bytes) -> bytes:
    """Characters, with codes: `x` hexadecimal, `o` octal, `n` a name, `c` the character itself."""
    with suppress(UnicodeError):
        run = run.decode().encode("latin-1")
    return re.sub(code, _byte_of_code, run)


def _byte_of_code(found: re.Match[bytes]) -> bytes:
    kind = found.lastgroup or ""
    code = found[kind]
    if kind == "n":
        return _NAMED.get(code, code)
    return code if kind == "c" else bytes([int(code, 16 if kind[0] == "x" else 8)])


def _strings(run: bytes) -> bytes:
    return b"".join(_text(_ESCAPE, text[1:-1]) for text in re.findall(_STRING, run))


def _base64(run: bytes) -> bytes:
    return b64decode(run.translate(bytes.maketrans(b"-_", b"+/")), validate=True)


_NO_HEX: Final = bytes(set(range(256)) - set(b"0123456789ABCDEFabcdef"))
_NAMES: Final = (
    b"NUL SOH STX ETX EOT ENQ ACK BEL BS HT LF VT FF CR SO SI DLE DC1 DC2 DC3 DC4 NAK SYN ETB "
    b"CAN EM SUB ESC FS GS RS US SP"
).split()
_NAMED: Final = {name: bytes([code]) for code, name in enumerate(_NAMES)} | {
    b"DEL": b"\x7f", b"TAB": b"\t", b"NL": b"\n", b"NULL": b"\0", b"a": b"\a", b"b": b"\b",
    b"t": b"\t", b"n": b"\n", b"v": b"\v", b"f": b"\f", b"r": b"\r", b"e": b"\x1b", b"0": b"\0",
}  # fmt: skip
"""Bytes of the names of control characters, and of the letters after a backslash."""


def _with_digits(pattern: bytes) -> bytes:
    return pattern.replace(b"@", b"[0-9A-Fa-f]")


_EDGES: Final = (rb"(?<![0-9A-Za-z])", rb"(?![0-9A-Za-z])")
_DECIMAL_EDGES: Final = (rb"(?<![\w.])(?<!\d[:-])", rb"(?!\w|[.:]\d)")
_NO_EDGES: Final = (b"", b"")
_GROUP: Final = rb"(?:(?:[0-9A-F]{2})++(?![0-9a-f])|(?:[0-9a-f]{2})++(?![0-9A-F]))"
"""Pairs of digits in one case; mixed case is a word."""
_PAIR: Final = rb"[0-9A-Fa-f]{2}"
_ANY: Final = rb"[^0-9A-Za-z\\$%&#\r\n]{0,4}+"
_SHORT: Final = rb"(@{1,2})"
_BYTE: Final = rb"(?<!\d)(-?\d{1,3})(?!\d|\"\s*:)"
_ESCAPE: Final = _with_digits(
    rb"\\(?:x\{?|u00)(?P<x>@@)(?:(?<=\{..)\})?|\\(?P<o>[0-3]?[0-7]{1,2})|\\(?P<n>.)"
)
_LONE_ESCAPE: Final = _with_digits(rb"\\(?:x@@|[0-3][0-7]{2}|u00@@)")
_STRING: Final = rb"\"(?:[^\"\\\n]|\\.)*+\"|'(?:[^'\\\n]|\\.)*+'"
_STRINGS: Final = rb"(?<!\w)[bu]?(?:" + _STRING + rb")(?: ?(?:" + _STRING + rb"))*+"
_CELL: Final = _with_digits(
    rb"'?\\x(?P<x>@@)'?|[\[<](?P<x1>@@)[\]>]|'0x(?P<x2>@@)'|'?\\(?P<n>[abtnvfr0])'?|'(?P<c>.)'"
)
_OD_CELL: Final = rb" (?P<o>[0-3][0-7]{2})|  \\(?P<n>[0abtnvfr])|   (?P<c>[ -~])"
_NAME: Final = b"NULL|TAB|NL|DEL|" + b"|".join(_NAMES)
_LETTERS: Final = rb"(?<![\w+/=-])(?=[\w+/-])(?:[\w+/-]{4})*+(?:@{2}==|@{3}=)?(?![\w+/=-])".replace(
    b"@", rb"[\w+/-]"
)

SEPARATORS: Final = (
    ("spaces", rb" {1,2}", "SSCOM, CoolTerm, Docklight, hexdump -C, socat -x, most terminals"),
    ("tabs", rb"\t", "spreadsheets, LabVIEW"),
    ("commas", rb" ?, ?", "Modbus tools, Serial Studio, CSV exports"),
    ("colons", rb":", "ESPHome, HHD Serial Monitor, tshark"),
    ("dashes", rb" ?- ?", "C# BitConverter, modbus_tk"),
    ("semicolons", rb" ?; ?", "HTerm"),
    ("bars", rb" ?\| ?", "PulseView, Markdown tables"),
    ("points", rb"\.", "Cisco consoles"),
    ("underscores", rb"_", "Verilog test benches"),
    ("slashes", rb"/", "PLC consoles"),
)
"""Between two pairs of digits: name, pattern, programs."""

_NUMBERS: Final = (
    ("unpadded hex, spaces", _SHORT, 16, 1, rb" {1,2}", _EDGES, "HTerm, AccessPort, Arduino print"),
    ("unpadded hex, commas", _SHORT, 16, 1, rb" ?, ?", _EDGES, "JavaScript toString(16)"),
    ("unpadded hex, dashes", _SHORT, 16, 1, rb" ?- ?", _EDGES, "Java toHexString"),
    ("0x before each byte", rb"0[xX](@{1,2})(?!@)[}'\"#]?+", 16, 1, _ANY, _EDGES,
     "C, Rust, Saleae Logic, Wireshark C arrays, CoolTerm"),
    ("\\x before each byte", rb"\\+x\{?(@@)\}?+", 16, 1, _ANY, _NO_EDGES, "shells, jq, printf"),
    ("$ before each byte", rb"\$(@{1,2})(?!@)", 16, 1, _ANY, _EDGES, "Pascal, HTerm"),
    ("% before each byte", rb"%(@{1,2})(?!@)", 16, 1, _ANY, _EDGES, "URLs"),
    ("&H before each byte", rb"&[hH](@{1,2})(?!@)", 16, 1, _ANY, _EDGES, "Visual Basic"),
    ("# before each byte", rb"(?:16)?#(@{1,2})(?!@)#?+", 16, 1, _ANY, _EDGES,
     "Docklight scripts, IEC 61131, Erlang"),
    ("8'h before each byte", rb"8'h(@{1,2})(?!@)", 16, 1, _ANY, _EDGES, "Verilog"),
    ("x before each byte", rb"[xX]['\"]?(@{1,2})(?!@)['\"]?+", 16, 1, _ANY, _EDGES, "VHDL, SQL"),
    ("U+00 before each byte", rb"(?:U\+|\\u)00(@@)(?!@)", 16, 1, _ANY, _EDGES, "JavaScript, JSON"),
    ("h after each byte", rb"0?(@@)[hH]", 16, 1, rb"[ ,;]{0,3}", _EDGES, "assemblers, YAT, HTerm"),
    ("hex in []", rb"\[(?:0[xX])?(@{1,2})\]", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "RealTerm"),
    ("hex in <>", rb"<(?:0[xX])?(@{1,2})>", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "Termite, CuteCom"),
    ("hex in ()", rb"\((?:0[xX])?(@{1,2})\)", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "Hercules"),
    ("hex in {}", rb"\{(?:0[xX])?(@{1,2})\}", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "Hercules, Tcl"),
    ('hex in ""', rb"\"(?:0[xX])?(@{1,2})\"", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "JSON of strings"),
    ("hex in ''", rb"'(?:0[xX])?(@{1,2})'", 16, 1, rb"[ ,;]{0,2}", _NO_EDGES, "Python's lists"),
    ("decimal, spaces", _BYTE, 10, 1, rb"[ \t]+", _DECIMAL_EDGES, "MATLAB, Go, NumPy, RealTerm"),
    ("decimal, commas", _BYTE, 10, 1, rb"[ \t]*,[ \t]*", _DECIMAL_EDGES,
     "Java (signed), Python, ROS messages, Node-RED"),
    ("decimal, semicolons", _BYTE, 10, 1, rb" ?; ?", _DECIMAL_EDGES, "spreadsheets"),
    ("decimal, dashes", _BYTE, 10, 1, rb"-", _DECIMAL_EDGES, "Docklight"),
    ("decimal, keys", _BYTE, 10, 1, rb" ?, ?\"\d+\" ?: ?", _DECIMAL_EDGES, "JSON of a Uint8Array"),
    ("octal", rb"([0-3][0-7]{2})", 8, 1, rb"[ ,]{1,2}", _EDGES, "od -b, hexdump -b"),
    ("binary", rb"(?:0b)?([01]{4}_?[01]{4})", 2, 1, rb"[ ,;]{0,2}", _EDGES, "xxd -b, FPGA logs"),
    ("octal words", rb"([0-7]{6})", 8, 2, rb" {1,5}", _EDGES, "od"),
    ("decimal words", rb"(-?\d{1,5})", 10, 2, rb" {1,5}", _EDGES, "od -d, hexdump -d"),
    ("0x words", rb"0[xX](@{4})", 16, 2, rb"[ ,;]{1,2}", _EDGES, "debuggers, arrays of uint16_t"),
)  # fmt: skip
"""Name, unit, base, bytes, separator, what is not before and after a run, programs."""

_BRACKETS: Final = (
    ("[ ]", rb"\[", rb"\]", "minicom, interceptty, DSView"),
    ("< >", rb"<", rb">", "Docklight, Bray's Terminal, Termite"),
    ("{ }", rb"\{", rb"\}", "Hercules"),
    ("( )", rb"\(", rb"\)", "YAT"),
)
"""Around the codes in a text: name, opening, closing, programs."""

_TEXTS: Final = (
    ("quoted escapes", _STRINGS, _strings, "Python, C, Qt, strace, JSON"),
    ("a character in each line",
     rb"(?m)(?<=[,;\t])(?:" + re.sub(rb"\?P<\w+>", b"?:", _CELL) + rb"|[ -~])(?=[,;\t]|$)",
     partial(_text, _CELL), "DSView, Saleae Logic in ASCII"),
    ("text with escapes",
     rb"(?<![!-\[\]-~])[!-\[\]-~]*+" + _LONE_ESCAPE
     + rb"(?:" + _LONE_ESCAPE + rb"|\\[abtnvfr0\\]|[ -\[\]-~])*+",
     partial(_text, _ESCAPE), "journalctl, cat of a log of C strings"),
    ("characters of od -c",
     rb"(?m)(?<=\d)(?: [0-3][0-7]{2}|  \\[0abtnvfr]|   [ -~])+(?= *$)",
     partial(_text, _OD_CELL), "od -c, hexdump -c"),
    ("base64", _LETTERS, _base64, "JSON of MQTT and of clouds"),
)  # fmt: skip
"""Name, pattern, decoder, programs."""


def _units(unit: bytes, separator: bytes, edges: tuple[bytes, bytes], least: bytes) -> bytes:
    return edges[0] + unit + rb"(?:" + separator + unit + rb")" + least + edges[1]


def _needs(name: str, unit: bytes, separator: bytes) -> bytes:
    """Two bytes; nothing for the first separator of a form, which finds single bytes."""
    return b"" if name.endswith("spaces") or "," not in name else unit + separator + unit


def _hex_forms() -> Iterator[Extractor]:
    for name, separator, tools in SEPARATORS:
        pattern = _units(_PAIR, separator, _EDGES, rb"*+")
        yield Extractor(
            f"hex pairs, {name}", tools, pattern, _hex,
            masks_times=name != "colons", text_beside=True,
            needs=_needs(f", {name}", _PAIR, separator),
        )  # fmt: skip
    alone = rb"(?:" + _EDGES[0] + rb"|(?<=[^0-9A-Za-z]0[xX]))" + _GROUP + _EDGES[1]
    yield Extractor("hex digits", "Tasmota, logcat, candump, MQTT", alone, _hex)
    groups = _units(_GROUP, rb" ", _EDGES, rb"++")
    yield Extractor("hex groups", "xxd, LabVIEW", groups, _hex, text_beside=True)
    words = _units(_GROUP, rb" {1,5}", _EDGES, rb"++")
    yield Extractor(
        "hex words, little endian", "od -x, hexdump, xxd -e", words, _reversed_words, size=2,
        text_beside=True,
    )  # fmt: skip


def _number_forms() -> Iterator[Extractor]:
    for name, unit, base, size, separator, edges, tools in _NUMBERS:
        unit = _with_digits(unit)
        least = rb"++" if name.startswith("unpadded") else rb"*+"
        pattern = _units(unit, separator, edges, least)
        orders: tuple[Literal["little", "big"], ...] = ("little", "big")
        for order in orders if size > 1 else orders[:1]:
            full = f"{name}, {order} endian" if size > 1 else name
            decode = partial(_numbers, unit, base, size, order)
            needs = _needs(name, unit, separator)
            yield Extractor(full, tools, pattern, decode, size, needs=needs)


def _text_forms() -> Iterator[Extractor]:
    for brackets, opening, closing, tools in _BRACKETS:
        code = opening + rb"(?:(?:0x)?(?P<x>@@)|(?P<n>" + _NAME + rb"))" + closing
        code = _with_digits(code)
        bare = re.sub(rb"\?P<\w+>", b"?:", code)
        word, plain = (rb"(?:(?!" + bare + rb")[%b-~])*+" % first for first in (b"!", b" "))
        pattern = rb"(?<![!-~])" + word + bare + rb"(?:" + plain + bare + rb")*+"
        name = f"text with codes in {brackets}"
        yield Extractor(name, tools, pattern, partial(_text, code))
        yield Extractor(f"{name} to the end", tools, pattern + plain, partial(_text, code))
    for name, pattern, decode, tools in _TEXTS:
        yield Extractor(name, tools, pattern, decode, 0)


EXTRACTORS: Final = (*_hex_forms(), *_number_forms(), *_text_forms())
"""All of them; earlier ones are preferred where the evidence is equal."""
