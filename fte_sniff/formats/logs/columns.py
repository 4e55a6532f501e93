"""Many lines at once with numpy: one line of each length and shape is read, the others like it.

Two lines have the same shape if they differ only in digits: of the bytes, of the time, and of
numbers before the bytes. What is not so regular is read line by line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fte_sniff.formats.logs.evidence import NUMBER_TOKEN
from fte_sniff.formats.logs.streams import LogStreams
from fte_sniff.formats.logs.text import TextBlock
from fte_sniff.formats.logs.times import Fields, Stamp

if TYPE_CHECKING:
    from fte_sniff.formats.logs.evidence_log import EvidenceLog
    from fte_sniff.formats.logs.streams import Array

Bytes = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]

_MOST_SHAPES: Final = 24
_LONGEST: Final = 4096
_LEAST_SHARE: Final = 0.9
_VALUE: Final = np.full(256, 0xFF, np.uint8)
for _base, _digits in ((0, b"0123456789"), (10, b"ABCDEF"), (10, b"abcdef")):
    _VALUE[list(_digits)] = np.arange(_base, _base + len(_digits))


class _Shape(NamedTuple):
    """Lines that differ only in digits."""

    rows: Array
    """Their indices in the block."""
    data: Bytes
    """Of each line, the same number of bytes."""
    label: str | None
    stamp: Stamp | None


def read_columns(log: EvidenceLog, block: TextBlock, streams: LogStreams, name: str) -> bool:
    """Append the bytes of a block of lines; False, and nothing is done, if they are not regular."""
    text = np.frombuffer(block.text, np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    starts = np.append(0, ends[:-1] + 1)
    lengths = ends - starts
    shapes: list[_Shape] = []
    for length in np.flatnonzero(np.bincount(lengths)).tolist():
        rows = np.flatnonzero(lengths == length)
        if 0 < length <= _LONGEST and len(rows) > 1:
            items = np.ndarray((len(text) - length + 1,), f"V{length}", text, 0, (1,))
            shapes += _shapes(log, items, starts, rows)
    known = np.full(len(ends), -1)
    for number, shape in enumerate(shapes):
        known[shape.rows] = number
    zones = {shape.stamp and shape.stamp.zone_s for shape in shapes}
    if (known < 0).mean() > 1 - _LEAST_SHARE or len(zones) != 1:
        return False
    _append(log, shapes, known, block, streams, name)
    return True


def _shapes(
    log: EvidenceLog, items: npt.NDArray[np.void], starts: Array, rows: Array
) -> Iterator[_Shape]:
    """The lines of one length by their shapes; `items` are lines from each offset on."""
    for _ in range(_MOST_SHAPES):
        if not len(rows):
            return
        table = _columns(items[starts[rows]])
        line = table[:, 0].tobytes()
        other = np.arange(len(rows)) > 0
        if parts := _parts(log, line):
            fixed, numbers, pairs, fields = parts
            same = (table[fixed] == table[fixed, :1]).all(0)
            same &= (table[numbers] - np.uint8(ord("0")) < 10).all(0)
            nibbles = _VALUE.take(table[pairs])
            same &= (nibbles < 16).all(0)
            own = rows if same.all() else rows[same]
            if not same.all():
                table = _columns(items[starts[own]])
                nibbles = _VALUE.take(table[pairs])
            stamp = None
            if fields:
                stamp = log.layout.times.stamp(line, fields, partial(_number, table))
            if stamp is not None or not fields:
                data = np.ascontiguousarray((nibbles[::2] << np.uint8(4) | nibbles[1::2]).T)
                label = log.layout.label_of(line, log.layout.runs(line)[0])
                yield _Shape(own, data, label, stamp)
                other &= ~same
        rows = rows[other]


def _columns(items: npt.NDArray[np.void]) -> Bytes:
    """The bytes of lines of one length; a row for each column of the text."""
    return np.ascontiguousarray(items.view(np.uint8).reshape(len(items), -1).T)


def _parts(log: EvidenceLog, line: bytes) -> tuple[Bools, Bools, list[int], Fields] | None:
    """Where a line has fixed text, digits of numbers and of bytes, and the fields of its time."""
    layout = log.layout
    found = layout.runs(line)
    labels = {layout.label_of(line, one) for one in found}
    if len(labels) != 1 or any(run.gap for run in found):
        return None
    pairs = list[int]()
    for one in found:
        text = line[one.start : one.stop]
        of_run = [one.start + pair.start() for pair in re.finditer(b"[0-9A-Fa-f]{2}", text)]
        pairs += [at + digit for at in of_run[one.cut] for digit in (0, 1)]
    place = layout.stamp_of(line, found[0])
    if len(pairs) != 2 * sum(len(one.data) for one in found):
        return None
    if (place is None) != (layout.times.where != "before"):
        return None
    fields = {} if place is None else place[0]
    free, numbers = np.zeros((2, len(line)), np.bool_)
    free[pairs] = True
    for number in re.finditer(NUMBER_TOKEN, line[: found[0].start]):
        numbers[number.start() : number.end()] = True
    numbers[slice(*fields.get("zone", (0, 0)))] = False
    numbers &= np.frombuffer(line, np.uint8) - np.uint8(ord("0")) < 10
    return ~(free | numbers), numbers, pairs, fields


def _number(table: Bytes, start: int, stop: int) -> Array | int:
    """The number in some columns; one for all lines while their digits are equal."""
    number: Array | int = 0
    for digits in table[start:stop]:
        equal = (digits == digits[0]).all()
        number = number * 10 + (int(digits[0]) if equal else digits.astype(np.int64)) - ord("0")
    return number


def _append(
    log: EvidenceLog,
    shapes: list[_Shape],
    known: Array,
    block: TextBlock,
    streams: LogStreams,
    name: str,
) -> None:
    """Append all lines in their order; those of no shape one by one."""
    sizes, ns = np.zeros((2, len(known)), np.int64)
    table = np.zeros((len(known), max(shape.data.shape[1] for shape in shapes)), np.uint8)
    for rows, data, _, stamp in shapes:
        table[rows, : data.shape[1]], sizes[rows] = data, data.shape[1]
        ns[rows] = 0 if stamp is None else stamp.ns
    zone = shapes[0].stamp and shapes[0].stamp.zone_s
    numbers = np.arange(block.first, block.first + len(known))
    labels: dict[str | None, list[int]] = {}
    for number, shape in enumerate(shapes):
        labels.setdefault(shape.label, []).append(number)
    start = 0
    for stop in [*np.flatnonzero(known < 0).tolist(), len(known)]:
        part, times = slice(start, stop), None
        if shapes[0].stamp is not None and stop > start:
            times = log.clock.column(Stamp(ns[part], zone), numbers[part])
        elif streams.start_ns is not None:
            size = streams.size + np.cumsum(sizes[part])
            times = streams.start_ns + size * streams.byte_ns
        one_by_one = [stop] if stop < len(known) else []
        if shapes[0].stamp is not None and times is None:
            one_by_one = [*range(start, stop), *one_by_one]
        else:
            for label, own in labels.items():
                mine = np.isin(known[part], own)
                if not mine.any():
                    continue
                stream = log.stream_of(streams, name, label)
                data, size = table[part][mine], sizes[part][mine]
                if (size < data.shape[1]).any():
                    data = data[np.arange(data.shape[1]) < size[:, None]]
                own_times = None if times is None else times[mine]
                stream.append_columns(data.tobytes(), size, numbers[part][mine], own_times)
        for at in one_by_one:
            log.read_line(block.lines[at], block.first + at, streams, name)
        start = stop + 1
