"""The framer as a whole: named cases, properties, scheduling, restarts.

A case is a line of segments; each one is written with the faults its row must have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fte_sniff.protocol.framer.framer as framer_module
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    Chunk,
    Damage,
    Fault,
    Frame,
    Framer,
    Row,
    byte_time_ns,
)
from fte_sniff.protocol.framer import FTE_TABLES, FrameTables
from fte_sniff.protocol.framer.model import EXTRA, KNOWN
from tests.examples import examples
from tests.protocol import oracle
from tests.protocol.oracle import USUAL_FLAGS
from tests.protocol.streams import (
    FORMATS,
    TABLES,
    draw_format_frame,
    near_frames,
    near_frames_of,
    raw_bytes,
    streams_of,
)
from tests.support.faults import PAYLOADS, draw_frame

# Named cases

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
    "reserve set where it is always 00": [
        *[(SPEED, "")] * KNOWN,
        ("AA 01 01 03 E8 00 01 00 00 EE", "reserved_nonzero"),
        ("AA 00 00 00 00 00 01 00 00 EE", "reserved_nonzero"),
        (SPEED, ""),
    ],
    "reserve set where it is always something else": [
        *[("AA 01 01 03 E8 FF FF FF FF EE", "")] * KNOWN,
        ("AA 01 01 03 E8 00 01 00 00 EE", ""),
        (SPEED, ""),
        (RESET, ""),
    ],
    "reserve set where nothing is known": [
        (SPEED, ""),
        ("AA 01 01 03 E8 12 34 00 00 EE", ""),
        (RESET, ""),
        ("AA 00 77 12 34 00 00 77 00 EE", ""),
        (SPEED, ""),
    ],
    "reserve of speed feedback": [
        (SPEED, ""),
        ("55 01 01 03 E8 12 34 00 0F EE", "reserved_nonzero"),
        (SPEED, ""),
    ],
    "undefined flag": [
        (SPEED, ""),
        ("55 01 01 03 E8 00 00 00 8F EE", "undefined_flags"),
        (SPEED, ""),
    ],
    "any error flag": [
        (SPEED, ""),
        *((f"55 01 01 03 E8 00 00 {error:02X} 0F EE", "") for error in range(256)),
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
    "started within a frame": [("27 10 00 0F EE", "noise"), (PLACE, ""), (PLACE, "")],
    "started where a payload imitates a header": [
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
        *[(SPEED, "")] * KNOWN,
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
    "after damage, a frame that ends as only another kind does": [
        (SPEED, ""),
        ("55 01 04 16 AC 20 44 00 00 0F EE", "overlong"),
        ("AA 02 02 FB 09 FF CC 00 0F EE", "ambiguous"),
        (FEEDBACK, ""),
    ],
    "a header for a NUM that means nothing": [
        *[(SPEED, "")] * KNOWN,
        ("AA 03 AA FF 93 00 00 00 00 EE", "ambiguous"),
        (SPEED, ""),
    ],
    "a tail for a NUM that means nothing": [
        *[(SPEED, "")] * KNOWN,
        ("AA 03 EE 00 84 00 00 00 00 EE", "ambiguous"),
        (SPEED, ""),
    ],
    "any other NUM that means nothing": [
        (SPEED, ""),
        ("AA 03 77 00 84 00 10 00 20 EE", ""),
        (SPEED, ""),
    ],
    "a frame that is not in the protocol, alone": [
        ("AA 09 01 02 03 04 05 06 07 EE", "unknown_cmd")
    ],
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
def test_case(name: str) -> None:
    """Alone, byte by byte, and before other frames."""
    case = CASES[name]
    data = _bytes(case)
    _check(case, _rows_of([data]))
    _check(case, _rows_of([bytes([byte]) for byte in data]))
    _check(case + TRAILING, _rows_of([_bytes(case + TRAILING)]))


def _rows_of(reads: list[bytes]) -> list[Row]:
    framer = Framer("p")
    return [row for data in reads for row in framer.feed(Chunk("p", None, data))] + framer.flush()


def test_framed_rows_are_frames_and_the_rest_is_damage() -> None:
    framed = {"", "ambiguous", "unknown_cmd", "bad_motor", "reserved_nonzero", "undefined_flags"}
    for case in CASES.values():
        framer = Framer("p")
        for row in framer.feed(Chunk("p", None, _bytes(case))) + framer.flush():
            faults = ",".join(row.faults)
            assert isinstance(row, Frame if faults in framed else Damage)


UNDECIDABLE = bytes.fromhex("AA 02 03 EE AA 02 01 03 E8 EE")
"""Repeated, it is also the repetition of another frame.

