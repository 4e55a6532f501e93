"""Named damage cases, each whole, byte by byte, and with trailing data.

A case is a line of pieces, `|` between them; each piece is written with what its row must be.
"""

from __future__ import annotations

from itertools import pairwise

import pytest

from fte_sniff.protocol import Chunk, Damage, Fault, Frame, Framer, Row
from tests.protocol.framer.patterns import USUAL_FLAGS

SPEED = "AA 01 01 03 E8 00 00 00 00 EE"
POSITION = "AA 02 02 03 E8 00 00 27 10 EE"
FEEDBACK = "55 01 01 03 E8 00 00 00 0F EE"
PLACE = "55 02 01 00 00 27 10 00 0F EE"
RESET = "AA 00 00 00 00 00 00 00 00 EE"

CASES: dict[str, list[tuple[str, str]]] = {
    "clean": [(SPEED, ""), (FEEDBACK, ""), (RESET, "")],
    "tail lost": [(SPEED, ""), ("AA 01 01 03 E8 00 00 00 00", "truncated"), (SPEED, "")],
    "only the header left": [(SPEED, ""), ("AA", "truncated"), (FEEDBACK, "")],
    "middle lost": [(SPEED, ""), ("AA 02 02 03 10 EE", "truncated"), (SPEED, "")],
    "header lost": [(SPEED, ""), ("02 02 03 E8 00 00 27 10 EE", "noise"), (SPEED, "")],
    "only the tail left": [(PLACE, "ambiguous"), ("EE", "noise"), (SPEED, "")],
    "one byte put in": [(SPEED, ""), ("AA 01 01 03 77 E8 00 00 00 00 EE", "overlong"), (SPEED, "")],
    "four bytes put in": [
        (SPEED, ""),
        ("55 01 01 03 E8 12 34 56 78 00 00 00 0F EE", "overlong"),
        (SPEED, ""),
    ],
    "header changed": [(SPEED, ""), ("AB 02 02 03 E8 00 00 27 10 EE", "bad_header"), (SPEED, "")],
    "tail changed": [(SPEED, ""), ("AA 02 02 03 E8 00 00 27 10 EF", "bad_tail"), (SPEED, "")],
    "cmd changed": [(SPEED, ""), ("AA 42 02 03 E8 00 00 27 10 EE", "unknown_cmd"), (SPEED, "")],
    "reset as feedback": [
        (SPEED, ""),
        ("55 00 01 03 E8 00 00 00 0F EE", "unknown_cmd"),
        (SPEED, ""),
    ],
    "motor 0": [(SPEED, ""), ("AA 02 00 03 E8 00 00 27 10 EE", "bad_motor"), (SPEED, "")],
    "motor 5": [(SPEED, ""), ("55 02 05 00 00 27 10 00 0F EE", "bad_motor"), (SPEED, "")],
    "reserve set": [
        (SPEED, ""),
        ("AA 01 01 03 E8 00 01 00 00 EE", "reserved_nonzero"),
        (SPEED, ""),
    ],
    "undefined flag": [
        (SPEED, ""),
        ("55 01 01 03 E8 00 00 80 0F EE", "undefined_flags"),
        (SPEED, ""),
    ],
    "noise between": [(SPEED, ""), ("12 34 56 78 9A BC", "noise"), (FEEDBACK, ""), (SPEED, "")],
    "noise before": [("00 FF 00 FF", "noise"), (SPEED, ""), (SPEED, "")],
    "noise that begins like a frame": [
        (SPEED, ""),
        ("AA 01 77 12 34 AA 9C 66 31 22 90 AB C1 20 77", "truncated noise"),
        (SPEED, ""),
        (FEEDBACK, ""),
    ],
    "joined in mid-frame": [("27 10 00 0F EE", "noise"), (PLACE, ""), (PLACE, "")],
    "joined where a payload imitates a header": [
        ("AA 03 27 10 EE", "truncated noise"),
        (POSITION, ""),
        (SPEED, ""),
    ],
    "a shifted window that looks like a reset": [
        (POSITION, ""),
        ("AA 02 01 AA 00 00 00 00 00 EE", ""),
        ("AA 03 00 00 00 00 00 00 00 EE", ""),
        ("55 02 01 00 00 AA 00 00 0F EE", ""),
        (SPEED, ""),
    ],
    "two damaged in a row, in step": [
        (SPEED, ""),
        ("AA 02 02 03 E8 00 00 27 10 EF", "bad_tail"),
        ("AB 02 02 03 E8 00 00 27 10 EE", "bad_header"),
        (SPEED, ""),
        (FEEDBACK, ""),
    ],
    "payload full of headers and tails": [
        (SPEED, ""),
        ("AA 02 03 AA 55 EE AA 00 EE EE", ""),
        ("55 02 03 EE AA 03 EE 00 0F EE", ""),
        (SPEED, ""),
    ],
    "a frame that ends as only another kind does": [
        (SPEED, ""),
        ("AA 02 04 FF 59 FF FE 00 0F EE", ""),
        (SPEED, ""),
    ],
    "such a frame alone": [("AA 02 01 03 E8 00 00 00 0F EE", "")],
    "behind damage, a frame that ends as only another kind does": [
        (SPEED, ""),
        ("55 01 04 16 AC 20 44 00 00 0F EE", "overlong"),
        ("AA 02 02 FB 09 FF CC 00 0F EE", "ambiguous"),
        (FEEDBACK, ""),
    ],
    "a header for a NUM that means nothing": [
        (SPEED, ""),
        ("AA 03 AA FF 93 00 00 00 00 EE", "ambiguous"),
        (SPEED, ""),
    ],
    "a tail for a NUM that means nothing": [
        (SPEED, ""),
        ("AA 03 EE 00 84 00 00 00 00 EE", "ambiguous"),
        (SPEED, ""),
    ],
    "any other NUM that means nothing": [
        (SPEED, ""),
        ("AA 03 77 00 84 00 10 00 20 EE", ""),
        (SPEED, ""),
    ],
    "a frame the protocol has not, alone": [("AA 09 01 02 03 04 05 06 07 EE", "unknown_cmd")],
}

