"""The forms × separators table: how programs write bytes, each combination as an extractor.

An extractor is a regular expression, generated from the table, for the runs of bytes in a line.
Lines are bytes, so that offsets in them hold whatever the encoding of the text around the runs.
"""

from __future__ import annotations

import re
from base64 import b64decode
from binascii import unhexlify
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple


class Run(NamedTuple):
    """The bytes that an extractor reads in a line."""

    start: int
    stop: int
    data: bytes
    unit: int = 1
    """Bytes of each written number."""


@dataclass(frozen=True, slots=True)
class Extractor:
    """One form with one separator."""

    name: str
    pattern: bytes
    """Compiled at the first use: a table of compiled patterns would delay the start."""
    decode: Callable[[bytes], bytes]
    unit: int = 1
    """Bytes of each written number; 0 if numbers cannot be left out of a run."""
    needs: bytes = b""
    """A pattern that a text with such runs has; a quick test."""
    masks_times: bool = True
    """Whether the first date or time of a line cannot be bytes."""
    columnar: bool = False
    """Whether each byte is two hexadecimal digits."""

    def runs(self, line: bytes) -> Iterator[Run]:
        """The runs of a line, whose times are masked if `masks_times`."""
        for found in re.finditer(self.pattern, line):
            start, stop = found.span()
            text = found[0]
            if self.columnar and b"  " in text:
                text = _without_text_column(line, start, text, self.decode)
                stop = start + len(text)
            try:
                data = self.decode(text)
            except (ValueError, OverflowError):
                continue
            if data:
                yield Run(start, stop, data, self.unit)


def _without_text_column(
    line: bytes, start: int, run: bytes, decode: Callable[[bytes], bytes]
) -> bytes:
    """The run, without the start of a column of characters that shows the bytes before it."""
    for gap in re.finditer(rb"  ", run):
        data = decode(run[: gap.start()])
        shown = line[start + gap.end() :].strip(b" |\r\t")
        if len(data) - 2 <= len(shown) <= len(data) + 2 and all(
            text == byte or not 0x21 <= byte <= 0x7E
            for text, byte in zip(shown, data, strict=False)
        ):
            return run[: gap.start()]
    return run


_DIGITS: Final = re.compile(rb"[0-9A-Fa-f]+")
_NO_HEX: Final = bytes(set(range(256)) - set(b"0123456789ABCDEFabcdef"))


def _hex(run: bytes) -> bytes:
    return unhexlify(run.translate(None, _NO_HEX))


def _numbers(base: int, run: bytes) -> bytes:
    return bytes(int(digits, base) for digits in _DIGITS.findall(run))


def _found(pattern: bytes, run: bytes) -> bytes:
    return bytes(int(digits, 16) for digits in re.findall(pattern, run))


_DECIMAL: Final = re.compile(rb"(?<!\d)-?\d+(?!\d|\"\s*:)")


def _decimal(run: bytes) -> bytes:
    values = [int(digits) for digits in _DECIMAL.findall(run)]
    if min(values) < -128 or max(values) > (127 if min(values) < 0 else 255):
        raise ValueError
    return bytes(value & 0xFF for value in values)


def _words(base: int, size: int, order: str, run: bytes) -> bytes:
    made = b"".join(int(digits, base).to_bytes(size, "little") for digits in _DIGITS.findall(run))
    return made if order == "little" else _swapped(made, size)


def _swapped(data: bytes, size: int) -> bytes:
    return b"".join(data[at : at + size][::-1] for at in range(0, len(data), size))


_NAMES: Final = (
    b"NUL SOH STX ETX EOT ENQ ACK BEL BS HT LF VT FF CR SO SI DLE DC1 DC2 DC3 DC4 NAK SYN ETB "
    b"CAN EM SUB ESC FS GS RS US SP"
).split()
_CODE_OF: Final[dict[bytes, int]] = {name: code for code, name in enumerate(_NAMES)} | {
    b"DEL": 0x7F, b"TAB": 9, b"NL": 10, b"NULL": 0
}  # fmt: skip
_SIMPLE: Final = dict(zip(b"abtnvfre0", b"\a\b\t\n\v\f\r\x1b\0", strict=True))
_ESCAPES: Final = re.compile(
    rb"\\x(?:([0-9A-Fa-f]{2})|\{([0-9A-Fa-f]{2})\})|\\u00([0-9A-Fa-f]{2})|\\([0-3]?[0-7]{1,2})|\\(.)|([^\\]+)",
    re.DOTALL,
)


