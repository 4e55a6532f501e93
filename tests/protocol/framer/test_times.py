"""Times of rows, what silence decides, and rows that are drained at whatever times."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    Chunk,
    Damage,
    Fault,
    Frame,
    Framer,
    Row,
    Rows,
    byte_time_ns,
)
from tests.examples import examples
from tests.protocol.streams import raw_bytes

BYTE_NS = byte_time_ns(DEFAULT_BAUD)
MS = 1_000_000
START = 1_700_000_000_000_000_000
SPEED = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
HOSTILE = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")


def test_bytes_of_a_chunk_at_once_all_have_its_time() -> None:
    framer = Framer("p")
    for chunk in (
        Chunk("p", START, SPEED * 2, at_once=True),
        Chunk("p", START + MS, SPEED * 2),
        Chunk("p", START + 2 * MS, SPEED, at_once=True),
    ):
        framer.push(chunk)
    framer.finish()
    rows = framer.drain()
    first, last = START, START + 2 * MS
    between = [max(START, START + MS - count * FRAME_LENGTH * BYTE_NS) for count in (2, 1)]
    assert [row.t_ns for row in rows] == [first, first, *between, last]
    assert [row.read_delay_ns for row in rows] == [0, 0, *(START + MS - t for t in between), 0]


def _byte_by_byte(framer: Framer, data: bytes) -> list[list[Row]]:
    return [framer.feed(Chunk("p", None, bytes([byte]))) for byte in data]


@pytest.mark.parametrize("baud", [0, -115_200])
def test_a_baud_below_1_is_refused(baud: int) -> None:
    with pytest.raises(ValueRangeError, match=f"baud {baud} is out of range"):
        Framer("p", baud)
    with pytest.raises(ValueRangeError, match=f"baud {baud} is out of range"):
        Framer("p").set_baud(baud)


def test_on_a_calm_line_a_frame_is_returned_with_its_last_byte() -> None:
    framer = Framer("p")
    framer.feed(Chunk("p", None, SPEED * 60))
    out = _byte_by_byte(framer, SPEED * 5)
    assert [len(rows) for rows in out] == ([0] * 9 + [1]) * 5


def test_a_line_is_calm_until_it_shows_damage() -> None:
    framer = Framer("p")
    out = _byte_by_byte(framer, SPEED[4:] + SPEED * 5)
    assert [len(rows) for rows in out[26:]] == ([0] * 9 + [1]) * 3
    after_damage = _byte_by_byte(framer, b"\x12\x34\x56" + SPEED * 6)
    assert [len(rows) for rows in after_damage[-20:]] == ([0] * 3 + [1] + [0] * 6) * 2
    assert framer.flush()[0].raw == SPEED


def test_after_damage_a_frame_waits_for_the_end_of_an_overlong_one() -> None:
    framer = Framer("p")
    framer.feed(Chunk("p", None, SPEED * 3 + b"\x12\x34\x56" + SPEED * 3))
    out = _byte_by_byte(framer, SPEED + b"\x12\xee")
    assert [row.raw for rows in out for row in rows] == [SPEED]
    (waiting, _) = framer.feed(Chunk("p", None, SPEED * 3))[:2]
    assert (waiting.raw, waiting.faults) == (SPEED, (Fault.AMBIGUOUS,))


@examples(30)
@given(st.integers(0, 10_000))
def test_junk_right_before_a_frame_gives_no_doubt_where_the_line_pauses(
    seed: int,
) -> None:
    random, framer = Random(seed), Framer("p")
    rows: list[Row] = []
    for number in range(100):
        junk = bytes(random.randrange(0x10, 0x50) for _ in range(random.choice([0, 0, 0, 1, 2, 3])))
        t_ns = START + number * 5 * MS
        rows += framer.feed(Chunk("p", t_ns, junk + SPEED))
    rows += framer.flush()
    assert [row.faults for row in rows if row.raw == SPEED] == [()] * 100


@examples(150)
@given(raw_bytes)
def test_no_frame_waits_for_more_than_two_further_ones(data: bytes) -> None:
    framer = Framer("p")
    for place, rows in enumerate(_byte_by_byte(framer, data), start=1):
        for row in rows:
            waited = place - row.offset - len(row.raw)
            assert waited <= (2 * FRAME_LENGTH if isinstance(row, Frame) else 90)


def test_a_disputed_frame_is_returned_after_two_further_frames() -> None:
    framer = Framer("p")
    framer.feed(Chunk("p", None, SPEED * 3 + b"\x12\x34\x56" + SPEED * 3))
    framer.feed(Chunk("p", None, HOSTILE))
    out = [row for rows in _byte_by_byte(framer, SPEED * 2) for row in rows]
    assert HOSTILE in [row.raw for row in out]


@given(st.integers(1, 40), st.binary(max_size=20))
def test_silence_of_20_ms_decides_the_last_frame(frames: int, junk: bytes) -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED * frames + junk + SPEED))
    rows += framer.feed(Chunk("p", START + 20 * MS, b""))
    assert rows[-1].raw == SPEED
    assert framer.flush() == []


def test_less_silence_does_not_settle_a_disputed_frame() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED + b"\x12\x34" + HOSTILE))
    rows += framer.feed(Chunk("p", START + 19 * MS, b""))
    assert HOSTILE not in [row.raw for row in rows]


def test_silence_decides_noise() -> None:
    framer = Framer("p")
    assert framer.feed(Chunk("p", START, b"\x12\x34\x56")) == []
    (row,) = framer.feed(Chunk("p", START + 25 * MS, b""))
    assert (row.raw, row.faults) == (b"\x12\x34\x56", (Fault.NOISE,))


def test_a_delayed_reader_cuts_no_frame() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED * 3 + SPEED[:4]))
    rows += framer.feed(Chunk("p", START + 50 * MS, b""))
    rows += framer.feed(Chunk("p", START + 120 * MS, SPEED[4:] + SPEED))
    rows += framer.flush()
    assert [row.raw for row in rows] == [SPEED] * 5
    assert all(isinstance(row, Frame) and row.faults == () for row in rows)


def test_the_beginning_of_a_frame_is_given_up_after_half_a_second() -> None:
    framer = Framer("p")
    framer.feed(Chunk("p", START, SPEED * 3 + SPEED[:4]))
    framer.feed(Chunk("p", START + 30 * MS, b""))
    assert framer.feed(Chunk("p", START + 490 * MS, b"")) == []
    (row,) = framer.feed(Chunk("p", START + 500 * MS, b""))
    assert (row.raw, row.faults) == (SPEED[:4], (Fault.TRUNCATED,))
    later = framer.feed(Chunk("p", START + 600 * MS, SPEED[4:])) + framer.flush()
    assert all(row.faults == (Fault.NOISE,) for row in later)


def test_a_row_begins_its_bytes_before_the_read() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED * 3)) + framer.flush()
    assert [row.t_ns for row in rows] == [START - n * FRAME_LENGTH * BYTE_NS for n in (3, 2, 1)]
    assert [row.read_delay_ns for row in rows] == [n * FRAME_LENGTH * BYTE_NS for n in (3, 2, 1)]


def test_a_row_does_not_begin_before_the_read_before_its_own() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED))
    rows += framer.feed(Chunk("p", START + BYTE_NS, SPEED * 2)) + framer.flush()
    assert [row.t_ns for row in rows[1:]] == [START, START]


@given(st.lists(st.tuples(st.integers(-5 * MS, 30 * MS), st.integers(0, 25)), max_size=20))
def test_times_never_fall(reads: list[tuple[int, int]]) -> None:
    framer, now, rows = Framer("p"), START, []
    for step, size in reads:
        now += step
        rows += framer.feed(Chunk("p", now, (SPEED * 3)[:size]))
    times = [row.t_ns for row in rows + framer.flush()]
    assert all(t is not None for t in times)
    assert times == sorted(t for t in times if t is not None)


def test_untimed_input_has_no_times() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, SPEED * 2 + b"\x01")) + framer.flush()
    assert [(row.t_ns, row.read_delay_ns) for row in rows] == [(None, None)] * 3


def test_memory_stays_bounded() -> None:
    for unit in (b"\xaa", b"\xee", b"\x00", b"\x55\x02", HOSTILE, HOSTILE[3:] + HOSTILE[:4]):
        framer = Framer("p")
        held = 0
        for _ in range(8):
            rows = framer.feed(Chunk("p", None, unit * (1000 // len(unit))))
            held += 1000 // len(unit) * len(unit) - sum(len(row.raw) for row in rows)
            assert held <= 1200


def test_a_new_baud_dates_the_bytes_after_it_and_no_others() -> None:
    framer = Framer("p")
    rows = framer.feed(Chunk("p", START, SPEED))
    framer.set_baud(9600)
    rows += framer.feed(Chunk("p", START + 100 * MS, SPEED))
    rows += framer.flush()
    slow = byte_time_ns(9600)
    assert [row.t_ns for row in rows] == [
        START - FRAME_LENGTH * BYTE_NS,
        START + 100 * MS - FRAME_LENGTH * slow,
    ]


FEEDBACK = bytes.fromhex("55 01 01 03 E8 00 00 00 0F EE")
NOISE = (Fault.NOISE,)


def cut(data: bytes, size: int) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]


def drained(chunks: Sequence[Chunk]) -> list[Rows]:
    """The rows after each chunk, and those at the end of the stream."""
    framer = Framer("p")
    found = []
    for chunk in chunks:
        framer.push(chunk)
        found.append(framer.drain())
    framer.finish()
    return [*found, framer.drain()]


def rows_of(parts: Sequence[Rows]) -> list[Row]:
    return [row for rows in parts for row in rows]


def check(parts: Sequence[Rows], data: bytes) -> None:
    """Fails unless the rows are those of these bytes, each byte in one row."""
    at = 0
    for row in rows_of(parts):
        assert row.offset == at
        assert row.raw == data[at : at + len(row.raw)]
        at += len(row.raw)
    assert at == len(data)


@given(raw_bytes, st.integers(1, 60), st.sampled_from([0, 1, 5, 25, 600]))
def test_rows_have_the_bytes(data: bytes, size: int, silence_ms: int) -> None:
    chunks, t_ns = [], START
    for piece in cut(data, size):
        t_ns += silence_ms * MS
        chunks += [Chunk("p", t_ns, piece), Chunk("p", t_ns + silence_ms * MS, b"")]
        t_ns += silence_ms * MS
    check(drained(chunks), data)


def test_nothing_is_drained_before_it_is_decided() -> None:
    framer = Framer("p")
    assert not framer.drain()
    framer.push(Chunk("p", None, SPEED[:4]))
    assert not framer.drain()


@pytest.mark.parametrize(
    ("pending", "silence_ms", "rows"),
    [
        (SPEED[:4], 600, [(4, (Fault.TRUNCATED,))]),
        (b"\x12\x34\x56", 25, [(3, NOISE)]),
        (b"\x12\x34" + HOSTILE, 25, [(2, NOISE), (10, (Fault.AMBIGUOUS,))]),
        (bytes(100), 25, [(100, NOISE)]),
    ],
)
def test_silence_returns_the_bytes_of_what_it_decides(
    pending: bytes, silence_ms: int, rows: list[tuple[int, tuple[Fault, ...]]]
) -> None:
    framer = Framer("p")
    framer.push(Chunk("p", START, SPEED * 3))
    framer.push(Chunk("p", START + MS, pending))
    before = framer.drain()
    assert len(before) == 3
    framer.push(Chunk("p", START + (1 + silence_ms) * MS, b""))
    own = framer.drain()
    assert own.tobytes() == pending
    assert sum(length for length, _ in rows) == len(pending)
    assert [len(row.raw) for row in own] == [length for length, _ in rows]
    framer.finish()
    check([before, own, framer.drain()], SPEED * 3 + pending)


@pytest.mark.parametrize("noise", [bytes(5000), Random(1).randbytes(5000), b"\xaa" * 5000])
@pytest.mark.parametrize("size", [1, 7, 300, 1024, 1025, 4000])
def test_noise_in_spans_has_the_rows_that_it_has_at_once(noise: bytes, size: int) -> None:
    parts = drained([Chunk("p", None, piece) for piece in cut(noise, size)])
    check(parts, noise)
    framer = Framer("p")
    at_once = framer.feed(Chunk("p", None, noise)) + framer.flush()
    assert rows_of(parts) == at_once
    assert max(len(row.raw) for row in at_once) <= 1024


def test_noise_that_goes_on_is_cut_where_1024_bytes_are_full() -> None:
    parts = drained([Chunk("p", None, piece) for piece in cut(bytes(2500), 100)])
    assert [(row.offset, len(row.raw)) for row in rows_of(parts)] == [
        (0, 1024),
        (1024, 1024),
        (2048, 452),
    ]
    assert [number for number, rows in enumerate(parts) if len(rows)] == [10, 20, 25]


def test_silence_ends_a_run_of_noise() -> None:
    framer = Framer("p")
    framer.push(Chunk("p", START, bytes(700)))
    framer.push(Chunk("p", START + 100 * MS, b""))
    framer.push(Chunk("p", START + 101 * MS, bytes(700)))
    framer.finish()
    rows = framer.drain()
    assert [(len(row.raw), type(row), row.faults) for row in rows] == [(700, Damage, NOISE)] * 2


@pytest.mark.parametrize("lead", range(30, 140, 3))
def test_long_noise_byte_by_byte_stays_noise(lead: int) -> None:
    """A lone header in it does not begin a frame, however the noise is cut."""
    noise = bytes(lead) + b"\x55" + bytes(60)
    parts = drained([Chunk("p", None, piece) for piece in cut(noise, 1)])
    assert [(len(row.raw), row.faults) for row in rows_of(parts)] == [(len(noise), NOISE)]
