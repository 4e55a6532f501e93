"""Where messages begin: the same with an index, without one, and whatever a false one says."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from fte_sniff.recording.mcap.records import HEAD, RecordError
from fte_sniff.recording.messages.index import (
    CHANNEL_PLACE,
    FRONT,
    MESSAGE_HEAD,
    indexed_places,
    message_starts,
)

_LENGTHS = st.sampled_from([0, 1, 32, FRONT - MESSAGE_HEAD - 1, FRONT - MESSAGE_HEAD, 200])
_RECORDS = st.lists(st.one_of(_LENGTHS, st.just(None)), min_size=1, max_size=30)


def _chunk(lengths: list[int | None]) -> tuple[bytes, list[int]]:
    """Messages of these lengths, another record where there is none; and where messages begin."""
    data, places = b"", []
    for number, length in enumerate(lengths):
        if length is None:
            data += HEAD.pack(Opcode.METADATA, 3) + b"abc"
            continue
        places.append(len(data))
        data += HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD - HEAD.size + length)
        data += struct.pack("<HIQQ", number, number, number, number) + bytes([number]) * length
    return data, places


def _index(places: list[int]) -> bytes:
    entries = b"".join(struct.pack("<QQ", 0, place) for place in places)
    return struct.pack("<HI", 1, len(entries)) + entries


@given(_RECORDS, st.randoms())
def test_an_index_changes_nothing_but_the_speed(
    lengths: list[int | None], random: np.random.Generator
) -> None:
    data, places = _chunk(lengths)
    shuffled = sorted(places, key=lambda _: random.random())
    half = len(places) // 2
    indexes = [_index(shuffled[:half]), _index(shuffled[half:])]
    for named in (indexed_places(indexes, len(data)), None):
        found = message_starts(data, named)
        assert found.starts.tolist() == places
        assert found.lengths.tolist() == [length for length in lengths if length is not None]
        assert found.others == [(Opcode.METADATA, b"abc")] * lengths.count(None)
        for start, front in zip(places, found.fronts, strict=True):
            assert front.tobytes() == data[start : start + FRONT].ljust(FRONT, b"\0")
        numbers = [number for number, length in enumerate(lengths) if length is not None]
        assert found.number(CHANNEL_PLACE, "<u2").tolist() == numbers


@given(_RECORDS, st.lists(st.integers(0, 2**64 - 1), max_size=3), st.data())
def test_a_false_index_is_not_believed(
    lengths: list[int | None], far: list[int], data: st.DataObject
) -> None:
    chunk, places = _chunk(lengths)
    near = data.draw(st.lists(st.integers(0, len(chunk)), max_size=5))
    kept = data.draw(st.lists(st.sampled_from(places), max_size=30)) if places else []
    false = [*kept, *near, *far]
    found = message_starts(chunk, indexed_places([_index(false)], len(chunk)))
    assert found.starts.tolist() == places


@pytest.mark.parametrize("body", [b"", b"\1\0\0\0\0", _index([1])[:-1], _index([1]) + b"\0"])
def test_an_index_that_is_none_names_no_places(body: bytes) -> None:
    assert indexed_places([_index([0]), body], 100) is None


@pytest.mark.parametrize("cut", [1, MESSAGE_HEAD, MESSAGE_HEAD + 9])
def test_records_beyond_the_end_are_refused(cut: int) -> None:
    data, places = _chunk([10, 10, 10])
    named = indexed_places([_index(places)], len(data) - cut)
    with pytest.raises(RecordError, match="beyond"):
        message_starts(data[:-cut], named)


def test_a_message_too_short_for_its_head_is_refused() -> None:
    data = HEAD.pack(Opcode.MESSAGE, 5) + b"abcde"
    with pytest.raises(RecordError, match="without its head"):
        message_starts(data, None)