See docs/reference/protocol.md, "Why frames are hard to find".
"""


def test_the_undecidable_stream_is_marked() -> None:
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
def test_a_calm_line_may_repeat_a_frame_for_ever(flags: bytes, apart_ns: int | None) -> None:
    """A target whose last bytes are another kind's flags is not a reason for doubt each time."""
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


def test_after_damage_such_a_frame_is_doubted_until_the_line_is_calm_again() -> None:
    plain, doubted = bytes.fromhex(SPEED), bytes.fromhex("AA 02 01 03 E8 00 00 00 0F EE")
    stream = plain * 3 + plain[:7] + (plain * 20 + doubted) * 10
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
    assert [row.faults for row in rows if row.raw == plain] == [()] * 203
    reported = [row.faults for row in rows if row.raw == doubted]
    assert reported[0] == (Fault.AMBIGUOUS,)
    assert reported[5:] == [()] * 5


TWO_READINGS = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")
"""A frame, or two truncated ones, each with more of a frame's own bytes than the one has."""


def test_what_is_both_one_frame_and_two_truncated_ones_is_read_by_what_is_before() -> None:
    def reported(stream: bytes) -> list[tuple[int, tuple[Fault, ...]]]:
        framer = Framer("p")
        rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
        return [(len(row.raw), row.faults) for row in rows]

    assert reported(TWO_READINGS) == [(10, (Fault.AMBIGUOUS,))]
    assert reported(b"\x00\x00" + TWO_READINGS) == [(6, (Fault.NOISE,)), (6, (Fault.TRUNCATED,))]


def test_silence_distinguishes_one_frame_from_two_truncated_ones() -> None:
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


def test_stubs_are_recognized_again_after_a_frame() -> None:
    framer = Framer("p")
    stub, frame = bytes.fromhex("55 02"), bytes.fromhex(SPEED)
    rows = framer.feed(Chunk("p", None, (frame * 3 + stub) * 8 + frame * 3)) + framer.flush()
    assert [row.faults for row in rows if row.raw == stub] == [(Fault.TRUNCATED,)] * 8


# Properties, each for two frame formats

MS = 1_000_000
BYTE_NS = byte_time_ns(DEFAULT_BAUD)

for_each_format = pytest.mark.parametrize("name", FORMATS)


def rows_of(chunks: Sequence[Chunk], name: str = "fte") -> list[Row]:
    framer = Framer("p", tables=TABLES[name])
    rows = [row for chunk in chunks for row in framer.feed(chunk)]
    return rows + framer.flush()


def rows_at_once(stream: bytes, name: str = "fte") -> list[Row]:
    return rows_of([Chunk("p", None, stream)], name)


@for_each_format
@examples(150)
@given(st.data(), st.integers(1, 50))
def test_rows_cover_the_stream(name: str, drawn: st.DataObject, size: int) -> None:
    data = drawn.draw(streams_of(name))
    chunks = [Chunk("p", None, data[at : at + size]) for at in range(0, len(data), size)]
    at = 0
    for row in rows_of(chunks, name):
        assert (row.port, row.offset) == ("p", at)
        assert row.raw
        assert len(row.raw) == FORMATS[name].length or isinstance(row, Damage)
        assert len(row.raw) <= 1024
        at += len(row.raw)
    assert at == len(data)
    assert b"".join(row.raw for row in rows_of(chunks, name)) == data


