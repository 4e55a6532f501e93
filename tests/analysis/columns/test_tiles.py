"""What the framer has decided, piece by piece, side by side: the rows that it gives elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.faults import damaged_stream
from fte_sniff.protocol import Chunk, Framer, Row
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.row_batch import PackedRows, packed_tiles
from tests.protocol.streams import raw_bytes

TIMES = st.none() | st.integers(0, 2**62) | st.integers(10**18, 10**18 + 10**9)


def pieces(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    """The data cut into pieces of these sizes, again and again."""
    found: list[bytes] = []
    at = turn = 0
    while at < len(data):
        size = sizes[turn % len(sizes)]
        found.append(data[at : at + size])
        at, turn = at + size, turn + 1
    return found


def one_by_one(chunks: Sequence[Chunk]) -> list[Row]:
    framer = Framer("p")
    fed = [framer.feed(chunk) for chunk in chunks]
    return [row for rows in fed for row in rows] + framer.flush()


def kept(chunks: Sequence[Chunk], taken_after: int) -> list[DecidedSpan]:
    """The same in portions, each taken after so many chunks."""
    framer, found = Framer("p"), []
    for count, chunk in enumerate(chunks):
        framer.push(chunk)
        if count % taken_after == 0:
            found.append(framer.drain())
    framer.finish()
    return [*found, framer.drain()]


def told(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """All that rows tell, also what does not make them unequal."""
    return [(type(row), row, row.read_delay_ns, row.order_uncertain) for row in rows]


def check(chunks: Sequence[Chunk], taken_after: int) -> None:
    expected = told(one_by_one(chunks))
    portions = kept(chunks, taken_after)
    assert told([row for portion in portions for row in portion.rows()]) == expected
    packed = [packed_tiles(portion) for portion in portions]
    assert [len(portion) for portion in portions] == [len(rows) for rows in packed]
    assert told([row for rows in packed for row in rows]) == expected
    assert told(list(PackedRows.concat(packed))) == expected


@settings(deadline=None)
@given(raw_bytes, st.lists(st.integers(1, 120), min_size=1, max_size=4), st.integers(1, 5))
def test_pieces_give_the_rows(data: bytes, sizes: list[int], taken_after: int) -> None:
    check([Chunk("p", None, piece) for piece in pieces(data, sizes)], taken_after)


@settings(deadline=None)
@given(
    raw_bytes,
    st.lists(st.integers(1, 60), min_size=1, max_size=4),
    st.lists(TIMES, min_size=1, max_size=20),
    st.integers(1, 5),
)
def test_and_their_times(
    data: bytes, sizes: list[int], times: list[int | None], taken_after: int
) -> None:
    cut = pieces(data, sizes)
    chunks = [Chunk("p", times[at % len(times)], piece) for at, piece in enumerate(cut)]
    check(chunks, taken_after)


@pytest.mark.parametrize("size", [1 << 12, 99_991, 1 << 20])
@pytest.mark.parametrize(
    ("share", "payload"), [(0.0, "ordinary"), (0.001, "ordinary"), (0.2, "hostile")]
)
def test_large_pieces_give_the_rows(size: int, share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 20_000 if share < 0.1 else 2000, share, payload)
    check([Chunk("p", None, piece) for piece in pieces(stream, [size])], 1)


def test_noise_goes_on_from_piece_to_piece() -> None:
    noise = Random(1).randbytes(10_000)
    check([Chunk("p", None, piece) for piece in pieces(noise, [7, 4000])], 1)


def test_nothing_decided_is_no_rows() -> None:
    framer = Framer("p")
    assert list(packed_tiles(framer.drain())) == framer.drain().rows() == []
