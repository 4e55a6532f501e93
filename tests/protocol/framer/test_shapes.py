"""The shapes that the framer finds are those that the regular expressions say."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from itertools import product

import pytest
from hypothesis import given

from fte_sniff.protocol import FRAME_LENGTH, KINDS, TAIL, frame_faults
from fte_sniff.protocol import codec as structure
from fte_sniff.protocol.codec import HEADER_BYTES, LONGEST_OVERLONG
from fte_sniff.protocol.framer import predicates as shapes
from fte_sniff.protocol.framer.tables import FAULT_SETS
from fte_sniff.protocol.spec import CMD_OFFSET, KIND_BY_HEADER_AND_CMD, NUM_OFFSET
from tests.examples import examples
from tests.protocol.framer import patterns
from tests.protocol.framer.near_frames import near_frames, near_frames_of

OFTEN = 10
"""Each answer is given at least so many times, or the bytes are not what they should be."""

Pattern = re.Pattern[bytes]

OF_A_FRAME: dict[str, tuple[Callable[[bytes, int], bool], Pattern]] = {
    "framed": (shapes.framed, patterns.FRAMED),
    "strict": (shapes.strict, patterns.STRICT),
    "undivided": (shapes.undivided, patterns.UNDIVIDED),
    "plain": (shapes.plain, patterns.PLAIN),
    "calm": (shapes.is_calm, patterns.CALM),
}
UP_TO_AN_END: dict[str, tuple[Callable[[bytes, int, int], bool], Pattern]] = {
    "firm": (shapes.is_firm, patterns.FIRM),
    "doubtless": (shapes.is_doubtless, patterns.DOUBTLESS),
}
SEARCHES: dict[str, tuple[Callable[[bytes, int, int], int], Pattern]] = {
    "doubtless": (shapes.doubtless_frame, patterns.DOUBTLESS),
    "framed": (shapes.framed_from, patterns.FRAMED),
    "strict": (shapes.strict_from, patterns.STRICT),
}
RUNS = {"plain": (False, patterns.PLAIN_RUN), "undivided": (True, patterns.UNDIVIDED_RUN)}


def _kind_named(data: bytes, at: int) -> str:
    kind = KIND_BY_HEADER_AND_CMD.get((data[at], data[at + CMD_OFFSET]))
    return kind.name if kind else ""


def _on_all(same: Callable[[bytes], None]) -> None:
    """Try it with all sorts of bytes: always with the same ones, and with some that nobody knew."""
    for seed in range(150):
        same(near_frames_of(seed))
    examples(100)(given(near_frames)(same))()


ANYTHING = {
    kind.name
    for kind in KINDS
    if all(legal is None for legal in structure.legal_bytes(kind)[NUM_OFFSET:-1])
}
"""Kinds that everything fits behind header and CMD."""


def _all_kinds_often(answers: Counter[tuple[str, bool]], never: set[str] | None = None) -> None:
    """Fails unless each kind was often called so, and, but for some, often was not."""
    for kind in KINDS:
        assert answers[kind.name, True] > OFTEN, kind.name
        assert (answers[kind.name, False] > OFTEN) is (kind.name not in (never or ())), kind.name


@pytest.mark.parametrize("name", OF_A_FRAME)
def test_a_frame_has_the_shape_that_is_said(name: str) -> None:
    has, pattern = OF_A_FRAME[name]
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            expected = pattern.match(data, at) is not None
            assert has(data, at) is expected
            if data[at + FRAME_LENGTH - 1] == TAIL or name in ("framed", "calm"):
                answers[_kind_named(data, at), expected] += 1

    _on_all(same)
    _all_kinds_often(answers, ANYTHING if name == "strict" else None)


@given(near_frames)
def test_what_is_cut_off_is_no_calm_frame(data: bytes) -> None:
    for at in range(max(0, len(data) - FRAME_LENGTH + 1), len(data) + 2):
        assert shapes.is_calm(data, at) is False


@pytest.mark.parametrize("name", UP_TO_AN_END)
def test_a_frame_has_it_with_what_is_known_behind_it(name: str) -> None:
    has, pattern = UP_TO_AN_END[name]
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            just = at + LONGEST_OVERLONG
            for end in {at, just - 1, just, len(data)}:
                if end > len(data):
                    continue
                expected = pattern.match(data, at, end) is not None
                assert has(data, at, end) is expected
                if data[at + FRAME_LENGTH - 1] == TAIL and just <= end:
                    answers[_kind_named(data, at), expected] += 1

    _on_all(same)
    _all_kinds_often(answers)


@pytest.mark.parametrize("name", SEARCHES)
def test_the_next_such_frame_is_found(name: str) -> None:
    find, pattern = SEARCHES[name]
    answers: Counter[bool] = Counter()

    def same(data: bytes) -> None:
        for start in range(len(data) + 2):
            for stop in (-5, start - 1, start + 9, start + 15, len(data) - 2, len(data), 10_000):
                found = pattern.search(data, start, max(0, stop))
                assert find(data, start, stop) == (found.start() if found else -1)
                answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


def test_the_next_anchor_is_found() -> None:
    answers: Counter[bool] = Counter()

    def same(data: bytes) -> None:
        for start in range(len(data) + 2):
            found = patterns.ANCHOR.search(data, start)
            assert shapes.anchor_from(data, start) == (found.start() if found else -1)
            answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


@given(near_frames, near_frames)
def test_an_anchor_that_is_yet_to_come_begins_close_to_the_end(data: bytes, behind: bytes) -> None:
    anchor = shapes.anchor_from(data + behind, 0)
    if shapes.anchor_from(data, 0) < 0 <= anchor:
        assert anchor >= len(data) - shapes.ANCHOR_REACH


@pytest.mark.parametrize("name", RUNS)
def test_a_run_ends_where_it_is_said(name: str) -> None:
    calm, pattern = RUNS[name]
    lengths: Counter[int] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) + 1):
            for end in {at, max(at, len(data) - 5), len(data)}:
                found = pattern.match(data, at, end)
                assert found
                assert shapes.run_end(data, at, end, calm=calm) == found.end()
                lengths[(found.end() - at) // FRAME_LENGTH] += 1

    _on_all(same)
    assert min(lengths[count] for count in range(3)) > OFTEN


def test_a_run_may_be_as_long_as_it_is() -> None:
    frame = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
    data = frame * 5000 + b"\x12" + frame
    for calm in (False, True):
        assert shapes.run_end(data, 0, len(data), calm=calm) == 50_000
        assert shapes.run_end(data, 0, 33_333, calm=calm) == 33_330


def test_a_payload_divides_a_frame_where_it_is_said() -> None:
    answers: Counter[tuple[bool, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - 2):
            expected = patterns.DIVIDING.match(data, at) is not None
            assert shapes.dividing(data, at) is expected
            answers[data[at] == TAIL, expected] += 1

    _on_all(same)
    assert min(answers[tail, said] for tail in (False, True) for said in (False, True)) > OFTEN


def test_ten_framed_bytes_have_the_faults_that_the_codec_names() -> None:
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            header = data[at] if data[at] in HEADER_BYTES else HEADER_BYTES[at % len(HEADER_BYTES)]
            raw = bytes([header, *data[at + 1 : at + FRAME_LENGTH - 1], TAIL])
            named = frame_faults(raw)
            assert FAULT_SETS[shapes.faults_of_framed(data[:at] + raw, at)] == named
            answers[_kind_named(raw, 0), not named] += 1

    _on_all(same)
    assert answers["", False] > OFTEN
    _all_kinds_often(answers, ANYTHING)


def test_bytes_fit_the_ends_of_a_kind_as_far_as_the_structure_says() -> None:
    lengths = (0, 1, 6, 9, 10, 11)
    heads: Counter[int] = Counter()
    rests: Counter[int] = Counter()

    def same(data: bytes) -> None:
        for at, length, (number, kind) in product(range(len(data)), lengths, enumerate(KINDS)):
            end = min(len(data), at + length)
            head = patterns.head_fit(kind, data[at:end])
            rest = patterns.rest_fit(kind, data[at:end])
            assert shapes.head_fit(data, at, end, number) == head
            assert shapes.rest_fit(data, at, end, number) == rest
            heads[head] += 1
            rests[rest] += 1

    _on_all(same)
    assert set(heads) == set(rests) == set(range(FRAME_LENGTH + 1))
