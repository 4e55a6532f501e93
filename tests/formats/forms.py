"""The forms in which bytes are pasted, written as their programs write them, for any bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from fte_sniff.formats.logs.pastes import logged_bytes
from fte_sniff.formats.logs.text_lines import Piece

FULL_WIDTH = str.maketrans("0123456789ABCDEF ", "０１２３４５６７８９ＡＢＣＤＥＦ　")  # noqa: RUF001


def bytes_of_text(text: str, note: Callable[[str], None] | None = None) -> bytes:
    """All bytes that `text` writes; `note` gets what was doubtful, one line each."""
    lines = enumerate(text.splitlines(), start=1)
    pieces = (Piece(line, number, 0) for number, line in lines)
    return b"".join(logged.data for logged in logged_bytes(pieces, note))


def _rows(data: bytes, width: int = 16) -> Iterator[tuple[int, bytes]]:
    return ((at, data[at : at + width]) for at in range(0, len(data), width))


def _seen(data: bytes) -> str:
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in data)


def xxd(data: bytes) -> str:
    return "".join(f"{at:08x}: {row.hex(' ', -2):39}  {_seen(row)}\n" for at, row in _rows(data))


def xxd_bytes(data: bytes) -> str:
    return "".join(f"{at:08x}: {row.hex(' '):47}  {_seen(row)}\n" for at, row in _rows(data))


def hexdump(data: bytes) -> str:
    text, before, squeezed = "", b"", False
    for at, row in _rows(data):
        if row == before and at + len(row) < len(data):
            text += "" if squeezed else "*\n"
            squeezed = True
            continue
        before, squeezed = row, False
        halves = f"{row[:8].hex(' '):23}  {row[8:].hex(' '):23}"
        text += f"{at:08x}  {halves}  |{_seen(row)}|\n"
    return f"{text}{len(data):08x}\n"


def od(data: bytes) -> str:
    rows = "".join(f"{at:07o} {row.hex(' ')}\n" for at, row in _rows(data))
    return f"{rows}{len(data):07o}\n"


def od_decimal(data: bytes) -> str:
    rows = "".join(f"{at:07d} {row.hex(' ')}\n" for at, row in _rows(data))
    return f"{rows}{len(data):07d}\n"


def od_text(data: bytes) -> str:
    rows = "".join(f"{at:06x} {row.hex(' '):47}  >{_seen(row)}<\n" for at, row in _rows(data))
    return f"{rows}{len(data):06x}\n"


def wireshark(data: bytes) -> str:
    return "".join(f"{at:04x}   {row.hex(' '):47}   {_seen(row)}\n" for at, row in _rows(data))


def wireshark_stream(data: bytes) -> str:
    """Two ways, by turns, each with addresses of its own."""
    text, sent, indents = "", [0, 0], ("", "    ")
    for number, (_, row) in enumerate(_rows(data)):
        way = number % 2
        seen = _seen(row[:8]) + " " + _seen(row[8:])
        halves = f"{row[:8].hex(' '):23}  {row[8:].hex(' '):23}"
        text += f"{indents[way]}{sent[way]:08X}  {halves}   {seen}\n"
        sent[way] += len(row)
    return text


def putty(data: bytes) -> str:
    text = "=~=~=~=~=~= PuTTY log 2026.01.31 12:00:00 =~=~=~=~=~=\nEvent Log: Opening COM3\n"
    for number, (_, packet) in enumerate(_rows(data, 20)):
        way = ("Outgoing", "Incoming")[number % 2]
        text += f"{way} raw data at 2026-01-31 12:00:0{number % 10}\n"
        text += "".join(
            f"  {at:08x}  {row.hex(' '):47}  {_seen(row)}\n" for at, row in _rows(packet)
        )
    return text


def hexyl(data: bytes) -> str:
    text = "┌────────┬─────────────────────────┬─────────────────────────┬────────┬────────┐\n"
    for at, row in _rows(data):
        seen = "".join(chr(b) if 0x20 <= b < 0x7F else "⋄" if not b else "×" for b in row)
        halves = f"{row[:8].hex(' '):23} ┊ {row[8:].hex(' '):23}"
        text += f"│{at:08x}│ {halves} │{seen[:8]:8}┊{seen[8:]:8}│\n"
    return (
        text + "└────────┴─────────────────────────┴─────────────────────────┴────────┴────────┘\n"
    )


def hexyl_of_debian(data: bytes) -> str:
    """Version 0.8, in colours: a zero byte is shown as 0, white space as _."""
    text = ""
    for at, row in _rows(data):
        seen = "".join(
            chr(b) if 0x20 < b < 0x7F else "0" if not b else "_" if b in b" \t\n\r\x0c" else "•"
            for b in row
        )
        halves = f"{row[:8].hex(' '):23} ┊ {row[8:].hex(' '):23}".replace("00", "\x1b[90m00\x1b[0m")
        text += f"│\x1b[90m{at:08x}\x1b[0m│ {halves} │{seen[:8]:8}┊{seen[8:]:8}│\n"
    return text


def spy(data: bytes) -> str:
    return "".join(
        f"{at // 16:06d}.001 {('TX', 'RX')[at // 16 % 2]:5} 0000  {row.hex(' ').upper():48}  "
        f"{_seen(row)}\n"
        for at, row in _rows(data)
    )


def beside(data: bytes) -> str:
    return "".join(f"{row.hex(' ').upper():47}  |{_seen(row)}|\n" for _, row in _rows(data))


def c_array(data: bytes) -> str:
    rows = "".join(
        "    " + " ".join(f"0x{byte:02X}," for byte in row) + f" // {at}\n"
        for at, row in _rows(data, 8)
    )
    return f"static const uint8_t frame[] = {{ /* AA 55 */\n{rows}}};\n"


def c_string(data: bytes) -> str:
    return '"' + "".join(f"\\x{byte:02x}" for byte in data) + '"'


def python_bytes(data: bytes) -> str:
    return f"data = {data!r}"


def python_list(data: bytes) -> str:
    return f"[{', '.join(map(hex, data))}]"


def json_array(data: bytes) -> str:
    return '{"data": [' + ", ".join(map(str, b"\xaa\x55" + data)) + "]}"


def json_lines(data: bytes) -> str:
    return "[\n" + ",\n".join(f"  {byte}" for byte in b"\xaa\x55" + data) + "\n]\n"


def yaml(data: bytes) -> str:
    return "data:\n" + "".join(f"- {byte}\n" for byte in b"\xaa\x55" + data) + "---\n"


def java(data: bytes) -> str:
    signed = (byte - 256 if byte > 127 else byte for byte in b"\xaa\x55" + data)
    return f"[{', '.join(map(str, signed))}]"


def decimal_columns(data: bytes) -> str:
    return "".join(
        " ".join(f"{byte:3d}" for byte in row) + "\n" for _, row in _rows(b"\xaa\x55" + data)
    )


def full_width(data: bytes) -> str:
    return data.hex(" ").upper().translate(FULL_WIDTH)


def chinese_commas(data: bytes) -> str:
    return "、".join(f"{byte:02X}" for byte in data) + "。"


def fenced(data: bytes) -> str:
    return f"```hex\n{data.hex(' ')}\n```\n"


def h_behind(data: bytes) -> str:
    return " ".join(f"{byte:02X}h" for byte in data)


def dashes(data: bytes) -> str:
    return data.hex("-").upper()


def numbered(data: bytes) -> str:
    # One line alone would not show that its number is one.
    rows = enumerate(_rows(b"\xaa\x55" * 5 + data, 10), start=9)
    return "".join(f"{number}: {row.hex(' ').upper()}\n" for number, (_, row) in rows)


def sscom(data: bytes) -> str:
    return "".join(
        f"[14:03:{number % 60:02d}.123]{('发→◇', '收←◆')[number % 2]}{row.hex(' ').upper()} \r\n"
        for number, (_, row) in enumerate(_rows(data, 10))
    )


def xcom(data: bytes) -> str:
    return "".join(
        f"[2026-01-31 14:03:{at // 10 % 60:02d}.123]# RECV HEX>\r\n{row.hex(' ').upper()} \r\n\r\n"
        for at, row in _rows(data, 10)
    )


def labelled(data: bytes) -> str:
    return "".join(
        f"{('TX', 'RX')[at // 10 % 2]} ({len(row)} bytes): {row.hex(' ')}\n"
        for at, row in _rows(data, 10)
    )


def ros(data: bytes) -> str:
    return "".join(
        f"[INFO] [{1769860800 + at}.123456789] [base_driver]: TX: {row.hex(' ')}\n"
        for at, row in _rows(data, 10)
    )


def logging(data: bytes) -> str:
    return "".join(
        f"2026-01-31 14:03:22,{at % 1000:03d} - INFO - RX: {row.hex(' ')}\n"
        for at, row in _rows(data, 10)
    )


def node(data: bytes) -> str:
    return f"<Buffer {data.hex(' ')}>\n"


DECIMAL = (json_array, json_lines, yaml, java, decimal_columns)
"""They begin with AA 55, so that they are decimal beyond doubt."""

NUMBERED = (numbered,)
"""They begin with AA 55 five times, so that there are two lines."""

FORMS: dict[str, Callable[[bytes], str]] = {
    form.__name__: form
    for form in (
        *(xxd, xxd_bytes, hexdump, od, od_decimal, od_text, wireshark, wireshark_stream),
        *(putty, hexyl, hexyl_of_debian, spy, beside, c_array, c_string, python_bytes, python_list),
        *(full_width, chinese_commas, fenced, h_behind, dashes, sscom, xcom, labelled),
        *(ros, logging, node, *DECIMAL, *NUMBERED),
    )
}
"""By name, what writes bytes in a form; its bytes are those that `bytes_in` gives."""


def bytes_in(form: Callable[[bytes], str], data: bytes) -> bytes:
    """The bytes that the form holds."""
    if form in DECIMAL:
        return b"\xaa\x55" + data
    return b"\xaa\x55" * 5 + data if form in NUMBERED else data
