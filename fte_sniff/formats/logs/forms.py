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
from functools import partial
from typing import Final, Literal, NamedTuple


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
    pattern: bytes
    """Of a run; compiled at the first use, because that of all patterns delays the start."""
    decode: Callable[[bytes], bytes]
    size: int = 1
    """Bytes of each number; 0 if the runs have no numbers."""
    needs: bytes = b""
    """What a text with such runs has."""
    masks_times: bool = True
    """Whether the first date or time of a line cannot be bytes."""

    @property
    def columnar(self) -> bool:
        """Whether each byte is two hexadecimal digits."""
        return self.decode is _hex

    def runs(self, text: bytes) -> Iterator[Run]:
        """The runs of a line, or of several lines."""
        for found in re.finditer(self.pattern, text):
            with suppress(ValueError, OverflowError):
                if data := self.decode(found[0]):
                    yield Run(*found.span(), data)


def _hex(run: bytes) -> bytes:
    return unhexlify(run.translate(None, _NO_HEX))


def _reversed_words(run: bytes) -> bytes:
    return b"".join(unhexlify(digits)[::-1] for digits in run.split())


def _numbers(
    unit: bytes, base: int, size: int, order: Literal["little", "big"], run: bytes
) -> bytes:
    values = (int(digits, base) for digits in re.findall(unit, run))
    return b"".join(value.to_bytes(size, order, signed=value < 0) for value in values)


def _text(code: bytes, run: bytes) -> bytes:
    """Characters, with codes: `x`, `o` or `d` for digits, `n` a name, `c` the character itself."""
    with suppress(UnicodeError):
        run = run.decode().encode("latin-1")
    return re.sub(code, _byte_of_code, run)


def _byte_of_code(found: re.Match[bytes]) -> bytes:
    kind = found.lastgroup or ""
    code = found[kind]
    if kind == "n":
        return _NAMED.get(code, code)
    return code if kind == "c" else bytes([int(code, {"x": 16, "o": 8, "d": 10}[kind[0]])])


def _strings(code: bytes, run: bytes) -> bytes:
    return b"".join(_text(code, text[1:-1]) for text in re.findall(_STRING, run))


def _base64(run: bytes) -> bytes:
    return b64decode(run.translate(bytes.maketrans(b"-_", b"+/")), validate=True)


def _expanded(pattern: bytes) -> bytes:
    return pattern.replace(b"@", b"[0-9A-Fa-f]")


def _unnamed(pattern: bytes) -> bytes:
    return re.sub(rb"\?P<\w+>", b"?:", pattern)


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
_NAME: Final = b"NULL|TAB|NL|DEL|" + b"|".join(_NAMES)

_WORD: Final = (rb"(?<![0-9A-Za-z])", rb"(?![0-9A-Za-z])")
"""What is not before and after a run."""
_NUMBER: Final = (rb"(?<![\w.])(?<!\d[:-])", rb"(?!\w|[.:]\d)")
_ANYWHERE: Final = (b"", b"")
_GROUP: Final = rb"(?:(?:[0-9A-F]{2})++(?![0-9a-f])|(?:[0-9a-f]{2})++(?![0-9A-F]))"
"""Pairs of digits in one case; mixed case is a word."""
_ANY: Final = rb"[^0-9A-Za-z\\$%&#\r\n]{0,4}+"
_BYTE: Final = rb"(?<!\d)(-?\d{1,3})(?!\d|\"\s*:)"
_STRING: Final = rb"\"(?:[^\"\\\n]|\\.)*+\"|'(?:[^'\\\n]|\\.)*+'"
_STRINGS: Final = rb"(?<!\w)[bu]?(?:%b)(?: ?(?:%b))*+" % (_STRING, _STRING)
_ESCAPE: Final = _expanded(
    rb"\\(?:x\{?|u00)(?P<x>@@)(?:(?<=\{..)\})?|\\(?P<o>[0-3]?[0-7]{1,2})|\\(?P<n>.)"
)
_CODE: Final = _expanded(rb"\\(?:x@@|[0-3][0-7]{2}|u00@@)")
_CELL: Final = _expanded(
    rb"'?\\x(?P<x>@@)'?|[\[<](?P<x1>@@)[\]>]|'0x(?P<x2>@@)'|'?\\(?P<n>[abtnvfr0])'?|'(?P<c>.)'"
)
_OD_CELL: Final = rb" (?P<o>[0-3][0-7]{2})|  \\(?P<n>[0abtnvfr])|   (?P<c>[ -~])"