@st.composite
def timed_chunks(draw: st.DrawFn, name: str) -> list[Chunk]:
    """Chunks with bursts, pauses, silence, and late reads."""
    data = draw(streams_of(name))
    cuts = sorted(draw(st.sets(st.integers(0, max(0, len(data))), max_size=6)) | {0, len(data)})
    chunks: list[Chunk] = []
    now = 10_000 * MS
    timed = draw(st.booleans())
    for start, stop in pairwise(cuts):
        pause = draw(st.sampled_from([0, 0, BYTE_NS, 5 * BYTE_NS, 5 * MS, 25 * MS, 600 * MS]))
        late = draw(st.sampled_from([1.0, 1.0, 0.5]))
        now += pause + int((stop - start) * BYTE_NS * late)
        chunks.append(Chunk("p", now if timed else None, data[start:stop]))
    return chunks


@st.composite
def cut_differently(draw: st.DrawFn, name: str) -> tuple[list[Chunk], list[Chunk]]:
    """Chunks, and others of equal bytes and times, with empty chunks in the silences."""
    chunks = draw(timed_chunks(name))
    other: list[Chunk] = []
    last: int | None = None
    for chunk in chunks:
        size = len(chunk.data)
        if chunk.t_ns is not None and last is not None:
            began = chunk.t_ns - size * BYTE_NS
            for beat in range(last + 10 * MS, began + 1, 10 * MS):
                other.append(Chunk("p", beat, b""))
        if draw(st.booleans()):
            cuts = sorted(draw(st.sets(st.integers(1, max(1, size - 1)), max_size=4)))
        else:
            cuts = list(range(1, size))
        edges = [0, *(cut for cut in cuts if 0 < cut < size), size]
        for start, stop in pairwise(edges):
            t_ns = None if chunk.t_ns is None else chunk.t_ns - (size - stop) * BYTE_NS
            other.append(Chunk("p", t_ns, chunk.data[start:stop]))
        last = chunk.t_ns if chunk.t_ns is None or last is None else max(last, chunk.t_ns)
    return chunks, other


@for_each_format
@examples(150)
@given(st.data())
def test_cutting_into_other_chunks_gives_the_same_rows(name: str, drawn: st.DataObject) -> None:
    chunks, other = drawn.draw(cut_differently(name))
    assert rows_of(chunks, name) == rows_of(other, name)


def draw_frame_of(random: Random, name: str) -> bytes:
    if name == "fte":
        return draw_frame(random, PAYLOADS["ordinary"])
    return draw_format_frame(random, FORMATS[name])


def clear_frames(seed: int, count: int, name: str) -> list[bytes]:
    """Legal frames with ordinary values and no header or tail inside."""
    random, frames = Random(seed), []
    delimiters = {*FORMATS[name].headers.values(), FORMATS[name].tail}
    while len(frames) < count:
        raw = draw_frame_of(random, name)
        if delimiters.isdisjoint(raw[1:-1]):
            frames.append(raw)
    return frames


@st.composite
def one_damaged(draw: st.DrawFn, name: str) -> tuple[list[bytes], int, bytes]:
    """Whole frames, the number of one of them, and its bytes after damage."""
    frame_format = FORMATS[name]
    frames = clear_frames(draw(st.integers(0, 10_000)), 12, name)
    number = draw(st.integers(3, 8))
    raw = frames[number]
    count = draw(st.integers(1, frame_format.length - 1))
    start = draw(st.integers(0, frame_format.length - count))
    inserted = draw(st.binary(max_size=min(4, count)).filter(lambda b: frame_format.tail not in b))
    plain = bytes(byte for byte in inserted if byte not in frame_format.headers.values())
    return frames, number, raw[:start] + plain + raw[start + count :]


@for_each_format
@examples(100)
@given(st.data())
def test_a_damaged_frame_costs_only_itself(name: str, drawn: st.DataObject) -> None:
    frames, number, became = drawn.draw(one_damaged(name))
    stream = b"".join((*frames[:number], became, *frames[number + 1 :]))
    found = [row.raw for row in rows_at_once(stream, name) if isinstance(row, Frame)]
    for index, raw in enumerate(frames):
        if index != number:
            assert found.count(raw) >= frames.count(raw) - (raw == frames[number])
    assert len(found) in (len(frames) - 1, len(frames))


