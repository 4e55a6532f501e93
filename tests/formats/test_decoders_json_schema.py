"""The JSON Schema accepts every JSON line that the program writes, and no others."""

from __future__ import annotations

import io
import json
from typing import Any

import pytest
from hypothesis import given
from jsonschema import Draft202012Validator

from fte_sniff.formats.decoders import json_schema
from fte_sniff.formats.writers import JsonlWriter
from fte_sniff.protocol import COLUMNS, DEFAULT_BAUD, KINDS, Chunk, Framer, Row, Rows, encode
from fte_sniff.protocol.dissect import WHY, with_readings
from tests.protocol.streams import raw_bytes
from tests.recording.conftest import some_rows

VALIDATOR = Draft202012Validator(json.loads(json_schema()))


def lines(rows: list[Row]) -> list[dict[str, Any]]:
    stream = io.StringIO()
    JsonlWriter(stream).write(rows)
    return [json.loads(line) for line in stream.getvalue().splitlines()]


def test_schema_is_valid_and_lists_the_columns_in_order() -> None:
    Draft202012Validator.check_schema(json.loads(json_schema()))
    columns = [column.name for column in COLUMNS]
    assert [*json.loads(json_schema())["properties"]] == [*columns, WHY]
    assert json.loads(json_schema())["required"] == columns


@given(raw_bytes)
def test_every_row_of_any_stream_is_valid(data: bytes) -> None:
    framer = Framer("p", DEFAULT_BAUD)
    rows = [*framer.feed(Chunk("p", None, data)), *framer.flush()]
    explained = [row for batch in with_readings([Rows.from_rows(rows)]) for row in batch]
    for line in lines(explained):
        VALIDATOR.validate(line)


@pytest.mark.parametrize(
    "changed",
    [
        {"motor": None},
        {"motor": 256},
        {"rpm": 32_768},
        {"rpm": -32_769},
        {"rpm": 1.5},
        {"pulses": 1},
        {"direction": "feedback"},
        {"cmd": 2},
        {"kind": None},
        {"kind": "spead"},
        {"status": "suspect"},
        {"faults": ["bad_motor"]},
        {"faults": ["wrong"]},
        {"raw": "aa"},
        {"raw": "A"},
        {"time": 1},
        {"more": 1},
    ],
)
def test_row_that_the_program_never_writes_is_invalid(changed: dict[str, Any]) -> None:
    (line,) = lines([row for row in some_rows(6) if row.raw[:2] == b"\xaa\x01"][:1])
    assert all(VALIDATOR.is_valid(line | {"rpm": rpm}) for rpm in (-32_768, 0, 32_767))
    assert not VALIDATOR.is_valid(line | changed)
    assert not VALIDATOR.is_valid({name: line[name] for name in [*line][1:]})


def test_every_kind_of_frame_is_valid_at_the_ends_of_its_ranges() -> None:
    for kind in KINDS:
        for end in ("low", "high"):
            raw = encode(kind, {field.name: getattr(field, end) for field in kind.fields})
            framer = Framer("p", DEFAULT_BAUD)
            rows = [*framer.feed(Chunk("p", None, raw * 3)), *framer.flush()]
            assert {line["kind"] for line in lines(rows)} == {kind.name}
            assert all(map(VALIDATOR.is_valid, lines(rows)))
