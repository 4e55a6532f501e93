"""The framer as a whole: named cases, properties, times, silence, quality.

A case is a line of segments; each one is written with the faults that its rows must have.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from itertools import pairwise
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol import framer as framer_module
from fte_sniff.protocol.framer import KNOWN, Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import MOST_BYTES, Row
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    HEADER_BYTES,
    TAIL,
    Fault,
    byte_time_ns,
)
from tests.examples import examples
from tests.protocol.streams import raw_bytes, rows_of
from tests.support.faults import PAYLOADS, RESERVES, damaged_stream, draw_frame
from tests.support.score import labels, score

MS = 1_000_000
BYTE_NS = byte_time_ns(DEFAULT_BAUD)
START = 1_700_000_000_000_000_000
NOISE = (Fault.NOISE,)


def framed(chunks: Sequence[Chunk]) -> list[Row]:
    """The rows of these chunks, drained after each."""
    framer, rows = Framer("p"), list[Row]()
    for chunk in chunks:
        framer.push(chunk)
        rows += framer.drain()
    return rows + list(framer.finish())


# Named cases

SPEED = "AA 01 01 03 E8 00 00 00 00 EE"
POSITION = "AA 02 02 03 E8 00 00 27 10 EE"
FEEDBACK = "55 01 01 03 E8 00 00 00 0F EE"
PLACE = "55 02 01 00 00 27 10 00 0F EE"
RESET = "AA 00 00 00 00 00 00 00 00 EE"
TRAILING = [(FEEDBACK, ""), (SPEED, ""), (POSITION, "")]


def between(damage: str, label: str) -> list[tuple[str, str]]:
    return [(SPEED, ""), (damage, label), (SPEED, "")]


CASES: dict[str, list[tuple[str, str]]] = {
    "clean": [(SPEED, ""), (FEEDBACK, ""), (RESET, "")],
    "tail lost": between("AA 01 01 03 E8 00 00 00 00", "truncated"),
    "only the header left": [(SPEED, ""), ("AA", "truncated"), (FEEDBACK, "")],
    "middle lost": between("AA 02 02 03 10 EE", "truncated"),
    "header lost": between("02 02 03 E8 00 00 27 10 EE", "noise"),
    "only the tail left": [(PLACE, ""), ("EE", "noise"), (SPEED, "")],
    "one byte inserted": between("AA 01 01 03 77 E8 00 00 00 00 EE", "overlong"),
    "four bytes inserted": between("55 01 01 03 E8 12 34 56 78 00 00 00 0F EE", "overlong"),
    "header changed": between("AB 02 02 03 E8 00 00 27 10 EE", "bad_header"),
    "tail changed": between("AA 02 02 03 E8 00 00 27 10 EF", "bad_tail"),
    "cmd changed": between("AA 42 02 03 E8 00 00 27 10 EE", "unknown_cmd"),
    "reset as feedback": between("55 00 01 03 E8 00 00 00 0F EE", "unknown_cmd"),
    "motor 0": between("AA 02 00 03 E8 00 00 27 10 EE", "bad_motor"),
    "motor 5": between("55 02 05 00 00 27 10 00 0F EE", "bad_motor"),
    "reserve set after eight frames with 00": [
        *[(SPEED, "")] * KNOWN,
        ("AA 01 01 03 E8 00 01 00 00 EE", "reserved_nonzero"),
        (SPEED, ""),
        ("AA 00 00 00 00 00 01 00 00 EE", ""),
    ],
    "reserve set after seven": [
        *[(SPEED, "")] * (KNOWN - 1),
        ("AA 01 01 03 E8 00 01 00 00 EE", ""),
        (SPEED, ""),
    ],
    "reserve set where it is always something else": [
        *[("AA 01 01 03 E8 FF FF FF FF EE", "")] * KNOWN,
        ("AA 01 01 03 E8 00 01 00 00 EE", ""),
        (SPEED, ""),
        (RESET, ""),
    ],
    "reserve of speed feedback": between("55 01 01 03 E8 12 34 00 0F EE", "reserved_nonzero"),
    "undefined flag": between("55 01 01 03 E8 00 00 00 8F EE", "undefined_flags"),
    "two faults": between("55 01 07 03 E8 00 00 00 8F EE", "bad_motor,undefined_flags"),
    "any error flag": [
        (SPEED, ""),
        *((f"55 01 01 03 E8 00 00 {1 << bit:02X} 0F EE", "") for bit in range(8)),
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
    "a frame that ends as only another kind does": between("AA 02 04 FF 59 FF FE 00 0F EE", ""),
    "such a frame alone": [("AA 02 01 03 E8 00 00 00 0F EE", "")],
    "any NUM that means nothing": between("AA 03 EE 00 84 00 10 00 20 EE", ""),
    "a frame that is not in the protocol, alone": [
        ("AA 09 01 02 03 04 05 06 07 EE", "unknown_cmd")
    ],
    "noise longer than a row": [
        (SPEED, ""),
        *[("11 22 33 44" * 4, "noise")] * 2,
        ("11 22 33", "noise"),
        (SPEED, ""),
        (SPEED, ""),
    ],
}


def _bytes(case: list[tuple[str, str]]) -> bytes:
    return b"".join(bytes.fromhex(segment) for segment, _ in case)


def _check(case: list[tuple[str, str]], rows: list[Row]) -> None:
    """Fails unless the rows cut the stream at the segments, with their faults."""
    assert b"".join(row.raw for row in rows) == _bytes(case)
    at, left = 0, list(rows)
    for segment, label in case:
        at += len(bytes.fromhex(segment))
        inside = []
        while left and left[0].offset < at:
            inside.append(left.pop(0))
        assert inside[-1].offset + len(inside[-1].raw) == at, label
        assert {",".join(row.faults) for row in inside} <= (set(label.split()) or {""})
        assert len(inside) == 1 or len(label.split()) > 1


@pytest.mark.parametrize("name", CASES)
def test_case(name: str) -> None:
    """Alone, byte by byte, and before other frames."""
    case = CASES[name]
    _check(case, rows_of(_bytes(case)))
    _check(case, rows_of(_bytes(case), 1))
    _check(case + TRAILING, rows_of(_bytes(case + TRAILING)))


UNDECIDABLE = bytes.fromhex("AA 02 03 EE AA 02 01 03 E8 EE")
"""Repeated, it is also the repetition of another frame.

