"""Decided spans: their bytes, their segments, and their rows."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import Chunk, Damage, Fault, Frame, Framer, Row
from fte_sniff.protocol.framer.segments import DecidedSpan
from tests.protocol.streams import raw_bytes

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
FEEDBACK = bytes.fromhex("55 01 01 03 E8 00 00 00 0F EE")
DISPUTED = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")
MS = 1_000_000
START = 10**18
NOISE = (Fault.NOISE,)


def cut(data: bytes, size: int) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]


def spans_of(chunks: Sequence[Chunk]) -> list[DecidedSpan]:
    """One span for each chunk, and one for the end of the stream."""
    framer = Framer("p")
    spans = []
    for chunk in chunks:
        framer.push(chunk)
        spans.append(framer.drain())
    framer.finish()
    return [*spans, framer.drain()]


def rows_of(spans: Sequence[DecidedSpan]) -> list[Row]:
    return [row for span in spans for row in span.rows()]


def check(spans: Sequence[DecidedSpan], data: bytes) -> None:
    """Fails unless the spans cover these bytes and agree with their rows."""
    at = 0
    for span in spans:
        rows = span.rows()
        assert span.start == at
        assert len(span) == len(rows)
        assert list(span.headers()) == [
            (row.offset, row.raw[0]) for row in rows if isinstance(row, Frame)
        ]
        last = rows[-1] if rows else None
        assert span.last() == (
            last and (len(last.raw), isinstance(last, Frame), tuple(last.faults))
        )
        size = sum(len(row.raw) for row in rows)
        assert span.data[:size] == b"".join(row.raw for row in rows)
        assert span.data[:size] == data[at : at + size]
        at += size
    assert at == len(data)


@given(raw_bytes, st.integers(1, 60), st.sampled_from([0, 1, 5, 25, 600]))
def test_spans_agree_with_their_rows(data: bytes, size: int, silence_ms: int) -> None:
    chunks, t_ns = [], START
    for piece in cut(data, size):
        t_ns += silence_ms * MS
        chunks += [Chunk("p", t_ns, piece), Chunk("p", t_ns + silence_ms * MS, b"")]
        t_ns += silence_ms * MS
    check(spans_of(chunks), data)


def test_a_span_in_which_nothing_was_decided_is_empty() -> None:
    span = Framer("p").drain()
    assert (len(span), span.rows(), list(span.headers())) == (0, [], [])
    assert span.last() is None
    framer = Framer("p")
    framer.push(Chunk("p", None, FRAME[:4]))
    assert (len(framer.drain()), framer.drain().last()) == (0, None)


@pytest.mark.parametrize(
    ("data", "last"),
    [
        (FRAME * 3, (10, True, ())),
        (FRAME * 3 + FRAME[:6], (6, False, (Fault.TRUNCATED,))),
        (FRAME * 3 + b"\x12\x34\x56", (3, False, NOISE)),
        (bytes(1500), (476, False, NOISE)),
        (DISPUTED, (10, True, (Fault.AMBIGUOUS,))),
    ],
)
def test_the_last_row_of_a_span_is_reported(
    data: bytes, last: tuple[int, bool, tuple[Fault, ...]]
) -> None:
    framer = Framer("p")
    framer.push(Chunk("p", None, data))
    framer.finish()
    assert framer.drain().last() == last
    assert framer.drain().last() is None


def test_the_last_of_many_frames_in_step_is_one_of_them() -> None:
    framer = Framer("p")
    framer.push(Chunk("p", None, (FRAME + FEEDBACK) * 500))
    framer.finish()
    span = framer.drain()
    assert (len(span), span.last()) == (1000, (10, True, ()))
    assert list(span.headers()) == [(10 * n, (0xAA, 0x55)[n % 2]) for n in range(1000)]


@pytest.mark.parametrize(
    ("pending", "silence_ms", "rows"),
    [
        (FRAME[:4], 600, [(4, (Fault.TRUNCATED,))]),
        (b"\x12\x34\x56", 25, [(3, NOISE)]),
        (b"\x12\x34" + DISPUTED, 25, [(2, NOISE), (10, (Fault.AMBIGUOUS,))]),
        (bytes(100), 25, [(100, NOISE)]),
    ],
)
def test_silence_returns_the_bytes_of_what_it_decides(
    pending: bytes, silence_ms: int, rows: list[tuple[int, tuple[Fault, ...]]]
) -> None:
    framer = Framer("p")
    framer.push(Chunk("p", START, FRAME * 3))
    framer.push(Chunk("p", START + MS, pending))
    before = framer.drain()
    assert len(before) == 3
    framer.push(Chunk("p", START + (1 + silence_ms) * MS, b""))
    span = framer.drain()
    own = span.rows()
    assert b"".join(row.raw for row in own) == pending
    assert span.data[: len(pending)] == pending
    assert sum(length for length, _ in rows) == len(pending)
    assert [len(row.raw) for row in own] == [length for length, _ in rows]
    framer.finish()
    check([before, span, framer.drain()], FRAME * 3 + pending)


@pytest.mark.parametrize("noise", [bytes(5000), Random(1).randbytes(5000), b"\xaa" * 5000])
@pytest.mark.parametrize("size", [1, 7, 300, 1024, 1025, 4000])
def test_noise_in_spans_has_the_rows_that_it_has_at_once(noise: bytes, size: int) -> None:
    spans = spans_of([Chunk("p", None, piece) for piece in cut(noise, size)])
    check(spans, noise)
    framer = Framer("p")
    at_once = framer.feed(Chunk("p", None, noise)) + framer.flush()
    assert rows_of(spans) == at_once
    assert max(len(row.raw) for row in at_once) <= 1024


def test_noise_that_goes_on_is_cut_where_1024_bytes_are_full() -> None:
    spans = spans_of([Chunk("p", None, piece) for piece in cut(bytes(2500), 100)])
    assert [(row.offset, len(row.raw)) for row in rows_of(spans)] == [
        (0, 1024),
        (1024, 1024),
        (2048, 452),
    ]
    assert [number for number, span in enumerate(spans) if len(span)] == [10, 20, 25]


def test_silence_ends_a_run_of_noise() -> None:
    framer = Framer("p")
    framer.push(Chunk("p", START, bytes(700)))
    framer.push(Chunk("p", START + 100 * MS, b""))
    framer.push(Chunk("p", START + 101 * MS, bytes(700)))
    framer.finish()
    rows = framer.drain().rows()
    assert [(len(row.raw), type(row), row.faults) for row in rows] == [(700, Damage, NOISE)] * 2


@pytest.mark.parametrize("lead", range(30, 140, 3))
def test_long_noise_byte_by_byte_stays_noise(lead: int) -> None:
    """A lone header in it is no beginning of a frame, however the noise is cut."""
    noise = bytes(lead) + b"\x55" + bytes(60)
    spans = spans_of([Chunk("p", None, piece) for piece in cut(noise, 1)])
    assert [(len(row.raw), row.faults) for row in rows_of(spans)] == [(len(noise), NOISE)]
