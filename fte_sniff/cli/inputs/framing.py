"""Owns the bytes of a log on their way through the framer, to portions that are handed on at once.

It must not know a format of logs, nor what becomes of the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from fte_sniff.errors import FileError, FteSniffError
from fte_sniff.formats.logs.hex_log import at_own_times
from fte_sniff.protocol import FRAME_LENGTH, Chunk, Fault, Framer
from fte_sniff.protocol.framer.segments import Decided

PORTION: Final = 1 << 19
"""Bytes that are handed on at once, more or less, where nobody waits for them."""


def decided(
    chunks: Iterable[Chunk], name: str, note: Callable[[str], None], drained: Callable[[], bool]
) -> Iterator[Decided]:
    """All that the chunks hold, portion by portion.

    Args:
        chunks: of one port; their times may fall.
        name: the port.
        note: is told where they end within a frame.
        drained: whether the chunk behind the latest has to be waited for.

    Raises:
        FileError: there is no chunk.
        FteSniffError: what the chunks raise; what stood before is not lost with it.
    """
    framer = Framer(name)
    gathered, some = 0, False
    try:
        for chunk in at_own_times(chunks, framer):
            some = True
            framer.pour(chunk)
            gathered += len(chunk.data)
            if gathered >= PORTION or drained():
                gathered = 0
                yield framer.take()
    except FteSniffError:
        framer.end()
        yield framer.take()
        raise
    if not some:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    framer.end()
    last = framer.take()
    yield last
    _note_cut_frame(last, name, note)


def _note_cut_frame(last: Decided, name: str, note: Callable[[str], None]) -> None:
    row = last.last()
    if row is None:
        return
    size, framed, faults = row
    if not framed and Fault.TRUNCATED in faults:
        note(f"{name}: ends in the middle of a frame ({size} of {FRAME_LENGTH} bytes)")
