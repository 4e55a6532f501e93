"""Owns the rows of messages that lie side by side and keep to one layout.

It must not know channels, nor how it was seen that they keep to it. Bytes that cannot be what their
message says they are make no row here: reading it by itself tells what is wrong with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL
from fte_sniff.recording.encoding.layout import Layout
from fte_sniff.recording.encoding.message_reader import MessageReader
from fte_sniff.recording.reading.side import RAW, Side
from fte_sniff.row_batch import Array, RowColumns, Words


def put_side(
    columns: RowColumns,
    rows: Array,
    side: Side,
    log_times: Array,
    layout: Layout,
    reader: MessageReader,
) -> tuple[Array, tuple[int, int] | None]:
    """Fill in all but the ports.

    Args:
        columns: takes the rows.
        rows: where, for each message.
        side: the messages.
        log_times: theirs.
        layout: what all of them keep to.
        reader: that of one of their channels.

    Returns:
        A mask of the messages that make a row; the first and last log time of those, if any.
    """
    times = side.number(layout.time, "<i8") if layout.time is not None else log_times
    offsets = side.number(layout.offset, "<i8")
    raw = side.raw(layout)
    framed = _framed(side, layout)
    good = (times >= 0) & (offsets >= 0) & _is_sound(raw, framed, layout.raw_length)
    faults = _fault_codes(columns.words, reader, side, layout)
    good &= faults >= 0
    if not good.all():
        rows, side, log_times = rows[good], side.parted(good), log_times[good]
        times, offsets, raw = times[good], offsets[good], raw[good]
        framed = framed if framed is True else framed[good]
        faults = faults[good] if layout.fault_count else faults
    if not len(rows):
        return good, None
    columns.t_ns[rows] = times
    columns.offset[rows] = offsets
    columns.raw.view(RAW).reshape(-1)[rows] = raw.view(RAW).reshape(-1)
    if framed is not True:
        columns.framed[rows] = framed
    if layout.fault_count:
        columns.faults[rows] = faults
    _put_seldom(columns, rows, side, layout)
    logged = log_times.view(np.uint64)
    return good, (int(logged.min()), int(logged.max()))


def _put_seldom(columns: RowColumns, rows: Array, side: Side, layout: Layout) -> None:
    """What blank columns hold already for most rows."""
    if layout.delay is None:
        columns.delayed[rows] = False
    else:
        columns.delay_ns[rows] = side.number(layout.delay, "<i8")
    if layout.unordered is not None:
        columns.unordered[rows] = side.number(layout.unordered, "u1").astype(np.bool_)
    if layout.raw_length != FRAME_LENGTH:
        columns.length[rows] = layout.raw_length
    if layout.raw_length > FRAME_LENGTH:
        whole = side.bytes_at(layout.raw, layout.raw_length)
        columns.long.update(zip(rows.tolist(), whole, strict=True))


def _framed(side: Side, layout: Layout) -> Any:
    if layout.framed is None:
        return True
    return side.number(layout.framed, "u1").astype(np.bool_)


def _fault_codes(words: Words, reader: MessageReader, side: Side, layout: Layout) -> Array:
    """The number of each row's faults in the words; -1 where this version knows them not."""
    if not layout.fault_count:
        return np.zeros(1, np.int32)
    packed = np.zeros(len(side), np.uint32)
    for at in range(layout.fault_count):
        packed = packed << np.uint32(8) | side.number(layout.faults + at, "u1")
    found, inverse = np.unique(packed, return_inverse=True)
    count = layout.fault_count
    codes = [_fault_code(words, reader, number.to_bytes(count, "big")) for number in found.tolist()]
    return np.array(codes)[inverse]


def _fault_code(words: Words, reader: MessageReader, numbers: bytes) -> int:
    try:
        return words.fault_code(tuple(map(reader.fault, numbers)))
    except ValueError:
        return -1


def _is_sound(raw: Array, framed: Any, length: int) -> Any:
    """Where bytes can be what they are said to be: damage is anything, a frame has its frame."""
    if framed is not True and not framed.any():
        return True
    if length != FRAME_LENGTH:
        return ~framed
    first = raw[:, 0]
    sound = raw[:, -1] == TAIL
    headed = np.zeros(len(raw), np.bool_)
    for header in HEADERS.values():
        headed |= first == header
    sound &= headed
    return sound if framed is True else sound | ~framed
