"""Coverage-guided fuzzing of the framer's promises.

    python tests/fuzz/fuzz_framer.py [corpus folder] [-max_total_time=300]

Needs atheris and the interpreted framer (`FTE_SNIFF_COMPILED=0 pip install -e .`), because compiled
code gives no coverage. The first byte of the input selects how the stream, the other bytes, is cut.
Failures are: an exception, rows that do not cover the stream, rows that depend on the chunks, a
frame that is not ten bytes between a header and a tail, a frame with status `ok` that is illegal, a
frame that waited for more than two further ones, or columns that differ from the rows.
"""

from __future__ import annotations

import sys

import atheris

from tests.support.columns import fed

with atheris.instrument_imports(include=["fte_sniff.protocol"]):
    from fte_sniff.protocol import (
        DEFAULT_BAUD,
        FRAME_LENGTH,
        HEADERS,
        TAIL,
        Chunk,
        Framer,
        Row,
        Status,
        byte_time_ns,
        encode,
    )
    from fte_sniff.protocol.dissect import dissect


BYTE_NS = byte_time_ns(DEFAULT_BAUD)
SILENCES_NS = (0, 3 * BYTE_NS, 5_000_000, 25_000_000, 600_000_000)


def chunks_of(how: int, stream: bytes) -> list[Chunk]:
    """The stream in pieces of one size, with one silence between them, timed or not."""
    size = 1 + how % 32
    silence = SILENCES_NS[how // 32 % len(SILENCES_NS)]
    timed, now = how >= 128, 10**18
    chunks = []
    for at in range(0, len(stream), size):
        piece = stream[at : at + size]
        now += silence + len(piece) * BYTE_NS
        chunks.append(Chunk("p", now if timed else None, piece))
    return chunks


def byte_by_byte(chunks: list[Chunk]) -> list[Chunk]:
    """Chunks of one byte at the times of these, with heartbeats in the silences."""
    singles: list[Chunk] = []
    last: int | None = None
    for chunk in chunks:
        size = len(chunk.data)
        if chunk.t_ns is not None and last is not None:
            began = chunk.t_ns - size * BYTE_NS
            singles += [Chunk("p", t, b"") for t in range(last, began + 1, 10_000_000)]
        for place in range(size):
            t_ns = None if chunk.t_ns is None else chunk.t_ns - (size - place - 1) * BYTE_NS
            singles.append(Chunk("p", t_ns, chunk.data[place : place + 1]))
        last = chunk.t_ns
    return singles


def rows_of(chunks: list[Chunk]) -> list[Row]:
    framer = Framer("p")
    rows = [row for chunk in chunks for row in fed(framer, chunk)]
    return rows + list(framer.finish())


def rows_in_time(chunks: list[Chunk]) -> list[Row]:
    """The rows of single bytes; fails where a frame comes too late."""
    framer, rows, come = Framer("p"), [], 0
    for chunk in chunks:
        come += len(chunk.data)
        for row in fed(framer, chunk):
            late = come - row.offset - len(row.raw)
            assert late <= 2 * FRAME_LENGTH or not row.framed
            rows.append(row)
    return rows + list(framer.finish())


def check(data: bytes) -> None:
    """Fails where a promise is broken."""
    chunks = chunks_of(data[0], data[1:]) if data else []
    rows = rows_of(chunks)
    at = 0
    for row in rows:
        assert row.offset == at
        assert row.raw
        at += len(row.raw)
        assert b"".join(part.raw for part in dissect(row)) == row.raw
        if row.framed:
            assert len(row.raw) == FRAME_LENGTH
            assert row.raw[0] in HEADERS.values()
            assert row.raw[-1] == TAIL
            if row.status is Status.OK:
                assert row.kind is not None
                other = encode(row.kind, row.values, row.cmd)
                assert [a for a, b in zip(row.raw, other, strict=True) if a != b] in (
                    [],
                    [row.raw[2]],
                )
    assert b"".join(row.raw for row in rows) == data[1:]
    assert rows == rows_in_time(byte_by_byte(chunks))
    framer = Framer("p")
    framer.push(Chunk("p", None, data[1:]))
    framer.finish()
    assert list(framer.drain()) == rows_of([Chunk("p", None, data[1:])])


def main() -> None:
    """Run the fuzzer until it finds something, or is ended."""
    atheris.Setup(sys.argv, check)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
