"""The dump of the stream around a row."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import Damage, Fault, Frame, Row
from fte_sniff.tui.panes.bytes import dump, neighbours
from fte_sniff.tui.table.theme import DARK

FRAME = bytes.fromhex("AA010103E800000000EE")


def _rows(lengths: list[int], ports: str = "p") -> list[Row]:
    rows: list[Row] = []
    offsets = dict.fromkeys(ports, 0)
    for number, length in enumerate(lengths):
        port = ports[number % len(ports)]
        at = offsets[port]
        offsets[port] += length
        if length == 10:
            rows.append(Frame(port, at, FRAME, None))
        else:
            raw = bytes((at + n) % 256 for n in range(length))
            rows.append(Damage(port, at, raw, None, (Fault.NOISE,)))
    return rows


def _store(rows: list[Row]) -> RowStore:
    store = RowStore(10_000, 16)
    store.append(rows)
    return store


LENGTHS = st.lists(st.sampled_from([1, 3, 10, 10, 10, 40]), min_size=1, max_size=80)


@given(LENGTHS, st.data(), st.sampled_from(["p", "pq"]), st.sampled_from([38, 50, 79, 150]))
def test_the_bytes_around_a_row_stand_at_their_offsets(
    lengths: list[int], data: st.DataObject, ports: str, width: int
) -> None:
    rows = _rows(lengths, ports)
    index = data.draw(st.integers(0, len(rows) - 1))
    row = rows[index]
    stream = b"".join(other.raw for other in rows if other.port == row.port)
    near = neighbours(_store(rows), index, 200)
    assert b"".join(other.raw for other in near) in stream
    assert near[0].offset <= max(0, row.offset - 200)
    text = dump(row, near, width, DARK).plain
    abreast = {38: 8, 50: 8, 79: 16, 150: 32}[width]
    own, inside = bytearray(), False
    for line in text.split("\n"):
        assert len(line) <= width
        start, signs = int(line[:12].replace(",", "")), line[13 : 13 + 3 * abreast + 1]
        for place in range(abreast):
            sign, digits = signs[3 * place], signs[3 * place + 1 : 3 * place + 3]
            inside = sign == "[" or (inside and sign != "]")
            if digits != "··":
                assert int(digits, 16) == stream[start + place]
                own += bytes([int(digits, 16)] if inside else [])
        inside = inside and signs[-1] != "]"
    assert bytes(own) == row.raw


def test_the_row_is_held_by_brackets_and_others_begin_with_a_bar() -> None:
    rows = _rows([10, 10, 10])
    lines = dump(rows[1], rows, 79, DARK).plain.split("\n")
    assert lines[0].startswith("           0 |AA 01 01 03 E8 00 00 00 00 EE[AA 01 01 03 E8 00 ")
    assert lines[1].startswith("          16  00 00 00 EE]AA 01")
    assert lines[0].endswith("................")


@pytest.mark.parametrize("width", [50, 79, 150])
@pytest.mark.parametrize("at", range(8))
def test_each_bracket_stands_once(at: int, width: int) -> None:
    rows = _rows([6, 10, 10, 10, 10, 10, 10, 10])
    drawn = dump(rows[at], rows, width, DARK).plain
    end = 13 + 3 * {50: 8, 79: 16, 150: 32}[width] + 1
    signs = "".join(line[:end] for line in drawn.split("\n"))
    assert (signs.count("["), signs.count("]")) == (1, 1)


def test_what_the_store_does_not_have_is_dots() -> None:
    rows = _rows([10] * 30)
    del rows[3:9]
    text = dump(rows[3], rows, 79, DARK).plain
    assert re.search(r"··(·|\s)+··\[AA", text)


def test_rows_of_other_ports_are_no_neighbours() -> None:
    rows = _rows([10] * 40, "pq")
    near = neighbours(_store(rows), 20, 30)
    assert {row.port for row in near} == {"p"}
    assert len(near) == 7


def test_a_row_that_left_has_no_neighbours() -> None:
    store = RowStore(5, 2)
    store.append(_rows([10] * 9))
    with pytest.raises(IndexError):
        neighbours(store, 2, 100)
    assert neighbours(store, 5, 100)[0].offset == 40
