"""Owns the checksum that guards chunks, data and summary of an MCAP: CRC-32, as in zlib.

It must not know what it is reckoned over. It is not zlib's own, because that takes six times as
long, which was a tenth of all reading.
"""

from __future__ import annotations

from zlib_ng.zlib_ng import crc32

__all__ = ["RunningChecksum", "crc32"]

_LARGE = 64 * 1024
_MOST_WAITING = 512 * 1024


class RunningChecksum:
    """The checksum of all that was added, in its order.

    Small pieces wait until they are worth it: to reckon lets go of the interpreter, and where other
    threads want it, to get it back takes longer than the checksum of a small piece.
    """

    def __init__(self) -> None:
        self._value = 0
        self._waiting: list[bytes] = []
        self._size = 0

    def add(self, piece: bytes) -> None:
        """Take more bytes."""
        if len(piece) >= _LARGE:
            self._value = crc32(piece, self.value())
            return
        self._waiting.append(piece)
        self._size += len(piece)
        if self._size >= _MOST_WAITING:
            self.value()

    def value(self) -> int:
        """That of all so far."""
        if self._waiting:
            self._value = crc32(b"".join(self._waiting), self._value)
            self._waiting.clear()
            self._size = 0
        return self._value
