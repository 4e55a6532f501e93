"""Frame the chunks of one port, and turn what is decided into rows: a list where they are few."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from fte_sniff.errors import FileError, FteSniffError
from fte_sniff.protocol import DEFAULT_BAUD, FRAME_LENGTH, Chunk, Fault, Framer
from fte_sniff.protocol.framer.segments import DecidedSpan

if TYPE_CHECKING:
    from fte_sniff.row_batch import Rows

SPAN_BYTES: Final = 1 << 19
"""Bytes that are framed before their rows are yielded, unless a reader waits for them."""

FEW: Final = 20_000
"""Rows of an input that come as lists, before numpy and polars are loaded for the others."""

FEWEST: Final = 100
"""Spans of fewer rows become lists; for them numpy is slower."""


def decided_spans(
    chunks: Iterable[Chunk],
    name: str,
    note: Callable[[str], None],
    drained: Callable[[], bool],
    baud: int = DEFAULT_BAUD,
) -> Iterator[DecidedSpan]:
    """Frame all chunks, about `SPAN_BYTES` at a time.

    Args:
        chunks: of one port; their times may fall.
        name: the port.
        note: called with a message if the input ends within a frame.
        drained: whether the next chunk has to be waited for, so that rows are not held back.
        baud: bits per second.

    Raises:
        FileError: there is no chunk.
        FteSniffError: raised by the chunks, after the rows before it.
    """
    framer = Framer(name, baud)
    size, empty = 0, True
    try:
        before_ns = None
        for chunk in chunks:
            if before_ns is not None and chunk.t_ns is not None and chunk.t_ns < before_ns:
                framer.reset_clock()
            before_ns = before_ns if chunk.t_ns is None else chunk.t_ns
            empty = False
            framer.push(chunk)
            size += len(chunk.data)
            if size >= SPAN_BYTES or drained():
                size = 0
                yield framer.drain()
    except FteSniffError:
        framer.finish()
        yield framer.drain()
        raise
    if empty:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    framer.finish()
    last = framer.drain()
    yield last
    if cut := cut_frame_note(last):
        note(f"{name}: {cut}")


def rows_of_spans(spans: Iterable[DecidedSpan], few: int = FEW) -> Iterator[Rows]:
    """The rows of each span; the first `few` rows come as lists."""
    count = 0
    for span in spans:
        rows = len(span)
        count += rows
        if count < few or rows < min(few, FEWEST):
            yield span.rows()
            continue
        from fte_sniff.row_batch import RowBatch

        yield RowBatch.from_span(span)


def cut_frame_note(last: DecidedSpan) -> str | None:
    """That a stream whose last rows these are ends within a frame."""
    row = last.last()
    if row is None or row[1] or Fault.TRUNCATED not in row[2]:
        return None
    return f"ends in the middle of a frame ({row[0]} of {FRAME_LENGTH} bytes)"
