"""What a line has in its open reserve: learned from its frames, for each kind and offset.

The protocol document states no value for the reserve of control frames. Each host has its own: 00,
FF, the bytes of an earlier frame, or anything. So a reserve byte is evidence only as far as the
line has shown what it usually is:

    open       nothing is known, or the byte changes: it is scored like a payload byte
    constant   `KNOWN` frames in a row had this byte: another byte is unusual, and
               `reserved_nonzero` if the constant is 00

A constant is given up if `ENOUGH` frames in a row contradict it with the same byte, or if many do:
each one outweighs `CONTRADICTION` frames that agree, of which at most `MOST_COUNTED` are counted.

A kind of which fewer than `KNOWN` frames were seen has the constants of another kind with the same
header: those at the same offsets, and the byte that fills its reserve at all others. (A reset is
rare, and the host that sends it fills the reserve in the same way.)
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, u8

from fte_sniff.protocol.framer.predicates import kind_at
from fte_sniff.protocol.framer.tables import EXACT, LEARNING, NO_KIND, FrameTables

KNOWN: Final[i64] = 8
"""Frames in a row with the same byte after which it is a constant."""

MOST_COUNTED: Final[i64] = 32
"""Frames with the constant that are counted, at most."""

CONTRADICTION: Final[i64] = 4
"""How many frames with the constant one frame without it outweighs."""

ENOUGH: Final[i64] = 3
"""Frames in a row with the same other byte that end a constant."""

_OPEN: Final[i64] = -1


@final
class ReserveLearner:
    """Learns the reserve of one line from its frames, in stream order."""

    def __init__(self, tables: FrameTables) -> None:
        """`tables` are those of a line whose reserve is not known."""
        self._unknown = tables
        self.reset()

    def reset(self) -> None:
        """Forget everything: a new stream starts."""
        tables = self._unknown
        count, size = tables.kind_count, tables.kind_count * tables.length
        self.tables = tables
        """The tables for the reserve as it is known so far."""
        self._bytes = vec[i64]([_OPEN] * size)
        """By kind and offset: the byte of the last frame."""
        self._repeats = vec[i64]([i64(0)] * size)
        """By kind and offset: the frames in a row that had it, at most `KNOWN`."""
        self._support = vec[i64]([i64(0)] * size)
        """By kind and offset: the frames with the constant, less those without it."""
        self._constants = vec[i64]([_OPEN] * size)
        """By kind and offset: the constant, or `_OPEN`."""
        self._seen = vec[i64]([i64(0)] * count)
        """By kind: the frames seen, at most `KNOWN`."""
        self.marks = vec[u8]([u8(0)] * count)
        """By kind: `LEARNING`, else `EXACT`, else 0."""
        for kind in range(count):
            self._mark(kind, tables.open_reserve[kind * tables.length] != 0)

    def observe(self, data: bytes, at: i64) -> None:
        """Learn from the frame at an offset, and bring `tables` up to date."""
        tables = self._unknown
        kind = kind_at(tables, data, at)
        if kind == NO_KIND or tables.open_reserve[kind * tables.length] == 0:
            return
        row = kind * tables.length
        changed, settled = False, True
        if self._seen[kind] < KNOWN:
            self._seen[kind] += 1
            changed = self._seen[kind] == KNOWN
        for number in range(row, row + tables.length):
            offset = i64(tables.open_reserve[number])
            if offset == 0:
                break
            if self._count(row + offset, i64(data[at + offset])):
                changed = True
            place = row + offset
            if self._support[place] < MOST_COUNTED or self._bytes[place] != self._constants[place]:
                settled = False
        self._mark(kind, not settled)
        if changed:
            self.tables = tables.with_reserve(self._reserve())

    def _mark(self, kind: i64, learning: bool) -> None:
        exact = EXACT if self._unknown.word_exact[kind] == 1 else u8(0)
        self.marks[kind] = LEARNING if learning else exact

    def _count(self, place: i64, byte: i64) -> bool:
        """Count one byte at a kind and offset; True if it makes or ends a constant there."""
        repeats = self._repeats[place] + 1 if byte == self._bytes[place] else i64(1)
        self._bytes[place], self._repeats[place] = byte, min(repeats, KNOWN)
        constant = self._constants[place]
        if constant == _OPEN:
            if repeats < KNOWN:
                return False
            self._constants[place], self._support[place] = byte, repeats
        elif byte == constant:
            self._support[place] = min(self._support[place] + 1, MOST_COUNTED)
            return False
        else:
            self._support[place] -= CONTRADICTION
            if self._support[place] > 0 and repeats < ENOUGH:
                return False
            self._constants[place] = _OPEN
        return True

    def _reserve(self) -> dict[tuple[int, int], int]:
        """The constants of the line, by kind and offset."""
        tables, reserve = self._unknown, dict[tuple[int, int], int]()
        for kind in range(tables.kind_count):
            row = kind * tables.length
            for number in range(row, row + tables.length):
                offset = i64(tables.open_reserve[number])
                if offset == 0:
                    break
                known = self._seen[kind] == KNOWN
                constant = self._constants[row + offset] if known else self._usual(kind, offset)
                if constant != _OPEN:
                    reserve[int(kind), int(offset)] = int(constant)
        return reserve

    def _usual(self, kind: i64, offset: i64) -> i64:
        """The constant of known kinds with the same header at an offset, or at all of theirs."""
        tables = self._unknown
        for other in range(tables.kind_count):
            if tables.headers[other] != tables.headers[kind] or self._seen[other] < KNOWN:
                continue
            constant = self._constants[other * tables.length + offset]
            if constant == _OPEN:
                constant = self._only_byte(other)
            if constant != _OPEN:
                return constant
        return _OPEN

    def _only_byte(self, kind: i64) -> i64:
        """The byte that fills a kind's reserve; `_OPEN` if there are several or none."""
        tables, row = self._unknown, kind * self._unknown.length
        only = _OPEN
        for number in range(row, row + tables.length):
            offset = i64(tables.open_reserve[number])
            if offset == 0:
                break
            constant = self._constants[row + offset]
            if constant == _OPEN or (only != _OPEN and constant != only):
                return _OPEN
            only = constant
        return only
