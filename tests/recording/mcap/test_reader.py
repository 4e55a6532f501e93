"""Where messages begin: the same with an index, without one, and whatever a false one says."""

import struct
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.recording.mcap.reader import (
    CHANNEL_OFFSET,
    HEAD,
    MESSAGE_HEAD,
    PREFIX,
    RecordError,
    RunningChecksum,
    index_messages,
    indexed_starts,
)

MOST = 1000
"""Records of a chunk, at most."""
_LENGTHS = st.sampled_from([0, 1, 32, PREFIX - MESSAGE_HEAD - 1, PREFIX - MESSAGE_HEAD, 200])
_RECORDS = st.lists(st.one_of(_LENGTHS, st.just(None)), min_size=1, max_size=30)


def _chunk(lengths: list[int | None]) -> tuple[bytes, list[int]]:
    """Messages of these lengths, another record where there is none; and where messages begin."""
    data, starts = b"", []
    for number, length in enumerate(lengths):
        if length is None:
            data += HEAD.pack(Opcode.SCHEMA, 3) + b"abc"
            continue
        starts.append(len(data))
        data += HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD - HEAD.size + length)
        data += struct.pack("<HIQQ", number, number, number, number) + bytes([number]) * length
    return data, starts


def _index(starts: list[int]) -> bytes:
    entries = b"".join(struct.pack("<QQ", 0, start) for start in starts)
    return struct.pack("<HI", 1, len(entries)) + entries


@given(_RECORDS, st.randoms())
def test_an_index_changes_nothing_but_the_speed(
    lengths: list[int | None], random: np.random.Generator
) -> None:
    data, starts = _chunk(lengths)
    shuffled = sorted(starts, key=lambda _: random.random())
    half = len(starts) // 2
    indexes = [_index(shuffled[:half]), _index(shuffled[half:])]
    for named in (indexed_starts(indexes, len(data)), None):
        found = index_messages(data, named, MOST)
        assert found.starts.tolist() == starts
        assert found.lengths.tolist() == [length for length in lengths if length is not None]
        assert found.definitions == [(Opcode.SCHEMA, b"abc")] * lengths.count(None)
        for start, prefix in zip(starts, found.prefixes, strict=True):
            assert prefix.tobytes() == data[start : start + PREFIX].ljust(PREFIX, b"\0")
        numbers = [number for number, length in enumerate(lengths) if length is not None]
        assert found.field(CHANNEL_OFFSET, "<u2").tolist() == numbers


@given(_RECORDS)
def test_a_right_index_is_used(lengths: list[int | None]) -> None:
    """Only the records between its messages are walked over, from where the last message ends."""
    data, starts = _chunk(lengths)
    named = indexed_starts([_index(starts)], len(data))
    found = index_messages(data, named, MOST)
    assert named is None or found.starts is named


@given(_RECORDS, st.lists(st.integers(0, 2**64 - 1), max_size=3), st.data())
def test_a_wrong_index_is_ignored(
    lengths: list[int | None], far: list[int], data: st.DataObject
) -> None:
    chunk, starts = _chunk(lengths)
    near = data.draw(st.lists(st.integers(0, len(chunk)), max_size=5))
    kept = data.draw(st.lists(st.sampled_from(starts), max_size=30)) if starts else []
    false = [*kept, *near, *far]
    found = index_messages(chunk, indexed_starts([_index(false)], len(chunk)), MOST)
    assert found.starts.tolist() == starts


@pytest.mark.parametrize("body", [b"", b"\1\0\0\0\0", _index([1])[:-1], _index([1]) + b"\0"])
def test_an_invalid_index_has_no_starts(body: bytes) -> None:
    assert indexed_starts([_index([0]), body], 100) is None


@pytest.mark.parametrize("cut", [1, MESSAGE_HEAD, MESSAGE_HEAD + 9])
def test_records_beyond_the_end_are_an_error(cut: int) -> None:
    data, starts = _chunk([10, 10, 10])
    named = indexed_starts([_index(starts)], len(data) - cut)
    with pytest.raises(RecordError, match="beyond"):
        index_messages(data[:-cut], named, MOST)


def test_a_message_too_short_for_its_head_costs_only_itself() -> None:
    data, starts = _chunk([10, 10])
    short = HEAD.pack(Opcode.MESSAGE, 5) + b"abcde"
    found = index_messages(data + short, None, MOST)
    assert (found.starts.tolist(), found.without_head) == (starts, 1)


@pytest.mark.parametrize("opcode", [Opcode.MESSAGE, Opcode.METADATA, 0x80])
def test_more_records_than_allowed_are_an_error(opcode: int) -> None:
    data = HEAD.pack(opcode, 0) * 10
    assert len(index_messages(data, None, 10)) == 0
    with pytest.raises(RecordError, match="more records"):
        index_messages(data, None, 9)


def test_bytes_of_opcode_zero_are_not_a_record() -> None:
    with pytest.raises(RecordError, match="no MCAP record"):
        index_messages(bytes(9), None, MOST)


@given(st.lists(st.sampled_from([0, 1, 9, 60_000, 64 * 1024, 70_000]), max_size=30), st.data())
def test_the_running_checksum_is_that_of_all_pieces(sizes: list[int], data: st.DataObject) -> None:
    running, whole = RunningChecksum(), b""
    for number, size in enumerate(sizes):
        piece = bytes([number]) * size
        running.update(piece)
        whole += piece
        if data.draw(st.booleans()):
            assert running.value() == crc32(whole)
    assert running.value() == crc32(whole)