_PAIRS: Final = (
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
"""Pairs of hexadecimal digits: what is between two, its pattern, programs."""

_NUMBERS: Final = (
    ("unpadded hex, spaces", rb"(@{1,2})", 16, rb" {1,2}", _WORD, "HTerm, AccessPort, Arduino"),
    ("unpadded hex, commas", rb"(@{1,2})", 16, rb" ?, ?", _WORD, "JavaScript toString(16)"),
    ("unpadded hex, dashes", rb"(@{1,2})", 16, rb" ?- ?", _WORD, "Java toHexString"),
    ("hex pairs, tags", rb"(?<![</\w])(@@)(?!\w)", 16, rb"(?:</?[a-z]\w*>)++", _WORD,
     "tables in HTML and XML"),
    ("0x before each byte", rb"0[xX](@{1,2})(?!@)[}'\"#]?+", 16, _ANY, _WORD,
     "C, Rust, Saleae Logic, Wireshark C arrays, CoolTerm"),
    ("\\x before each byte", rb"\\+x\{?(@@)\}?+", 16, _ANY, _ANYWHERE, "shells, jq, printf"),
    ("$ before each byte", rb"#?\$(@{1,2})(?!@)", 16, _ANY, _WORD, "Pascal, HTerm"),
    ("\\ before each byte", rb"\\(@@)(?!@)", 16, _ANY, _ANYWHERE, "LabVIEW"),
    ("% before each byte", rb"%(@{1,2})(?!@)", 16, _ANY, _WORD, "URLs"),
    ("&H before each byte", rb"&[hH](@{1,2})(?!@)", 16, _ANY, _WORD, "Visual Basic"),
    ("# before each byte", rb"(?:(?:B#)?16)?#(@{1,2})(?!@)#?+", 16, _ANY, _WORD,
     "Docklight scripts, IEC 61131, Erlang"),
    ("8'h before each byte", rb"8'h(@{1,2})(?!@)", 16, _ANY, _WORD, "Verilog"),
    ("x before each byte", rb"[xXhH]['\"]?(@{1,2})(?!@)['\"]?+", 16, _ANY, _WORD,
     "VHDL, SQL, WaveForms"),
    ("U+00 before each byte", rb"(?:U\+|\\u)00(@@)(?!@)", 16, _ANY, _WORD, "JavaScript, JSON"),
    ("h after each byte", rb"0?(@@)[hH]", 16, rb"[ ,;]{0,3}", _WORD, "assemblers, YAT, HTerm"),
    ("hex in brackets", rb"[\[<({](?:0[xX])?(@{1,2})[\]>)}]", 16, rb"[ ,;]{0,2}", _ANYWHERE,
     "RealTerm, libmodbus, Termite, Hercules, slsnif, Tcl"),
    ("decimal in brackets", rb"[!-~]?[\[<({](\d{3})[\]>)}]", 10, rb" ?", _ANYWHERE,
     "Bray's Terminal, slsnif"),
    ("hex in quotes", rb"[\"'](?:0[xX])?(@{1,2})[\"']", 16, rb"[ ,;]{0,2}", _ANYWHERE,
     "lists of strings in JSON and Python"),
    ("decimal, spaces", _BYTE, 10, rb"[ \t]+", _NUMBER, "MATLAB, Go, NumPy, RealTerm"),
    ("decimal, commas", _BYTE, 10, rb"[ \t]*,[ \t]*", _NUMBER, "Java, Python, ROS, Node-RED"),
    ("decimal, semicolons", _BYTE, 10, rb" ?; ?", _NUMBER, "spreadsheets"),
    ("decimal, dashes", _BYTE, 10, rb"-", _NUMBER, "Docklight"),
    ("decimal, keys", _BYTE, 10, rb" ?, ?\"\d+\" ?: ?", _NUMBER, "JSON of a Uint8Array"),
    ("octal", rb"([0-3][0-7]{2})", 8, rb"[ ,]{1,2}", _WORD, "od -b, hexdump -b"),
    ("binary", rb"(?:0b)?([01]{4}_?[01]{4})", 2, rb"[ ,;]{0,2}", _WORD, "xxd -b, FPGA logs"),
    ("octal words", rb"([0-7]{6})", 8, rb" {1,5}", _WORD, "od"),
    ("decimal words", rb"(-?\d{1,5})", 10, rb" {1,5}", _WORD, "od -d, hexdump -d"),
    ("0x words", rb"0[xX](@{4})", 16, rb"[ ,;]{1,2}", _WORD, "debuggers, arrays of uint16_t"),
)  # fmt: skip
"""Name, unit, base, separator, edges, programs."""

_BRACKETS: Final = (
    ("[ ]", rb"\[", rb"\]", "minicom, interceptty, DSView"),
    ("< >", rb"<", rb">", "Docklight, Bray's Terminal, Termite"),
    ("{ }", rb"\{", rb"\}", "Hercules"),
    ("( )", rb"\(", rb"\)", "YAT"),
)
"""Around the codes in a text: name, opening, closing, programs."""

_TEXTS: Final[tuple[tuple[str, bytes, Callable[[bytes], bytes], str], ...]] = (
    ("quoted escapes", _STRINGS, partial(_strings, _ESCAPE), "Python, C, Qt, strace, JSON"),
    ("quoted decimal escapes", _STRINGS, partial(_strings, rb"\\(?P<d>\d{1,3})|\\(?P<n>.)"),
     "Lua, Haskell"),
    ("a character in each line",
     rb"(?m)(?<=[,;\t])(?:%b|[ -~])(?=[,;\t]|$)" % _unnamed(_CELL), partial(_text, _CELL),
     "DSView, Saleae Logic in ASCII"),
    ("text with escapes",
     rb"(?<![!-\[\]-~])[!-\[\]-~]*+%b(?:%b|\\[abtnvfr0\\]|[ -\[\]-~])*+" % (_CODE, _CODE),
     partial(_text, _ESCAPE), "journalctl, logs of C strings without quotes"),
    ("characters of od -c", rb"(?m)(?<=\d)(?:%b)+(?= *$)" % _unnamed(_OD_CELL),
     partial(_text, _OD_CELL), "od -c, hexdump -c"),
    ("base64", rb"(?<![\w+/-])(?=[\w+/-])(?:@{4})*+(?:@{2}==|@{3}=)?(?![\w+/=-])".replace(
        b"@", rb"[\w+/-]"), _base64, "JSON of MQTT and of clouds"),
)  # fmt: skip
"""Name, pattern, decoder, programs."""


def _hex_forms() -> Iterator[Extractor]:
    for name, separator, tools in _PAIRS:  # the same between all: a text beside is after two spaces
        pattern = rb"%b@@(?:(%b)@@(?:\1@@)*+)?+%b" % (_WORD[0], separator, _WORD[1])
        needs = b"" if name == "spaces" else _expanded(rb"@@%b@@" % separator)
        masks = name != "colons"
        yield Extractor(f"hex pairs, {name}", tools, _expanded(pattern), _hex, 1, needs, masks)
    alone = rb"(?:%b|(?<=[^0-9A-Za-z]0[xX])|(?<=\\x))%b%b" % (_WORD[0], _GROUP, _WORD[1])
    yield Extractor("hex digits", "Tasmota, logcat, candump, MQTT, SQL", alone, _hex)
    groups = rb"%b%b(?:(%%b)%b(?:\1%b)*+)?+%b" % (_WORD[0], _GROUP, _GROUP, _GROUP, _WORD[1])
    needs = _expanded(rb"@@ {1,5}@@")
    yield Extractor("hex groups", "xxd, usbmon, LabVIEW", groups % b" ", _hex, 1, needs)
    tools, words = "od -x, hexdump, xxd -e", groups % rb" {1,5}"
    yield Extractor("hex words, little endian", tools, words, _reversed_words, 2, needs)


def _number_forms() -> Iterator[Extractor]:
    for name, unit, base, separator, (before, after), tools in _NUMBERS:
        unit, size = _expanded(unit), 2 if "words" in name else 1
        pattern = before + unit + rb"(?:" + separator + unit + rb")*+" + after
        several = "," in name and name != "decimal, spaces"
        needs = unit + separator + unit if several else b""
        orders: tuple[Literal["little", "big"], ...] = ("little", "big")
        for order in orders[:size]:
            full = name if size == 1 else f"{name}, {order} endian"
            decode = partial(_numbers, unit, base, size, order)
            yield Extractor(full, tools, pattern, decode, size, needs)


def _text_forms() -> Iterator[Extractor]:
    for brackets, opening, closing, tools in _BRACKETS:
        code = rb"%b(?:(?:0x)?(?P<x>@@)|(?P<n>%b))%b" % (opening, _NAME, closing)
        bare = _unnamed(_expanded(code))
        decode: Callable[[bytes], bytes] = partial(_text, _expanded(code))
        word, plain = (rb"(?:(?!%b)[%b-~])*+" % (bare, first) for first in (b"!", b" "))
        pattern = rb"(?<![!-~])" + word + bare + rb"(?:" + plain + bare + rb")*+"
        name = f"text with codes in {brackets}"
        yield Extractor(name, tools, pattern, decode)
        yield Extractor(f"{name} to the end", tools, pattern + plain, decode)
    for name, pattern, decode, tools in _TEXTS:
        yield Extractor(name, tools, pattern, decode, 0)


EXTRACTORS: Final = (*_hex_forms(), *_number_forms(), *_text_forms())
"""All of them; earlier ones are preferred where the evidence is equal."""
