"""The four properties of the framer, each by itself: each catches what the others miss."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from random import Random

from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import PAYLOADS, draw_frame
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    Chunk,
    Damage,
    Fault,
    Frame,
    Framer,
    Row,
    byte_time_ns,
)
from tests.examples import examples
from tests.protocol.streams import raw_bytes

BYTE_NS = byte_time_ns(DEFAULT_BAUD)
MS = 1_000_000


def rows_of(chunks: Sequence[Chunk]) -> list[Row]:
    framer = Framer("p")
    rows = [row for chunk in chunks for row in framer.feed(chunk)]
    return rows + framer.flush()


@examples(150)
@given(raw_bytes, st.integers(1, 50))
def test_rows_tile_the_stream(data: bytes, size: int) -> None:
    chunks = [Chunk("p", None, data[at : at + size]) for at in range(0, len(data), size)]
    at = 0
    for row in rows_of(chunks):
        assert (row.port, row.offset) == ("p", at)
        assert row.raw
        assert len(row.raw) == FRAME_LENGTH or isinstance(row, Damage)
        assert len(row.raw) <= 1024
        at += len(row.raw)
    assert at == len(data)
    assert b"".join(row.raw for row in rows_of(chunks)) == data


@st.composite
def timed_chunks(draw: st.DrawFn) -> list[Chunk]:
    """Chunks as a line gives them: bursts, pauses, silence, and reads that come late."""
    data = draw(raw_bytes)
    cuts = sorted(draw(st.sets(st.integers(0, max(0, len(data))), max_size=6)) | {0, len(data)})
    chunks: list[Chunk] = []
    now = 10_000 * MS
    timed = draw(st.booleans())
    for start, stop in pairwise(cuts):
        pause = draw(st.sampled_from([0, 0, BYTE_NS, 5 * BYTE_NS, 5 * MS, 25 * MS, 600 * MS]))
        late = draw(st.sampled_from([1.0, 1.0, 0.5]))
        now += pause + int((stop - start) * BYTE_NS * late)
        chunks.append(Chunk("p", now if timed else None, data[start:stop]))
    return chunks


@st.composite
def cut_otherwise(draw: st.DrawFn) -> tuple[list[Chunk], list[Chunk]]:
    """The same bytes at the same times, cut into other chunks, with heartbeats in the silences."""
    chunks = draw(timed_chunks())
    other: list[Chunk] = []
    last: int | None = None
    for chunk in chunks:
        size = len(chunk.data)
        if chunk.t_ns is not None and last is not None:
            began = chunk.t_ns - size * BYTE_NS
            for beat in range(last + 10 * MS, began + 1, 10 * MS):
                other.append(Chunk("p", beat, b""))
        if draw(st.booleans()):
            cuts = sorted(draw(st.sets(st.integers(1, max(1, size - 1)), max_size=4)))
        else:
            cuts = list(range(1, size))
        edges = [0, *(cut for cut in cuts if 0 < cut < size), size]
        for start, stop in pairwise(edges):
            t_ns = None if chunk.t_ns is None else chunk.t_ns - (size - stop) * BYTE_NS
            other.append(Chunk("p", t_ns, chunk.data[start:stop]))
        last = chunk.t_ns if chunk.t_ns is None or last is None else max(last, chunk.t_ns)
    return chunks, other


@examples(150)
@given(cut_otherwise())
def test_cutting_into_other_chunks_gives_the_same_rows(
    cuts: tuple[list[Chunk], list[Chunk]],
) -> None:
    chunks, other = cuts
    assert rows_of(chunks) == rows_of(other)


def calm_frames(seed: int, count: int) -> list[bytes]:
    """Legal frames of ordinary motion that hold no second header and no second tail."""
    random, frames = Random(seed), []
    while len(frames) < count:
        raw = draw_frame(random, PAYLOADS["ordinary"])
        if not any(byte in raw[1:9] for byte in b"\xaa\x55\xee"):
            frames.append(raw)
    return frames


@st.composite
def one_damaged(draw: st.DrawFn) -> tuple[list[bytes], int, bytes]:
    """Whole frames, the number of one of them, and what became of it."""
    frames = calm_frames(draw(st.integers(0, 10_000)), 12)
    number = draw(st.integers(3, 8))
    raw = frames[number]
    count = draw(st.integers(1, 9))
    start = draw(st.integers(0, FRAME_LENGTH - count))
    put_in = draw(st.binary(max_size=min(4, count)).filter(lambda b: 0xEE not in b))
    calm = bytes(byte for byte in put_in if byte not in b"\xaa\x55")
    return frames, number, raw[:start] + calm + raw[start + count :]


@examples(100)
@given(one_damaged())
def test_a_damaged_frame_costs_only_itself(case: tuple[list[bytes], int, bytes]) -> None:
    frames, number, became = case
    stream = b"".join((*frames[:number], became, *frames[number + 1 :]))
    found = [row.raw for row in rows_of([Chunk("p", None, stream)]) if isinstance(row, Frame)]
    for place, raw in enumerate(frames):
        if place != number:
            assert found.count(raw) >= frames.count(raw) - (raw == frames[number])
    assert len(found) in (len(frames) - 1, len(frames))


@examples(100)
@given(st.integers(0, 10_000), st.integers(0, 8), st.binary(min_size=1, max_size=60))
def test_junk_before_a_frame_never_costs_the_frame(seed: int, number: int, junk: bytes) -> None:
    frames = calm_frames(seed, 12)
    before, behind = b"".join(frames[:number]), b"".join(frames[number:])
    rows = rows_of([Chunk("p", None, before + junk + behind)])
    starts = {row.offset for row in rows if isinstance(row, Frame)}
    begins = range(len(before) + len(junk), len(before) + len(junk) + len(behind), FRAME_LENGTH)
    assert set(begins) <= starts


def test_noise_is_cut_at_1024_bytes() -> None:
    rows = rows_of([Chunk("p", None, bytes(3000))])
    assert [(len(row.raw), row.faults) for row in rows] == [
        (1024, (Fault.NOISE,)),
        (1024, (Fault.NOISE,)),
        (952, (Fault.NOISE,)),
    ]
