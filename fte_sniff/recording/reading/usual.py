"""Owns the usual case: sound frames, whose messages begin alike whatever their schema.

It must not know channels or ports. All that makes such a row stands in the message's front at one
place, so rows of any number of schemas are read at once, and need not be brought into order.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL
from fte_sniff.recording.container.records import HEAD
from fte_sniff.recording.encoding.columns import Array, RowColumns
from fte_sniff.recording.encoding.layout import Layout, Layouts
from fte_sniff.recording.encoding.messages import class_of
from fte_sniff.recording.encoding.topics import TOPICS
from fte_sniff.recording.reading.side import RAW, Guard, all_fit, guard, which_fit, words_of
from fte_sniff.recording.reading.starts import (
    FRONT,
    LENGTH_PLACE,
    LOG_TIME_PLACE,
    MESSAGE_HEAD,
    numbers,
)

_NUMBER = 8
_SIGN = 0x80
"""The bit of a number's last byte that no time and no offset has."""


def _model() -> Layout:
    """The layout of some topic's sound frames."""
    layout = Layouts(class_of(TOPICS[0]).DESCRIPTOR).usual
    assert layout is not None
    return layout


_MODEL = _model()


@lru_cache(maxsize=256)
def is_usual(layout: Layout) -> bool:
    """Whether messages of this layout are of sound frames, and all that makes the row is in place.

    So it is for every schema of ours; those of a file may be others.
    """
    plain = layout.time is layout.framed is layout.unordered is None and not layout.fault_count
    places = layout.offset, layout.delay, layout.raw, layout.raw_length
    wanted = _MODEL.offset, _MODEL.delay, _MODEL.raw, _MODEL.raw_length
    return plain and places == wanted and MESSAGE_HEAD + len(layout.mask) <= FRONT


def _length(layout: Layout) -> int:
    """What stands in the head of each message's record."""
    return MESSAGE_HEAD - HEAD.size + len(layout.mask)


@lru_cache(maxsize=256)
def _guard(layout: Layout, header: int) -> Guard:
    """That of the layout; besides, its length, numbers below 2^63, and both ends of the frame."""
    mask, expected = bytearray(layout.mask), bytearray(layout.expected)
    mask[layout.offset + _NUMBER - 1] |= _SIGN
    for place, byte in ((layout.raw, header), (layout.raw + FRAME_LENGTH - 1, TAIL)):
        mask[place], expected[place] = 0xFF, byte
    head = bytearray(MESSAGE_HEAD)
    head[LOG_TIME_PLACE + _NUMBER - 1] = _SIGN
    length = slice(LENGTH_PLACE, LENGTH_PLACE + _NUMBER)
    head[length] = b"\xff" * _NUMBER
    found = bytearray(MESSAGE_HEAD)
    found[length] = _length(layout).to_bytes(_NUMBER, "little")
    return guard((head + mask).ljust(FRONT, b"\0"), (found + expected).ljust(FRONT, b"\0"))


def which_usual(fronts: Array, layout: Layout) -> Array | None:
    """Which of the fronts keep to a usual layout and are of frames; None where all do."""
    words = words_of(fronts)
    header = int(fronts[:1].view(np.uint8)[MESSAGE_HEAD + layout.raw])
    headers = HEADERS.values()
    if header in headers and all_fit(words, _guard(layout, header)):
        return None
    as_long = numbers(fronts, LENGTH_PLACE, "<i8") == _length(layout)
    if as_long.any() and not as_long.all():
        fits = which_usual(fronts[as_long], layout)
        if fits is not None:
            as_long[as_long] = fits
        return np.asarray(as_long)
    each = [which_fit(words, _guard(layout, one)) for one in headers]
    return np.asarray(np.logical_or.reduce(each))


def put_usual(columns: RowColumns, rows: slice | Array, fronts: Array) -> tuple[int, int]:
    """Fill in these rows from their fronts, one at least; returns the first and last log time."""
    times = numbers(fronts, LOG_TIME_PLACE, "<i8")
    columns.t_ns[rows] = times
    columns.offset[rows] = _column(fronts, _MODEL.offset, "<i8")
    columns.delay_ns[rows] = _column(fronts, _MODEL.delay or 0, "<i8")
    columns.raw.view(RAW).reshape(-1)[rows] = _column(fronts, _MODEL.raw, RAW)
    return int(times.min()), int(times.max())


def _column(fronts: Array, place: int, kind: str | np.dtype[np.void]) -> Array:
    found: Array = np.ndarray((len(fronts),), kind, fronts, MESSAGE_HEAD + place, (FRONT,))
    return found
