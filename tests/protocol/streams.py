"""Streams for property tests: damaged, imitating, repeating, random."""

from __future__ import annotations

from hypothesis import strategies as st

from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Row
from tests.support.faults import PAYLOADS, damaged_stream


def rows_of(stream: bytes, size: int | None = None) -> list[Row]:
    """The rows of a stream that comes at once, or in chunks of this size."""
    framer, step = Framer("p"), size or max(1, len(stream))
    rows = list[Row]()
    for at in range(0, len(stream), step):
        framer.push(Chunk("p", None, stream[at : at + step]))
        rows += framer.drain()
    return rows + list(framer.finish())


imitating = st.sampled_from([0xAA, 0x55, 0xEE, 0x00, 0x01, 0x02, 0x03, 0x0F])
raw_bytes = st.one_of(
    st.binary(max_size=200),
    st.lists(imitating, max_size=200).map(bytes),
    st.builds(
        lambda seed, share, payload: damaged_stream(seed, 25, share, payload)[0],
        st.integers(0, 10_000),
        st.sampled_from([0.05, 0.2, 0.5, 1.0]),
        st.sampled_from(sorted(PAYLOADS)),
    ),
    st.builds(
        lambda before, framed, after: bytes(before) + b"\x55" + framed + b"\xee" + bytes(after),
        st.integers(0, 200),
        st.lists(imitating, min_size=8, max_size=28).map(bytes),
        st.integers(0, 60),
    ),
    st.builds(lambda unit, times: unit * times, st.binary(min_size=1, max_size=12), st.just(40)),
)