See docs/reference/protocol.md, "Why frames are hard to find".
"""


def test_the_undecidable_stream_is_ambiguous() -> None:
    rows = rows_of(UNDECIDABLE * 30)
    assert [row.raw for row in rows] == [UNDECIDABLE] * 30
    assert {row.faults for row in rows[1:]} == {(Fault.AMBIGUOUS,)}


def test_silence_decides_the_undecidable_stream() -> None:
    for shift in (0, 4):
        stream = UNDECIDABLE * 20
        cuts = [0, shift, *range(shift + 10, len(stream), 10), len(stream)]
        chunks = [
            Chunk("p", START + number * 30 * MS, stream[start:stop])
            for number, (start, stop) in enumerate(pairwise(cuts))
        ]
        rows = [row for row in framed(chunks) if shift + 10 <= row.offset < len(stream) - 10]
        assert {row.offset % 10 for row in rows} == {shift}
        assert {(len(row.raw), row.faults) for row in rows} == {(10, ())}


def test_a_frame_may_be_repeated_for_ever() -> None:
    frame = bytes.fromhex("AA 02 01 03 E8 00 00 00 0F EE")
    for apart_ns in (None, 900_000, 30 * MS):
        chunks = [
            Chunk("p", None if apart_ns is None else START + number * apart_ns, frame)
            for number in range(300)
        ]
        assert [(row.raw, row.faults) for row in framed(chunks)] == [(frame, ())] * 300


# Properties


DAMAGES = {Fault.NOISE, Fault.TRUNCATED, Fault.OVERLONG, Fault.BAD_HEADER, Fault.BAD_TAIL}


@examples(150)
@given(raw_bytes, st.integers(1, 50))
def test_rows_cover_the_stream(data: bytes, size: int) -> None:
    rows, at = rows_of(data, size), 0
    for row in rows:
        assert (row.port, row.offset) == ("p", at)
        assert 1 <= len(row.raw) <= MOST_BYTES
        if row.framed:
            assert len(row.raw) == FRAME_LENGTH
            assert (row.raw[0] in HEADER_BYTES, row.raw[-1]) == (True, TAIL)
            assert DAMAGES.isdisjoint(row.faults)
        else:
            assert not DAMAGES.isdisjoint(row.faults)
        at += len(row.raw)
    assert b"".join(row.raw for row in rows) == data


@given(raw_bytes)
def test_bytes_of_rows_are_padded_with_zeros(data: bytes) -> None:
    framer = Framer("p")
    framer.push(Chunk("p", None, data))
    rows = framer.finish()
    assert not rows.raw[np.arange(MOST_BYTES) >= rows.length[:, None]].any()


@st.composite
def timed_chunks(draw: st.DrawFn) -> list[Chunk]:
    """Chunks with bursts, pauses, silence, and late reads."""
    data = draw(raw_bytes)
    cuts = sorted(draw(st.sets(st.integers(0, len(data)), max_size=6)) | {0, len(data)})
    chunks, now, timed = list[Chunk](), 10_000 * MS, draw(st.booleans())
    for start, stop in pairwise(cuts):
        pause = draw(st.sampled_from([0, 0, BYTE_NS, 5 * MS, 25 * MS, 600 * MS]))
        late = draw(st.sampled_from([1.0, 1.0, 0.5]))
        now += pause + int((stop - start) * BYTE_NS * late)
        chunks.append(Chunk("p", now if timed else None, data[start:stop]))
    return chunks


@st.composite
def cut_differently(draw: st.DrawFn) -> tuple[list[Chunk], list[Chunk]]:
    """Chunks, and others of equal bytes and times, with empty chunks in the silences."""
    chunks, other, last = draw(timed_chunks()), list[Chunk](), None
    for chunk in chunks:
        size = len(chunk.data)
        if chunk.t_ns is not None and last is not None:
            began = chunk.t_ns - size * BYTE_NS
            other += [Chunk("p", beat, b"") for beat in range(last + 10 * MS, began + 1, 10 * MS)]
        cuts = sorted(draw(st.sets(st.integers(1, max(1, size - 1)), max_size=4)))
        if draw(st.integers(0, 3)) == 3:
            cuts = list(range(1, size))
        for start, stop in pairwise([0, *(cut for cut in cuts if 0 < cut < size), size]):
            t_ns = None if chunk.t_ns is None else chunk.t_ns - (size - stop) * BYTE_NS
            other.append(Chunk("p", t_ns, chunk.data[start:stop]))
        last = chunk.t_ns if chunk.t_ns is None or last is None else max(last, chunk.t_ns)
    return chunks, other


@examples(300)
@given(cut_differently(), st.booleans())
def test_cutting_into_other_chunks_gives_the_same_rows(
    both: tuple[list[Chunk], list[Chunk]], drained_once: bool
) -> None:
    chunks, other = both
    if drained_once:
        framer = Framer("p")
        for chunk in chunks:
            framer.push(chunk)
        assert list(framer.finish()) == framed(other)
    else:
        assert framed(chunks) == framed(other)


@examples(30)
@given(
    st.integers(0, 10_000),
    st.sampled_from([0.05, 0.3, 1.0]),
    st.sampled_from(sorted(PAYLOADS)),
    st.sampled_from(sorted(RESERVES)),
    st.integers(1, 300),
)
def test_long_streams_have_the_same_rows_in_any_chunks(
    seed: int, share: float, payload: str, reserve: str, size: int
) -> None:
    stream = damaged_stream(seed, 150, share, payload, reserve)[0] + UNDECIDABLE * 20
    rows = rows_of(stream)
    assert rows_of(stream, size) == rows
    assert b"".join(row.raw for row in rows) == stream


def clear_frames(seed: int, count: int) -> list[bytes]:
    """Legal frames with ordinary values and no header or tail inside."""
    random, frames = Random(seed), list[bytes]()
    while len(frames) < count:
        raw = draw_frame(random, PAYLOADS["ordinary"])
        if {*HEADER_BYTES, TAIL}.isdisjoint(raw[1:-1]):
            frames.append(raw)
    return frames


@st.composite
def one_damaged(draw: st.DrawFn) -> tuple[list[bytes], int, bytes]:
    """Whole frames, the number of one of them, and its bytes after damage."""
    frames = clear_frames(draw(st.integers(0, 10_000)), 12)
    number = draw(st.integers(3, 8))
    raw = frames[number]
    count = draw(st.integers(1, FRAME_LENGTH - 1))
    start = draw(st.integers(0, FRAME_LENGTH - count))
    inserted = draw(st.binary(max_size=min(4, count)))
    plain = bytes(byte for byte in inserted if byte not in (*HEADER_BYTES, TAIL))
    return frames, number, raw[:start] + plain + raw[start + count :]


@examples(150)
@given(one_damaged())
def test_a_damaged_frame_costs_only_itself(case: tuple[list[bytes], int, bytes]) -> None:
    frames, number, became = case
    rows = rows_of(b"".join((*frames[:number], became, *frames[number + 1 :])))
    found = [row.raw for row in rows if row.framed]
    for index, raw in enumerate(frames):
        if index != number:
            assert found.count(raw) >= frames.count(raw) - (raw == frames[number])
    assert len(found) in (len(frames) - 1, len(frames))


@examples(150)
@given(st.integers(0, 10_000), st.integers(0, 8), st.binary(min_size=1, max_size=200))
def test_junk_before_a_frame_never_costs_the_frame(seed: int, number: int, junk: bytes) -> None:
    frames = clear_frames(seed, 12)
    before, after = b"".join(frames[:number]), b"".join(frames[number:])
    starts = {row.offset for row in rows_of(before + junk + after) if row.framed}
    first = len(before) + len(junk)
    assert set(range(first, first + len(after), FRAME_LENGTH)) <= starts


@examples(150)
@given(st.integers(0, 100_000), st.integers(1, 12), st.sampled_from(sorted(PAYLOADS)))
def test_legal_frames_are_read_back(seed: int, count: int, payload: str) -> None:
    random = Random(seed)
    frames = [draw_frame(random, PAYLOADS[payload]) for _ in range(count)]
    rows = rows_of(b"".join(frames))
    assert [row.raw for row in rows] == frames
    assert {row.framed for row in rows} == {True}
    assert {fault for row in rows for fault in row.faults} <= {Fault.AMBIGUOUS}


# Times and silence

FRAME = bytes.fromhex(SPEED)


@pytest.mark.parametrize("baud", [0, -115_200])
def test_a_baud_below_1_is_refused(baud: int) -> None:
    with pytest.raises(ValueRangeError, match=f"baud {baud} is out of range"):
        Framer("p", baud)
    with pytest.raises(ValueRangeError, match=f"baud {baud} is out of range"):
        Framer("p").set_baud(baud)


@given(
    st.lists(
        st.tuples(
            st.none() | st.integers(-5 * MS, 30 * MS),
            st.integers(1, 25),
            st.booleans(),
            st.sampled_from([9600, DEFAULT_BAUD]),
        ),
        max_size=20,
    )
)
def test_a_row_begins_its_bytes_before_the_read_but_not_before_the_read_before(
    reads: list[tuple[int | None, int, bool, int]],
) -> None:
    framer, now, floor = Framer("p"), START, 0
    times: list[tuple[int | None, int | None]] = []
    for step, size, at_once, baud in reads:
        framer.set_baud(baud)
        now += step or 0
        framer.push(Chunk("p", None if step is None else now, (FRAME * 3)[:size], at_once=at_once))
        byte_ns = 0 if at_once else byte_time_ns(baud)
        began = [max(floor, now - count * byte_ns) for count in range(size, 0, -1)]
        known = [(t_ns, max(0, now - t_ns)) for t_ns in began]
        times += [(None, None)] * size if step is None else known
        floor = floor if step is None else max(floor, now)
    rows = framer.finish()
    assert [(row.t_ns, row.delay_ns) for row in rows] == [times[row.offset] for row in rows]
    known_times = [row.t_ns for row in rows if row.t_ns is not None]
    assert known_times == sorted(known_times)


def after_silence(data: bytes, silence_ms: int) -> list[tuple[bytes, tuple[Fault, ...]]]:
    """The rows that a silence decides behind frames and these bytes."""
    framer = Framer("p")
    framer.push(Chunk("p", START, FRAME * 3 + data))
    framer.drain()
    framer.push(Chunk("p", START + silence_ms * MS, b""))
    return [(row.raw, row.faults) for row in framer.drain()]


@given(st.integers(1, 40), st.binary(max_size=20))
def test_silence_of_20_ms_decides_the_last_frame(frames: int, junk: bytes) -> None:
    framer = Framer("p")
    framer.push(Chunk("p", START, FRAME * frames + junk + FRAME))
    framer.push(Chunk("p", START + 20 * MS, b""))
    assert framer.drain()[-1].raw == FRAME
    assert not len(framer.finish())


def test_silence_decides_noise_and_the_start_of_a_frame_after_half_a_second() -> None:
    assert after_silence(b"\x12\x34\x56", 19) == []
    assert after_silence(b"\x12\x34\x56", 20)[-1] == (b"\x12\x34\x56", NOISE)
    assert after_silence(FRAME[:4], 499) == [(FRAME, ())]
    assert after_silence(FRAME[:4], 500)[-1] == (FRAME[:4], (Fault.TRUNCATED,))
    assert after_silence(b"\x77" + FRAME[:4], 499)[-1] == (b"\x77", NOISE)
    assert after_silence(bytes(100), 25)[-1] == (bytes(4), NOISE)


@pytest.mark.parametrize("cut", range(1, FRAME_LENGTH))
def test_a_delayed_reader_cuts_no_frame(cut: int) -> None:
    chunks = [
        Chunk("p", START, FRAME * 3 + FRAME[:cut]),
        Chunk("p", START + 50 * MS, b""),
        Chunk("p", START + 120 * MS, FRAME[cut:] + FRAME),
    ]
    assert [(row.raw, row.faults) for row in framed(chunks)] == [(FRAME, ())] * 5


def test_a_late_read_is_no_silence() -> None:
    late = Chunk("p", START + 700 * MS, FRAME[4:] + FRAME, is_late=True)
    rows = framed([Chunk("p", START, FRAME * 3 + FRAME[:4]), late])
    assert [row.raw for row in rows] == [FRAME] * 5


def test_silence_ends_a_run_of_noise() -> None:
    chunks = [Chunk("p", START, bytes(20)), Chunk("p", START + 100 * MS, bytes(20))]
    assert [(len(row.raw), row.faults) for row in framed(chunks)] == [
        (16, NOISE), (4, NOISE), (16, NOISE), (4, NOISE)
    ]  # fmt: skip


@pytest.mark.parametrize(
    "unit", ["AA", "EE", "00", "55 02", "AA 02 03 EE 55 02 01 03 E8 EE", "AA EE"]
)
def test_few_bytes_wait(unit: str) -> None:
    """Whatever comes: memory is bounded, and what was received is soon in a row."""
    framer, size, given = Framer("p"), 0, 0
    for _ in range(8):
        data = bytes.fromhex(unit) * 300
        framer.push(Chunk("p", None, data))
        size += len(data)
        given += int(framer.drain().length.sum())
        assert size - given <= 160
    framer.push(Chunk("p", None, FRAME * 3))
    assert [row.raw for row in framer.finish()][-3:] == [FRAME] * 3


pieces = [FRAME, FRAME[:4], FRAME[4:], b"\xaa", b"\xee", b"\x00\x17", b"\x55\x01"]
restarted_streams = st.lists(st.sampled_from(pieces)).map(b"".join)


@given(restarted_streams, restarted_streams)
def test_after_a_restart_rows_are_as_at_the_start_of_a_stream(first: bytes, second: bytes) -> None:
    restarted, fresh = Framer("p"), Framer("p")
    restarted.push(Chunk("p", 100 * MS, first))
    assert restarted.finish().tobytes() == first
    for framer in (restarted, fresh):
        framer.push(Chunk("p", 5000 * MS, second))
    after, expected = restarted.finish(), fresh.finish()
    assert [(row.offset - len(first), row.raw, row.faults, row.t_ns) for row in after] == [
        (row.offset, row.raw, row.faults, row.t_ns) for row in expected
    ]


@given(restarted_streams, st.lists(st.integers(0, 40)))
def test_pending_since_is_the_time_of_the_first_byte_in_no_row(
    stream: bytes, cuts: list[int]
) -> None:
    framer, t_ns, size, given = Framer("p"), 10**18, 0, 0
    began: list[int] = []
    for length in (*cuts, len(stream)):
        data = stream[size : size + length]
        size += len(data)
        floor, t_ns = t_ns, t_ns + 15 * MS
        began += [max(floor, t_ns - n * BYTE_NS) for n in range(len(data), 0, -1)]
        framer.push(Chunk("p", t_ns, data))
        given += int(framer.drain().length.sum())
        expected = None if given == size else max(began[given], 10**18)
        assert framer.pending_since_ns == expected
    framer.finish()
    assert framer.pending_since_ns is None


@given(
    st.binary(max_size=60),
    st.sets(st.integers(0, 30)),
    st.sets(st.integers(0, 30)),
    st.integers(1, 30),
)
def test_line_errors_mark_the_rows_of_their_bytes_and_the_next_one(
    noise: bytes, errors: set[int], errors_before: set[int], size: int
) -> None:
    """Errors are counted with a read, or with an empty one before it."""
    data, chunks, wrong = FRAME * 2 + noise + FRAME, list[Chunk](), set[int]()
    for number, start in enumerate(range(0, len(data), size)):
        if number in errors_before:
            chunks.append(Chunk("p", None, b"", has_line_errors=True))
            wrong.add(start)
        read = data[start : start + size]
        chunks.append(Chunk("p", None, read, has_line_errors=number in errors))
        wrong |= set(range(start, start + len(read) + 1)) if number in errors else set()
    for row in framed(chunks):
        hit = not wrong.isdisjoint(range(row.offset, row.offset + len(row.raw)))
        assert (Fault.LINE_ERROR in row.faults) == hit
        assert row.faults[-1:] == (Fault.LINE_ERROR,) or not hit


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
        "lost, header too": "noise",
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
    for _ in range(200):
        frames = [draw_frame(random, PAYLOADS["ordinary"]) for _ in range(8)]
        cut = random.randrange(1, 2 * FRAME_LENGTH)
        first = -cut % FRAME_LENGTH
        starts = [row.offset for row in rows_of(b"".join(frames)[cut:]) if row.framed]
        assert starts == list(range(first, 8 * FRAME_LENGTH - cut, FRAME_LENGTH))


@pytest.mark.parametrize("payload", PAYLOADS)
@pytest.mark.parametrize("reserve", RESERVES)
def test_frames_with_any_reserve_are_found(reserve: str, payload: str) -> None:
    for share in (0.0, 0.2):
        stream, sent = damaged_stream(1, 3000, share, payload, reserve)
        judged = score(sent, rows_of(stream))
        assert judged.found_share >= (0.9995 if share else 1.0)
        assert judged.invented_ok <= (1 if share else 0)
        assert judged.doubted_share <= 0.03


def test_the_memory_of_a_framer_does_not_grow_with_the_number_of_its_chunks() -> None:
    framer, frame, sizes = Framer("p"), bytes.fromhex(SPEED), list[int]()
    ours = tracemalloc.Filter(True, framer_module.__file__)
    tracemalloc.start()
    try:
        for number in range(600):
            framer.push(Chunk("p", START + number * MS, frame))
            framer.drain()
            if number in (200, 599):
                own = tracemalloc.take_snapshot().filter_traces([ours])
                sizes.append(sum(one.size for one in own.traces))
    finally:
        tracemalloc.stop()
    assert sizes[1] - sizes[0] < 5_000
