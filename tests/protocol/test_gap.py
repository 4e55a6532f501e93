"""The division of gaps, against a slow one that sums over candidates byte by byte."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from math import prod
from operator import mul
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import candidates as module
from fte_sniff.protocol.candidates import INTACT, LONGEST
from fte_sniff.protocol.gap import Gaps, divide
from fte_sniff.protocol.islands import is_start, strict_frames
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    HEADER_BYTES,
    KINDS,
    TAIL,
    FrameKind,
)
from tests.examples import examples
from tests.protocol.streams import raw_bytes, rows_of
from tests.support.faults import damaged_stream

EACH = (1 - INTACT) / 5
"""Prior of each kind of damage."""

near_frames = st.builds(
    lambda seed, first, size: damaged_stream(seed, 8, 0.7, "hostile")[0][first : first + size],
    st.integers(0, 10_000),
    st.integers(0, 9),
    st.integers(1, 45),
)
gaps = st.tuples(near_frames.filter(len), st.booleans(), st.booleans())


def damages(length: int) -> Iterator[tuple[int, int, float]]:
    """First and last bytes of a frame that are left in `length` bytes, and the prior of that."""
    for head in range(FRAME_LENGTH + 1):
        for rest in range(FRAME_LENGTH + 1 - head):
            if head + rest == length < FRAME_LENGTH:
                yield head, rest, EACH / 9 / (length + 1)
            if length == FRAME_LENGTH and 4 <= head + rest < FRAME_LENGTH:
                yield head, rest, EACH / 6 / (head + rest + 1)
            if length > FRAME_LENGTH and head and rest and head + rest == FRAME_LENGTH:
                yield head, rest, EACH / 4 / 9
            if length > 1 and rest and head + rest < FRAME_LENGTH and head + rest < length:
                yield head, rest, 1e-5


DAMAGES = [[*damages(length)] for length in range(LONGEST + 1)]
TABLES = module._SCORES.astype(np.float64).tolist()


def score_of(raw: bytes, *, contains_frame: bool) -> float:
    """The score of a candidate."""
    if len(raw) == FRAME_LENGTH and (whole := sent_as(raw)):
        return INTACT * whole
    total = 0.0
    for table, kind in zip(TABLES, KINDS, strict=False):
        first = [1.0, *accumulate((own[byte] for own, byte in zip(table, raw, strict=False)), mul)]
        back = zip(reversed(table), reversed(raw), strict=False)
        last = [1.0, *accumulate((own[byte] for own, byte in back), mul)]
        scores = (first[head] * last[rest] * prior for head, rest, prior in DAMAGES[len(raw)])
        total += share(kind) * sum(scores)
    if len(raw) == FRAME_LENGTH and raw[0] in HEADER_BYTES and raw[-1] == TAIL:
        total += module._ANY_FRAMED
    return total * module._CONTAINING if contains_frame else total


def share(kind: FrameKind) -> float:
    return len(kind.cmds) / sum(len(one.cmds) for one in KINDS if one.header == kind.header) / 2


def sent_as(raw: bytes) -> float:
    """The score of the first bytes of a frame of any kind."""
    return sum(
        share(kind) * prod(own[byte] for own, byte in zip(table, raw, strict=False))
        for table, kind in zip(TABLES, KINDS, strict=False)
    )


def posteriors(data: bytes, before: bool, after: bool) -> dict[tuple[int, int], float]:
    """By candidate: the probability that it is a segment."""
    size, strict = len(data), set(strict_frames(np.frombuffer(data, np.uint8)).tolist())
    scores = {}
    for at in range(size):
        for stop in range(at + 1, min(at + LONGEST, size) + 1):
            inside = not strict.isdisjoint(range(at, stop - FRAME_LENGTH + 1))
            contains = inside and stop - at > FRAME_LENGTH
            scores[at, stop] = score_of(data[at:stop], contains_frame=contains)
        if after and size - at < FRAME_LENGTH:
            scores[at, size] += INTACT * sent_as(data[at:])
    forward, noise = [float(before and at < LONGEST) for at in range(size + 1)], [0.0] * (size + 1)
    forward[0] = 1.0
    entering = list(forward)
    for at in range(size):
        entering[at] = forward[at] + noise[at] * (data[at] in HEADER_BYTES)
        noise[at + 1] = (forward[at] * EACH / 30 + noise[at]) * 0.98
        for stop in range(at + 1, min(at + LONGEST, size) + 1):
            forward[stop] += entering[at] * scores[at, stop]
    backward, inside_noise = [0.0] * (size + 1), [0.0] * (size + 1)
    backward[size] = inside_noise[size] = 1.0
    for at in range(size - 1, -1, -1):
        stops = range(at + 1, min(at + LONGEST, size) + 1)
        leaving = sum(scores[at, stop] * backward[stop] for stop in stops)
        inside_noise[at] = 0.98 * inside_noise[at + 1] + leaving * (data[at] in HEADER_BYTES)
        backward[at] = leaving + EACH / 30 * 0.98 * inside_noise[at + 1]
    total = forward[size] + noise[size]
    return {
        (at, stop): entering[at] * score * backward[stop] / total
        for (at, stop), score in scores.items()
    }


def divided(parts: list[tuple[bytes, bool, bool]]) -> list[dict[tuple[int, int], float]]:
    """By gap: the segments, and the probability of a whole frame."""
    data = b"".join(raw for raw, _, _ in parts)
    stops = np.cumsum([len(raw) for raw, _, _ in parts])
    starts = stops - [len(raw) for raw, _, _ in parts]
    flags = (np.array([part[at] for part in parts], np.bool_) for at in (1, 2))
    segments: list[dict[tuple[int, int], float]] = [{} for _ in parts]
    for found in divide(np.frombuffer(data, np.uint8), Gaps(starts, stops, starts, stops, *flags)):
        columns = (column.tolist() for column in found)
        for start, stop, probability in zip(*columns, strict=True):
            gap = int(np.searchsorted(stops, start, "right"))
            segments[gap][start - int(starts[gap]), stop - int(starts[gap])] = probability
    return segments


@examples(60)
@given(st.lists(gaps, min_size=1, max_size=4))
def test_segments_are_those_of_the_slow_division(parts: list[tuple[bytes, bool, bool]]) -> None:
    for (raw, before, after), found in zip(parts, divided(parts), strict=True):
        expected = posteriors(raw, before, after)
        for segment, probability in expected.items():
            assert segment in found or probability < 0.5001, (raw.hex(), segment, probability)
        for segment, whole in found.items():
            assert expected[segment] > 0.4999, (raw.hex(), segment, expected[segment])
            assert whole in (0.0, pytest.approx(expected[segment], rel=1e-4))


@given(raw_bytes)
def test_strict_frames_are_legal_at_every_byte(data: bytes) -> None:
    legal = [kind.legal_bytes() for kind in KINDS]
    expected = [
        at
        for at in range(len(data) - FRAME_LENGTH + 1)
        if any(
            all(own is None or byte in own for byte, own in zip(data[at:], sets, strict=False))
            for sets in legal
        )
    ]
    assert strict_frames(np.frombuffer(data, np.uint8)).tolist() == expected
    for at in expected:
        assert all(is_start(data[at : at + size]) for size in range(1, FRAME_LENGTH))


@pytest.mark.parametrize("raw", ["EE", "AA 04", "AA 01 05", "55 00", "55 01 01 00 00 01"])
def test_these_bytes_start_no_strict_frame(raw: str) -> None:
    assert not is_start(bytes.fromhex(raw))


# The worked example of docs/framer.md

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
EXAMPLE = bytes.fromhex(
    "AA 01 01 03 E8 AA 02 01 03 E8 00 00 00 0F EE 55 01 01 03 E8 00 00 00 0F EE"
)
"""A frame that lost its last five bytes, and two whole frames."""

PAGE = Path(__file__).parents[2] / "docs" / "framer.md"


def example_blocks() -> Iterator[str]:
    """The blocks of numbers that the page shows, in its order."""
    code = [kind.name for kind in KINDS].index("position")
    score, lines = INTACT * share(KINDS[code]), []
    for offset, byte in enumerate(EXAMPLE[5:15]):
        factor = float(module._SCORES[code][offset][byte])
        score *= factor
        lines.append(f"{byte:02X}  {factor:8.4f}   {score:.3g}")
    yield "\n".join(lines)
    data = FRAME + EXAMPLE
    yield "\n".join(
        f"{start:2}-{stop:2}  {data[start:stop].hex(' ').upper():29}"
        f"  {score_of(data[start:stop], contains_frame=False):7.1e}  {probability:.4f}"
        for (start, stop), probability in posteriors(data, False, False).items()
        if probability > 0.005
    )
    rows = rows_of(FRAME * 8 + EXAMPLE + FRAME * 3)
    yield "\n".join(
        f"{row.offset - 70:2}-{row.offset - 70 + len(row.raw)}  {','.join(row.faults) or 'ok'}"
        for row in rows[7:10]
    )


def test_the_page_about_the_framer_shows_the_numbers_of_the_code() -> None:
    page = PAGE.read_text("utf-8")
    assert (FRAME + EXAMPLE).hex(" ").upper() in page
    for block in example_blocks():
        assert f"\n{block}\n" in page
