"""Rows that are drained from a framer, at whatever times."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import Chunk, Damage, Fault, Framer, Row, Rows
from tests.protocol.streams import raw_bytes

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
FEEDBACK = bytes.fromhex("55 01 01 03 E8 00 00 00 0F EE")
DISPUTED = bytes.fromhex("AA 02 03 EE 55 02 01 03 E8 EE")
MS = 1_000_000
START = 10**18
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
    framer.push(Chunk("p", None, FRAME[:4]))
    assert not framer.drain()


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
    own = framer.drain()
    assert own.tobytes() == pending
    assert sum(length for length, _ in rows) == len(pending)
    assert [len(row.raw) for row in own] == [length for length, _ in rows]
    framer.finish()
    check([before, own, framer.drain()], FRAME * 3 + pending)


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
    """A lone header in it is no beginning of a frame, however the noise is cut."""
    noise = bytes(lead) + b"\x55" + bytes(60)
    parts = drained([Chunk("p", None, piece) for piece in cut(noise, 1)])
    assert [(len(row.raw), row.faults) for row in rows_of(parts)] == [(len(noise), NOISE)]