TRAILING = [(FEEDBACK, ""), (SPEED, ""), (POSITION, "")]


def _bytes(case: list[tuple[str, str]]) -> bytes:
    return b"".join(bytes.fromhex(piece) for piece, _ in case)


def _check(case: list[tuple[str, str]], rows: list[Row]) -> None:
    expected = [(len(bytes.fromhex(piece)), label) for piece, label in case]
    got = [(len(row.raw), ",".join(row.faults)) for row in rows]
    assert len(got) >= len(expected)
    assert sum(length for length, _ in got) == sum(length for length, _ in expected)
    at = 0
    for length, label in expected:
        inside: list[str] = []
        end = at + length
        while at < end:
            size, faults = got.pop(0)
            inside.append(faults)
            at += size
        assert at == end, label
        assert set(inside) <= (set(label.split()) or {""})
        assert len(inside) == 1 or len(label.split()) > 1


@pytest.mark.parametrize("name", CASES)
def test_whole(name: str) -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, _bytes(CASES[name])))
    _check(CASES[name], rows + framer.flush())


@pytest.mark.parametrize("name", CASES)
def test_byte_by_byte(name: str) -> None:
    framer, rows = Framer("p"), []
    for byte in _bytes(CASES[name]):
        rows += framer.feed(Chunk("p", None, bytes([byte])))
    _check(CASES[name], rows + framer.flush())


@pytest.mark.parametrize("name", CASES)
def test_with_trailing_data(name: str) -> None:
    case = CASES[name] + TRAILING
    framer = Framer("p")
    _check(case, framer.feed(Chunk("p", None, _bytes(case))) + framer.flush())


def test_framed_rows_are_frames_and_the_rest_is_damage() -> None:
    framed = {"", "ambiguous", "unknown_cmd", "bad_motor", "reserved_nonzero", "undefined_flags"}
    for case in CASES.values():
        framer = Framer("p")
        for row in framer.feed(Chunk("p", None, _bytes(case))) + framer.flush():
            faults = ",".join(row.faults)
            assert isinstance(row, Frame if faults in framed else Damage)


UNDECIDABLE = bytes.fromhex("AA 02 03 EE AA 02 01 03 E8 EE")
"""PROTOCOL.md, "Why framing is hard here": repeated, it is also the repetition of another frame."""


def test_the_undecidable_stream_says_so() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, UNDECIDABLE * 30)) + framer.flush()
    assert len(rows) == 30
    assert all(row.faults == (Fault.AMBIGUOUS,) for row in rows)


@pytest.mark.parametrize("shift", [0, 4])
def test_silence_decides_the_undecidable_stream(shift: int) -> None:
    framer, rows, t_ns = Framer("p"), [], 10**18
    stream = UNDECIDABLE * 20
    cuts = [shift, *range(shift + 10, len(stream), 10)]
    for start, stop in pairwise(cuts):
        t_ns += 3_000_000
        rows += framer.feed(Chunk("p", t_ns, stream[start:stop]))
    rows += framer.flush()
    assert all(isinstance(row, Frame) for row in rows)
    assert [row.faults for row in rows[3:-1]] == [()] * (len(rows) - 4)


