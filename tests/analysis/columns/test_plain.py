"""Runs of plain frames are found quickly, and never longer than they are."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from hypothesis import given
from hypothesis import strategies as st

from benchmarks.faults import damaged_stream
from fte_sniff.analysis.columns import plain
from fte_sniff.analysis.columns.plain import PlainRuns
from fte_sniff.protocol import FRAME_LENGTH
from fte_sniff.protocol.framer.patterns import PLAIN_RUN
from tests.examples import examples


def _plain_frames(data: bytes) -> int:
    with ThreadPoolExecutor(2) as threads:
        return PlainRuns(data, threads)(0)


byte = st.one_of(
    st.sampled_from([0xAA, 0x55, 0xEE, 0, 1, 2, 3, 4, 0x0F, 0x10]), st.integers(0, 255)
)


@examples(100)
@given(st.integers(0, 5000), st.lists(st.tuples(st.integers(0, 399), byte), max_size=4))
def test_a_run_is_never_counted_longer_than_it_is(
    seed: int, changes: list[tuple[int, int]]
) -> None:
    stream = bytearray(damaged_stream(seed, 40, 0, "hostile" if seed % 2 else "ordinary")[0])
    for place, value in changes:
        stream[place] = value
    data = bytes(stream)
    match = PLAIN_RUN.match(data)
    assert match is not None
    assert _plain_frames(data) <= match.end() // FRAME_LENGTH


@given(st.integers(0, 5000))
def test_a_run_of_plain_frames_is_counted_whole(seed: int) -> None:
    frame = damaged_stream(seed, 1, 0, "ordinary")[0]
    if not any(value in b"\xaa\x55\xee" for value in frame[1:9]):
        assert _plain_frames(frame * 5000) == 5000


@given(st.integers(0, 5000), st.sampled_from([0.0, 0.02, 0.3]), st.binary(max_size=30))
def test_from_every_place_no_more_is_found_than_is_there(
    seed: int, share: float, before: bytes
) -> None:
    data = before + damaged_stream(seed, 60, share, "hostile")[0]
    with ThreadPoolExecutor(2) as threads:
        runs = PlainRuns(data, threads)
        for place in range(len(data)):
            match = PLAIN_RUN.match(data, place)
            assert match is not None
            assert runs(place) <= (match.end() - place) // FRAME_LENGTH


def test_zeros_are_no_frames() -> None:
    for value in (0, 0xAA, 0xEE):
        assert _plain_frames(bytes([value]) * 500) == 0


def test_runs_go_on_over_slabs() -> None:
    frame = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
    count = plain.SLAB // FRAME_LENGTH * 2 + 500
    for junk in (b"", b"\x01\x02\x03"):
        with ThreadPoolExecutor(2) as threads:
            assert PlainRuns(junk + frame * count, threads)(len(junk)) == count