@for_each_format
@examples(100)
@given(st.integers(0, 10_000), st.integers(0, 8), st.binary(min_size=1, max_size=60))
def test_junk_before_a_frame_never_costs_the_frame(
    name: str, seed: int, number: int, junk: bytes
) -> None:
    frames, length = clear_frames(seed, 12, name), FORMATS[name].length
    before, after = b"".join(frames[:number]), b"".join(frames[number:])
    rows = rows_at_once(before + junk + after, name)
    starts = {row.offset for row in rows if isinstance(row, Frame)}
    stop = len(before) + len(junk) + len(after)
    assert set(range(len(before) + len(junk), stop, length)) <= starts


@for_each_format
@examples(100)
@given(st.integers(0, 100_000), st.integers(1, 12))
def test_legal_frames_are_read_back(name: str, seed: int, count: int) -> None:
    random = Random(seed)
    frames = [draw_frame_of(random, name) for _ in range(count)]
    rows = rows_at_once(b"".join(frames), name)
    assert [row.raw for row in rows] == frames
    assert {type(row) for row in rows} == {Frame}
    assert {fault for row in rows for fault in row.faults} <= {Fault.AMBIGUOUS}


def test_damage_of_another_format_is_named() -> None:
    drive = bytes.fromhex("C3 11 02 00000155 00000077 7E")
    damaged = {
        drive[:6]: Fault.TRUNCATED,
        drive[:4] + b"\x44" + drive[4:]: Fault.OVERLONG,
        b"\x44" + drive[1:]: Fault.BAD_HEADER,
        drive[:-1] + b"\x44": Fault.BAD_TAIL,
        b"\xc3\x55" + drive[2:]: Fault.UNKNOWN_CMD,
        drive[:2] + b"\x33" + drive[3:]: Fault.BAD_MOTOR,
        b"\x44\x45\x46": Fault.NOISE,
    }
    stream = drive * 4 + b"".join(raw + drive * 3 for raw in damaged)
    rows = [row for row in rows_at_once(stream, "other") if row.faults]
    assert [(row.raw, row.faults) for row in rows] == [
        (raw, (fault,)) for raw, fault in damaged.items()
    ]


@for_each_format
def test_tables_of_the_same_format_are_equal(name: str) -> None:
    one, other = TABLES[name], FrameTables(FORMATS[name])
    for attribute in ("kind_of", "legal", "byte_scores", "offset_faults", "word_base"):
        assert list(getattr(one, attribute)) == list(getattr(other, attribute))


# Restarts

SPEED_BYTES = bytes.fromhex(SPEED)

restarted_streams = st.lists(
    st.sampled_from(
        [SPEED_BYTES, SPEED_BYTES[:4], SPEED_BYTES[4:], b"\xaa", b"\xee", b"\x00\x17", b"\x55\x01"]
    )
).map(b"".join)


def test_a_truncated_frame_does_not_join_the_bytes_after_a_restart() -> None:
    framer = Framer("p")
    before = framer.feed(Chunk("p", 100 * MS, SPEED_BYTES * 5 + SPEED_BYTES[:6])) + framer.restart()
    # The other four bytes, at once: together they would be a frame.
    after = framer.feed(Chunk("p", 101 * MS, SPEED_BYTES[6:] + SPEED_BYTES * 3)) + framer.flush()
    assert [row.raw for row in before] == [SPEED_BYTES] * 5 + [SPEED_BYTES[:6]]
    assert before[-1].faults == (Fault.TRUNCATED,)
    assert [row.raw for row in after] == [SPEED_BYTES[6:]] + [SPEED_BYTES] * 3


@given(restarted_streams, restarted_streams)
def test_after_a_restart_rows_are_as_at_the_start_of_a_stream(first: bytes, second: bytes) -> None:
    restarted, fresh = Framer("p"), Framer("p")
    before = restarted.feed(Chunk("p", 100 * MS, first)) + restarted.restart()
    assert b"".join(row.raw for row in before) == first
    after = restarted.feed(Chunk("p", 5000 * MS, second)) + restarted.flush()
    expected = fresh.feed(Chunk("p", 5000 * MS, second)) + fresh.flush()
    assert [(row.offset - len(first), row.raw, row.faults, row.t_ns) for row in after] == [
        (row.offset, row.raw, row.faults, row.t_ns) for row in expected
    ]


