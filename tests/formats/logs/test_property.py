"""One property: frames written in any form, with any label, time, encoding and foreign lines."""

from __future__ import annotations

import random
from base64 import b64encode
from collections.abc import Callable
from typing import NamedTuple

from hypothesis import example, given
from hypothesis import strategies as st

from tests.examples import examples
from tests.formats.logs.layouts import Sent, clock, escaped
from tests.formats.logs.test_layouts import FOREIGN, a_log, found_in, frames_of, rows_of

Writer = Callable[[bytes], str]


def _each(form: str, separator: str = " ") -> Writer:
    return lambda data: separator.join(form.format(byte) for byte in data)


PAIRS = {
    f"pairs {name}": _each(form, separator)
    for form in ("{:02X}", "{:02x}")
    for name, separator in {
        f"{form} {separator!r}": separator
        for separator in (" ", "  ", "\t", ",", ", ", ":", "-", ";", "|", " | ", "_", "/", ".")
    }.items()
}
MARKED = {
    f"{form} {separator!r}": _each(form, separator)
    for form in ("0x{:02X}", "0x{:02x}", "0x{:x}", "${:02X}", "%{:02X}", "&H{:02X}", "16#{:02X}#")
    for separator in (" ", ",", ", ", "; ")
}
OTHERS: dict[str, Writer] = {
    "digits": bytes.hex,
    "DIGITS": lambda data: data.hex().upper(),
    "0x and digits": lambda data: f"0x{data.hex()}",
    "\\x": _each("\\x{:02x}", ""),
    "\\": _each("\\{:02X}", ""),
    "h": _each("{:02X}h"),
    "unpadded": _each("{:x}"),
    "brackets": _each("[{:02X}]", ""),
    "angles": _each("<{:02x}>", ""),
    "braces": _each("{{{:02X}}}", ""),
    "parentheses": _each("({:02X})"),
    "quotes": _each('"0x{:02x}"', ", "),
    "decimal": _each("{}"),
    "decimal, commas": _each("{}", ", "),
    "padded decimal": _each("{:3d}"),
    "signed": lambda data: ", ".join(str(b - 256 if b > 127 else b) for b in data),
    "octal": _each("{:03o}"),
    "binary": _each("{:08b}"),
    "repr": repr,
    "C string": lambda data: f'"{escaped(data)}"',
    "octal escapes": lambda data: '"' + "".join(f"\\{byte:03o}" for byte in data) + '"',
    "base64": lambda data: b64encode(data).decode(),
    "JSON": lambda data: f"[{','.join(map(str, data))}]",
}
FORMS = PAIRS | MARKED | OTHERS


class Words(NamedTuple):
    """The words for the two directions of a line."""

    tx: str
    rx: str


WORDS = [
    Words(*words.split("/"))
    for words in (
        "TX/RX", "tx/rx", "send/recv", "Sent/Received", "WRITE/READ", "out/in", "发送/接收",
        "发/收", "→/←", "-->/<--", ">>/<<", "host/device", "host/controller", "request/response",
        "onWrite/onRead", "COM3/COM4", "ttyUSB0/ttyUSB1",
    )
]  # fmt: skip
PREFIXES = (
    "{time} {word}: ", "[{time}] {word} ", "[{time}][{word}] ", "{word} {time} ", "{time},{word},",
    "{time}\t{word}\t", "{word}: ", "{word} ", "#{n} {time} {word} ", "{time} {word} len={size} ",
    "{time} {word}[{size}]: ", "D/Serial({n}): {word} {time} ", "{time} | {word} | ",
    "time={time} dir={word} data=", "{n:06d} {word} {time} ", "<{time} {word}> ",
)  # fmt: skip
TIMES: dict[str, Callable[[int], str]] = {
    "ms": clock,
    "ISO": lambda ms: f"2026-01-31T{clock(ms)}",
    "ISO Z": lambda ms: f"2026-01-31T{clock(ms)}Z",
    "seconds": lambda ms: f"2026-01-31 {clock(ms, 0)}",
    "month": lambda ms: f"Jan 31 {clock(ms)}",
    "day first": lambda ms: f"31/01/2026 {clock(ms)}",
    "year first": lambda ms: f"2026/01/31 {clock(ms)}",
    "comma": lambda ms: clock(ms).replace(".", ","),
    "epoch": lambda ms: f"{1_769_817_600 + ms / 1000:.3f}",
    "none": lambda ms: "",
}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "gb18030", "latin-1", "crlf", "nul", "colour")


def encoded(lines: list[str], encoding: str) -> bytes:
    """The lines as a file."""
    text = "".join(f"{line}\n" for line in lines)
    if encoding == "crlf":
        return text.replace("\n", "\r\n").encode()
    if encoding == "nul":
        return text.encode().replace(b"\n", b"\0\n")
    if encoding == "colour":
        return "".join(f"\x1b[32m{line}\x1b[0m\n" for line in lines).encode()
    return text.encode(encoding, "replace")


@given(
    st.sampled_from(sorted(FORMS)),
    st.sampled_from(WORDS),
    st.sampled_from(PREFIXES),
    st.sampled_from(sorted(TIMES)),
    st.sampled_from(ENCODINGS),
    st.integers(0, 10**6),
    st.lists(st.sampled_from([*FOREIGN, "über 5 µs", "电机 2 停止"]), max_size=80),
)
@example("0x and digits", WORDS[0], "{time} {word} ", "ms", "utf-8", 0, ["0x3ffb4280"])
@examples(60)
def test_frames_come_back_exactly(
    form: str, words: Words, prefix: str, time: str, encoding: str, seed: int, foreign: list[str]
) -> None:
    if encoding == "latin-1" and not f"{words.tx}{words.rx}".isascii():
        words = WORDS[0]
    log = a_log(seed)
    lines = [line_of(n, sent, form, words, prefix, time) for n, sent in enumerate(log)]
    rng = random.Random(seed)
    for text in foreign:
        lines.insert(rng.randint(0, len(lines)), text)
    rows, notes = rows_of(encoded(lines, encoding))
    assert found_in(rows) == frames_of(log), notes
    assert sum(len(row.raw) for row in rows) == sum(len(sent.data) for sent in log)
    assert any("no bytes" in note for note in notes) == any(foreign)
    if time == "none" or "{time}" not in prefix:
        assert not any(row.t_ns for row in rows)
        return
    resolution_ns = 10**9 if time == "seconds" else 10**6
    stamps = {"tx": starts(log, "tx"), "rx": starts(log, "rx")}
    for row in rows:
        assert row.framed
        ms = stamps["tx" if row.raw[0] == 0xAA else "rx"].pop(0)
        expected, day_ns = ms * 10**6, 86_400 * 10**9
        assert row.t_ns is not None, notes
        early = (expected - row.t_ns) % day_ns
        assert early <= resolution_ns + 10**6 or early >= day_ns - resolution_ns, notes


def line_of(n: int, sent: Sent, form: str, words: Words, prefix: str, time: str) -> str:
    """A line of the log."""
    word, size = getattr(words, sent.way), len(sent.data)
    begin = prefix.format(time=TIMES[time](sent.ms), word=word, n=n, size=size)
    return begin + FORMS[form](sent.data)


def starts(log: list[Sent], way: str) -> list[int]:
    """When the first byte of each frame of a direction arrived, in milliseconds."""
    times = [sent.ms for sent in log if sent.way == way for _ in sent.data]
    return times[::10]
