"""What the framer learns of a line's reserve, and that no reserve costs a frame."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import FRAME_LENGTH, KINDS, Chunk, Fault, Frame, Framer
from fte_sniff.protocol.framer import FTE_TABLES
from fte_sniff.protocol.framer.reserve import (
    CONTRADICTION,
    ENOUGH,
    KNOWN,
    MOST_COUNTED,
    ReserveLearner,
)
from fte_sniff.protocol.framer.tables import LEARNING
from fte_sniff.protocol.spec import FTE_FORMAT
from tests.examples import examples
from tests.protocol.streams import rows_of
from tests.support.faults import PAYLOADS, RESERVES, damaged_stream
from tests.support.score import score

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