@given(restarted_streams, st.lists(st.integers(0, 40)))
def test_pending_since_is_the_time_of_the_first_pending_byte(
    stream: bytes, cuts: list[int]
) -> None:
    framer, t_ns, size, given = Framer("p"), 10**18, 0, 0
    began: list[int] = []
    for length in (*cuts, len(stream)):
        data = stream[size : size + length]
        size += len(data)
        floor, t_ns = t_ns, t_ns + 15 * MS
        began += [max(floor, t_ns - n * byte_time_ns(115200)) for n in range(len(data), 0, -1)]
        given += sum(len(row.raw) for row in framer.feed(Chunk("p", t_ns, data)))
        pending = framer.pending_since_ns
        assert (pending is None) is (given == size)
        if pending is not None:
            assert pending == max(began[given], 10**18)
    framer.flush()
    assert framer.pending_since_ns is None


# Scheduling

NEVER = -1
WIDEST = FTE_TABLES.widest
AHEAD = 2 * FRAME_LENGTH

scheduled = st.one_of(near_frames, near_frames, raw_bytes)

NEWS = [(0, 0), (0, 25), (12, 25), (31, 30), (31, 40), (0, -20)]
"""Bytes from the start to the offset where something new can be learnt, and to the decoded end."""


def next_decoding(data: bytes, start: int, not_before: int, decoded_to: int) -> tuple[int, int]:
    limit = min(len(data), start + WIDEST)
    known = limit - EXTRA
    if known < start + 2 * FRAME_LENGTH:
        return NEVER, NEVER
    pair = oracle.UNLEARNED.STRICT_PAIR.search(
        data, max(start, not_before - 2 * FRAME_LENGTH), known
    )
    three = oracle.FRAMED_THREE.match(data, start, known)
    strict = list(oracle.UNLEARNED.STRICT.finditer(data, start, known))
    ends = [found.end() for found in (pair, three, *strict[2:3]) if found]
    arguments = [(end + EXTRA, end) for end in ends if end >= not_before]
    if limit == start + WIDEST:
        arguments.append((limit, limit))
    deadline = next_deadline(data, start, decoded_to, limit)
    if deadline != NEVER:
        arguments.append((deadline, deadline))
    return min(arguments, default=(NEVER, NEVER))


def next_deadline(data: bytes, start: int, decoded_to: int, limit: int) -> int:
    first = max(start, decoded_to + 1 - FRAME_LENGTH - AHEAD)
    framed = oracle.FRAMED.search(data, first, limit - AHEAD) if limit > AHEAD else None
    return framed.end() + AHEAD if framed else NEVER


def test_decoding_waits_as_long_as_the_patterns_need() -> None:
    answers: Counter[str] = Counter()

    def same(data: bytes) -> None:
        for start in range(0, len(data) + 1, 7):
            for not_before, decoded_to in NEWS:
                arguments = (data, start, start + not_before, start + decoded_to)
                expected = next_decoding(*arguments)
                assert framer_module.next_decoding(FTE_TABLES, *arguments) == expected
                answers[_called(expected, start)] += 1

    for seed in range(100):
        same(near_frames_of(seed))
    examples(100)(given(scheduled)(same))()
    assert min(answers[what] for what in ("never", "frames", "deadline", "widest")) > 10


def _called(arguments: tuple[int, int], start: int) -> str:
    place, to = arguments
    if place == NEVER:
        return "never"
    if to < place:
        return "frames"
    return "widest" if place == start + WIDEST else "deadline"


@given(scheduled, st.data())
def test_deadlines_are_where_the_patterns_have_them(data: bytes, drawn: st.DataObject) -> None:
    for start in range(0, len(data) + 1, 3):
        decoded_to = drawn.draw(st.integers(0, len(data)))
        limit = drawn.draw(st.integers(0, len(data)))
        expected = next_deadline(data, start, decoded_to, limit)
        assert framer_module.next_deadline(FTE_TABLES, data, start, decoded_to, limit) == expected


@given(scheduled, st.integers(0, 40))
def test_decoding_starts_after_bytes_past_their_deadline(data: bytes, start: int) -> None:
    for known in range(start, len(data)):
        begin = max(start, known - FTE_TABLES.lead)
        while late := oracle.FRAMED.search(data, begin, max(begin, known - 1)):
            begin = late.start() + 1
        assert framer_module.lead_start(FTE_TABLES, data, start, known) == begin
