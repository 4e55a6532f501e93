"""Lines of one shape: they have the same length and differ only in digits.

One of them is parsed; numpy reads the bytes and times of the others at the same offsets.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from fte_sniff.formats.log_form import NO_TIME
from fte_sniff.formats.logs.evidence import NUMBER_TOKEN
from fte_sniff.formats.logs.layout import Layout, without_bytes
from fte_sniff.formats.logs.times import OF_CLOCK, Fields, TimeRule

_MOST_SHAPES: Final = 24
"""Of one length; the lines of others are parsed one by one."""
_LONGEST_SHAPE: Final = 4096
_ZERO: Final = np.uint8(ord("0"))
_HEX_DIGITS: Final = np.full(256, 0xFF, np.uint8)
"""By character, the value of a hexadecimal digit; 255 of others."""
_HEX_DIGITS[list(b"0123456789ABCDEFabcdef")] = [*range(16), *range(10, 16)]
_NEXT_DIGIT: Final = bytes.maketrans(b"0123456789", b"1234567890")


class _Shape(NamedTuple):
    """A line, and where others of its shape may differ from it."""

    line: bytes
    label: str | None
    fields: Fields
    """Of its time."""
    digits: list[int]
    """Offsets of the decimal digits of times and other numbers."""
    pairs: list[int]
    """Offsets of pairs of hexadecimal digits, those of the data first."""
    size: int
    """Of the data."""


def alike_lines(text: bytes, layout: Layout) -> Iterator[tuple[Any, bytes, str | None, Any]]:
    """The lines of a text that have the shape of another line, shape by shape.

    Yields their indices in the text, int64; their bytes, of each line the same number; their label;
    and their times, an int64 column or one for all.
    """
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
    starts = np.append(0, ends[:-1] + 1)
    lengths = ends - starts
    counts = np.bincount(lengths[(lengths > 0) & (lengths <= _LONGEST_SHAPE)])
    for length in np.flatnonzero(counts).tolist():
        rows = np.flatnonzero(lengths == length)
        lines = np.ndarray((len(text) - length + 1,), f"V{length}", text, 0, (1,))
        for _ in range(_MOST_SHAPES):
            if len(rows) < 2:
                break
            same = np.arange(len(rows)) == 0
            if shape := _shape_of(lines[starts[rows[0]]].tobytes(), layout):
                table = lines[starts[rows]].view(np.uint8).reshape(len(rows), -1)
                same, data, stamp = _read(shape, np.ascontiguousarray(table.T), layout.times)
                if stamp is not None:
                    yield rows[same], data, shape.label, stamp
            rows = rows[~same]


def _shape_of(line: bytes, layout: Layout) -> _Shape | None:
    """The shape of a line; None if lines like it must be parsed one by one."""
    found, another = layout.read(line)
    if another or not found or any(one.gap for one in found):
        return None
    if any((one.label, one.fields) != (found[0].label, found[0].fields) for one in found):
        return None
    pairs, skipped = list[int](), list[int]()
    for one in found:
        run = re.finditer(b"[0-9A-Fa-f]{2}", line[one.start : one.stop])
        starts = [one.start + pair.start() for pair in run]
        pairs += starts[one.cut]
        skipped += sorted({*starts} - {*starts[one.cut]})
    data = b"".join(one.data for one in found)
    digits_of_data = b"".join(line[at : at + 2] for at in pairs)
    untimed = found[0].fields is None and layout.times.where in ("before", "after")
    if not data or untimed or data.hex().encode() != digits_of_data.lower():
        return None
    fields = found[0].fields or {}
    timed = {at for name in fields.keys() & OF_CLOCK for at in range(*fields[name])}
    tokens = re.finditer(NUMBER_TOKEN, without_bytes(line, found))
    numbers = {at for token in tokens for at in range(*token.span())}
    numbers -= {at for span in fields.values() for at in range(*span)}
    digits = {at for at in timed | numbers if re.match(rb"\d(?![xX])", line[at : at + 2])}
    other = bytearray(line)
    for at in digits & numbers:
        other[at] = _NEXT_DIGIT[line[at]]
    if layout.read(bytes(other)) != (found, b""):
        digits &= timed  # the numbers are labels
    return _Shape(line, found[0].label, fields, sorted(digits), pairs + skipped, len(data))


def _read(shape: _Shape, table: Any, times: TimeRule) -> tuple[Any, bytes, Any]:
    """Which lines have a shape, their bytes and times; no times if one of them is impossible.

    `table` has a column for each line, uint8.
    """
    fixed = np.ones(len(table), np.bool_)
    fixed[[*shape.digits, *shape.pairs, *(at + 1 for at in shape.pairs)]] = False
    same = (table[fixed] == table[fixed, :1]).all(0)
    same &= (table[shape.digits] - _ZERO < 10).all(0)
    high, low = (_HEX_DIGITS.take(table[[at + n for at in shape.pairs]]) for n in (0, 1))
    same &= ((high | low) < 16).all(0)
    if not same.all():
        table, high, low = (own[:, same] for own in (table, high, low))
    data = (high << np.uint8(4) | low)[: shape.size].T.tobytes()
    read = partial(_number, table)
    stamp = times.stamp(shape.line, shape.fields, read) if shape.fields else NO_TIME
    return same, data, stamp


def _number(table: Any, start: int, stop: int) -> Any:
    """The number in some columns of a table of lines; one for all while their digits are equal."""
    number: Any = 0
    for digits in table[start:stop]:
        equal = (digits == digits[0]).all()
        number = number * 10 + (int(digits[0]) if equal else digits.astype("int64")) - ord("0")
    return number
