"""What is read up to a frame beyond doubt is read as if it were weighed with all that follows."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fte_sniff.protocol.framer.framer as framer_module
from benchmarks.faults import PAYLOADS, damaged_stream, draw_frame
from fte_sniff.protocol import Chunk, Framer, Row
from fte_sniff.protocol.framer import enclosed
from fte_sniff.protocol.framer.choice import calmly, chosen
from fte_sniff.protocol.framer.enclosed import firm_frame, read_by_itself
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.undisputed import undisputed
from fte_sniff.protocol.framer.weighing import Ending, Weighing, trusted

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


def firm(seed: int) -> bytes:
    """A frame beyond doubt, and what must be known behind it."""
    random = Random(seed)
    while True:
        raw = draw_frame(random, PAYLOADS["ordinary"]) + bytes(4)
        if firm_frame(raw, 0, len(raw)) == 0:
            return raw


@settings(max_examples=400, deadline=None)
@given(stretches, st.integers(0, 10_000), st.booleans())
def test_a_stretch_read_by_itself_is_read_as_with_the_frame_behind_it(
    stretch: bytes, seed: int, calm: bool
) -> None:
    data = stretch + firm(seed)[:10]
    parts = read_by_itself(data, 0, len(stretch), calm=calm)
    if parts is None:
        return
    weighing = Weighing(Window(data), trusted(), Ending.BOUNDARY)
    reading = chosen(weighing, Stretch(0, 10, True, (), 1.0))
    if calm:
        reading = calmly(weighing, reading)
    assert reading[-1].certain
    assert tuple(part[:4] for part in parts) == tuple(part[:4] for part in reading[:-1])


@settings(max_examples=400, deadline=None)
@given(stretches, st.integers(0, 10_000), st.binary(max_size=10))
def test_nothing_behind_a_frame_beyond_doubt_tells_more_of_what_is_before_it(
    stretch: bytes, seed: int, behind: bytes
) -> None:
    data = stretch + firm(seed)
    start = firm_frame(data, 0, len(data))
    assert start is not None
    upto = Weighing(Window(data[: start + 10]), trusted(), Ending.BOUNDARY)
    if upto.whole_frames()[start] < 0.9995:
        return
    whole = Weighing(Window(data + behind), trusted(), Ending.OPEN).whole_frames()
    assert whole[start] > 0.999
    for place, probability in upto.whole_frames().items():
        assert whole[place] == pytest.approx(probability, abs=1e-3)


@settings(max_examples=400, deadline=None)
@given(st.integers(0, 100_000), st.sampled_from(sorted(PAYLOADS)), st.integers(0, 10_000))
def test_damage_with_one_reading_is_read_as_weighing_reads_it(
    seed: int, payload: str, behind: int
) -> None:
    data = damaged_stream(seed, 1, 1.0, payload)[0] + firm(behind)
    part = undisputed(data, 0)
    if part is None:
        return
    weighing = Weighing(Window(data[: part.stop + 10]), trusted(), Ending.BOUNDARY)
    first, *others = chosen(weighing)
    assert len(others) == 1
    assert others[0].certain
    assert first[:4] == part[:4]


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("p")
    return framer.feed(Chunk("p", None, stream)) + framer.flush()


@pytest.mark.interpreted
@pytest.mark.parametrize(
    ("share", "payload"), [(0.05, "ordinary"), (0.2, "ordinary"), (0.2, "hostile")]
)
def test_without_such_frames_the_rows_are_the_same(
    share: float, payload: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, _ = damaged_stream(8, 1500, share, payload)
    quick = rows_of(stream)
    monkeypatch.setattr(framer_module, "firm_frame", lambda *_: None)
    monkeypatch.setattr(framer_module, "undisputed", lambda *_: None)
    assert quick == rows_of(stream)


def test_what_is_remembered_is_bounded() -> None:
    for remembered in (enclosed._read, enclosed._read_calmly):
        limit = remembered.cache_info().maxsize
        assert limit is not None
        assert limit <= 1 << 14
