"""Logs of many lines without a common shape: how many of them are parsed one by one."""

from __future__ import annotations

import random
from base64 import b64encode
from collections.abc import Callable
from io import BytesIO
from string import ascii_lowercase

import pytest

from fte_sniff.formats.log_reader import LogReader
from fte_sniff.formats.logs.evidence import Lane, hypotheses
from fte_sniff.formats.logs.forms import EXTRACTORS
from fte_sniff.formats.logs.layout import Layout
from tests.formats.logs.layouts import clock
from tests.formats.logs.test_layouts import a_log, frames_of, rows_of

RANDOM = random.Random(7)
NAMES = ["".join(RANDOM.choices(ascii_lowercase, k=RANDOM.randint(3, 9))) for _ in range(500)]
VARIED: dict[str, Callable[[int, str, bytes], str]] = {
    "decimals": lambda at, t, data: f"{t} [{', '.join(map(str, data))}]",
    "decimals, no times": lambda at, t, data: ", ".join(map(str, data)),
    "JSON": lambda at, t, data: f'{{"t":{1_700_000_000_000 + at},"data":{[*data]}}}',
    "Python repr": lambda at, t, data: f"{t} {'TX' if data[0] == 0xAA else 'RX'} {data!r}",
    "unpadded": lambda at, t, data: f"{at}: {' '.join(f'{byte:X}' for byte in data)}",
    "characters": lambda at, t, data: (
        f"{t} " + "".join(chr(b) if 32 < b < 127 else f"[{b:02X}]" for b in data)
    ),
    "base64": lambda at, t, data: f'{{"n":{at},"data":"{b64encode(data).decode()}"}}',
    "foreign lines with numbers": lambda at, t, data: (
        f"{t} [{NAMES[at * 7 % 500]}] RX: {data.hex(' ')}\n"
        f"{t} [{NAMES[at * 11 % 500]}] {NAMES[at % 500]} took {at * 13 % 977} us"
    ),
}


def varied_log(form: str, frames: int) -> tuple[bytes, bytes]:
    """A log with a line of such a form for each frame, and the bytes of the frames."""
    sent = [data for seed in range(40) for own in frames_of(a_log(seed)).values() for data in own]
    sent = [sent[at % len(sent)] for at in range(frames)]
    lines = (VARIED[form](at, clock(at), data) for at, data in enumerate(sent))
    return "".join(f"{line}\n" for line in lines).encode(), b"".join(sent)


@pytest.mark.parametrize("form", VARIED)
def test_few_lines_are_parsed_one_by_one(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = 0
    read = Layout.read

    def counted(self: Layout, line: bytes) -> object:
        nonlocal parsed
        parsed += 1
        return read(self, line)

    content, data = varied_log(form, 8000)
    reader = LogReader("log.txt", None, BytesIO(content))
    assert reader.form.share is not None
    monkeypatch.setattr(Layout, "read", counted)
    found = [stream for block in reader.read() for stream in block or ()]
    assert sum(len(stream.data) for stream in found) == len(data)
    assert parsed < 300


def test_a_line_that_begins_with_a_character_is_found_among_many() -> None:
    _, data = varied_log("decimals", 600)
    lines = [f"{chr(b) if 32 < b < 127 and chr(b).isalpha() else f'[{b:02X}]'}," for b in data]
    rows, notes = rows_of("\n".join(lines).encode())
    assert b"".join(row.raw for row in rows) == data, notes


def test_lanes_of_single_numbers_are_chosen_once(monkeypatch: pytest.MonkeyPatch) -> None:
    content, _ = varied_log("decimals, no times", 200)
    compared = 0
    repeats = Lane.repeats

    def counted(self: Lane, other: Lane) -> bool:
        nonlocal compared
        compared += 1
        return repeats(self, other)

    monkeypatch.setattr(Lane, "repeats", counted)
    form = next(one for one in EXTRACTORS if one.name == "decimal, spaces")
    hypotheses(content.splitlines(), [form])
    assert 0 < compared <= 200
