"""Owns the usual case: sound frames, whose messages begin alike whatever their schema.

It must not know channels or ports. Whether messages are such is seen schema by schema; all that
makes the row stands in the message's front at one place, so the rows of any number of schemas are
read at once, and need not be brought into order.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL
from fte_sniff.recording.encoding.layout import Layout, Layouts
from fte_sniff.recording.encoding.messages import class_of
from fte_sniff.recording.encoding.topics import TOPICS
from fte_sniff.recording.reading.side import RAW, Guard, Side, all_fit, guard, which_fit
from fte_sniff.recording.reading.starts import FRONT, MESSAGE_HEAD
from fte_sniff.row_batch import Array, RowColumns

_NUMBER = 8
_SIGN = 0x80
"""The bit of a number's last byte that no offset has."""


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
    return plain and places == wanted and MESSAGE_HEAD + layout.raw + FRAME_LENGTH <= FRONT


@lru_cache(maxsize=256)
def _guard(layout: Layout, header: int) -> Guard:
    """That of the layout; besides, an offset below 2^63, and both ends of the frame."""
    mask, expected = bytearray(layout.mask), bytearray(layout.expected)
    mask[layout.offset + _NUMBER - 1] |= _SIGN
    for place, byte in ((layout.raw, header), (layout.raw + FRAME_LENGTH - 1, TAIL)):
        mask[place], expected[place] = 0xFF, byte
    return guard(mask, expected)


def which_usual(side: Side, layout: Layout) -> Array | None:
    """Which messages, one at least and all as long as the usual layout, keep to it and are of
    frames; None where all do."""
    words, headers = side.words, HEADERS.values()
    header = next(side.bytes_at(layout.raw, 1))[0]
    if header in headers and all_fit(words, _guard(layout, header)):
        return None
    each = [which_fit(words, _guard(layout, one)) for one in headers]
    return np.asarray(np.logical_or.reduce(each))


def put_usual(columns: RowColumns, rows: slice | Array, fronts: Array) -> None:
    """Fill in these rows from their fronts; all but times and ports."""
    columns.offset[rows] = _column(fronts, _MODEL.offset, "<i8")[rows]
    columns.delay_ns[rows] = _column(fronts, _MODEL.delay or 0, "<i8")[rows]
    columns.raw.view(RAW).reshape(-1)[rows] = _column(fronts, _MODEL.raw, RAW)[rows]


def _column(fronts: Array, place: int, kind: str | np.dtype[np.void]) -> Array:
    found: Array = np.ndarray((len(fronts),), kind, fronts, MESSAGE_HEAD + place, (FRONT,))
    return found
