"""How well frames are found on damaged streams, against bounds, and against the oracle."""

from __future__ import annotations

from random import Random

import pytest

from benchmarks.faults import PAYLOADS, damaged_stream, draw_frame
from benchmarks.score import labels, score
from fte_sniff.protocol import FRAME_LENGTH, Chunk, Frame, Framer, Row
from tests.protocol import oracle
from tests.protocol.framer.inside import CLOSED, trusted, whole_frames


def rows_of(stream: bytes) -> list[Row]:
    framer = Framer("p")
    return framer.feed(Chunk("p", None, stream)) + framer.flush()


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


@pytest.mark.parametrize("seed", range(12))
def test_the_weights_of_a_window_are_the_oracles(seed: int) -> None:
    stream, _ = damaged_stream(seed, 8, 0.5, "hostile")
    stream = stream[:100]
    probable = whole_frames(stream, trusted(), CLOSED)
    assert probable == pytest.approx(oracle.weigh(stream), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_streaming_decides_as_the_oracle_does_on_the_whole(seed: int) -> None:
    stream, _ = damaged_stream(seed, 60, 0.4, "hostile")
    lead = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE") * 3
    probable = oracle.weigh(lead + stream)
    rows = [row for row in rows_of(lead + stream) if isinstance(row, Frame)]
    starts = {row.offset for row in rows}
    assert {start for start, p in probable.items() if p > 0.98} <= starts
    for row in rows:
        if not row.faults:
            assert probable[row.offset] > 0.5
        if row.offset in probable and probable[row.offset] < 0.02:
            assert row.faults
