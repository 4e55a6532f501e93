"""Scores, posterior probabilities and segments of disputed spans, against an independent oracle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from pathlib import Path
from random import Random
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, Fault, Frame
from fte_sniff.protocol.framer import FrameTables
from fte_sniff.protocol.framer.decoder import (
    BoundaryState,
    CandidateSet,
    DamagedSpan,
    ForwardBackward,
    Segment,
    after_certain_frame,
    decode,
)
from fte_sniff.protocol.framer.model import (
    BOUNDARY,
    CLOSED,
    FAULT_SETS,
    INTACT,
    JUNK,
    KNOWN,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_CONTINUES,
    NOISE_ENDS,
    OPEN,
    find_unambiguous,
)
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.oracle import LINES, UNLEARNED, ZERO, Oracle
from tests.protocol.streams import near_frames, rows_of, unambiguous_frame
from tests.slow import first
from tests.support.faults import PAYLOADS, damaged_stream, draw_frame
from tests.support.score import labels, score

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")


class Part(NamedTuple):
    """A segment in plain numbers and fault words."""

    start: int
    stop: int
    framed: bool
    faults: tuple[Fault, ...]

    @property
    def certain(self) -> bool:
        return self.framed and not self.faults


def parts_of(segments: Sequence[Segment]) -> list[Part]:
    return [Part(one.start, one.stop, one.framed, FAULT_SETS[one.faults]) for one in segments]


def whole_frames(
    data: bytes, state: BoundaryState, ending: int, line: Oracle = UNLEARNED
) -> dict[int, float]:
    """The offsets where a whole frame can start in a span, with the probability (0-1) of each."""
    posterior = ForwardBackward(CandidateSet(line.tables, data), state, ending)
    probabilities = posterior.frame_probabilities()
    return {
        prefix.start: probabilities[number]
        for number, prefix in enumerate(posterior.candidates.prefixes)
        if prefix.whole > 0
    }


def decoded(
    data: bytes,
    state: BoundaryState,
    ending: int,
    *,
    line: Oracle = ZERO,
) -> list[Part]:
    """The segments of a span."""
    return parts_of(decode(ForwardBackward(CandidateSet(line.tables, data), state, ending)))


def candidate_scores(tables: FrameTables, data: bytes) -> dict[tuple[int, int], float]:
    """The start, stop and score of each frame, whole or damaged, that a span can hold."""
    candidates, length = CandidateSet(tables, data), tables.length
    scores: dict[tuple[int, int], float] = {}

    def count(start: int, stop: int, score: float) -> None:
        if score > 0:
            scores[start, stop] = scores.get((start, stop), 0.0) + score

    for prefix in candidates.prefixes:
        for cut in range(1, prefix.longest_truncated + 1):
            count(prefix.start, prefix.start + cut, candidates.truncated(prefix, cut))
        full = candidates.full_length(prefix, prefix.whole or prefix.bad_tail)
        count(prefix.start, prefix.start + length, full)
    for end in candidates.ends:
        for start in range(end.first, end.stop):
            count(start, end.stop, end.scores[start - end.first])
    return scores


def damaged_span(data: bytes, line: Oracle) -> list[Part]:
    """The segments of a span in which no whole frame is shown."""
    return parts_of(DamagedSpan(CandidateSet(line.tables, data), 0, len(data)).segments())


# Scores and segmentation

some = st.one_of(
    st.sampled_from([0xAA, 0x55, 0xEE, 0, 1, 2, 3, 4, 5, 0x0E, 0x0F, 0x10, 0x7F, 0xFE, 0xFF]),
    st.integers(0, 255),
)
spans = st.one_of(
    st.lists(some, min_size=1, max_size=40).map(bytes),
    near_frames.map(lambda data: data[:40]),
    st.integers(0, 10_000).map(lambda seed: damaged_stream(seed, 4, 0.9, "hostile")[0][:40]),
).filter(bool)


lines = st.sampled_from(sorted(LINES)).map(LINES.__getitem__)


def oracle_scores(data: bytes, line: Oracle) -> dict[tuple[int, int], float]:
    return {
        (start, candidate.stop): candidate.score
        for start in range(len(data))
        for candidate in line.candidates(data, start)
    }


@examples(150)
@given(spans, lines)
def test_candidates_score_as_the_oracle_computes(data: bytes, line: Oracle) -> None:
    scores = candidate_scores(line.tables, data)
    assert scores == pytest.approx(oracle_scores(data, line), rel=1e-9, abs=0)


def _noise(length: int) -> float:
    """The score of a run of noise, as the likelier of junk and long noise."""
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_CONTINUES ** (length - 1)


def _best(data: bytes, line: Oracle) -> float:
    """The best score of these bytes as damaged frames and runs of noise."""
    size = len(data)
    best, noisy = [1.0, *[0.0] * size], [False] * (size + 1)

    def reach(stop: int, score: float, noise: bool) -> None:
        if score > best[stop]:
            best[stop], noisy[stop] = score, noise

    for start in range(size):
        for candidate in line.candidates(data, start):
            if not candidate.whole:
                reach(candidate.stop, best[start] * candidate.score, False)
        for stop in range(start + 1, size + 1):
            if not noisy[start] and (stop == size or data[stop] in oracle.IS_HEADER):
                reach(stop, best[start] * _noise(stop - start), True)
    return best[size]


@examples(150)
@given(spans, lines)
def test_a_damaged_span_gets_its_best_segmentation(data: bytes, line: Oracle) -> None:
    if any(line.is_whole(data[at : at + FRAME_LENGTH]) for at in range(len(data))):
        return
    scores = oracle_scores(data, line)
    parts = damaged_span(data, line)
    assert [part.start for part in parts] == [0, *(part.stop for part in parts[:-1])]
    assert parts[-1].stop == len(data)
    total = prod(
        # A damaged frame without a header, and not of ten bytes, is labelled noise too.
        max(
            scores.get((part.start, part.stop), 0.0),
            _noise(part.stop - part.start) if part.faults == (Fault.NOISE,) else 0.0,
        )
        for part in parts
    )
    assert total == pytest.approx(_best(data, line))


# Unambiguous frames

imitating = st.sampled_from([0xAA, 0x55, 0xEE, 0x00, 0x01, 0x02, 0x03, 0x0F, 0x77])
shorter_spans = st.one_of(
    st.binary(min_size=1, max_size=30),
    st.lists(imitating, min_size=1, max_size=30).map(bytes),
    st.builds(
        lambda seed, cut: damaged_stream(seed, 4, 0.9, "hostile")[0][cut : cut + 30],
        st.integers(0, 10_000),
        st.integers(0, 8),
    ).filter(bool),
)


@examples(200)
@given(shorter_spans, lines, st.integers(0, 10_000), st.binary(max_size=10))
def test_bytes_after_an_unambiguous_frame_change_nothing_before_it(
    span: bytes, line: Oracle, seed: int, after: bytes
) -> None:
    data = span + unambiguous_frame(seed, line)
    start = find_unambiguous(line.tables, data, 0, len(data))
    assert start >= 0
    upto = whole_frames(data[: start + 10], after_certain_frame(), BOUNDARY, line)
    if upto[start] < 0.9995:
        return
    whole = whole_frames(data + after, after_certain_frame(), OPEN, line)
    assert whole[start] > 0.999
    for at, probability in upto.items():
        assert whole[at] == pytest.approx(probability, abs=1e-3)


@examples(200)
@given(
    st.lists(st.sampled_from([0x00, 0x01, 0x17, 0x54, 0xFF]), min_size=1, max_size=4).map(bytes),
    st.sampled_from(["AA 02 01", "AA 02 04", "AA 03 00", "55 01 02", "55 02 03"]),
    st.lists(st.sampled_from([0x00, 0x02, 0x17, 0x66, 0xFE, 0xFF]), min_size=4, max_size=4),
    st.lists(st.integers(0, 15), min_size=2, max_size=2),
)
def test_a_frame_after_short_noise_is_as_certain_as_by_its_scores(
    noise: bytes, head: str, payload: list[int], ending: list[int]
) -> None:
    data = noise + bytes([*bytes.fromhex(head), *payload, *ending, 0xEE]) + unambiguous_frame(0)
    start = find_unambiguous(ZERO.tables, data, 0, len(data))
    if start == len(noise):
        segments = decoded(data[: start + FRAME_LENGTH], after_certain_frame(), BOUNDARY)
        assert segments[-1] == (start, start + FRAME_LENGTH, True, ())


@pytest.mark.parametrize(
    ("damage", "fault"),
    [
        ("12 34", Fault.NOISE),
        ("01 03 E8 00 00 00 EE", Fault.NOISE),
        ("AA 01 01 03 E8 00", Fault.TRUNCATED),
        ("AA 01 01 00 00 00 EE", Fault.TRUNCATED),
        ("AA 01 01 03 E8 17 00 00 00 00 EE", Fault.OVERLONG),
        ("12 01 01 03 E8 00 00 00 00 EE", Fault.BAD_HEADER),
        ("AA 01 01 03 E8 00 00 00 00 12", Fault.BAD_TAIL),
        ("AA 42 01 03 E8 00 00 00 00 EE", Fault.UNKNOWN_CMD),
        ("AA 01 07 03 E8 00 00 00 00 EE", Fault.BAD_MOTOR),
    ],
)
def test_plain_damage_is_named(damage: str, fault: Fault) -> None:
    raw = bytes.fromhex(damage)
    framed = fault in (Fault.UNKNOWN_CMD, Fault.BAD_MOTOR)
    row = rows_of(FRAME + raw + FRAME * 2)[1]
    assert (row.raw, isinstance(row, Frame), row.faults) == (raw, framed, (fault,))


# Quality on damaged streams


@pytest.mark.parametrize(
    ("share", "payload", "found", "invented_ok", "doubted"),
    [
        (0.01, "ordinary", 1.0, 0, 0.001),
        (0.2, "ordinary", 1.0, 1, 0.018),
        (0.2, "hostile", 0.9997, 2, 0.022),
        (0.5, "hostile", 0.9992, 5, 0.05),
    ],
)
def test_frames_are_found_and_none_is_invented(
    share: float, payload: str, found: float, invented_ok: int, doubted: float
) -> None:
    stream, sent = damaged_stream(1, 5000, share, payload)
    judged = score(sent, rows_of(stream))
    assert judged.found_share >= found
    assert judged.invented_ok <= invented_ok
    assert judged.doubted_share <= doubted


def test_single_faults_are_named() -> None:
    stream, sent = damaged_stream(2, 20_000, 0.15, "ordinary")
    seen = labels(sent, rows_of(stream))
    for done, label in {
        "lost, header left": "truncated",
        "inserted": "overlong",
        "only the header changed": "bad_header",
        "only the tail changed": "bad_tail",
        "junk": "noise",
    }.items():
        named = {key: count for key, count in seen.items() if key[1] == done}
        assert sum(named.values()) > 30
        right = sum(count for key, count in named.items() if key[2] == label)
        assert right >= 0.95 * sum(named.values()), done


def test_joining_in_mid_stream_invents_nothing() -> None:
    random = Random(5)
    for _ in range(400):
        frames = [draw_frame(random, PAYLOADS["ordinary"]) for _ in range(8)]
        cut = random.randrange(1, 2 * FRAME_LENGTH)
        first = -cut % FRAME_LENGTH
        starts = [r.offset for r in rows_of(b"".join(frames)[cut:]) if isinstance(r, Frame)]
        assert starts == list(range(first, 8 * FRAME_LENGTH - cut, FRAME_LENGTH))


@pytest.mark.parametrize("seed", first(4, range(12)))
def test_the_probabilities_of_a_span_are_the_oracles(seed: int) -> None:
    stream, _ = damaged_stream(seed, 8, 0.5, "hostile")
    stream = stream[:100]
    for line in LINES.values():
        probable = whole_frames(stream, after_certain_frame(), CLOSED, line)
        assert probable == pytest.approx(line.probabilities(stream), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("seed", first(2, range(6)))
def test_streaming_decides_as_the_oracle_does_on_the_whole(seed: int) -> None:
    stream, _ = damaged_stream(seed, 60, 0.4, "hostile")
    lead = FRAME * KNOWN
    probable = ZERO.probabilities(lead + stream)
    rows = [row for row in rows_of(lead + stream) if isinstance(row, Frame)]
    starts = {row.offset for row in rows}
    assert {start for start, p in probable.items() if p > 0.98} <= starts
    for row in rows:
        if not row.faults:
            assert probable[row.offset] > 0.5
        if row.offset in probable and probable[row.offset] < 0.02:
            assert row.faults


# The worked example of docs/framer.md

EXAMPLE = bytes.fromhex(
    "AA 01 01 03 E8 AA 02 01 03 E8 00 00 00 0F EE 55 01 01 03 E8 00 00 00 0F EE"
)
"""A frame that lost its last five bytes, and two whole frames."""

PAGE = Path(__file__).parents[3] / "docs" / "framer.md"


def example_blocks() -> Iterator[str]:
    """The blocks of numbers that the page shows, in its order."""
    tables = ZERO.tables
    posterior = ForwardBackward(CandidateSet(tables, EXAMPLE), after_certain_frame(), BOUNDARY)
    score, lines = INTACT * tables.kind_shares[2], []
    for offset, byte in enumerate(EXAMPLE[5:15]):
        factor = tables.byte_scores[(2 * FRAME_LENGTH + offset) * 256 + byte]
        score *= factor
        lines.append(f"{byte:02X}  {factor:8.4f}   {score:.3g}")
    yield "\n".join(lines)
    scores = candidate_scores(tables, EXAMPLE)
    yield "\n".join(
        f"{start:2}-{stop:2}  {EXAMPLE[start:stop].hex(' ').upper():29}  {score:7.1e}  {p:.4f}"
        for (start, stop), score in sorted(scores.items())
        if (p := posterior.probability(start, stop, score)) >= 0.0005
    )
    forward, backward = posterior.forward, posterior.backward
    yield "\n".join(
        f"{at:2}   {forward.after_frame[at]:7.1e}   {forward.after_noise[at]:7.1e}"
        f"   {backward[at]:7.1e}   {posterior.boundary_probability(at):.4f}"
        for at in (0, 4, 5, 7, 15, 25)
    )
    yield "\n".join(
        f"{part.start:2}-{part.stop:2}  {'frame' if part.framed else 'damage'}"
        f"  {', '.join(part.faults)}".rstrip()
        for part in decoded(EXAMPLE, after_certain_frame(), BOUNDARY)
    )


def test_the_page_about_the_framer_shows_the_numbers_of_the_code() -> None:
    page = PAGE.read_text("utf-8")
    assert EXAMPLE[:5].hex(" ").upper() in page
    for block in example_blocks():
        assert f"\n{block}\n" in page


def test_the_framer_gives_the_rows_of_the_worked_example() -> None:
    rows = rows_of(FRAME * KNOWN + EXAMPLE + FRAME * 3)[KNOWN:-3]
    parts = decoded(EXAMPLE, after_certain_frame(), BOUNDARY)
    assert [(row.offset - 10 * KNOWN, isinstance(row, Frame), row.faults) for row in rows] == [
        (part.start, part.framed, part.faults) for part in parts
    ]
