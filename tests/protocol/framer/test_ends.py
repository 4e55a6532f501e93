"""What damaged frames weigh is what the oracle says, which writes out every way to damage one."""

from __future__ import annotations

from math import prod

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import damaged_stream
from fte_sniff.protocol import FRAME_LENGTH, Fault
from fte_sniff.protocol.framer.likelihood import (
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
)
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.framer import inside
from tests.protocol.framer.near_frames import near_frames

some = st.one_of(
    st.sampled_from([0xAA, 0x55, 0xEE, 0, 1, 2, 3, 4, 5, 0x0E, 0x0F, 0x10, 0x7F, 0xFE, 0xFF]),
    st.integers(0, 255),
)
stretches = st.one_of(
    st.lists(some, min_size=1, max_size=40).map(bytes),
    near_frames.map(lambda data: data[:40]),
    st.integers(0, 10_000).map(lambda seed: damaged_stream(seed, 4, 0.9, "hostile")[0][:40]),
).filter(bool)


def _oracles(data: bytes) -> dict[tuple[int, int], float]:
    return {
        (start, piece.stop): piece.weight
        for start in range(len(data))
        for piece in oracle.pieces(data, start)
    }


@examples(150)
@given(stretches)
def test_pieces_weigh_what_the_oracle_says(data: bytes) -> None:
    assert inside.piece_weights(data) == pytest.approx(_oracles(data), rel=1e-9, abs=0)


def _noise(length: int) -> float:
    """What a run of noise weighs, if it is the likelier of short and long."""
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_STAYS ** (length - 1)


def _best(data: bytes) -> float:
    """The weight of these bytes divided into damaged frames and noise, from left to right: at each
    place goes on what weighs most up to there. (Noise goes on as noise only as one run.)"""
    size = len(data)
    best, noisy = [1.0, *[0.0] * size], [False] * (size + 1)

    def reach(stop: int, weight: float, noise: bool) -> None:
        if weight > best[stop]:
            best[stop], noisy[stop] = weight, noise

    for start in range(size):
        for piece in oracle.pieces(data, start):
            if not piece.whole:
                reach(piece.stop, best[start] * piece.weight, False)
        for stop in range(start + 1, size + 1):
            if not noisy[start] and (stop == size or data[stop] in oracle.IS_HEADER):
                reach(stop, best[start] * _noise(stop - start), True)
    return best[size]


@examples(150)
@given(stretches)
def test_what_lies_between_frames_is_divided_as_well_as_can_be(data: bytes) -> None:
    if any(oracle.is_whole(data[at : at + FRAME_LENGTH]) for at in range(len(data))):
        return
    weights = _oracles(data)
    parts = inside.gap_of(data)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == len(data)
    told = prod(
        # What begins with no header, and is not ten bytes, is called noise, though it is a frame.
        max(
            weights.get((part.start, part.stop), 0.0),
            _noise(part.stop - part.start) if part.faults == (Fault.NOISE,) else 0.0,
        )
        for part in parts
    )
    assert told == pytest.approx(_best(data))
