"""A stream that is cut: what stands before it and what comes behind never join."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import Chunk, Fault, Framer, byte_time_ns

FRAME = bytes.fromhex("AA010103E800000000EE")
MS = 1_000_000

streams = st.lists(
    st.sampled_from([FRAME, FRAME[:4], FRAME[4:], b"\xaa", b"\xee", b"\x00\x17", b"\x55\x01"])
).map(b"".join)


def test_a_frame_that_was_cut_off_does_not_join_what_comes_behind() -> None:
    framer = Framer("p")
    before = framer.feed(Chunk("p", 100 * MS, FRAME * 5 + FRAME[:6])) + framer.cut()
    # The other four bytes, at once: together they would be a frame.
    behind = framer.feed(Chunk("p", 101 * MS, FRAME[6:] + FRAME * 3)) + framer.flush()
    assert [row.raw for row in before] == [FRAME] * 5 + [FRAME[:6]]
    assert before[-1].faults == (Fault.TRUNCATED,)
    assert [row.raw for row in behind] == [FRAME[6:]] + [FRAME] * 3


@given(streams, streams)
def test_behind_a_cut_rows_are_as_at_the_beginning_of_a_stream(first: bytes, second: bytes) -> None:
    cut, fresh = Framer("p"), Framer("p")
    before = cut.feed(Chunk("p", 100 * MS, first)) + cut.cut()
    assert b"".join(row.raw for row in before) == first
    behind = cut.feed(Chunk("p", 5000 * MS, second)) + cut.flush()
    expected = fresh.feed(Chunk("p", 5000 * MS, second)) + fresh.flush()
    assert [(row.offset - len(first), row.raw, row.faults, row.t_ns) for row in behind] == [
        (row.offset, row.raw, row.faults, row.t_ns) for row in expected
    ]


@given(streams, st.lists(st.integers(0, 40)))
def test_what_waits_is_told_by_its_first_byte(stream: bytes, cuts: list[int]) -> None:
    framer, t_ns, size, given = Framer("p"), 10**18, 0, 0
    began: list[int] = []
    for length in (*cuts, len(stream)):
        data = stream[size : size + length]
        size += len(data)
        floor, t_ns = t_ns, t_ns + 15 * MS
        began += [max(floor, t_ns - n * byte_time_ns(115200)) for n in range(len(data), 0, -1)]
        given += sum(len(row.raw) for row in framer.feed(Chunk("p", t_ns, data)))
        waits = framer.waits_since_ns
        assert (waits is None) is (given == size)
        if waits is not None:
            assert waits == max(began[given], 10**18)
    framer.flush()
    assert framer.waits_since_ns is None
