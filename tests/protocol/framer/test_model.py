"""The model of a line: predicates against the oracle, shares of damage, fault sets, the reserve."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Container, Sequence
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from librt.vecs import vec
from mypy_extensions import u8

from fte_sniff.protocol import FRAME_LENGTH, KINDS, TAIL, Chunk, Fault, Frame, Framer
from fte_sniff.protocol.framer import FTE_TABLES, FrameTables, model
from fte_sniff.protocol.framer.model import (
    CONTRADICTION,
    ENOUGH,
    FAULT_SETS,
    KNOWN,
    LEARNING,
    MOST_COUNTED,
    MOST_INSERTED,
    ReserveLearner,
    change_scores,
    fault_set,
    insertion_score,
    truncation_scores,
)
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FTE_FORMAT,
    HEADER_BYTES,
    KIND_BY_HEADER_AND_CMD,
    NUM_OFFSET,
)
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.oracle import LINES, Oracle
from tests.protocol.streams import near_frames, near_frames_of, rows_of
from tests.support.faults import PAYLOADS, RESERVES, damaged_stream
from tests.support.score import score

LONGEST = FRAME_LENGTH + model.EXTRA

OFTEN = settings.default.max_examples // 5
"""Least number of times that each answer must occur."""

Pattern = re.Pattern[bytes]

OF_A_FRAME: dict[str, Callable[[FrameTables, bytes, int], bool]] = {
    "framed": model.is_framed,
    "strict": model.is_strict,
    "unsplit": model.is_unsplit,
    "plain": model.is_plain,
    "clear": model.is_clear,
}
UP_TO_AN_END: dict[str, Callable[[FrameTables, bytes, int, int], bool]] = {
    "isolated": model.is_isolated,
    "unambiguous": model.is_unambiguous,
}
SEARCHES: dict[str, Callable[[FrameTables, bytes, int, int], int]] = {
    "unambiguous": model.find_unambiguous,
    "framed": model.find_framed,
    "strict": model.find_strict,
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
def test_what_is_cut_off_is_not_a_calm_frame(data: bytes) -> None:
    for at in range(max(0, len(data) - FRAME_LENGTH + 1), len(data) + 2):
        assert model.is_clear(FTE_TABLES, data, at) is False


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
        for start in range(0, len(data) + 2, 7):
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
            assert model.find_anchor(line.tables, data, start) == (found.start() if found else -1)
            answers[found is not None] += 1

    _on_all(same)
    assert min(answers[True], answers[False]) > OFTEN


@given(near_frames, near_frames)
def test_an_incomplete_anchor_starts_close_to_the_end(data: bytes, after: bytes) -> None:
    anchor = model.find_anchor(FTE_TABLES, data + after, 0)
    if model.find_anchor(FTE_TABLES, data, 0) < 0 <= anchor:
        assert anchor >= len(data) - (2 * FRAME_LENGTH - 1)


NOTHING_TO_LEARN = bytes([model.EXACT]) * len(KINDS)
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
                run = model.end_of_run(
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
            run = model.end_of_run(FTE_TABLES, marks, data, 0, end, calm=calm)
            assert run == (stop, -1)


def test_a_run_has_one_frame_after_the_first_that_can_teach() -> None:
    speed, reset = (bytes.fromhex(f"AA {cmd} 01 00 00 00 00 00 00 EE") for cmd in ("01", "00"))
    marks = vec[u8](
        bytes(model.LEARNING if kind.name == "reset" else model.EXACT for kind in KINDS)
    )

    def run(data: bytes) -> tuple[int, int]:
        return model.end_of_run(FTE_TABLES, marks, data, 0, len(data), calm=True)

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
            assert model.can_split(FTE_TABLES, data, at) is expected
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
            assert FAULT_SETS[model.framed_faults(line.tables, data[:at] + raw, at)] == named
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
        assert FAULT_SETS[getattr(model, name)] == (Fault[name],)
    assert FAULT_SETS[model.AMBIGUOUS] == (Fault.AMBIGUOUS,)


LENGTH = 10


def test_each_sort_of_damage_is_equally_likely() -> None:
    """The sum over all places, bits and lengths of a sort."""
    nothing, flipped, *wider = change_scores(LENGTH)
    assert nothing == 0
    flips = flipped * LENGTH * 8
    changes = sum(score * (LENGTH + 1 - width) for width, score in enumerate(wider, 2))
    insertions = insertion_score(LENGTH) * MOST_INSERTED * (LENGTH - 1)
    # Lost bytes begin at any of the offsets that leave this number of bytes.
    losses = sum(score * (left + 1) for left, score in enumerate(truncation_scores(LENGTH)))
    assert [changes, insertions, losses] == pytest.approx([flips] * 3)


RESET, SPEED = 0, 1
"""Indices in `KINDS`."""

FRAMES = 6000
"""Frames in each stream of the bar."""


def speed(reserve: str, motor: int = 1, rpm: int = 1000) -> bytes:
    return bytes([0xAA, 0x01, motor, *rpm.to_bytes(2, "big"), *bytes.fromhex(reserve), 0xEE])


def reset(reserve: str) -> bytes:
    return bytes([0xAA, 0x00, 0x00, *bytes.fromhex(reserve), 0xEE])


# No reserve costs a frame


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("reserve", RESERVES)
def test_undamaged_frames_with_any_reserve_are_found(reserve: str, payload: str) -> None:
    stream, sent = damaged_stream(1, FRAMES, 0.0, payload, reserve)
    judged = score(sent, rows_of(stream))
    assert judged.missed == []
    assert judged.invented == 0
    assert judged.doubted <= 0.03 * FRAMES


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("reserve", RESERVES)
def test_frames_with_any_reserve_are_found_beside_damage(reserve: str, payload: str) -> None:
    stream, sent = damaged_stream(1, FRAMES, 0.01, payload, reserve)
    judged = score(sent, rows_of(stream))
    assert judged.found_share >= 0.9995
    assert judged.invented_ok == 0
    assert judged.doubted_share <= 0.03


@pytest.mark.parametrize("reserve", RESERVES)
def test_heavy_damage_costs_few_frames_with_any_reserve(reserve: str) -> None:
    stream, sent = damaged_stream(1, FRAMES, 0.2, "ordinary", reserve)
    judged = score(sent, rows_of(stream))
    assert judged.found_share >= 0.999
    assert judged.invented_ok <= 2
    assert judged.doubted_share <= 0.05


def test_a_payload_that_ends_in_a_header_before_ff_is_found() -> None:
    frames = [speed("FF FF FF FF", motor=n % 4 + 1, rpm=426) for n in range(1000)]
    assert frames[0] == bytes.fromhex("AA 01 01 01 AA FF FF FF FF EE")
    assert [(row.raw, row.faults) for row in rows_of(b"".join(frames))] == [
        (raw, ()) for raw in frames
    ]


@pytest.mark.parametrize("reserve", RESERVES)
def test_a_line_of_one_kind_is_found_with_any_reserve(reserve: str) -> None:
    random, fill = Random(3), RESERVES[reserve]
    for head in (
        b"\xaa\x01\x01\x03\xe8",
        b"\xaa\x01\x02\x01\xaa",
        b"\xaa\x00\x00",
        b"\xaa\x00\xee",
    ):
        size = FRAME_LENGTH - 1 - len(head)
        frames = [head + fill(random, number, size) + b"\xee" for number in range(1000)]
        rows = rows_of(b"".join(frames))
        assert [row.raw for row in rows] == frames
        assert sum(bool(row.faults) for row in rows) <= 0.03 * len(frames)


def test_a_reset_may_have_the_reserve_of_speed_frames_in_another_order() -> None:
    frames = ([speed("AA EE AA EE")] * 19 + [reset("EE AA EE AA EE AA")]) * 50
    rows = rows_of(b"".join(frames))
    assert [row.raw for row in rows] == frames
    assert sum(bool(row.faults) for row in rows) <= KNOWN + 2


# `reserved_nonzero`


def faults_of(*frames: bytes) -> list[str]:
    """The faults of the last frame, and of each one before it that has some."""
    rows = rows_of(b"".join(frames) + speed("00 00 00 00"))[:-1]
    assert [row.raw for row in rows] == list(frames)
    return [",".join(row.faults) for row in rows if row.faults or row is rows[-1]]


def test_reserve_that_is_not_00_is_reported_on_a_line_where_it_is_00() -> None:
    usual, other = speed("00 00 00 00"), speed("12 34 00 00")
    assert faults_of(*[usual] * (KNOWN - 1), other) == [""]
    assert faults_of(*[usual] * KNOWN, other) == ["reserved_nonzero"]
    assert faults_of(*[usual] * KNOWN, other, usual) == ["reserved_nonzero", ""]


@pytest.mark.parametrize("reserve", [name for name in RESERVES if name not in {"00", "counter"}])
def test_a_line_with_another_reserve_has_no_such_fault(reserve: str) -> None:
    random = Random(4)
    frames = [speed(RESERVES[reserve](random, n, 4).hex()) for n in range(3 * KNOWN)]
    faults = {
        fault for row in rows_of(b"".join([*frames, speed("00 00 00 00")])) for fault in row.faults
    }
    assert Fault.RESERVED_NONZERO not in faults


def test_the_reserve_of_speed_feedback_is_00_by_the_document() -> None:
    for reserve in ("00 01", "FF FF", "AA EE"):
        raw = bytes.fromhex(f"55 01 01 03 E8 {reserve} 00 0F EE")
        assert {row.faults for row in rows_of(raw * 100)} == {(Fault.RESERVED_NONZERO,)}


def test_a_host_that_is_replaced_is_learned() -> None:
    old, new = speed("00 00 00 00"), speed("FF FF FF FF")
    rows = rows_of(old * 100 + new * 100)
    assert [row.raw for row in rows] == [old] * 100 + [new] * 100
    assert [row.faults for row in rows] == [()] * 100 + [(Fault.RESERVED_NONZERO,)] * ENOUGH + [
        ()
    ] * (100 - ENOUGH)


def test_a_restarted_stream_has_learned_nothing() -> None:
    framer, other = Framer("p"), speed("12 34 00 00")
    framer.feed(Chunk("p", None, speed("00 00 00 00") * 50))
    framer.restart()
    rows = framer.feed(Chunk("p", None, other * 3)) + framer.flush()
    assert [row.faults for row in rows] == [()] * 3


# What is learned


def learned(frames: Sequence[bytes]) -> dict[int, list[bytes | None]]:
    """By kind: the legal bytes of its open reserve after these frames."""
    learner = ReserveLearner(FTE_TABLES)
    for raw in frames:
        learner.observe(raw, 0)
    tables, size = learner.tables, FTE_FORMAT.length
    return {
        number: [
            bytes(
                byte for byte in range(256) if tables.legal[((number * size) + offset) * 256 + byte]
            )
            if any(not tables.legal[((number * size) + offset) * 256 + byte] for byte in range(256))
            else None
            for offset in kind.open_reserve
        ]
        for number, kind in enumerate(KINDS)
        if kind.open_reserve
    }


ZERO = b"\x00"


def test_a_constant_is_known_after_some_frames_in_a_row() -> None:
    frame = speed("00 00 00 00")
    assert learned([frame] * (KNOWN - 1))[SPEED] == [None] * 4
    assert learned([frame] * KNOWN)[SPEED] == [ZERO] * 4
    assert learned([frame, *[speed("00 00 00 07")] * KNOWN])[SPEED] == [*[ZERO] * 3, b"\x07"]
    mixed = [frame if number % 2 else speed("00 00 00 07") for number in range(99)]
    assert learned(mixed)[SPEED] == [ZERO, ZERO, ZERO, None]


def test_a_constant_survives_single_contradictions() -> None:
    frame, other = speed("00 00 00 00"), speed("00 00 00 07")
    settled = [frame] * MOST_COUNTED
    assert learned([*settled, *[other] * (ENOUGH - 1)])[SPEED] == [ZERO] * 4
    assert learned([*settled, *[other] * ENOUGH])[SPEED] == [ZERO, ZERO, ZERO, None]
    assert learned([*settled, *([other] + [frame] * CONTRADICTION) * 50])[SPEED] == [ZERO] * 4
    assert learned([*settled, *[other, frame] * 50])[SPEED] == [ZERO, ZERO, ZERO, None]


def test_a_kind_that_was_not_seen_has_the_reserve_of_another() -> None:
    assert learned([speed("FF FF FF FF")] * KNOWN)[RESET] == [b"\xff"] * 6
    pattern = [speed("AA EE AA 00")] * KNOWN
    assert learned(pattern)[RESET] == [None, None, b"\xaa", b"\xee", b"\xaa", ZERO]
    own = [*pattern, *[reset("01 02 03 04 05 06")] * KNOWN]
    assert learned(own)[RESET] == [bytes([byte]) for byte in range(1, 7)]
    assert learned([reset("00 00 00 00 00 00")] * KNOWN)[SPEED] == [ZERO] * 4


def test_a_kind_without_open_reserve_teaches_nothing() -> None:
    learner = ReserveLearner(FTE_TABLES)
    for raw in (
        "55 01 01 03 E8 00 00 00 0F EE",
        "AA 03 00 00 00 00 00 00 00 EE",
        "AA 09" + "00" * 8,
    ):
        for _ in range(2 * KNOWN):
            learner.observe(bytes.fromhex(raw), 0)
    assert learner.tables is FTE_TABLES


def test_a_kind_is_settled_when_one_more_frame_changes_nothing() -> None:
    learner = ReserveLearner(FTE_TABLES)
    assert [bool(mark & LEARNING) for mark in learner.marks] == [
        bool(kind.open_reserve) for kind in KINDS
    ]
    for number in range(MOST_COUNTED):
        assert learner.marks[SPEED] == LEARNING, number
        learner.observe(speed("00 00 00 00"), 0)
    assert learner.marks[SPEED] != LEARNING
    learner.observe(speed("00 00 00 01"), 0)
    assert learner.marks[SPEED] == LEARNING


# The chunks teach nothing


@examples(100)
@given(
    st.integers(0, 10_000),
    st.sampled_from([0.0, 0.05, 0.3]),
    st.sampled_from(sorted(PAYLOADS)),
    st.lists(st.sampled_from(sorted(RESERVES)), min_size=1, max_size=3),
    st.integers(1, 50),
)
def test_cutting_into_other_chunks_teaches_the_same(
    seed: int, share: float, payload: str, reserves: list[str], size: int
) -> None:
    stream = b"".join(damaged_stream(seed, 150, share, payload, own)[0] for own in reserves)
    rows = rows_of(stream)
    assert rows_of(stream, size) == rows
    assert b"".join(row.raw for row in rows) == stream


def test_rows_are_frames_where_only_the_reserve_is_unusual() -> None:
    frames = [speed("00 00 00 00")] * KNOWN + [speed("77 77 77 77"), speed("00 00 00 00")]
    assert {type(row) for row in rows_of(b"".join(frames))} == {Frame}