def _unescaped(text: bytes) -> bytes:
    made = bytearray()
    for short, braced, long, octal, simple, plain in _ESCAPES.findall(text):
        if short or braced or long:
            made.append(int(short or braced or long, 16))
        elif octal:
            made.append(int(octal, 8))
        elif simple:
            made.append(_SIMPLE.get(simple[0], simple[0]))
        else:
            made += _latin(plain)
    return bytes(made)


def _latin(text: bytes) -> bytes:
    try:
        return text.decode().encode("latin-1")
    except UnicodeError:
        return text


_STRING: Final = rb"\"(?:[^\"\\]|\\.)*+\"|'(?:[^'\\]|\\.)*+'"
_ANY_STRING: Final = re.compile(_STRING, re.DOTALL)


def _literal(run: bytes) -> bytes:
    return b"".join(_unescaped(text[1:-1]) for text in _ANY_STRING.findall(run))


def _bracketed(unit: re.Pattern[bytes], run: bytes) -> bytes:
    made, at = bytearray(), 0
    for found in unit.finditer(run):
        digits, name = found.groups()
        made += run[at : found.start()]
        made.append(int(digits, 16) if digits else _CODE_OF[name])
        at = found.end()
    return bytes(made + run[at:])


def _field(run: bytes) -> bytes:
    if len(run) == 1:
        return run
    if run[:1] == b"\\":
        return _unescaped(run)
    digits = run.strip(b"[]<>'")
    return digits if len(digits) == 1 else bytes([int(digits.removeprefix(b"0x"), 16)])


_CELL: Final = re.compile(rb".{3}(.)|.{2}\\(.)|.([0-7]{3})", re.DOTALL)


def _od_characters(run: bytes) -> bytes:
    made = bytearray()
    for at in range(0, len(run), 4):
        cell = run[at : at + 4].lstrip() or b" "
        if len(cell) == 3:
            made.append(int(cell, 8))
        else:
            made += _unescaped(cell) if len(cell) == 2 else cell
    return bytes(made)


def _base64(run: bytes) -> bytes:
    return b64decode(run.translate(bytes.maketrans(b"-_", b"+/")), validate=True)


_BEFORE: Final = rb"(?<![0-9A-Za-z])"
_AFTER: Final = rb"(?![0-9A-Za-z])"
_PAIR: Final = rb"[0-9A-Fa-f]{2}"

SEPARATORS: Final = (
    ("spaces", rb" {1,2}"),
    ("tabs", rb"\t"),
    ("commas", rb" ?, ?"),
    ("colons", rb":"),
    ("dashes", rb" ?- ?"),
    ("semicolons", rb" ?; ?"),
    ("bars", rb" ?\| ?"),
    ("points", rb"\."),
    ("underscores", rb"_"),
    ("slashes", rb"/"),
)
"""What stands between two bytes in all programs' hexadecimal forms; `spaces` also between groups
of a dump. Colons: ESPHome, HHD. Dashes: C# BitConverter, modbus_tk. Bars: PulseView. Commas: C,
Rust, Modbus tools. Semicolons: HTerm. Points: Cisco-like dumps. Tabs: spreadsheets."""


def _runs(unit: bytes, separator: bytes, least: bytes = b"*+") -> bytes:
    return _BEFORE + unit + rb"(?:" + separator + unit + rb")" + least + _AFTER


def _hex_forms() -> Iterator[Extractor]:
    for name, separator in SEPARATORS:
        yield Extractor(
            f"hex pairs, {name}", _runs(_PAIR, separator), _hex,
            needs=b"" if name == "spaces" else _PAIR + separator + _PAIR,
            masks_times=name != "colons", columnar=True,
        )  # fmt: skip
    # xxd groups two bytes, LabVIEW and many GUIs any number; mixed case is a word, not bytes.
    group = rb"(?:(?:[0-9A-F]{2})++(?![0-9a-f])|(?:[0-9a-f]{2})++(?![0-9A-F]))"
    alone = rb"(?:" + _BEFORE + rb"|(?<=[^0-9A-Za-z]0[xX]))" + group + _AFTER
    yield Extractor("hex digits", alone, _hex, columnar=True)
    yield Extractor("hex groups", _runs(group, rb" ", rb"++"), _hex, columnar=True)
    # HTerm, Access Port, Python's hex() without padding.
    short = rb"[0-9A-Fa-f]{1,2}"
    for name, separator in (SEPARATORS[0], SEPARATORS[2], SEPARATORS[4]):
        pattern = _runs(short, separator, rb"++")
        yield Extractor(f"unpadded hex, {name}", pattern, partial(_numbers, 16))


