"""What is read up to a frame beyond doubt is read as if it were weighed with all that follows."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import damaged_stream
from tests.examples import examples
from tests.protocol.framer.firm_frames import firm
from tests.protocol.framer.inside import (
    BOUNDARY,
    OPEN,
    doubtless_from,
    read_alone,
    reading_of,
    trusted,
    whole_frames,
)

imitating = st.sampled_from([0xAA, 0x55, 0xEE, 0x00, 0x01, 0x02, 0x03, 0x0F, 0x77])
stretches = st.one_of(
    st.binary(min_size=1, max_size=30),
    st.lists(imitating, min_size=1, max_size=30).map(bytes),
    st.builds(
        lambda seed, cut: damaged_stream(seed, 4, 0.9, "hostile")[0][cut : cut + 30],
        st.integers(0, 10_000),
        st.integers(0, 8),
    ).filter(bool),
)


@examples(400)
@given(stretches, st.integers(0, 10_000), st.booleans())
def test_a_stretch_read_by_itself_is_read_as_with_the_frame_behind_it(
    stretch: bytes, seed: int, calm: bool
) -> None:
    data = stretch + firm(seed)[:10]
    parts = read_alone(data, len(stretch), calm=calm)
    if parts is None:
        return
    reading = reading_of(data, trusted(), BOUNDARY, before_frame=True, calm=calm)
    assert reading.pop().certain
    assert parts == reading


@examples(400)
@given(stretches, st.integers(0, 10_000), st.binary(max_size=10))
def test_nothing_behind_a_frame_beyond_doubt_tells_more_of_what_is_before_it(
    stretch: bytes, seed: int, behind: bytes
) -> None:
    data = stretch + firm(seed)
    start = doubtless_from(data, 0, len(data))
    assert start >= 0
    upto = whole_frames(data[: start + 10], trusted(), BOUNDARY)
    if upto[start] < 0.9995:
        return
    whole = whole_frames(data + behind, trusted(), OPEN)
    assert whole[start] > 0.999
    for place, probability in upto.items():
        assert whole[place] == pytest.approx(probability, abs=1e-3)
