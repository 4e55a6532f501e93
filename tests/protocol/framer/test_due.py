"""When a stretch is weighed next is what the regular expressions say, without the short cuts."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH
from fte_sniff.protocol.codec import LONGEST_OVERLONG
from fte_sniff.protocol.framer import framer as due
from tests.examples import examples
from tests.protocol.framer.near_frames import near_frames, near_frames_of
from tests.protocol.framer.patterns import FRAMED, FRAMED_THREE, STRICT, STRICT_PAIR
from tests.protocol.streams import raw_bytes

NEVER = -1
BEHIND = LONGEST_OVERLONG - FRAME_LENGTH
AHEAD = 2 * FRAME_LENGTH

streams = st.one_of(near_frames, near_frames, raw_bytes)

NEWS = [(0, 0), (0, 25), (12, 25), (31, 30), (31, 40), (0, -20)]
"""Bytes from the start to where something new can be learnt, and to where all has been weighed."""


def next_due(data: bytes, start: int, not_before: int, weighed_to: int) -> tuple[int, int]:
    limit = min(len(data), start + due.WIDEST)
    known = limit - BEHIND
    if known < start + 2 * FRAME_LENGTH:
        return NEVER, NEVER
    pair = STRICT_PAIR.search(data, max(start, not_before - 2 * FRAME_LENGTH), known)
    three = FRAMED_THREE.match(data, start, known)
    strict = list(STRICT.finditer(data, start, known))
    ends = [found.end() for found in (pair, three, *strict[2:3]) if found]
    told = [(end + BEHIND, end) for end in ends if end >= not_before]
    if limit == start + due.WIDEST:
        told.append((limit, limit))
    promised = next_promised(data, start, weighed_to, limit)
    if promised != NEVER:
        told.append((promised, promised))
    return min(told, default=(NEVER, NEVER))


def next_promised(data: bytes, start: int, weighed_to: int, limit: int) -> int:
    first = max(start, weighed_to + 1 - FRAME_LENGTH - AHEAD)
    framed = FRAMED.search(data, first, limit - AHEAD) if limit > AHEAD else None
    return framed.end() + AHEAD if framed else NEVER


def test_it_is_due_where_it_is_said() -> None:
    answers: Counter[str] = Counter()

    def same(data: bytes) -> None:
        for start in range(0, len(data) + 1, 7):
            for not_before, weighed_to in NEWS:
                told = (data, start, start + not_before, start + weighed_to)
                expected = next_due(*told)
                assert due.next_due(*told) == expected
                answers[_called(expected, start)] += 1

    for seed in range(100):
        same(near_frames_of(seed))
    examples(100)(given(streams)(same))()
    assert min(answers[what] for what in ("never", "frames", "promised", "widest")) > 10


def _called(told: tuple[int, int], start: int) -> str:
    place, to = told
    if place == NEVER:
        return "never"
    if to < place:
        return "frames"
    return "widest" if place == start + due.WIDEST else "promised"


@given(streams, st.data())
def test_what_was_promised_falls_due(data: bytes, drawn: st.DataObject) -> None:
    for start in range(0, len(data) + 1, 3):
        weighed_to = drawn.draw(st.integers(0, len(data)))
        limit = drawn.draw(st.integers(0, len(data)))
        expected = next_promised(data, start, weighed_to, limit)
        assert due.next_promised(data, start, weighed_to, limit) == expected


@given(streams, st.integers(0, 40))
def test_weighing_begins_behind_what_is_noise_already(data: bytes, start: int) -> None:
    for known in range(start, len(data)):
        begin = max(start, known - due.LEAD)
        while late := FRAMED.search(data, begin, max(begin, known - 1)):
            begin = late.start() + 1
        assert due.lead(data, start, known) == begin
