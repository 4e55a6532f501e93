"""Owns the way from many bytes at once to numpy columns, at the machine's speed.

It must not decide what a frame is: the framer does. This module only counts frames in step faster
than a regular expression does, and turns what the framer says into columns.

Frames in step are looked at as two numbers, the first eight bytes and the last two, thousands at a
time; whatever is not plain ends the run, and the framer goes on byte by byte.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    TAIL,
    VALUE_FIELDS,
    Chunk,
    Fault,
    Frame,
    Framer,
    Row,
)
from fte_sniff.protocol.structure import legal_bytes
from fte_sniff.protocol.table import NUM_PLACE
from fte_sniff.protocol.tiling import Run

Array = npt.NDArray[Any]

NO_KIND: Final = len(KINDS)
"""The kind code of a row that has none."""

_FRAME: Final = np.dtype([("front", "<u8"), ("back", "<u2")])
_FIRST_BLOCK, _LARGEST_BLOCK = 1 << 10, 1 << 13
_LOW_BITS: Final = np.uint64(0x7F7F7F7F7F7F7F7F)
_EVERY_BYTE: Final = np.uint64(0x0101010101010101)


def _kind_codes() -> Array:
    """By header and CMD, read as one little-endian number: the kind's place in the table."""
    codes = np.full(1 << 16, NO_KIND, np.uint8)
    for code, kind in enumerate(KINDS):
        for cmd in kind.cmds:
            codes[kind.header | cmd << 8] = code
    return codes


def _num_fits() -> Array:
    """By kind and NUM: whether NUM fits; nothing fits where there is no kind."""
    fits = np.zeros((NO_KIND + 1, 256), np.bool_)
    for code, kind in enumerate(KINDS):
        legal = legal_bytes(kind)[NUM_PLACE]
        fits[code, list(range(256) if legal is None else legal)] = True
    return fits.reshape(-1)


def _forbidden_bits() -> tuple[Array, Array]:
    """By kind, in the front and in the back of a frame: the bits that must not be set."""
    masks = np.zeros((NO_KIND + 1, FRAME_LENGTH), np.uint8)
    for code, kind in enumerate(KINDS):
        for place in range(NUM_PLACE + 1, FRAME_LENGTH - 1):
            legal = legal_bytes(kind)[place]
            if legal is not None:
                masks[code, place] = 0xFF ^ np.bitwise_or.reduce(list(legal))
    packed = np.ascontiguousarray(masks).view(_FRAME).reshape(-1)
    return packed["front"].copy(), packed["back"].copy()


_KIND: Final = _kind_codes()
_NUM_FITS: Final = _num_fits()
_FRONT_MASK, _BACK_MASK = _forbidden_bits()
_TAIL_HIGH: Final = np.uint16(TAIL << 8)
_HEADERS: Final = tuple(np.uint64(header) * _EVERY_BYTE for header in HEADERS.values())
_TAILS: Final = np.uint64(TAIL) * _EVERY_BYTE
_ABOVE_CMDS: Final = np.uint64(0xFC) * _EVERY_BYTE
_ABOVE_NUMS: Final = np.uint64(0xF8) * _EVERY_BYTE
_NO_PAYLOAD: Final = np.uint64(0xFF << 56)


def plain_frames(data: bytes, start: int) -> int:
    """How many frames in step from `start` fit at every place and hold nothing dividing.

    It may stop early, never late: see `PLAIN_RUN`, which is what counts.
    """
    total = (len(data) - start) // FRAME_LENGTH
    frames = np.frombuffer(data, _FRAME, total, start)
    done, block = 0, _FIRST_BLOCK
    while done < total:
        wrong = _not_plain(frames[done : done + block])
        if wrong.any():
            return done + int(wrong.argmax())
        done += len(wrong)
        block = min(2 * block, _LARGEST_BLOCK)
    return done


def _not_plain(frames: Array) -> Array:
    front, back = np.ascontiguousarray(frames["front"]), np.ascontiguousarray(frames["back"])
    kinds = _KIND[front.astype(np.uint16)]
    num = (front >> np.uint64(16)).astype(np.uint8)
    wrong = ~_NUM_FITS[kinds.astype(np.uint16) << np.uint16(8) | num]
    wrong |= (front & _FRONT_MASK[kinds]) != 0
    wrong |= (back & _BACK_MASK[kinds]) != 0
    wrong |= (back & np.uint16(0xFF00)) != _TAIL_HIGH
    payload = front >> np.uint64(16) | back.astype(np.uint64) << np.uint64(48) | _NO_PAYLOAD
    wrong[_dividing(payload)] = True
    return np.asarray(wrong)


def _dividing(payload: Array) -> Array:
    """Where a header follows a tail, or stands before what can be a CMD and a motor."""
    headers = _zeros(payload ^ _HEADERS[0])
    for header in _HEADERS[1:]:
        headers |= _zeros(payload ^ header)
    with_header = headers.nonzero()[0]
    headers, payload = headers[with_header], payload[with_header]
    tails = _zeros(payload ^ _TAILS)
    cmds = _zeros(payload & _ABOVE_CMDS) & ~_zeros(payload)
    nums = _zeros(payload & _ABOVE_NUMS)
    named = headers & cmds >> np.uint64(8) & nums >> np.uint64(16)
    return np.asarray(with_header[(tails & headers >> np.uint64(8) | named) != 0])


