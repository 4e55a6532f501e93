"""Owns turning many messages of a chunk into columns at once.

It must not know files, threads or the order of chunks. Messages of one schema and one length are
laid side by side and their numbers read by numpy, once every one of them is seen to keep to the
layout. Those that do not, and what no layout fits, are read one by one, with the same outcome.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL, PortEvent
from fte_sniff.recording.columns import Array, RowColumns, Words
from fte_sniff.recording.layout import Layout
from fte_sniff.recording.messages import MessageReader, class_of
from fte_sniff.recording.records import HEAD
from fte_sniff.recording.starts import MESSAGE_HEAD
from fte_sniff.recording.topics import TOPICS
from fte_sniff.recording.wire import SOUND_LACKS, laid

Readers = Mapping[int, MessageReader | None]

_CHANNEL_PLACE = HEAD.size
_TIMES = 16
"""Bytes of log time and publish time, which stand right before the message."""
_WORD = 8
_STRIPE = 64
_FEW = 4
"""So few messages of one length are read one by one."""
_MOST_LENGTHS = 512
_CHANNELS = 1 << 16


@dataclass(slots=True)
class Gathered:
    """What came of some messages."""

    columns: RowColumns
    messages: int
    """Messages seen, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of ours."""
    losses: list[str] = field(default_factory=list)
    """What could not be read, one line each."""


def gather(
    records: bytes, starts: Array, lengths: Array, readers: Readers, words: Words
) -> Gathered:
    """The rows and events of the messages that begin at `starts`, in that order.

    Args:
        records: one or more unpacked chunks.
        starts: where message records begin, rising.
        lengths: of the messages, without their heads.
        readers: by channel; None for channels of no interest.
        words: takes up ports and faults.

    Raises:
        KeyError: there is a message of a channel that `readers` does not know.
    """
    return _Gathering(records, starts, lengths, readers, words).gathered()


class _Gathering:
    def __init__(
        self, records: bytes, starts: Array, lengths: Array, readers: Readers, words: Words
    ) -> None:
        self._records, self._starts, self._lengths = records, starts, lengths
        self._readers, self._words = readers, words
        self._rows = RowColumns.blank(words, len(starts))
        self._kept = np.zeros(len(starts), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._losses: list[str] = []
        self._first, self._last = 2**64, -1
        self._usual: list[tuple[Readers, Array]] = []
        self._channels: Array = _at_every_byte(records, "<u2", _CHANNEL_PLACE)[starts]

    def gathered(self) -> Gathered:
        for readers, rows in self._by_schema():
            lengths = self._lengths[rows]
            if (lengths == lengths[0]).all():
                self._take(readers, rows, int(lengths[0]))
                continue
            found, counts = np.unique(lengths, return_counts=True)
            if len(found) > _MOST_LENGTHS:
                self._take_each(readers, rows)
                continue
            for length, count in zip(found.tolist(), counts.tolist(), strict=True):
                same = rows[lengths == length]
                if count <= _FEW:
                    self._take_each(readers, same)
                else:
                    self._take(readers, same, length)
        self._take_usual()
        self._events.sort(key=lambda placed: placed[0])
        events = tuple(event for _, event in self._events)
        columns = self._rows.parted(slice(None), events)
        if not self._kept.all():
            columns = columns.parted(self._kept, events)
        times = None if self._last < 0 else (self._first, self._last)
        return Gathered(columns, len(self._starts), times, self._losses)

    def _by_schema(self) -> Iterator[tuple[Readers, Array]]:
        """The rows of all channels that share a schema, and the readers of those channels."""
        present = np.flatnonzero(np.bincount(self._channels, minlength=1)).tolist()
        groups: dict[int, dict[int, MessageReader]] = {}
        for channel in present:
            reader = self._readers[channel]
            if reader is not None:
                key = id(reader.layouts or reader)
                groups.setdefault(key, {})[channel] = reader
        if len(groups) == 1 and len(next(iter(groups.values()))) == len(present):
            yield next(iter(groups.values())), np.arange(len(self._starts))
            return
        codes = np.full(_CHANNELS, -1, np.int16)
        for code, channels in enumerate(groups.values()):
            codes[list(channels)] = code
        code_of_row = codes[self._channels]
        for code, channels in enumerate(groups.values()):
            yield channels, np.flatnonzero(code_of_row == code)

    def _take(self, readers: Readers, rows: Array, length: int) -> None:
        """Messages of one schema and one length."""
        reader = next(iter(readers.values()))
        assert reader is not None
        if reader.layouts is not None:
            side = _Side(self._records, self._starts[rows], length)
            for layout in reader.layouts.of_length(length):
                fits = side.fits(layout)
                if fits is None and _is_usual(layout):
                    self._usual.append((readers, rows))
                    return
                if fits is None:
                    rows = rows[self._take_side(readers, reader, rows, side, layout)]
                    break
                if fits.any():
                    part = side.parted(fits)
                    left = self._take_side(readers, reader, rows[fits], part, layout)
                    fits[np.flatnonzero(fits)[left]] = False
                    rows, side = rows[~fits], side.parted(~fits)
                if not len(rows):
                    break
        self._take_each(readers, rows)

    def _take_usual(self) -> None:
        """Sound frames of whatever schema have all that makes the row at the same places.

        So they are laid side by side once more, all together, and need not be brought into order.
        """
        if not self._usual:
            return
        rows = np.concatenate([own for _, own in self._usual])
        whole = len(rows) == len(self._starts)
        rows = np.arange(len(rows)) if whole else np.sort(rows)
        fronts = _at_every_byte(self._records, f"V{_FRONT.itemsize}", MESSAGE_HEAD - _TIMES)
        # By opaque bytes first: picking out structured items would copy field by field.
        front = fronts[self._starts if whole else self._starts[rows]].view(_FRONT)
        times, offsets = front["log_time"].copy(), front["offset"].copy()
        raw = front["raw"].copy().view(np.uint8).reshape(-1, FRAME_LENGTH)
        sound = _is_sound(raw, True, FRAME_LENGTH)
        if times.min() < 0 or offsets.min() < 0 or not sound.all():
            sound &= (times >= 0) & (offsets >= 0)
            odd = rows[~sound]
            for readers, own in self._usual:
                self._take_each(readers, np.intersect1d(own, odd))
            rows, front, whole = rows[sound], front[sound], False
            times, offsets, raw = times[sound], offsets[sound], raw[sound]
            if not len(rows):
                return
        self._stretch(int(times.min()), int(times.max()))
        every = {
            channel: reader for readers, _ in self._usual for channel, reader in readers.items()
        }
        at: Any = slice(None) if whole else rows
        columns = self._rows
        self._kept[at] = True
        columns.t_ns[at] = times
        columns.offset[at] = offsets
        columns.delay_ns[at] = front["delay"]
        columns.raw.view(_RAW).reshape(-1)[at] = raw.view(_RAW).reshape(-1)
        columns.port[at] = self._ports(every, at)

    def _take_side(
        self, readers: Readers, reader: MessageReader, rows: Array, side: _Side, layout: Layout
    ) -> Array:
        """Rows that keep to the layout; returns a mask of those that make no row all the same."""
        times = side.number(layout.time, "<i8") if layout.time is not None else side.log_times
        offsets = side.number(layout.offset, "<i8")
        raw = side.raw(layout)
        framed = self._framed(side, layout)
        good = (times >= 0) & (offsets >= 0) & _is_sound(raw, framed, layout.raw_length)
        faults = self._fault_codes(reader, side, layout)
        good &= faults >= 0
        if not good.all():
            rows, side = rows[good], side.parted(good)
            times, offsets, raw = times[good], offsets[good], raw[good]
            framed = framed if framed is True else framed[good]
            faults = faults[good] if layout.fault_count else faults
        if len(rows):
            self._put(rows, side, layout, times, offsets, raw, framed, faults)
            self._rows.port[rows] = self._ports(readers, rows)
        return np.asarray(~good)

    def _put(
        self,
        rows: Array,
        side: _Side,
        layout: Layout,
        times: Array,
        offsets: Array,
        raw: Array,
        framed: Any,
        faults: Array,
    ) -> None:
        columns = self._rows
        self._kept[rows] = True
        columns.t_ns[rows] = times
        columns.offset[rows] = offsets
        columns.raw.view(_RAW).reshape(-1)[rows] = raw.view(_RAW).reshape(-1)
        if layout.delay is None:
            columns.delayed[rows] = False
        else:
            columns.delay_ns[rows] = side.number(layout.delay, "<i8")
        if framed is not True:
            columns.framed[rows] = framed
        if layout.unordered is not None:
            columns.unordered[rows] = side.number(layout.unordered, "u1").astype(np.bool_)
        if layout.raw_length != FRAME_LENGTH:
            columns.length[rows] = layout.raw_length
        if layout.fault_count:
            columns.faults[rows] = faults
        if layout.raw_length > FRAME_LENGTH:
            whole = side.bytes_at(layout.raw, layout.raw_length)
            columns.long.update(zip(rows.tolist(), whole, strict=True))
        logged = side.log_times.view(np.uint64)
        self._stretch(int(logged.min()), int(logged.max()))

    def _framed(self, side: _Side, layout: Layout) -> Any:
        if layout.framed is None:
            return True
        return side.number(layout.framed, "u1").astype(np.bool_)

    def _fault_codes(self, reader: MessageReader, side: _Side, layout: Layout) -> Array:
        """The number of each row's faults in the words; -1 where this version knows them not."""
        if not layout.fault_count:
            return np.zeros(1, np.int32)
        packed = np.zeros(len(side), np.uint32)
        for at in range(layout.fault_count):
            packed = packed << np.uint32(8) | side.number(layout.faults + at, "u1")
        found, inverse = np.unique(packed, return_inverse=True)
        count = layout.fault_count
        codes = [
            self._fault_code(reader, number.to_bytes(count, "big")) for number in found.tolist()
        ]
        return np.array(codes)[inverse]

    def _fault_code(self, reader: MessageReader, numbers: bytes) -> int:
        try:
            return self._words.fault_code(tuple(map(reader.fault, numbers)))
        except ValueError:
            return -1

    def _ports(self, readers: Readers, rows: Any) -> Any:
        ports = {channel: reader.port for channel, reader in readers.items() if reader is not None}
        codes = {channel: self._words.port_code(port) for channel, port in ports.items()}
        if len(set(codes.values())) == 1:
            return next(iter(codes.values()))
        code_of_channel = np.zeros(max(codes) + 1, np.uint16)
        code_of_channel[list(codes)] = list(codes.values())
        return code_of_channel[self._channels[rows]]

    def _take_each(self, readers: Readers, rows: Array) -> None:
        for row in rows.tolist():
            reader = readers[int(self._channels[row])]
            assert reader is not None
            body = int(self._starts[row]) + MESSAGE_HEAD
            data = self._records[body : body + int(self._lengths[row])]
            log_time = int.from_bytes(self._records[body - _TIMES : body - _TIMES // 2], "little")
            try:
                entry = reader.entry(data, log_time)
            except ValueError as error:
                self._losses.append(f"{reader.topic}: {error}")
                continue
            self._stretch(log_time, log_time)
            if isinstance(entry, PortEvent):
                self._events.append((row, entry))
            else:
                self._rows.put(row, entry)
                self._kept[row] = True

    def _stretch(self, first: int, last: int) -> None:
        self._first, self._last = min(first, self._first), max(last, self._last)


_RAW = np.dtype(f"V{FRAME_LENGTH}")
_USUAL = {
    field.name: field.place for field in laid(class_of(TOPICS[0]).DESCRIPTOR.fields, SOUND_LACKS)
}
_USUAL_OFFSET, _USUAL_DELAY, _USUAL_RAW = (
    _USUAL[name] for name in ("offset", "read_delay_ns", "raw")
)
_FRONT = np.dtype(
    {
        "names": ["log_time", "offset", "delay", "raw"],
        "formats": ["<i8", "<i8", "<i8", _RAW],
        "offsets": [0, _TIMES + _USUAL_OFFSET, _TIMES + _USUAL_DELAY, _TIMES + _USUAL_RAW],
        "itemsize": _TIMES + _USUAL_RAW + FRAME_LENGTH,
    }
)
"""A usual message to the end of its raw bytes, its times before it."""


def _is_usual(layout: Layout) -> bool:
    """Whether these are sound frames with everything at its usual place."""
    places = (layout.offset, layout.delay, layout.raw)
    plain = layout.time is layout.framed is layout.unordered is None and not layout.fault_count
    return plain and places == (_USUAL_OFFSET, _USUAL_DELAY, _USUAL_RAW)


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


class _Side:
    """Messages of one length side by side, each with its times before it."""

    def __init__(self, records: bytes, starts: Array, length: int) -> None:
        self._lead = -length % _WORD
        width = self._lead + _TIMES + length
        first = MESSAGE_HEAD - _TIMES - self._lead
        self._set(_at_every_byte(records, f"V{width}", first)[starts], length)

    def _set(self, packed: Array, length: int) -> None:
        self._packed, self._length = packed, length
        self._width = packed.dtype.itemsize
        self._bytes: Array = packed.view(np.uint8).reshape(-1, self._width)

    def __len__(self) -> int:
        return len(self._packed)

    @property
    def log_times(self) -> Array:
        return self._numbers(self._lead, "<i8")

    def number(self, place: int, kind: str) -> Array:
        """The number at that place of every message."""
        return self._numbers(self._lead + _TIMES + place, kind)

    def _numbers(self, place: int, kind: str) -> Array:
        found: Array = np.ndarray((len(self),), kind, self._packed, place, (self._width,))
        return found.copy()

    def raw(self, layout: Layout) -> Array:
        """The first ten bytes of every row, zeros behind them."""
        place = self._lead + _TIMES + layout.raw
        there = self._bytes[:, place : place + min(layout.raw_length, FRAME_LENGTH)]
        if layout.raw_length >= FRAME_LENGTH:
            whole: Array = np.ndarray((len(self),), _RAW, self._packed, place, (self._width,))
            return whole.copy().view(np.uint8).reshape(-1, FRAME_LENGTH)
        found = np.zeros((len(self), FRAME_LENGTH), np.uint8)
        found[:, : there.shape[1]] = there
        return found

    def bytes_at(self, place: int, length: int) -> Iterator[bytes]:
        place += self._lead + _TIMES
        return (row[place : place + length].tobytes() for row in self._bytes)

    def parted(self, rows: Array) -> _Side:
        part = object.__new__(_Side)
        part._lead = self._lead
        part._set(self._packed[rows], self._length)
        return part

    def fits(self, layout: Layout) -> Array | None:
        """Which messages keep to the layout; None where all do, which is quickly seen."""
        mask, expected = _guard(layout, self._lead + _TIMES)
        words = self._packed.view("<u8").reshape(-1, self._width // _WORD)
        striped = len(words) // _STRIPE * _STRIPE
        wide = words[:striped].reshape(-1, _STRIPE * words.shape[1])
        if self._all_alike(wide, words, striped, mask, expected):
            return None
        return np.asarray(((words & mask) == expected).all(axis=1))

    def _all_alike(
        self, wide: Array, words: Array, striped: int, mask: Array, expected: Array
    ) -> bool:
        """Whether the guarded bits of all messages are as expected.

        They are, if neither of them all together (or) nor what they have in common (and) differs.
        """
        for reduce in (np.bitwise_or.reduce, np.bitwise_and.reduce):
            parts = [words[striped:]]
            if len(wide):
                parts.append(reduce(wide, axis=0).reshape(_STRIPE, -1))
            found = reduce(np.concatenate(parts), axis=0)
            if ((found & mask) != expected).any():
                return False
        return True


@lru_cache(maxsize=256)
def _guard(layout: Layout, lead: int) -> tuple[Array, Array]:
    """The layout's mask and what is expected under it, as words, with nothing asked of the lead."""
    return (
        np.frombuffer(bytes(lead) + layout.mask, "<u8"),
        np.frombuffer(bytes(lead) + layout.expected, "<u8"),
    )


def _at_every_byte(records: bytes, kind: str | np.dtype[Any], first: int) -> Array:
    """What stands `first` bytes behind every byte, as overlapping values of that kind."""
    size = np.dtype(kind).itemsize
    count = max(0, len(records) - first - size + 1)
    found: Array = np.ndarray((count,), kind, records, first, (1,))
    return found
