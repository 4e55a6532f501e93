"""Layouts of many tools, each made of any chunks, for tests."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple


class Sent(NamedTuple):
    """The bytes of a line of a log."""

    data: bytes
    way: str
    """`tx` or `rx`."""
    ms: int
    """Milliseconds since midnight."""


Layout = Callable[[Sequence[Sent]], str]

UPPER = "{:02X}".format


def clock(ms: int, digits: int = 3) -> str:
    """A time of day."""
    text = f"{ms // 3_600_000:02}:{ms // 60_000 % 60:02}:{ms // 1000 % 60:02}.{ms % 1000:03}"
    return text if digits == 3 else text[:-4]


def spaced(data: bytes) -> str:
    """Pairs with a space between two."""
    return data.hex(" ").upper()


def shown(data: bytes) -> str:
    """The column of characters beside a dump."""
    return "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in data)


def escaped(data: bytes) -> str:
    """A C string with escapes for all that is not printable."""
    return "".join(
        chr(b) if 0x20 <= b < 0x7F and chr(b) not in "\"'\\" else f"\\x{b:02x}" for b in data
    )


def line(form: str) -> Layout:
    """A layout of one form of line; the names in it are the keys of `values`."""

    def layout(log: Sequence[Sent]) -> str:
        return "".join(
            form.format(**values(number, sent)) + "\n" for number, sent in enumerate(log)
        )

    return layout


@cache
def values(number: int, sent: Sent) -> dict[str, object]:
    """What a line may contain."""
    data, tx = sent.data, sent.way == "tx"
    return {
        "n": number,
        "len": len(data),
        "t": clock(sent.ms),
        "s": clock(sent.ms, 0),
        "since": f"{sent.ms / 1000 - 43000:.6f}",
        "epoch": f"{1_700_000_000 + sent.ms / 1000:.6f}",
        "ms": 1_700_000_000_000 + sent.ms,
        "TX": "TX" if tx else "RX",
        "tx": sent.way,
        "Write": "Write" if tx else "Read",
        "send": "send" if tx else "recv",
        "arrow": "→" if tx else "←",
        "sign": ">" if tx else "<",
        "zh": "发送" if tx else "接收",
        "spaced": spaced(data),
        "lower": data.hex(" "),
        "hex": data.hex(),
        "HEX": data.hex().upper(),
        "dashes": data.hex("-").upper(),
        "colons": data.hex(":"),
        "commas": data.hex(",").upper(),
        "x": ", ".join(f"0x{b:02X}" for b in data),
        "xs": " ".join(f"0x{b:02x}" for b in data),
        "h": " ".join(f"{b:02X}h" for b in data),
        "dollar": " ".join(f"${b:02X}" for b in data),
        "dec": ", ".join(map(str, data)),
        "decs": " ".join(map(str, data)),
        "pad": " ".join(f"{b:3d}" for b in data),
        "signed": ", ".join(str(b - 256 if b > 127 else b) for b in data),
        "bits": " ".join(f"{b:08b}" for b in data),
        "oct": " ".join(f"{b:03o}" for b in data),
        "repr": repr(data),
        "quoted": escaped(data),
        "angle": "".join(f"<{b:02X}>" for b in data),
        "square": "".join(f"[{b:02X}]" for b in data),
        "percent": "".join(f"%{b:02X}" for b in data),
        "b64": b64encode(data).decode(),
        "shown": shown(data),
        "dump": f"{data.hex(' '):<47}  |{shown(data)}|",
        "json": json.dumps(list(data)),
        "strings": json.dumps([f"0x{b:02x}" for b in data]),
        "latin": json.dumps(data.decode("latin-1")),
        "sum": f"{sum(data) & 0xFF:02X}",
        "fours": data.hex(" ", -4),
        "X": "".join(f"\\{b:02X}" for b in data),
        "pascal": "".join(f"#${b:02X}" for b in data),
        "bars": " | ".join(map(UPPER, data)),
        "waves": " ".join(f"h{b:02X}" for b in data),
        "modbus": "".join(f"[{b:02X}]" if tx else f"<{b:02X}>" for b in data),
        "ns": (1_700_000_000_000 + sent.ms) * 10**6,
        "outgoing": "outgoing" if tx else "incoming",
        "name": "".join(chr(97 + (number * step) % 26) for step in (7, 5, 3, 11)),
        "noise": "HEAP 3ffb" if number % 3 else "HEAP 20",
    }


def realterm(log: Sequence[Sent]) -> str:
    return "".join(f"{value}\n" for value in (f"{b:02X}" for sent in log for b in sent.data))


def yaml(log: Sequence[Sent]) -> str:
    return "".join(
        "layout:\n  dim: []\n  data_offset: 0\ndata:\n"
        + "".join(f"- {b}\n" for b in sent.data)
        + "---\n"
        for sent in log
    )


def heading_above(log: Sequence[Sent]) -> str:
    return "".join(
        f"[{clock(sent.ms)}] {'Written' if sent.way == 'tx' else 'Read'} data (COM3)\n"
        f"    {sent.data.hex(' ')}\n\n"
        for sent in log
    )


def saleae2(log: Sequence[Sent]) -> str:
    text = "name,type,start_time,duration,data\n"
    for sent in log:
        name = "Async Serial" if sent.way == "rx" else "Async Serial [1]"
        for at, byte in enumerate(sent.data):
            start = sent.ms / 1000 - 43000 + at * 8.68e-5
            text += f'"{name}","data",{start:.9f},8.6e-05,0x{byte:02X}\n'
    return text


def dsview(log: Sequence[Sent]) -> str:
    text = "Id,Time[ns],0:UART: RX/TX\n"
    for number, sent in enumerate(log):
        for at, byte in enumerate(sent.data):
            text += f"{10 * number + at},{sent.ms * 10**6 + at * 86_806}.{0:020},{byte:02X}\n"
    return text


def two_columns(log: Sequence[Sent]) -> str:
    text = "Time [s],RX,TX\n"
    for sent in log:
        for at, byte in enumerate(sent.data):
            cells = f"0x{byte:02X}," if sent.way == "rx" else f",0x{byte:02X}"
            text += f"{sent.ms / 1000 - 43000 + at * 8.68e-5:.9f},{cells}\n"
    return text


def octal_words(log: Sequence[Sent]) -> str:
    data = b"".join(sent.data for sent in log)
    words = [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]
    rows = [words[at : at + 8] for at in range(0, len(words), 8)]
    lines = [
        f"{16 * at:07o} {' '.join(f'{word:06o}' for word in row)}\n" for at, row in enumerate(rows)
    ]
    return "".join(lines) + f"{len(data):07o}\n"


def hexyl(log: Sequence[Sent]) -> str:
    data = b"".join(sent.data for sent in log)
    return "".join(
        f"│{at:08x}│ {data[at : at + 8].hex(' '):<23} ┊ {data[at + 8 : at + 16].hex(' '):<23} │"
        f"{shown(data[at : at + 8]):<8}┊{shown(data[at + 8 : at + 16]):<8}│\n"
        for at in range(0, len(data), 16)
    )


def node_array(log: Sequence[Sent]) -> str:
    return "".join(
        f"Uint8Array({len(sent.data)}) [\n"
        + ",\n".join(
            "  " + ", ".join(f"{byte:3d}" for byte in sent.data[at : at + 4])
            for at in range(0, len(sent.data), 4)
        )
        + "\n]\n"
        for sent in log
    )


def pulseview(log: Sequence[Sent]) -> str:
    return "".join(
        f"{at * 100}-{at * 100 + 87} UART: {sent.way.upper()} data: {byte:02X}\n"
        for sent in log
        for at, byte in enumerate(sent.data)
    )


def hexdump(log: Sequence[Sent]) -> str:
    data = b"".join(sent.data for sent in log)
    return (
        "".join(
            f"{at:08x}  {data[at : at + 8].hex(' '):<23}  {data[at + 8 : at + 16].hex(' '):<23}"
            f"  |{shown(data[at : at + 16])}|\n"
            for at in range(0, len(data), 16)
        )
        + f"{len(data):08x}\n"
    )


def c_array(log: Sequence[Sent]) -> str:
    data = b"".join(sent.data for sent in log)
    rows = [data[at : at + 12] for at in range(0, len(data), 12)]
    body = "".join("  " + ", ".join(f"0x{b:02x}" for b in row) + ",\n" for row in rows)
    return f"unsigned char log[] = {{\n{body}}};\nunsigned int log_len = {len(data)};\n"


ONE_LINE: dict[str, Layout] = {
    "CoolTerm": line("{s} {TX}: {spaced}"),
    "Docklight": line("5/3/2024 {t} [{TX}] - {spaced} \n"),
    "HTerm": line("{TX} {x}"),
    "CuteCom": line("[{t}] {sign} {h}"),
    "Termite": line("{TX}: {angle}"),
    "YAT": line("({t}) (COM4) ({sign}{sign}) {h} ({len})"),
    "XCOM": line("[{t}]{zh}{arrow}{spaced} "),
    "Vofa+": line("{t} {tx} {HEX}"),
    "candump": line("({epoch}) vcan0 {TX} {HEX}"),
    "logcat": line("03-05 {t}  1234  5678 D Usb: on{Write}({len}) {colons}"),
    "Zephyr": line("[{t},678] <dbg> uart: {send}: {dump}"),
    "Arduino": line("{t} -> {spaced}"),
    "Node-RED": line('{{"ts":{ms},"topic":"{tx}","payload":{{"type":"Buffer","data":{json}}}}}'),
    "MQTT base64": line('{{"t":{ms},"dir":"{tx}","data":"{b64}"}}'),
    "Python repr": line("{t} {send} {repr}"),
    "Go": line("2024/03/05 {s} {send} [{decs}]"),
    "Rust hex": line("[2024-03-05T{s}Z DEBUG fte] {tx}: [{lower}]".replace("{lower}", "{commas}")),
    "Rust 0x": line("[2024-03-05T{s}Z DEBUG fte] {tx}: [{x}]"),
    "Java": line("{t} INFO {send} [{signed}]"),
    "C#": line("{t};{tx};{dashes}"),
    "MATLAB": line("{pad}"),
    "LabVIEW": line("{t}\t{Write}\t{len}\t{spaced}"),
    "Qt": line('{t} "{lower}" {send}'),
    "octal": line("{tx} {oct}"),
    "binary": line("{tx} {bits}"),
    "C string": line('{t} {send}("{quoted}", {len}) = {len}'),
    "JSON latin": line('{{"time":"2024-03-05T{t}Z","dir":"{tx}","data":{latin}}}'),
    "JSON strings": line('{{"time":"2024-03-05T{t}Z","dir":"{tx}","data":{strings}}}'),
    "Pascal": line("{t} {TX} {dollar}"),
    "checksum": line("{t} {TX} {spaced} {sum}"),
    "RealTerm brackets": line("{square}"),
    "spaces in brackets": line("[{t}] [{TX}] [{lower}]"),
    "Modbus slave": line("{n:06d} {Write} {commas}"),
    "percent": line("{t} {tx} {percent}"),
    "text beside": line("{t} {sign} {lower}   {shown}"),
    "record number": line("#{n} +{since}s {TX} len={len}: {spaced}"),
    "Swift": line("{t} {send} {len} bytes: [{dec}]"),
    "Erlang": line("{t} {send} <<{dec}>>"),
    "NumPy": line("{send} array([{dec}], dtype=uint8)"),
    "bytearray": line("{t} {tx}: bytearray({repr})"),
    "tshark fields": line("{n}\t{since}\t{tx}\t{colons}"),
    "kernel": line("[{since}] usb: {send} {len}: {lower}"),
    "JSON hex": line('{{"level":"debug","ts":{ms},"msg":"{send}","hex":"{hex}"}}'),
    "quoted CSV": line('"{n}","{t}","{TX}","{spaced}"'),
    "Markdown table": line("| {n} | {t} | {TX} | {spaced} |"),
    "long label": line("{t} [uart-3] com.acme.SerialPort - {send} (len={len}) -> {lower}"),
    "checksum in words": line("{TX}: {spaced} | sum={sum}"),
    "length before": line("{TX} {len:02d} {spaced}"),
    "number before": line("{n:02d} {spaced}"),
    "0x and digits": line("{t} {tx} 0x{HEX}"),
    "VHDL": line('{t} {tx} x"{HEX}"'),
    "ticks": line("{n:08d} {tx} {xs}"),
    "assembler": line("db {h}"),
    "XML": line('<msg dir="{tx}" time="{t}">{spaced}</msg>'),
    "XML attribute": line('<frame t="{ms}" d="{tx}" data="{HEX}"/>'),
    "Python tuple": line("({since}, {repr})"),
    "Chinese words": line("时间：{t}，方向：{zh}，数据：{spaced}"),
    "Chinese CSV": line("{n},{t},{zh},数据帧,{spaced}"),
    "usbmon": line("ffff8880 {ns} S B{tx}:1:005:2 -115 {len} = {fours}"),
    "NSData": line("2024-03-05 {t}+0000 App[12:345] {send} <{fours}>"),
    "NSData of iOS 13": line("2024-03-05 {t}+0000 App[12:345] {send} {{len = {len}, 0x{hex}}}"),
    "libmodbus": line("{modbus}"),
    "pymodbus": line("{t} DEBUG transport:312 {send}: {xs} old_data:  addr=None"),
    "QModMaster": line("{t} - {TX} > {lower}"),
    "LabVIEW escapes": line("{t}\t{TX}\t{X}"),
    "Delphi": line("{t} {TX} {pascal}"),
    "HTML table": line("<tr><td>{t}</td><td>{TX}</td><td>{spaced}</td></tr>"),
    "Org table": line("| {t} | {TX} | {bars} |"),
    "InfluxDB": line('uart,dir={tx},port=ttyUSB0 data="{hex}",len={len}i {ns}'),
    "psql": line("  {n:3} | 2024-03-05 {t} | {tx} | \\x{hex}"),
    "syslog": line("Mar  5 {s} robot fte[1234]: {TX} {lower}"),
    "RFC 5424": line("<134>1 2024-03-05T{t}Z robot fte 1234 - - {tx} {hex}"),
    "dmesg": line("[{since}] fte_uart: {tx}: 00000000: {dump}"),
    "nRF Connect": line('A\t{t}\t"(0x) {dashes}" {send}'),
    "glog": line("I0305 {t}456  1234 serial.cc:42] {tx} {lower}"),
    "journald": line('{{"__REALTIME_TIMESTAMP":"{ns}","DIR":"{tx}","MESSAGE":{json}}}'),
    "Elastic": line('{{"@timestamp":"2024-03-05T{t}Z","way":"{outgoing}","payload":"{lower}"}}'),
    "Moxa PComm": line("{n}, {t}, {send}, {len}, {spaced}"),
    "AccessPort": line("#{n}\t{t}\tIRP_MJ_{TX}\tCOM3\tSUCCESS\tLength: {len:04d}, Data: {spaced}"),
    "J-Link RTT": line("00> {t} {TX}[{len}] {spaced}"),
    "VS Code": line('[{t}] ---- {send} hex encoded message: "{spaced}" ----'),
    "R": line(" [1] {lower}"),
    "Docker": line("2024-03-05T{t}456789Z {tx} {lower}"),
    "Elixir": line("{t} [debug] {tx}: <<{dec}>>"),
    "SSCOM": line("[{t}]{zh}{arrow}◇{spaced} □"),
    "PlatformIO": line("{t} > {lower}"),
    "WaveForms": line("{TX}: {waves}"),
    "words after bytes": line("{spaced}   # {TX} at {t}"),
    "heading with a count": line("[{t}] {outgoing} {len} bytes:\n\t{lower}"),
    "tshark -T json": line(' "{tx}": {{\n  "tcp.payload": "{colons}",\n  "data.data": "{colons}"'),
    "Eclipse": line("{t} [{tx}]\t{lower}\t{noise}"),
}  # fmt: skip

OTHERS: dict[str, Layout] = {
    "RealTerm, one a line": realterm,
    "ROS echo": yaml,
    "Eltima": heading_above,
    "Saleae 2": saleae2,
    "DSView": dsview,
    "hexyl": hexyl,
    "Wireshark YAML": line("  - packet: {n}\n    peer: 0\n    data: !!binary |\n      {b64}"),
    "two columns": two_columns,
    "hexdump -C": hexdump,
    "C array": c_array,
    "od": octal_words,
    "Node.js": node_array,
    "PulseView": pulseview,
}


def windbg(log: Sequence[Sent]) -> str:
    data = b"".join(sent.data for sent in log)
    return (
        "".join(
            f"00000000`{at:08x}  {data[at : at + 8].hex(' ')}-{data[at + 8 : at + 16].hex(' ')}"
            f"  {shown(data[at : at + 16])}\n"
            for at in range(0, len(data) - 16, 16)
        )
        + f"00000000`{len(data):08x}  {data[-(len(data) % 16 or 16) :].hex(' ')}\n"
    )


def bus_hound(log: Sequence[Sent]) -> str:
    text = "Device  Length  Phase  Data                    Description\n"
    for sent in log:
        way = "OUT" if sent.way == "tx" else "IN "
        fours = "  ".join(sent.data[at : at + 4].hex(" ") for at in range(0, len(sent.data), 4))
        text += f"  23.1  {len(sent.data):5}  {way}    {fours:<53}{shown(sent.data)}\n"
    return text


def two_headings(log: Sequence[Sent]) -> str:
    return "".join(
        f"{number:06d}: 2024-03-05 {clock(sent.ms)} +0.02\n"
        f" IRP_MJ_{'WRITE' if sent.way == 'tx' else 'READ'} (DOWN)\n"
        f"  {spaced(sent.data):<47}  {shown(sent.data)}\n\n"
        for number, sent in enumerate(log)
    )


def zephyr(log: Sequence[Sent]) -> str:
    return "".join(
        f"[{clock(sent.ms)},000] <dbg> uart: {'uart_send' if sent.way == 'tx' else 'uart_recv'}\n"
        f"{'':39}{sent.data[:8].hex(' '):<23}  {sent.data[8:].hex(' '):<23}|{shown(sent.data)}\n"
        for sent in log
    )


OTHERS |= {
    "WinDbg": windbg,
    "Bus Hound": bus_hound,
    "HHD, two headings": two_headings,
    "Zephyr, two lines": zephyr,
}

LAYOUTS = ONE_LINE | OTHERS
