"""What serial assistants and terminals write around the bytes: one row for each program."""

from __future__ import annotations

import io
import re
from datetime import date

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.log_clock import LogClock
from fte_sniff.formats.logs.pastes import bytes_of_text, logged_bytes
from fte_sniff.formats.logs.text_lines import TextPieces
from fte_sniff.protocol import iso_time

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
