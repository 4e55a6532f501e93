"""Words beside whole frames are passed over and told; what may be a mistyped byte is refused."""

from __future__ import annotations

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.pastes import bytes_of_text

A = "AA 01 01 00 64 00 00 00 00 EE"
F = "55 01 01 00 64 00 00 00 0F EE"
BYTES = bytes.fromhex(A + F)


def read(text: str) -> tuple[bytes, list[str]]:
    told: list[str] = []
    return bytes_of_text(text, told.append), told


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{A} 收到 {F}", "收到"),
        (f"{A}，收到：{F}", "收到"),
        (f"{A}收到{F}", "收到"),
        (f"{A} 收到了 {F} 回复", "收到了 回复"),
        (f"{A} answer: {F}", "answer"),
        (f"电机: {A} 答复 {F}", "电机 答复"),
        (f"{A} ответ {F}", "ответ"),
        (f"0x{A.replace(' ', ' 0x')} 收到 0x{F.replace(' ', ', 0x')}", "收到"),
    ],
)
def test_words_beside_frames_are_no_bytes_and_told(text: str, words: str) -> None:
    data, told = read(text)
    assert data == BYTES
    assert told == [f"line 1: {words!r} beside frames is no hex, and is left out"]


def test_of_many_lines_the_first_is_told_and_how_many_more() -> None:
    data, told = read(f"{A} 收到 {F}\n" * 1500)
    assert data == BYTES * 1500
    assert told == [
        "line 1: '收到' beside frames is no hex, and is left out, as words on 1,499 more lines are"
    ]


@pytest.mark.parametrize(
    "text",
    [
        f"{A[:-2]}收到 {F}",
        f"{A} 收到 01 01 00 64 00 00 00 0F EE",
        f"{A} SS 01 01 00 64 00 00 00 0F EE",
        "AA OI 01 00 64 00 00 00 00 EE",
        "AA 01 01 00 64 00 00 00 OO EE",
        "AA 01 01 00 64 00 00 00 00 Ee 5S",
        f"{A} 收到 10 字节 {F}",
        "停止",
        f"{A} GG",
        f"{A} OFF0 {F}",
        "nothing here",
    ],
)
def test_what_may_be_a_mistyped_byte_is_refused(text: str) -> None:
    with pytest.raises(InputTextError) as caught:
        read(text)
    assert "not hex: " in str(caught.value)