@pytest.mark.parametrize("flags", USUAL_FLAGS, ids=bytes.hex)
@pytest.mark.parametrize("apart_ns", [None, 900_000, 5_000_000, 30_000_000])
def test_a_calm_line_may_say_the_same_for_ever(flags: bytes, apart_ns: int | None) -> None:
    """A target whose last bytes are another kind's flags is no reason for doubt each time."""
    frame = b"\xaa\x02\x01\x03\xe8\x00\x00" + flags + b"\xee"
    framer, rows = Framer("p"), []
    for number in range(300):
        t_ns = None if apart_ns is None else 10**18 + number * apart_ns
        rows += framer.feed(Chunk("p", t_ns, frame))
    rows += framer.flush()
    assert [(row.raw, row.faults) for row in rows] == [(frame, ())] * 300


@pytest.mark.parametrize(
    "frame",
    [
        "AA 03 00 EE 55 01 04 00 0F EE",
        "AA 02 01 03 EE 55 01 04 0F EE",
        "AA 03 00 55 EE 55 01 03 03 EE",
        "AA 03 55 EE 55 01 03 03 0F EE",
        "AA 03 EE 55 02 04 04 0F 00 EE",
        "AA 03 00 EE 55 02 04 04 0F EE",
    ],
)
@pytest.mark.parametrize("apart_ns", [None, 868_060, 1_900_000, 30_000_000])
def test_a_calm_line_is_not_called_damaged_for_what_it_carries(
    frame: str, apart_ns: int | None
) -> None:
    """Two truncated frames together would be as long; but this line has shown no damage."""
    stream = [bytes.fromhex(frame), bytes.fromhex(SPEED)] * 30
    framer, rows = Framer("p"), []
    for number, raw in enumerate(stream):
        t_ns = None if apart_ns is None else 10**18 + number * apart_ns
        rows += framer.feed(Chunk("p", t_ns, raw))
    rows += framer.flush()
    assert [row.raw for row in rows] == stream
    assert {row.faults for row in rows if row.raw == stream[1]} == {()}
    assert {row.faults for row in rows} <= {(), (Fault.AMBIGUOUS,)}


def test_behind_damage_such_a_frame_is_doubted_until_the_line_is_calm_again() -> None:
    plain, doubted = bytes.fromhex(SPEED), bytes.fromhex("AA 02 01 03 E8 00 00 00 0F EE")
    stream = plain * 3 + plain[:7] + (plain * 20 + doubted) * 10
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
    assert [row.faults for row in rows if row.raw == plain] == [()] * 203
    told = [row.faults for row in rows if row.raw == doubted]
    assert told[0] == (Fault.AMBIGUOUS,)
    assert told[5:] == [()] * 5


TWO_READINGS = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")
"""A frame, or two truncated ones, each with more of a frame's own bytes than the one has."""


def test_what_is_both_one_frame_and_two_truncated_ones_is_read_by_what_is_before() -> None:
    def told(stream: bytes) -> list[tuple[int, tuple[Fault, ...]]]:
        framer = Framer("p")
        rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
        return [(len(row.raw), row.faults) for row in rows]

    assert told(TWO_READINGS) == [(10, (Fault.AMBIGUOUS,))]
    assert told(b"\x00\x00" + TWO_READINGS) == [(6, (Fault.NOISE,)), (6, (Fault.TRUNCATED,))]


def test_silence_tells_one_frame_from_two_truncated_ones() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", 10**18, b"\x00\x00"))
    rows += framer.feed(Chunk("p", 10**18 + 25_000_000, TWO_READINGS)) + framer.flush()
    assert [row.raw for row in rows] == [b"\x00\x00", TWO_READINGS]


@pytest.mark.parametrize("unit", ["55 02", "AA 01", "55 02 01", "55 02 01 03"])
def test_endless_stubs_of_frames_become_noise(unit: str) -> None:
    raw = bytes.fromhex(unit)
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, raw * 100)) + framer.feed(Chunk("p", None, raw * 900))
    assert [(row.raw, row.faults) for row in rows[:4]] == [(raw, (Fault.TRUNCATED,))] * 4
    assert {row.faults for row in rows[4:]} == {(Fault.NOISE,)}
    assert len(rows) < 10


def test_stubs_are_told_again_after_a_frame() -> None:
    framer = Framer("p")
    stub, frame = bytes.fromhex("55 02"), bytes.fromhex(SPEED)
    rows = framer.feed(Chunk("p", None, (frame * 3 + stub) * 8 + frame * 3)) + framer.flush()
    assert [row.faults for row in rows if row.raw == stub] == [(Fault.TRUNCATED,)] * 8
