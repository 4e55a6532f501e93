"""Owns messages of one length laid side by side, and the reading of a number from all at once.

It must not know rows or columns. Whether messages keep to a layout is seen from all of them
together, by two passes over their bytes: neither with all bits set that any of them has, nor with
those alone that all of them have, may what the layout guards be other than it says.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH
from fte_sniff.recording.encoding.layout import Layout
from fte_sniff.recording.reading.starts import MESSAGE_HEAD, at_every_byte, numbers
from fte_sniff.row_batch import Array

RAW = np.dtype(f"V{FRAME_LENGTH}")
"""The bytes of a frame, so that they are copied as one."""

_WORD = 8
_STRIPE = 64

Guard = tuple[Array, Array]
"""A mask, and what is expected under it, as words."""


def guard(mask: bytes | bytearray, expected: bytes | bytearray) -> Guard:
    """The guard of bytes, with nothing asked of what fills up their first word."""
    lead = bytes(-len(mask) % _WORD)
    return np.frombuffer(lead + mask, "<u8"), np.frombuffer(lead + expected, "<u8")


def words_of(packed: Array) -> Array:
    """A line of words for each of equally many bytes, which must be whole words."""
    return packed.view("<u8").reshape(-1, packed.dtype.itemsize // _WORD)


def all_fit(words: Array, guarded: Guard) -> bool:
    """Whether every line keeps to the guard."""
    striped = len(words) // _STRIPE * _STRIPE
    if (_strayed(words[striped:], guarded)).any():
        return False
    if not striped:
        return True
    # Rows so wide that numpy goes over them at the speed of memory.
    wide = words[:striped].reshape(-1, _STRIPE * words.shape[1])
    strayed = _strayed(np.bitwise_or.reduce(wide, axis=0).reshape(_STRIPE, -1), guarded)
    strayed |= _strayed(np.bitwise_and.reduce(wide, axis=0).reshape(_STRIPE, -1), guarded)
    return not strayed.any()


def which_fit(words: Array, guarded: Guard) -> Array:
    """A mask of the lines that keep to the guard."""
    return np.asarray(~_strayed(words, guarded).any(axis=1))


def _strayed(words: Array, guarded: Guard) -> Array:
    """The guarded bits that are not as expected."""
    mask, expected = guarded
    found: Array = words & mask
    found ^= expected
    return found


@lru_cache(maxsize=256)
def _whole_guard(layout: Layout) -> Guard:
    return guard(layout.mask, layout.expected)


class Side:
    """Messages of one length side by side."""

    def __init__(self, records: bytes, starts: Array, length: int) -> None:
        """Lay out the messages whose records begin at `starts`."""
        # What stands before a message fills up its first word, and is one where it is empty.
        self._lead = -length % _WORD if length else _WORD
        self._set(at_every_byte(records, self._lead + length, MESSAGE_HEAD - self._lead)[starts])

    def _set(self, packed: Array) -> None:
        self._packed = packed
        self._bytes: Array = packed.view(np.uint8).reshape(-1, packed.dtype.itemsize)

    def __len__(self) -> int:
        return len(self._packed)

    @property
    def words(self) -> Array:
        """A line of words for each message; see `guard`."""
        return words_of(self._packed)

    def number(self, place: int, kind: str) -> Array:
        """The number at that place of every message."""
        return numbers(self._packed, self._lead + place, kind)

    def raw(self, layout: Layout) -> Array:
        """The first ten bytes of every row, zeros behind them."""
        place = self._lead + layout.raw
        if layout.raw_length >= FRAME_LENGTH:
            return numbers(self._packed, place, RAW).view(np.uint8).reshape(-1, FRAME_LENGTH)
        found = np.zeros((len(self), FRAME_LENGTH), np.uint8)
        found[:, : layout.raw_length] = self._bytes[:, place : place + layout.raw_length]
        return found

    def bytes_at(self, place: int, length: int) -> Iterator[bytes]:
        """The bytes at that place of every message."""
        place += self._lead
        return (row[place : place + length].tobytes() for row in self._bytes)

    def parted(self, rows: Array) -> Side:
        """Only these messages: a mask."""
        part = object.__new__(Side)
        part._lead = self._lead
        part._set(self._packed[rows])
        return part

    def fits(self, layout: Layout) -> Array | None:
        """Which messages keep to the layout; None where all do, which is quickly seen."""
        guarded = _whole_guard(layout)
        return None if all_fit(self.words, guarded) else which_fit(self.words, guarded)