_LEADS: Final = (
    ("0x", rb"0[xX]", "C, Rust, Saleae Logic, Wireshark C arrays, CoolTerm"),
    ("\\x", rb"\\+x\{?", "shells, jq, printf"),
    ("$", rb"\$", "Pascal, HTerm"),
    ("%", rb"%", "URLs"),
    ("&H", rb"&[hH]", "Visual Basic"),
    ("#", rb"(?:16)?#", "Docklight scripts, IEC 61131, Erlang"),
    ("8'h", rb"8'h", "Verilog"),
    ("x", rb"[xX]['\"]?", "VHDL, SQL"),
    ("U+00", rb"(?:U\+|\\u)00", "JavaScript, JSON"),
)
_BETWEEN: Final = rb"[^0-9A-Za-z\\$%&#\r\n]{0,4}+"


def _marked_forms() -> Iterator[Extractor]:
    for name, lead, _tools in _LEADS:
        unit = lead + rb"[0-9A-Fa-f]{1,2}(?![0-9A-Fa-f])[}'\"#]?+"
        if lead.endswith(rb"\{?"):  # no other character follows the digits of an escape
            unit = lead + rb"[0-9A-Fa-f]{2}\}?+"
        pattern = _BEFORE + unit + rb"(?:" + _BETWEEN + unit + rb")*+"
        decode = partial(_found, lead + rb"([0-9A-Fa-f]{1,2})")
        yield Extractor(f"{name} before each byte", pattern, decode, needs=lead)
    # Assemblers, YAT, HTerm.
    unit = rb"0?[0-9A-Fa-f]{2}[hH]"
    pattern = _runs(unit, rb"[ ,;]{0,3}")
    decode = partial(_found, rb"([0-9A-Fa-f]{2})[hH]")
    yield Extractor("h after each byte", pattern, decode, needs=unit)
    # RealTerm, Python lists of strings, Hercules: each byte in its own brackets or quotes.
    for opening, closing in (rb"[]", rb"<>", rb"()", rb"{}", b'""', b"''"):
        left, right = re.escape(bytes([opening])), re.escape(bytes([closing]))
        unit = left + rb"(?:0[xX])?[0-9A-Fa-f]{1,2}" + right
        pattern = unit + rb"(?:[ ,;]{0,2}" + unit + rb")*+"
        name = f"hex in {chr(opening)}{chr(closing)}"
        decode = partial(_found, rb"([0-9A-Fa-f]{1,2})" + right)
        yield Extractor(name, pattern, decode, needs=unit)


def _number_forms() -> Iterator[Extractor]:
    before, after = rb"(?<![\w.])(?<!\d[:-])", rb"(?![\w]|[.:]\d)"
    number = rb"-?\d{1,3}(?!\d)"
    # Java, Go, Python and MATLAB arrays; ROS messages; spreadsheets; JSON of a Uint8Array.
    for name, separator in (
        ("spaces", rb"[ \t]+"),
        ("commas", rb"[ \t]*,[ \t]*"),
        ("semicolons", rb" ?; ?"),
        ("dashes", rb"-"),
        ("keys", rb"\s?,\s?\"\d+\"\s?:\s?"),
    ):
        pattern = before + number + rb"(?:" + separator + number + rb")*+" + after
        needs = b"" if name == "spaces" else rb"\d" + separator + rb"-?\d"
        yield Extractor(f"decimal, {name}", pattern, _decimal, needs=needs)
    # od -b, hexdump -b.
    octal = _runs(rb"[0-3][0-7]{2}", rb"[ ,]{1,2}")
    yield Extractor("octal", octal, partial(_numbers, 8))
    # xxd -b, FPGA logs.
    bits = rb"(?:0b)?[01]{4}[_']?[01]{4}"
    pattern = _runs(bits, rb"[ ,;]{1,2}")
    yield Extractor("binary", pattern, _bits)
    yield Extractor("binary digits", _BEFORE + rb"(?:[01]{8})++" + _AFTER, _bits)
    # od, od -x, od -d, hexdump: words in the byte order of the machine.
    for digits, base, size, name in (
        (rb"[0-9A-Fa-f]{4}", 16, 2, "hex words"),
        (rb"[0-9A-Fa-f]{8}", 16, 4, "hex double words"),
        (rb"[0-9A-Fa-f]{16}", 16, 8, "hex quad words"),
        (rb"[0-7]{6}", 8, 2, "octal words"),
        (rb"\d{1,5}", 10, 2, "decimal words"),
    ):
        for order in ("little", "big"):
            if base == 16 and order == "big":
                continue  # the same bytes as hex groups
            decode = partial(_words, base, size, order)
            pattern = _runs(digits, rb" {1,5}")
            yield Extractor(f"{name}, {order} endian", pattern, decode, unit=0)
    for order in ("little", "big"):
        decode = partial(_words, 16, 2, order)
        pattern = _runs(rb"0[xX][0-9A-Fa-f]{4}", rb"[ ,;]{1,2}")
        yield Extractor(
            f"0x words, {order} endian",
            pattern,
            partial(_marked_words, order),
            unit=0,
            needs=rb"0[xX]",
        )


