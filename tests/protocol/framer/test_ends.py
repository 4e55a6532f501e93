"""What is remembered of the ends of frames is what would be reckoned anew."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import frame_faults
from fte_sniff.protocol.framer.choice import chosen
from fte_sniff.protocol.framer.ends import CANONICAL, back_of, between, front_of
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.weighing import Ending, Weighing, joined, trusted
from fte_sniff.protocol.structure import HEADER_BYTES, LONGEST_OVERLONG

some = st.one_of(
    st.sampled_from([0xAA, 0x55, 0xEE, 0, 1, 2, 3, 4, 5, 0x0E, 0x0F, 0x10, 0x7F, 0xFE, 0xFF]),
    st.integers(0, 255),
)


@given(st.sampled_from([0xAA, 0x55]), st.lists(some, max_size=9))
def test_a_front_weighs_what_its_canonical_bytes_weigh(header: int, behind: list[int]) -> None:
    own = bytes([header, *behind])
    reckon = front_of.__wrapped__
    assert reckon(own) == reckon(own.translate(CANONICAL)) == front_of(own.translate(CANONICAL))


@given(st.lists(some, max_size=9))
def test_a_back_weighs_what_its_canonical_bytes_weigh(before: list[int]) -> None:
    own = bytes([*before, 0xEE])
    reckon = back_of.__wrapped__
    for back in (reckon(own.translate(CANONICAL)), back_of(own.translate(CANONICAL))):
        assert back.rests == reckon(own).rests
        assert back.headless == reckon(own).headless
        for header in HEADER_BYTES:
            front = front_of(bytes([header]))
            for length in range(2, LONGEST_OVERLONG + 1):
                assert between(front, back, length) == between(front, reckon(own), length)


@given(st.lists(some, min_size=1, max_size=64), st.booleans())
def test_a_stretch_is_read_as_its_canonical_bytes_are(values: list[int], begins: bool) -> None:
    data = bytes(values)
    carry = joined() if begins else trusted()
    first, second = (
        chosen(Weighing(Window(raw), carry, Ending.CLOSED))
        for raw in (data, data.translate(CANONICAL))
    )
    assert first == second


@given(st.lists(some, min_size=8, max_size=8))
def test_canonical_bytes_show_the_same_faults(inside: list[int]) -> None:
    raw = bytes([0x55, *inside, 0xEE])
    assert frame_faults(raw) == frame_faults(raw.translate(CANONICAL))


def test_what_is_remembered_is_bounded() -> None:
    for remembered in (front_of, back_of):
        limit = remembered.cache_info().maxsize
        assert limit is not None
        assert limit <= 1 << 14
