"""The predicates agree with the regular expressions of the oracle; fault sets as numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, KINDS, TAIL, Fault
from fte_sniff.protocol.framer import FTE_TABLES, FrameTables, predicates, tables
from fte_sniff.protocol.framer.tables import FAULT_SETS, fault_set
from fte_sniff.protocol.spec import CMD_OFFSET, HEADER_BYTES, KIND_BY_HEADER_AND_CMD, NUM_OFFSET
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.oracle import frame_faults, legal_bytes
from tests.protocol.streams import near_frames, near_frames_of

LONGEST = FRAME_LENGTH + tables.EXTRA

OFTEN = 10
"""Least number of times that each answer must occur."""

Pattern = re.Pattern[bytes]

OF_A_FRAME: dict[str, tuple[Callable[[FrameTables, bytes, int], bool], Pattern]] = {
    "framed": (predicates.is_framed, oracle.FRAMED),
    "strict": (predicates.is_strict, oracle.STRICT),
    "unsplit": (predicates.is_unsplit, oracle.UNSPLIT),
    "plain": (predicates.is_plain, oracle.PLAIN),
    "clear": (predicates.is_clear, oracle.CLEAR),
}
UP_TO_AN_END: dict[str, tuple[Callable[[FrameTables, bytes, int, int], bool], Pattern]] = {
    "isolated": (predicates.is_isolated, oracle.ISOLATED),
    "unambiguous": (predicates.is_unambiguous, oracle.UNAMBIGUOUS),
}
SEARCHES: dict[str, tuple[Callable[[FrameTables, bytes, int, int], int], Pattern]] = {
    "unambiguous": (predicates.find_unambiguous, oracle.UNAMBIGUOUS),
    "framed": (predicates.find_framed, oracle.FRAMED),
    "strict": (predicates.find_strict, oracle.STRICT),
}
RUNS = {"plain": (False, oracle.PLAIN_RUN), "unsplit": (True, oracle.UNSPLIT_RUN)}


def _kind_named(data: bytes, at: int) -> str:
    kind = KIND_BY_HEADER_AND_CMD.get((data[at], data[at + CMD_OFFSET]))
    return kind.name if kind else ""


def _on_all(same: Callable[[bytes], None]) -> None:
    """Check fixed and random near frames."""
    for seed in range(150):
        same(near_frames_of(seed))
    examples(100)(given(near_frames)(same))()


ANYTHING = {
    kind.name for kind in KINDS if all(legal is None for legal in legal_bytes(kind)[NUM_OFFSET:-1])
}
"""Kinds for which every byte after header and CMD is legal."""


def _all_kinds_often(answers: Counter[tuple[str, bool]], never: set[str] | None = None) -> None:
    """Fail unless both answers occurred often for each kind; those in `never` have only one."""
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
            assert has(FTE_TABLES, data, at) is expected
            if data[at + FRAME_LENGTH - 1] == TAIL or name in ("framed", "clear"):
                answers[_kind_named(data, at), expected] += 1

    _on_all(same)
    _all_kinds_often(answers, ANYTHING if name == "strict" else None)


@given(near_frames)
def test_what_is_cut_off_is_no_calm_frame(data: bytes) -> None:
    for at in range(max(0, len(data) - FRAME_LENGTH + 1), len(data) + 2):
        assert predicates.is_clear(FTE_TABLES, data, at) is False


@pytest.mark.parametrize("name", UP_TO_AN_END)
def test_a_frame_has_it_with_what_is_known_after_it(name: str) -> None:
    has, pattern = UP_TO_AN_END[name]
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            just = at + LONGEST
            for end in {at, just - 1, just, len(data)}:
                if end > len(data):
                    continue
                expected = pattern.match(data, at, end) is not None
                assert has(FTE_TABLES, data, at, end) is expected
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
                assert find(FTE_TABLES, data, start, stop) == (found.start() if found else -1)
                answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


def test_the_next_anchor_is_found() -> None:
    answers: Counter[bool] = Counter()

    def same(data: bytes) -> None:
        for start in range(len(data) + 2):
            found = oracle.ANCHOR.search(data, start)
            assert predicates.find_anchor(FTE_TABLES, data, start) == (
                found.start() if found else -1
            )
            answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


@given(near_frames, near_frames)
def test_an_incomplete_anchor_starts_close_to_the_end(data: bytes, after: bytes) -> None:
    anchor = predicates.find_anchor(FTE_TABLES, data + after, 0)
    if predicates.find_anchor(FTE_TABLES, data, 0) < 0 <= anchor:
        assert anchor >= len(data) - (2 * FRAME_LENGTH - 1)


@pytest.mark.parametrize("name", RUNS)
def test_a_run_ends_where_it_is_said(name: str) -> None:
    calm, pattern = RUNS[name]
    lengths: Counter[int] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) + 1):
            for end in {at, max(at, len(data) - 5), len(data)}:
                found = pattern.match(data, at, end)
                assert found
                assert predicates.end_of_run(FTE_TABLES, data, at, end, calm=calm) == found.end()
                lengths[(found.end() - at) // FRAME_LENGTH] += 1

    _on_all(same)
    assert min(lengths[count] for count in range(3)) > OFTEN


def test_a_run_may_be_as_long_as_it_is() -> None:
    frame = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
    data = frame * 5000 + b"\x12" + frame
    for calm in (False, True):
        assert predicates.end_of_run(FTE_TABLES, data, 0, len(data), calm=calm) == 50_000
        assert predicates.end_of_run(FTE_TABLES, data, 0, 33_333, calm=calm) == 33_330


def test_a_payload_divides_a_frame_where_it_is_said() -> None:
    answers: Counter[tuple[bool, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - 2):
            expected = oracle.SPLITTING.match(data, at) is not None
            assert predicates.can_split(FTE_TABLES, data, at) is expected
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
            assert FAULT_SETS[predicates.framed_faults(FTE_TABLES, data[:at] + raw, at)] == named
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
            head = oracle.prefix_fit(kind, data[at:end])
            rest = oracle.suffix_fit(kind, data[at:end])
            assert predicates.prefix_fit(FTE_TABLES, data, at, end, number) == head
            assert predicates.suffix_fit(FTE_TABLES, data, at, end, number) == rest
            heads[head] += 1
            rests[rest] += 1

    _on_all(same)
    assert set(heads) == set(rests) == set(range(FRAME_LENGTH + 1))


GIVEN = [fault for fault in Fault if fault is not Fault.LINE_ERROR]
"""The framer gives all others."""


def test_every_number_is_that_of_its_faults() -> None:
    assert len(FAULT_SETS) == 2 ** len(GIVEN)
    for number, faults in enumerate(FAULT_SETS):
        assert fault_set(faults) == number
    assert FAULT_SETS[0] == ()


@given(st.lists(st.sampled_from(GIVEN), unique=True))
def test_faults_have_one_number_in_whatever_order_they_come(faults: list[Fault]) -> None:
    assert sorted(FAULT_SETS[fault_set(faults)]) == sorted(faults)
    assert fault_set(faults) == fault_set(reversed(faults))


def test_the_names_are_those_of_the_numbers() -> None:
    for name in ("UNKNOWN_CMD", "BAD_HEADER", "BAD_TAIL", "TRUNCATED", "OVERLONG", "NOISE"):
        assert FAULT_SETS[getattr(tables, name)] == (Fault[name],)
    assert FAULT_SETS[tables.AMBIGUOUS] == (Fault.AMBIGUOUS,)
