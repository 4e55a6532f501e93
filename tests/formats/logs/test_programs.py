"""What other programs write around the bytes, and the forms that only one program has."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from datetime import date

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.log_clock import LogClock
from fte_sniff.formats.logs.pastes import logged_bytes
from fte_sniff.formats.logs.text_lines import Piece, TextPieces
from fte_sniff.protocol import iso_time
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns
from tests.formats.forms import bytes_of_text

SENT, RECEIVED = Mark.SENT, Mark.RECEIVED
A = "AA 02 02 03 E8 00 00 27 10 EE"
F = "55 02 01 00 00 27 10 00 0F EE"
A_H, F_H = (" ".join(f"{pair}h" for pair in frame.split()) for frame in (A, F))
BYTES = bytes.fromhex(A + F)

LOGS = {
    "Docklight, American": (
        f"2/14/2024 13:45:12.345 [TX] - {A} \n\n2/14/2024 13:45:12.355 [RX] - {F} \n",
        ("2024-02-14T13:45:12.345", "2024-02-14T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "Docklight, American, 12 hours": (
        f"2/14/2024 1:45:12.345 PM [TX] - {A} \n\n2/14/2024 1:45:12.355 PM [RX] - {F} \n",
        ("2024-02-14T13:45:12.345", "2024-02-14T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "Docklight, German": (
        f"08.02.2024 13:45:12.34 [TX] - {A}\r\n08.02.2024 13:45:12.35 [RX] - {F}\r\n",
        ("2024-02-08T13:45:12.340", "2024-02-08T13:45:12.350"),
        (SENT, RECEIVED),
    ),
    "Eltima Serial Port Monitor": (
        f"[25/10/2018 10:15:36] Written data (COM2)\t\n    {A.lower()}   ª....è..'.î     \t\n"
        f"[25/10/2018 10:15:37] Read data (COM2)\t\n    {F.lower()}   U....'....\t\n",
        ("2018-10-25T10:15:36.000", "2018-10-25T10:15:37.000"),
        (SENT, RECEIVED),
    ),
    "RealTerm, Unix time": (
        f"1706702602.12, {A}\n1706702602.13, {F}\n",
        ("2024-01-31T12:03:22.120", "2024-01-31T12:03:22.130"),
        (None, None),
    ),
    "RealTerm, Unix time, no spaces": (
        f"1706702602,{A.replace(' ', '')}\n1706702603,{F.replace(' ', '')}\n",
        ("2024-01-31T12:03:22.000", "2024-01-31T12:03:23.000"),
        (None, None),
    ),
    "Tera Term": (
        f"[2024-02-08 13:45:12.345] {A}\n[2024-02-08 13:45:12.355] {F}\n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (None, None),
    ),
    "Tera Term 4": (
        f"[Thu Feb 08 13:45:12.345 2024] {A}\n[Thu Feb 08 13:45:12.355 2024] {F}\n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (None, None),
    ),
    "Tera Term, since it began": (
        f"[0 00:00:12.345] {A}\n[0 00:00:12.355] {F}\n",
        (None, None),
        (None, None),
    ),
    "YAT": (
        f"(13:45:12.345) (>>) {A_H} (10)\n(13:45:12.355) (<<) {F_H} (10)\n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (None, None),
    ),
    "YAT, all of it": (
        f"(2024-02-08 13:45:12.345+01:00) (+0.000) (COM1) (>>) {A_H} (10)\n"
        f"(2024-02-08 13:45:12.355+01:00) (+0.010) (COM1) (<<) {F_H} (10)\n",
        ("2024-02-08T12:45:12.345", "2024-02-08T12:45:12.355"),
        (None, None),
    ),
    "HTerm": (
        f"13:45:12.345: {A}\n13:45:12.355: {F}\n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (None, None),
    ),
    "CuteCom": (
        f"[13:45:12:345] {A.lower()}  \n[13:45:12:355] {F.lower()}  \n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (None, None),
    ),
    "minicom, HTerm, RealTerm": (f"{A.lower()} {F.lower()} ", (None,), (None,)),
    "picocom": ("".join(f"[{pair}]" for pair in f"{A} {F}".split()), (None,), (None,)),
    "CoolTerm": (
        f"2024-02-08 13:45:12 {A}\n2024-02-08 13:45:12.355 {F}\n",
        ("2024-02-08T13:45:12.000", "2024-02-08T13:45:12.355"),
        (None, None),
    ),
    "SSCOM": (
        f"[13:45:12.345]发→◇{A} □\n[13:45:12.355]收←◆{F} \n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "SSCOM, English": (
        f"[13:45:12.345]OUT→◇{A} □\n[13:45:12.355]IN←◆{F} \n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "UartAssist": (
        f"[2024-02-08 13:45:12.345]# SEND HEX>\n{A} \n\n"
        f"[2024-02-08 13:45:12.355]# RECV HEX>\n{F} \n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "UartAssist 5, with lengths": (
        f"[2024-02-08 13:45:12.345]# SEND HEX/10 >>>\n{A} \n\n"
        f"[2024-02-08 13:45:12.355]# RECV HEX/10 <<<\n{F} \n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "NetAssist": (
        f"[2024-02-08 13:45:12.345]# SEND HEX TO 10.0.0.7 :8080>\n{A} \n\n"
        f"[2024-02-08 13:45:12.355]# RECV HEX FROM 10.0.0.7 :8080>\n{F} \n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "no year": (
        f"[02-08 13:45:12:345] #SEND HEX>\n{A}\n\n[02-08 13:45:12:355] #RECV HEX>\n{F}\n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "XCOM": (
        f"[2024-02-08 13:45:12.345]TX：{A}\n[2024-02-08 13:45:12.355]RX：{F}\n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "友善串口": (
        f"[13:45:12.345] 发送: {A}\n[13:45:12.355] 接收: {F}\n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (SENT, RECEIVED),
    ),
    "Arduino, each byte as short as it can be": (
        "13:45:12.345 -> AA 2 2 3 E8 0 0 27 10 EE \n13:45:12.355 -> 55 2 1 0 0 27 10 0 F EE \n",
        ("2026-01-31T13:45:12.345", "2026-01-31T13:45:12.355"),
        (None, None),
    ),
    "socat -x": (
        f"> 2024/02/08 13:45:12.345678  length=10 from=0 to=9\n {A.lower()}\n"
        f"< 2024/02/08 13:45:12.355678  length=10 from=0 to=9\n {F.lower()}\n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (None, None),
    ),
    "socat -x -v": (
        f"> 2024/02/08 13:45:12.000345678  length=10 from=0 to=9\n"
        f" {A.lower():47}  .......'..\n--\n"
        f"< 2024/02/08 13:45:12.000355678  length=10 from=0 to=9\n"
        f" {F.lower():47}  U....'....\n--\n",
        ("2024-02-08T13:45:12.000", "2024-02-08T13:45:12.000"),
        (None, None),
    ),
    "jpnevulator": (
        f"2024-02-08 13:45:12.345678: /dev/ttyS0\n{A:47} .......'..\n"
        f"2024-02-08 13:45:12.355678: /dev/ttyS1\n{F:47} U....'....\n",
        ("2024-02-08T13:45:12.345", "2024-02-08T13:45:12.355"),
        (None, None),
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_the_log_of_each_program(name: str) -> None:
    text, times, marks = LOGS[name]
    log = HexLog.of_stream(io.BytesIO(text.encode()), "f", LogClock(date(2026, 1, 31)))
    chunks = list(log)
    assert b"".join(chunk.data for chunk in chunks) == BYTES
    assert tuple(chunk.t_ns and iso_time(chunk.t_ns)[:23] for chunk in chunks) == times
    assert not log.doubts
    logged = logged_bytes(TextPieces(io.BytesIO(text.encode()), "f"))
    assert tuple(one.mark for one in logged) == marks


UNTOLD = (
    *("minicom, HTerm, RealTerm", "picocom", "RealTerm, Unix time, no spaces", "jpnevulator"),
    "Arduino, each byte as short as it can be",
)
"""Cut, they look like other bytes."""


@pytest.mark.parametrize("name", [name for name in LOGS if name not in UNTOLD])
def test_a_log_that_ends_anywhere_gives_its_first_bytes_or_is_refused(name: str) -> None:
    text, _, _ = LOGS[name]
    begins = re.search("EEh?", text, re.IGNORECASE)
    assert begins is not None
    for cut in range(begins.end(), len(text)):
        try:
            found = bytes_of_text(text[:cut])
        except InputTextError:
            continue
        assert BYTES.startswith(found), text[:cut]


@pytest.mark.parametrize(
    "text",
    [
        f"(13:45:12.345) (>>) {A_H} (11)",
        f"TX: {A} (11 bytes)",
        f"TX: {A} [len=9]",
    ],
)
def test_a_count_behind_bytes_that_are_not_as_many_is_refused(text: str) -> None:
    with pytest.raises(InputTextError, match=r"line 1: (9|11) may be a byte, or a count that"):
        bytes_of_text(text)


def test_a_count_behind_bytes_is_none_of_them() -> None:
    assert bytes_of_text(f"TX: {A} (10 bytes)\nRX: {F} [10]") == BYTES
    assert bytes_of_text("TX: [AA] [02] [10]") == bytes.fromhex("AA0210")


CONTROL, FEEDBACK = BYTES[:10], BYTES[10:]
ESCAPED_A, ESCAPED_F = (
    "".join(f"\\x{byte:02x}" for byte in frame) for frame in (CONTROL, FEEDBACK)
)


def read(text: str) -> tuple[bytes, list[str]]:
    log = HexLog.of_stream(io.BytesIO(text.encode()), "f")
    return b"".join(chunk.data for chunk in log), log.doubts


def marks_of(text: str) -> list[Mark | None]:
    pieces = (Piece(line, number, 0) for number, line in enumerate(text.splitlines(), start=1))
    return [logged.mark for logged in logged_bytes(pieces)]


@pytest.mark.parametrize(
    ("write", "read_back"),
    [
        (f'write(3, "{ESCAPED_A}", 10) = 10', f'read(3, "{ESCAPED_F}", 4096) = 10'),
        (f'write(3, "{ESCAPED_A}", 10)     = 10', f'read(3, "{ESCAPED_F}", 4096)  = 10'),
        (
            f'13:45:12.345678 write(3, "{ESCAPED_A}", 10) = 10 <0.000040>',
            f'read(3, "{ESCAPED_F}", 10) = 10',
        ),
        (
            f'1706702602.345678 write(3, "{ESCAPED_A}", 10) = 10',
            f'     0.000031 read(3, "{ESCAPED_F}", 9) = 10',
        ),
        (
            f'write(3</dev/ttyUSB0>, "{ESCAPED_A}", 10) = 10',
            f'read(3</dev/ttyUSB0>, "{ESCAPED_F}", 10) = 10',
        ),
        (
            f'write(3</dev/tty<char 5:2>>, "{ESCAPED_A}", 10) = 10',
            f'read(3<x>, "{ESCAPED_F}", 10) = 10',
        ),
        (
            f'[pid  1234] write(3, "{ESCAPED_A}", 10) = 10',
            f'1234  read(3, "{ESCAPED_F}", 4096) = 10',
        ),
        (
            f'1234  13:45:12 write(3, "{ESCAPED_A}", 10) = 10',
            f'1234  13:45:12 read(3, "{ESCAPED_F}", 4096) = 10',
        ),
        (
            r"""write(3, "\252\2\2\3\350\0\0'\20\356", 10) = 10""",
            r"""read(3, "U\2\1\0\0'\20\0\17\356", 4096) = 10""",
        ),
    ],
)
def test_what_strace_shows(write: str, read_back: str) -> None:
    between = "read(3, 0x7ffc0, 255) = -1 EAGAIN (Resource temporarily unavailable)\nclose(4) = 0"
    text = f"{write}\n{between}\n{read_back}\n+++ exited with 0 +++\n"
    assert read(text) == (BYTES, [])
    assert marks_of(text) == [SENT, RECEIVED]


@pytest.mark.parametrize(
    "options",
    [["-xx"], ["-x", "-tt", "-T"], ["-ttt", "-f"], ["-y", "-r"]],
    ids=" ".join,
)
def test_what_strace_really_writes(options: list[str]) -> None:
    if shutil.which("strace") is None:
        pytest.skip("there is no strace here")
    program = f"import os; os.write(2, {BYTES!r}); os.write(2, bytes(range(256)))"
    command = ["strace", *options, "-s", "999", "-e", "trace=write", "-o", "/dev/stdout"]
    command += [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, timeout=60, check=False)
    if done.returncode:
        pytest.skip("strace may not trace here")
    assert read(done.stdout.decode())[0] == BYTES + bytes(range(256))


def test_what_strace_shows_as_written_but_was_not_is_left_out() -> None:
    assert (
        read(f'write(3, "{ESCAPED_A}", 10) = 4\nwrite(3, "{ESCAPED_A}", 10) = -1 EIO (x)')[0]
        == CONTROL[:4]
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'write(3, "{ESCAPED_A}"..., 64) = 64', "line 1: bytes are left out; trace with -s 65536"),
        (f'write(3, "{ESCAPED_A}", 64) = 64', "line 1: bytes are left out; trace with -s 65536"),
        (
            f'write(3, "{ESCAPED_A}", 10) = 10\nwrite(1, "x", 1) = 1',
            "line 2: file 1 is another than 3",
        ),
        ("read(3,  <unfinished ...>", "line 1: the call is not finished on its line"),
        ("uart-1: AA\nuart-2: 55", "line 2: uart-2 is another decoder than uart-1 above"),
        ("uart-1: rx-data: 170", "line 1: '170' is no byte in hex; export again"),
        ("uart-1: [AA]", "line 1: '[AA]' is no byte in hex; export again"),
        ("Time [s],Value,Parity Error,Framing Error\n0.1,o,,", "line 2: 'o' is no byte in hex"),
        ("Time [s],Value,Parity Error,Framing Error\n0.1,0xA,,", "line 2: '0xA' is no byte in hex"),
        ("Time [s],Value,Parity Error,Framing Error\n0.1,0xAA", "line 2: has 2 of 4 columns"),
        ("Time [s],Value,Parity Error,Framing Error\n0.1,\x1b[2J,,", "is no byte in hex"),
        (
            'name,type,start_time,duration,data\n"A","data",0.1,1e-5,0xAA\n"B","data",0.2,1e-5,0x01',
            "line 3: 'B' is another wire than 'A' above; export one at a time",
        ),
        (
            "13:45:12.345678 IP 10.0.0.2.500 > 10.0.0.3.4001: Flags [P.], length 10\n\t0x0000:  45",
            "line 1: packets of tcpdump hold more than their serial bytes; try: tcpdump -w x.pcap",
        ),
    ],
)
def test_what_would_be_other_bytes_is_refused_with_the_way_out(text: str, said: str) -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of_text(text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "\x1b" not in str(caught.value)


def annotations(line: str) -> str:
    return "".join(line.format(at * 87, at * 87 + 80, byte) for at, byte in enumerate(BYTES))


@pytest.mark.parametrize(
    ("line", "mark"),
    [
        ("uart-1: {2:02X}\n", None),
        ("uart-1: rx-data: {2:02X}\n", RECEIVED),
        ("{0}-{1} uart-1: {2:02X}\n", None),
        ("{0}-{1} uart-1: tx-data: {2:02X}\n", SENT),
        ("{0}-{1} UART: RX data: {2:02x}\n", RECEIVED),
        ("uart-1: Start bit\nuart-1: 1\nuart-1: 0\nuart-1: {2:02X}\nuart-1: Stop bit\n", None),
        ("UART: RX bits: 1\nUART: RX data: {2:02X}\nUART: RX stop bits: T\n", RECEIVED),
        ("> \t0x{2:02x} (^A)\n", None),
    ],
)
def test_annotations_of_a_uart(line: str, mark: Mark | None) -> None:
    text = annotations(line)
    assert read(text) == (BYTES, [])
    assert marks_of(text) == [mark] * len(BYTES)


def test_an_error_that_the_analyser_saw_is_told_once() -> None:
    assert read("uart-1: AA\nuart-1: Frame error\nuart-1: 01\nuart-1: Frame error") == (
        b"\xaa\x01",
        ["line 2: Frame error, as the analyser says"],
    )
    rows = "Time [s],Value,Parity Error,Framing Error\n0.1,0xAA,,Error\n0.2,0x01,,Error\n"
    assert read(rows) == (b"\xaa\x01", ["line 2: an error on the wire, as the analyser says"])


SALEAE = "Time [s],Value,Parity Error,Framing Error\n"
LOGIC_2 = "name,type,start_time,duration,data,error\n"


@pytest.mark.parametrize(
    ("heading", "row"),
    [
        (SALEAE, "{0:.15f},0x{1:02X},,\n"),
        (SALEAE, "{0:.15f},{1},,\n"),
        (LOGIC_2, '"Async Serial","data",{0:.7f},2.375e-05,0x{1:02X},\n'),
        (LOGIC_2, '"Async Serial","parity",{0},1e-05,1,\n"Async Serial","data",{0},1e-05,{1},\n'),
        ("Id,Time[ns],1:UART: RX/TX\n", "7,{0:.2f},{1:02X}\n"),
    ],
)
def test_what_analysers_export(heading: str, row: str) -> None:
    rows = "".join(row.format(at * 8.7e-5, byte) for at, byte in enumerate(BYTES))
    assert read(heading + rows)[0] == BYTES
    assert read(heading.replace(",", ", ") + rows.replace("\n", "\r\n"))[0] == BYTES


def test_rows_of_this_program_are_their_bytes() -> None:
    columns = "time,port,offset,length,direction,kind,status,faults,raw"
    text = (
        f'{columns}\n2026-01-31T12:00:00.500000000Z,a,0,10,control,position,ok,"a,b",'
        f"{CONTROL.hex().upper()}\n,a,10,10,,,ok,,{FEEDBACK.hex().upper()}\n"
    )
    log = HexLog.of_stream(io.BytesIO(text.encode()), "f")
    first, second = log
    assert (first.data, second.data) == (CONTROL, FEEDBACK)
    began_ns = (first.t_ns or 0) - 10 * byte_time_ns(DEFAULT_BAUD)
    assert iso_time(began_ns) == "2026-01-31T12:00:00.500000000Z"
    assert second.t_ns is None


NUMBERS = ", ".join(str(byte) for byte in BYTES)
LAYOUT = '{"dim": [{"label": "x", "size": 20, "stride": 20}], "data_offset": 0}'


@pytest.mark.parametrize(
    "text",
    [
        f'{{"data": [{NUMBERS}], "layout": {{"dim": [], "data_offset": 0}}}}',
        f'{{"layout": {LAYOUT}, "data": [{NUMBERS}]}}',
        '{\n  "layout": {\n    "dim": [],\n    "data_offset": 0\n  },\n  "data": [\n    '
        + NUMBERS.replace(", ", ",\n    ")
        + "\n  ]\n}",
        f"layout:\n  dim: []\n  data_offset: 0\ndata: [{NUMBERS}]\n---\n",
        "layout:\n  dim:\n  - label: x\n    size: 20\n    stride: 20\n  data_offset: 0\ndata:\n- "
        + NUMBERS.replace(", ", "\n- ")
        + "\n---\n",
        "".join(
            "layout:\n  dim: []\n  data_offset: 0\ndata:\n"
            + "".join(f"- {byte}\n" for byte in frame)
            + "---\n"
            for frame in (CONTROL, FEEDBACK)
        ),
        f"data: {BYTES!r}\n---\n",
        "std_msgs.msg.UInt8MultiArray(layout=std_msgs.msg.MultiArrayLayout(dim=[], data_offset=0),"
        f" data=array('B', [{NUMBERS}]))",
        f"array('B', [{NUMBERS}])",
        f'{{"type":"Buffer","data":[{NUMBERS.replace(" ", "")}]}}',
    ],
)
def test_messages_and_buffers(text: str) -> None:
    assert read(text)[0] == BYTES


def test_what_wireshark_copies_as_an_escaped_string() -> None:
    assert read(f'"{ESCAPED_A}" \\\n"{ESCAPED_F}"\n') == (BYTES, [])
