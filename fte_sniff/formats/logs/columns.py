"""Many lines at once with numpy: one line of each length and shape is read, the others like it.

Two lines have the same shape if they differ only in digits: of the bytes, of the time, and of
numbers before the bytes. What is not so regular is read line by line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fte_sniff.formats.logs.evidence import NUMBER_TOKEN
from fte_sniff.formats.logs.times import Fields, Stamp

if TYPE_CHECKING:
    from fte_sniff.formats.logs.evidence_log import EvidenceLog
    from fte_sniff.formats.logs.streams import LogStreams

Array = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]

_MOST_SHAPES: Final = 24
_LEAST_SHARE: Final = 0.9
_PAIR: Final = re.compile(rb"[0-9A-Fa-f]{2}")
_SHAPE: Final = np.arange(256, dtype=np.uint8)
_SHAPE[list(b"123456789ABCDEFabcdef")] = ord("0")
_VALUE: Final = np.full(256, 0xFF, np.uint8)
_VALUE[list(b"0123456789")] = np.arange(10)
_VALUE[list(b"ABCDEF")] = _VALUE[list(b"abcdef")] = np.arange(10, 16)


class Columns(NamedTuple):
    """The lines of one stream."""

    stops: Array
    """The offset after the bytes of each line, among those of all."""
    lines: Array
    t_ns: Array | None


class _Shape(NamedTuple):
    """Lines that differ only in digits."""

    rows: Array
    """Their indices in the block."""
    data: Bytes
    """Of each line, the same number of bytes."""
    label: str | None
    stamp: Stamp | None


def read_columns(
    log: EvidenceLog, lines: Sequence[bytes], first: int, streams: LogStreams, name: str
) -> bool:
    """Append the bytes of a block of lines; False, and nothing is done, if they are not regular."""
    lengths = np.fromiter(map(len, lines), np.int64, len(lines))
    text = np.frombuffer(b"".join(lines), np.uint8)
    starts = np.cumsum(lengths) - lengths
    shapes: list[_Shape] = []
    known = np.zeros(len(lines), np.bool_)
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        if length == 0 or len(rows) == 1:
            continue
        items = np.ndarray((len(text) - length + 1,), f"V{length}", text, 0, (1,))[starts[rows]]
        table = items.view(np.uint8).reshape(-1, length)
        for shape in _shapes(log, table, rows):
            shapes.append(shape)
            known[shape.rows] = True
    kinds = {shape.stamp and (shape.stamp.kind, shape.stamp.zone_s) for shape in shapes}
    if known.mean() < _LEAST_SHARE or len(kinds) != 1:
        return False
    _append(log, shapes, lines, first, known, streams, name)
    return True


def _shapes(log: EvidenceLog, table: Bytes, rows: Array) -> Iterator[_Shape]:
    """The lines of one length by their shapes."""
    for _ in range(_MOST_SHAPES):
        if not len(rows):
            return
        line = table[0].tobytes()
        read = _read(log, line, table, rows)
        if read is None:
            other = (_SHAPE[table] != _SHAPE[table[0]]).any(1)
        else:
            shape, same = read
            yield shape
            if same.all():
                return
            other = ~same
            other[0] = False
        table, rows = table[other], rows[other]


def _read(
    log: EvidenceLog, line: bytes, table: Bytes, rows: Array
) -> tuple[_Shape, npt.NDArray[np.bool_]] | None:
    """The lines that are like the first in all but digits of bytes, time and numbers."""
    layout = log.layout
    found = layout.runs(line)
    if not found or any(run.gap for run in found):
        return None
    run, pairs = found[0], list[int]()
    for one in found:
        of_run = [pair.start() for pair in _PAIR.finditer(line, one.start, one.stop)]
        pairs += of_run[one.cut]
    place = layout.stamp_of(line, run)
    labels = {layout.label_of(line, one) for one in found}
    if len(pairs) != sum(len(one.data) for one in found) or len(labels) > 1:
        return None
    if (place is None) != (layout.times.where != "before"):
        return None
    of_bytes, numbers = np.zeros((2, len(line)), np.bool_)
    of_bytes[pairs] = of_bytes[[at + 1 for at in pairs]] = True
    for number in re.finditer(NUMBER_TOKEN, line[: run.start]):
        numbers[number.start() : number.end()] = True
    numbers &= np.frombuffer(line, np.uint8) - np.uint8(ord("0")) < 10
    if place is not None and "zone" in place[2]:
        numbers[slice(*place[2]["zone"])] = False
    fixed = ~(of_bytes | numbers)
    same = (table[:, fixed] == np.frombuffer(line, np.uint8)[fixed]).all(1)
    same &= (table[:, numbers] - np.uint8(ord("0")) < 10).all(1)
    high, low = _VALUE[table[:, pairs]], _VALUE[table[:, [at + 1 for at in pairs]]]
    same &= ((high | low) < 16).all(1)
    whole = bool(same.all())
    if not whole:
        table, rows, high, low = table[same], rows[same], high[same], low[same]
    stamp = None
    if place is not None:
        if not _is_clock(place[2], table):
            return None
        stamp = layout.times.stamp(line, place[2], lambda start, stop: _number(table, start, stop))
    data: Bytes = high * 16 + low
    return _Shape(rows, data, layout.label_of(line, run), stamp), same


def _number(table: Bytes, start: int, stop: int) -> Array:
    powers = 10 ** np.arange(stop - start - 1, -1, -1, dtype=np.int64)
    return (table[:, start:stop] - np.int64(ord("0"))) @ powers


_LIMITS: Final = {"h": 24, "mi": 59, "s": 60, "mo": 12, "mo2": 12, "mo5": 12, "d": 31, "d2": 31}


def _is_clock(fields: Fields, table: Bytes) -> bool:
    return all(
        (_number(table, *span) <= _LIMITS[name]).all()
        for name, span in fields.items()
        if name in _LIMITS
    )


def _append(
    log: EvidenceLog,
    shapes: Sequence[_Shape],
    lines: Sequence[bytes],
    first: int,
    known: npt.NDArray[np.bool_],
    streams: LogStreams,
    name: str,
) -> None:
    """Append all lines in their order; those of no shape one by one."""
    sizes = np.zeros(len(lines), np.int64)
    shape_of = np.full(len(lines), -1)
    for number, shape in enumerate(shapes):
        sizes[shape.rows], shape_of[shape.rows] = shape.data.shape[1], number
    starts = np.cumsum(sizes) - sizes
    data = np.empty(int(sizes.sum()), np.uint8)
    for shape in shapes:
        data[starts[shape.rows][:, None] + np.arange(shape.data.shape[1])] = shape.data
    stamps = _stamps(shapes, len(lines))
    labels = [shape.label for shape in shapes]
    start = 0
    for stop in [*np.flatnonzero(~known).tolist(), len(lines)]:
        if stop > start:
            part = slice(start, stop)
            stamp = stamps and stamps._replace(
                ns=stamps.ns[part], days=None if stamps.days is None else stamps.days[part]
            )
            t_ns = log.column_of(stamp, np.arange(first + start, first + stop))
            for label in dict.fromkeys(labels):
                numbers = [number for number, other in enumerate(labels) if other == label]
                mine = np.isin(shape_of[part], numbers)
                own = sizes[part][mine]
                if len(own):
                    begin, end = int(starts[start]), int(starts[stop - 1] + sizes[stop - 1])
                    of_label = data[begin:end][np.repeat(mine, sizes[part])]
                    columns = Columns(
                        np.cumsum(own),
                        np.arange(first + start, first + stop)[mine],
                        None if t_ns is None else t_ns[mine],
                    )
                    log.stream_of(streams, name, label).append_columns(of_label.tobytes(), columns)
        if stop < len(lines):
            log.read_line(lines[stop], first + stop, streams, name)
        start = stop + 1


def _stamps(shapes: Sequence[_Shape], count: int) -> Stamp | None:
    """The stamps of all lines as columns; None without any."""
    if shapes[0].stamp is None:
        return None
    ns, days = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for shape in shapes:
        if shape.stamp is not None:
            ns[shape.rows] = shape.stamp.ns
            days[shape.rows] = 0 if shape.stamp.days is None else shape.stamp.days
    stamp = shapes[0].stamp
    return Stamp(ns, None if stamp.days is None else days, stamp.zone_s, stamp.kind)