def _zeros(numbers: Array) -> Array:
    """The highest bit of every byte that is 0."""
    return np.asarray(~((numbers & _LOW_BITS) + _LOW_BITS | numbers | _LOW_BITS))


@dataclass(frozen=True, slots=True)
class BulkColumns:
    """The rows of one port's stream as columns, all equally long, in stream order."""

    port: str
    offset: Array
    """Of the row's first byte, int64."""
    length: Array
    """Bytes, int64."""
    framed: Array
    """Whether the row is a frame, bool."""
    kind: Array
    """Place of the kind in `KINDS`, `NO_KIND` where the row has none, uint8."""
    values: Mapping[str, Array]
    """By row name, the value in its own width; it means something only where `known` says so."""
    faults: Array
    """Place of the row's faults in `fault_sets`, uint16."""
    fault_sets: tuple[tuple[Fault, ...], ...]
    """Every combination of faults that occurs; the first is none."""

    def known(self, name: str) -> Array:
        """Where the rows have a value of that name."""
        has = np.array([kind.field(name) is not None for kind in KINDS] + [False])
        return has[self.kind]


def bulk_columns(port: str, data: bytes, baud: int = DEFAULT_BAUD) -> BulkColumns:
    """Frame the bytes of one port, which have no times, into columns."""
    framer = Framer(port, baud, skip=plain_frames)
    spans = framer.feed_spans(Chunk(port, None, data)) + framer.flush_spans()
    return _columns(port, spans)


_BLANK: Final = bytes(FRAME_LENGTH)


def _columns(port: str, spans: Iterable[Row | Run]) -> BulkColumns:
    parts: list[bytes] = []
    odd: list[tuple[int, Row]] = []
    rows = 0
    for span in spans:
        if isinstance(span, Run):
            parts.append(span.raw)
            rows += len(span.raw) // FRAME_LENGTH
        else:
            parts.append(span.raw if isinstance(span, Frame) else _BLANK)
            odd.append((rows, span))
            rows += 1
    raw = np.frombuffer(parts[0] if len(parts) == 1 else b"".join(parts), np.uint8)
    frames = raw.reshape(-1, FRAME_LENGTH)
    places = np.array([place for place, _ in odd], np.int64)
    length = np.full(rows, FRAME_LENGTH, np.int64)
    length[places] = [len(row.raw) for _, row in odd]
    framed = np.ones(rows, np.bool_)
    framed[places] = [isinstance(row, Frame) for _, row in odd]
    faults = np.zeros(rows, np.uint16)
    faults[places], sets = _fault_codes([row.faults for _, row in odd])
    kind, values = _decoded(frames)
    offset = np.arange(0, rows * FRAME_LENGTH, FRAME_LENGTH)
    excess = np.zeros(rows, np.int64)
    excess[places] = length[places] - FRAME_LENGTH
    if excess.any():
        offset += np.cumsum(excess) - excess
    return BulkColumns(port, offset, length, framed, kind, values, faults, sets)


def _fault_codes(
    rows: list[tuple[Fault, ...]],
) -> tuple[list[int], tuple[tuple[Fault, ...], ...]]:
    """A number for each row's faults, and what the numbers stand for."""
    numbers: dict[tuple[Fault, ...], int] = {(): 0}
    codes: list[int] = []
    last: tuple[Fault, ...] | None = None
    for faults in rows:
        if faults is not last:
            number, last = numbers.setdefault(faults, len(numbers)), faults
        codes.append(number)
    return codes, tuple(numbers)


_Places: TypeAlias = list[tuple[int, Array]]
"""Where a field stands, by its first byte, and which kinds have it there."""


def _field_places() -> dict[str, tuple[np.dtype[Any], _Places]]:
    """For every row name the field's form on the wire, and its places."""
    found: dict[str, tuple[np.dtype[Any], _Places]] = {}
    for first in VALUE_FIELDS:
        places: dict[int, Array] = {}
        for code, kind in enumerate(KINDS):
            field = kind.field(first.name)
            if field is not None:
                places.setdefault(field.start, np.zeros(NO_KIND + 1, np.bool_))[code] = True
        wire = np.dtype(f">{'i' if first.signed else 'u'}{first.size}")
        found[first.name] = wire, list(places.items())
    return found


_FIELD_PLACES: Final = _field_places()


def _decoded(frames: Array) -> tuple[Array, Mapping[str, Array]]:
    """The kind of every row, and every field of the table, read where the row's kind has it."""
    rows = len(frames)
    kinds = np.empty(rows, np.uint8)
    values = {
        name: np.empty(rows, wire.newbyteorder("=")) for name, (wire, _) in _FIELD_PLACES.items()
    }
    for at in range(0, rows, _LARGEST_BLOCK):
        block = slice(at, at + _LARGEST_BLOCK)
        own = frames[block]
        kind = _KIND[own[:, 0] | own[:, 1].astype(np.uint16) << np.uint16(8)]
        kinds[block] = kind
        for name, (wire, ((start, _), *others)) in _FIELD_PLACES.items():
            column = values[name][block]
            column[:] = _read(own, start, wire)
            for other, has in others:
                np.copyto(column, _read(own, other, wire), where=has[kind])
    return kinds, MappingProxyType(values)


def _read(frames: Array, start: int, wire: np.dtype[Any]) -> Array:
    """One field in every frame; fields are big-endian (PROTOCOL.md, "Framing")."""
    return np.ndarray((len(frames),), wire, frames, offset=start, strides=(FRAME_LENGTH,))