def _marked_words(order: str, run: bytes) -> bytes:
    return _words(16, 2, order, re.sub(rb"0[xX]", b"", run))


def _bits(run: bytes) -> bytes:
    digits = run.replace(b"0b", b"").translate(None, b"_' ,;")
    return bytes(int(digits[at : at + 8], 2) for at in range(0, len(digits), 8))


def _text_forms() -> Iterator[Extractor]:
    # Python's b'..', C, Qt's qDebug, strace, JSON.
    pattern = rb"(?s)(?<!\w)[bu]?(?:" + _STRING + rb")(?:\s?(?:" + _STRING + rb"))*+"
    yield Extractor("quoted escapes", pattern, _literal, unit=0, needs=rb"\\")
    # DSView, Docklight, Bray's Terminal, minicom, interceptty: characters, and codes among them.
    by_length: list[bytes] = sorted(_CODE_OF, key=len, reverse=True)
    names = b"|".join(by_length)
    for name, left, right in (
        ("[ ]", rb"\[", rb"\]"), ("< >", rb"<", rb">"), ("{ }", rb"\{", rb"\}"),
        ("( )", rb"\(", rb"\)"),
    ):  # fmt: skip
        code = left + rb"(?:(?:0x)?%b|%b)" + right
        unit = re.compile(code % (rb"(" + _PAIR + rb")", rb"(" + names + rb")"))
        code %= (_PAIR, names)
        plain = rb"(?:(?!" + code + rb")%b)*"
        pattern = plain % rb"[!-~]" + code + rb"(?:" + plain % rb"[ -~]" + code + rb")*"
        yield Extractor(
            f"text with codes in {name}", pattern, partial(_bracketed, unit), unit=0,
            needs=code,
        )  # fmt: skip
    # A cell each: DSView and Saleae in ASCII.
    code = rb"\[[0-9A-F]{2}\]|<[0-9A-F]{2}>|'?\\x[0-9A-Fa-f]{2}'?|'0x[0-9A-F]{2}'|'[!-~]'"
    pattern = rb"(?<=[,;\t])(?:" + code + rb"|[ -~])(?=[,;\t]|$)"
    yield Extractor("a character in each line", pattern, _field, unit=0)
    escape = rb"\\(?:x[0-9A-Fa-f]{2}|[0-3][0-7]{2}|u00[0-9A-Fa-f]{2})"
    pattern = rb"[!-\[\]-~]*" + escape + rb"(?:" + escape + rb"|\\[abtnvfr0\\]|[ -\[\]-~])*+"
    yield Extractor("text with escapes", pattern, _unescaped, unit=0, needs=escape)
    # od -c, hexdump -c.
    cell = rb"(?: [0-3][0-7]{2}|  \\[0abtnvfr]|   [!-~]|    )"
    yield Extractor(
        "characters of od -c", rb"(?<=\d)(?:" + cell + rb")+(?= *$)", _od_characters, unit=0
    )
    # JSON of MQTT and the cloud.
    letter, ends = rb"[\w+/-]", rb"[\w+/=-]"
    pattern = rb"(?<!%b)(?=%b)(?:%b{4})*+(?:%b{2}==|%b{3}=)?(?!%b)"
    pattern %= (ends, letter, letter, letter, letter, ends)
    yield Extractor("base64", pattern, _base64, unit=0)


EXTRACTORS: Final = (*_hex_forms(), *_marked_forms(), *_number_forms(), *_text_forms())
"""All of them; earlier ones are preferred where the evidence is equal."""

BY_NAME: Final = {extractor.name: extractor for extractor in EXTRACTORS}
