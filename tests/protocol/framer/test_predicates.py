"""The predicates agree with the regular expressions of the oracle; fault sets as numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Container
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from librt.vecs import vec
from mypy_extensions import u8

from fte_sniff.protocol import FRAME_LENGTH, KINDS, TAIL, Fault
from fte_sniff.protocol.framer import FTE_TABLES, FrameTables, predicates, tables
from fte_sniff.protocol.framer.tables import FAULT_SETS, fault_set
from fte_sniff.protocol.spec import CMD_OFFSET, HEADER_BYTES, KIND_BY_HEADER_AND_CMD, NUM_OFFSET
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.oracle import LINES, Oracle
from tests.protocol.streams import near_frames, near_frames_of

LONGEST = FRAME_LENGTH + tables.EXTRA

OFTEN = settings.default.max_examples // 5
"""Least number of times that each answer must occur."""

Pattern = re.Pattern[bytes]

OF_A_FRAME: dict[str, Callable[[FrameTables, bytes, int], bool]] = {
    "framed": predicates.is_framed,
    "strict": predicates.is_strict,
    "unsplit": predicates.is_unsplit,
    "plain": predicates.is_plain,
    "clear": predicates.is_clear,
}
UP_TO_AN_END: dict[str, Callable[[FrameTables, bytes, int, int], bool]] = {
    "isolated": predicates.is_isolated,
    "unambiguous": predicates.is_unambiguous,
}
SEARCHES: dict[str, Callable[[FrameTables, bytes, int, int], int]] = {
    "unambiguous": predicates.find_unambiguous,
    "framed": predicates.find_framed,
    "strict": predicates.find_strict,
}
RUNS = {"plain": False, "unsplit": True}
"""By the predicate of each frame: whether the line is calm."""

for_each_line = pytest.mark.parametrize("line", LINES.values(), ids=LINES)


def _pattern(line: Oracle, name: str) -> Pattern:
    """The oracle's pattern of a predicate on a line."""
    pattern: Pattern = getattr(line, name.upper(), None) or getattr(oracle, name.upper())
    return pattern


def _kind_named(data: bytes, at: int) -> str:
    kind = KIND_BY_HEADER_AND_CMD.get((data[at], data[at + CMD_OFFSET]))
    return kind.name if kind else ""


def _on_all(same: Callable[[bytes], None]) -> None:
    """Check fixed and random near frames."""
    for seed in range(5 * settings.default.max_examples):
        same(near_frames_of(seed))
    examples(100)(given(near_frames)(same))()


def _anything(line: Oracle) -> set[str]:
    """The kinds for which every byte after header and CMD is legal."""
    return {kind.name for kind in KINDS if set(line.legal_bytes(kind)[NUM_OFFSET:-1]) == {None}}


def _all_kinds_often(
    answers: Counter[tuple[str, bool]], always: Container[str] = (), never: Container[str] = ()
) -> None:
    """Fail unless both answers occurred often for each kind, but one for those in the others."""
    for kind in KINDS:
        assert (answers[kind.name, True] > OFTEN) is (kind.name not in never), kind.name
        assert (answers[kind.name, False] > OFTEN) is (kind.name not in always), kind.name


def _never_clear(line: Oracle) -> set[str]:
    """The kinds whose constant reserve has a header or a tail."""
    delimiters = {*HEADER_BYTES, TAIL}
    return {KINDS[kind].name for (kind, _), byte in line.reserve.items() if byte in delimiters}


@for_each_line
@pytest.mark.parametrize("name", OF_A_FRAME)
def test_a_frame_has_the_stated_shape(name: str, line: Oracle) -> None:
    has, pattern = OF_A_FRAME[name], _pattern(line, name)
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            expected = pattern.match(data, at) is not None
            assert has(line.tables, data, at) is expected
            if data[at + FRAME_LENGTH - 1] == TAIL or name in ("framed", "clear"):
                answers[_kind_named(data, at), expected] += 1

    _on_all(same)
    _all_kinds_often(answers, _anything(line) if name == "strict" else ())


@given(near_frames)
def test_what_is_cut_off_is_no_calm_frame(data: bytes) -> None:
    for at in range(max(0, len(data) - FRAME_LENGTH + 1), len(data) + 2):
        assert predicates.is_clear(FTE_TABLES, data, at) is False


@for_each_line
@pytest.mark.parametrize("name", UP_TO_AN_END)
def test_a_frame_has_it_with_what_is_known_after_it(name: str, line: Oracle) -> None:
    has, pattern = UP_TO_AN_END[name], _pattern(line, name)
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            just = at + LONGEST
            for end in {at, just - 1, just, len(data)}:
                if end > len(data):
                    continue
                expected = pattern.match(data, at, end) is not None
                assert has(line.tables, data, at, end) is expected
                if data[at + FRAME_LENGTH - 1] == TAIL and just <= end:
                    answers[_kind_named(data, at), expected] += 1

    _on_all(same)
    _all_kinds_often(answers, never=_never_clear(line) if name == "unambiguous" else ())


