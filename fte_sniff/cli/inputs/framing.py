"""Owns the bytes of a log on their way through the framer, to portions that are handed on at once.

It must not know a format of logs, nor what becomes of the rows. What looks through many bytes at
once is loaded when there are many; a short log needs none of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from fte_sniff.errors import FileError, FteSniffError
from fte_sniff.formats.logs.hex_log import at_own_times
from fte_sniff.protocol import FRAME_LENGTH, Chunk, Fault, Framer
from fte_sniff.protocol.framer.keeping import Decided

if TYPE_CHECKING:
    from fte_sniff.protocol.framer.framer import Scout, Skip

PORTION: Final = 1 << 19
"""Bytes that are handed on at once, more or less, where nobody waits for them."""

_MANY: Final = 1 << 15
"""Bytes that are worth a look at once."""


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
    framer, kept = Framer.keeping(name, _Lookout())
    gathered, some = 0, False
    try:
        for chunk in at_own_times(chunks, framer):
            some = True
            framer.pour(chunk)
            gathered += len(chunk.data)
            if gathered >= PORTION or drained():
                gathered = 0
                yield kept.take()
    except FteSniffError:
        framer.end()
        yield kept.take()
        raise
    if not some:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    framer.end()
    last = kept.take()
    yield last
    _note_cut_frame(last, name, note)


class _Lookout:
    """Looks through many bytes at once, and loads what that takes when they come."""

    def __init__(self) -> None:
        self._scout: Scout | None = None

    def __call__(self, data: bytes) -> Skip | None:
        if len(data) < _MANY:
            return None
        if self._scout is None:
            from concurrent.futures import ThreadPoolExecutor

            from fte_sniff.analysis.columns.bulk import scout

            self._scout = scout(ThreadPoolExecutor(thread_name_prefix="frames"))
        return self._scout(data)


def _note_cut_frame(last: Decided, name: str, note: Callable[[str], None]) -> None:
    if not last.tiles:
        return
    tile = last.tiles[-1]
    if not tile.framed and tile.faults is not None and Fault.TRUNCATED in tile.faults:
        size = tile.stop - tile.start
        note(f"{name}: ends in the middle of a frame ({size} of {FRAME_LENGTH} bytes)")
