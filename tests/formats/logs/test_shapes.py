"""Logs of many lines without a common shape: how many of them are parsed one by one."""

from __future__ import annotations

from io import BytesIO

import pytest

from benchmarks.log_import import SHAPES
from fte_sniff.formats.logs.evidence import EXTRACTORS, Lane, hypotheses
from fte_sniff.formats.logs.layout import Layout
from fte_sniff.formats.logs.reader import LogReader
from tests.formats.logs.layouts import clock
from tests.formats.logs.test_layouts import a_log, frames_of, rows_of


def varied_log(form: str, frames: int) -> tuple[bytes, bytes]:
    """A log with a line of such a form for each frame, and the bytes of the frames."""
    sent = [data for seed in range(40) for own in frames_of(a_log(seed)).values() for data in own]
    sent = [sent[at % len(sent)] for at in range(frames)]
    lines = (SHAPES[form](at, clock(at), data) for at, data in enumerate(sent))
    return "".join(f"{line}\n" for line in lines).encode(), b"".join(sent)


def calls_of(owner: type, name: str, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """A list that grows by one item with each call of a method."""
    calls: list[object] = []
    method = getattr(owner, name)

    def counted(self: object, argument: object) -> object:
        calls.append(argument)
        return method(self, argument)

    monkeypatch.setattr(owner, name, counted)
    return calls


@pytest.mark.parametrize("form", SHAPES)
def test_few_lines_are_parsed_one_by_one(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    content, data = varied_log(form, 8000)
    reader = LogReader("log.txt", None, BytesIO(content))
    assert reader.form.share is not None
    parsed = calls_of(Layout, "read", monkeypatch)
    found = [stream for block in reader.read() for stream in block or ()]
    assert sum(len(stream.data) for stream in found) == len(data)
    assert len(parsed) < 300


def test_a_line_that_begins_with_a_character_is_found_among_many() -> None:
    _, data = varied_log("decimals", 600)
    lines = [f"{chr(b) if 32 < b < 127 and chr(b).isalpha() else f'[{b:02X}]'}," for b in data]
    rows, notes = rows_of("\n".join(lines).encode())
    assert b"".join(row.raw for row in rows) == data, notes


def test_lanes_of_single_numbers_are_chosen_once(monkeypatch: pytest.MonkeyPatch) -> None:
    content, _ = varied_log("decimals, no times", 200)
    compared = calls_of(Lane, "repeats", monkeypatch)
    form = next(one for one in EXTRACTORS if one.name == "decimal, spaces")
    hypotheses(content.splitlines(), [form])
    assert 0 < len(compared) <= 200


@pytest.mark.parametrize("size", [6000, 6001, 6015, 6016])
def test_swapped_words_are_read_to_the_last_byte(size: int) -> None:
    data = varied_log("decimals", 700)[1][:size]
    lines = []
    for at in range(0, size, 16):
        row = data[at : min(at + 16, size)]
        words = (int.from_bytes(row[place : place + 2], "little") for place in range(0, 16, 2))
        lines.append(
            " ".join([f"{at:07x}", *(f"{word:04x}" for word in words)][: 1 + (len(row) + 1) // 2])
        )
    rows, notes = rows_of("\n".join([*lines, f"{size:07x}", ""]).encode())
    assert b"".join(row.raw for row in rows) == data, notes