@for_each_line
@pytest.mark.parametrize("name", SEARCHES)
def test_the_next_such_frame_is_found(name: str, line: Oracle) -> None:
    find, pattern = SEARCHES[name], _pattern(line, name)
    answers: Counter[bool] = Counter()

    def same(data: bytes) -> None:
        for start in range(len(data) + 2):
            for stop in (-5, start - 1, start + 9, start + 15, len(data) - 2, len(data), 10_000):
                found = pattern.search(data, start, max(0, stop))
                assert find(line.tables, data, start, stop) == (found.start() if found else -1)
                answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


@for_each_line
def test_the_next_anchor_is_found(line: Oracle) -> None:
    answers: Counter[bool] = Counter()

    def same(data: bytes) -> None:
        for start in range(len(data) + 2):
            found = line.ANCHOR.search(data, start)
            assert predicates.find_anchor(line.tables, data, start) == (
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


NOTHING_TO_LEARN = bytes([tables.EXACT]) * len(KINDS)
"""The marks of all kinds on a line whose reserve is settled."""


@for_each_line
@pytest.mark.parametrize("name", RUNS)
def test_a_run_ends_at_the_stated_offset(name: str, line: Oracle) -> None:
    calm, pattern = RUNS[name], _pattern(line, f"{name}_run")
    lengths: Counter[int] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) + 1):
            for end in {at, max(at, len(data) - 5), len(data)}:
                found = pattern.match(data, at, end)
                assert found
                run = predicates.end_of_run(
                    line.tables, vec[u8](NOTHING_TO_LEARN), data, at, end, calm=calm
                )
                assert run == (found.end(), -1)
                lengths[(found.end() - at) // FRAME_LENGTH] += 1

    _on_all(same)
    assert min(lengths[count] for count in range(3)) > OFTEN


def test_a_run_may_be_as_long_as_it_is() -> None:
    frame = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
    data, marks = frame * 5000 + b"\x12" + frame, vec[u8](NOTHING_TO_LEARN)
    for calm in (False, True):
        for end, stop in ((len(data), 50_000), (33_333, 33_330)):
            run = predicates.end_of_run(FTE_TABLES, marks, data, 0, end, calm=calm)
            assert run == (stop, -1)


def test_a_run_has_one_frame_after_the_first_that_can_teach() -> None:
    speed, reset = (bytes.fromhex(f"AA {cmd} 01 00 00 00 00 00 00 EE") for cmd in ("01", "00"))
    marks = vec[u8](
        bytes(tables.LEARNING if kind.name == "reset" else tables.EXACT for kind in KINDS)
    )

    def run(data: bytes) -> tuple[int, int]:
        return predicates.end_of_run(FTE_TABLES, marks, data, 0, len(data), calm=True)

    assert run(speed * 9) == (90, -1)
    assert run(speed * 3 + reset + speed * 5) == (50, 40)
    assert run(speed * 3 + reset * 5) == (50, 40)
    assert run(speed * 3 + reset) == (40, 40)
    assert run(speed * 3 + reset[:9]) == (30, -1)


def test_a_payload_divides_a_frame_at_the_stated_offset() -> None:
    answers: Counter[tuple[bool, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - 2):
            expected = oracle.SPLITTING.match(data, at) is not None
            assert predicates.can_split(FTE_TABLES, data, at) is expected
            answers[data[at] == TAIL, expected] += 1

    _on_all(same)
    assert min(answers[tail, said] for tail in (False, True) for said in (False, True)) > OFTEN


@for_each_line
def test_ten_framed_bytes_have_the_faults_that_the_codec_names(line: Oracle) -> None:
    answers: Counter[tuple[str, bool]] = Counter()

    def same(data: bytes) -> None:
        for at in range(len(data) - FRAME_LENGTH + 1):
            header = data[at] if data[at] in HEADER_BYTES else HEADER_BYTES[at % len(HEADER_BYTES)]
            raw = bytes([header, *data[at + 1 : at + FRAME_LENGTH - 1], TAIL])
            named = line.frame_faults(raw)
            assert FAULT_SETS[predicates.framed_faults(line.tables, data[:at] + raw, at)] == named
            answers[_kind_named(raw, 0), not named] += 1

    _on_all(same)
    assert answers["", False] > OFTEN
    _all_kinds_often(answers, _faultless(line))


def _faultless(line: Oracle) -> set[str]:
    """The kinds that have no fault with any bytes after header and CMD."""
    return {
        kind.name
        for kind in KINDS
        if not any(field.fault for field in kind.fields)
        and not any(line.legal_bytes(kind)[offset] == b"\0" for offset in kind.reserved)
    }


@for_each_line
def test_bytes_fit_the_ends_of_a_kind_as_far_as_the_structure_shows(line: Oracle) -> None:
    lengths = (0, 1, 6, 9, 10, 11)
    heads: Counter[int] = Counter()
    rests: Counter[int] = Counter()

    def same(data: bytes) -> None:
        for at, length, (number, kind) in product(range(len(data)), lengths, enumerate(KINDS)):
            end = min(len(data), at + length)
            head = line.prefix_fit(kind, data[at:end])
            rest = line.suffix_fit(kind, data[at:end])
            assert predicates.prefix_fit(line.tables, data, at, end, number) == head
            assert predicates.suffix_fit(line.tables, data, at, end, number) == rest
            heads[head] += 1
            rests[rest] += 1

    _on_all(same)
    assert set(rests) == set(range(FRAME_LENGTH + 1))
    assert set(heads) >= {0, 1, 2, FRAME_LENGTH - 1, FRAME_LENGTH}


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
