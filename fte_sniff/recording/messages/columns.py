"""Messages to RowBatch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL, PortEvent
from fte_sniff.recording.messages.codec import MessageReader, class_of
from fte_sniff.recording.messages.index import (
    CHANNEL_PLACE,
    FRONT,
    LOG_TIME_PLACE,
    MESSAGE_HEAD,
    MessageIndex,
    at_every_byte,
    numbers,
)
from fte_sniff.recording.messages.schema import TOPICS
from fte_sniff.recording.messages.wire_layout import WireLayout, WireLayouts
from fte_sniff.row_batch import Array, Codebook, RowBatch

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
def _whole_guard(layout: WireLayout) -> Guard:
    return guard(layout.mask, layout.expected)


class UniformBatch:
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

    def raw(self, layout: WireLayout) -> Array:
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

    def parted(self, rows: Array) -> UniformBatch:
        """Only these messages: a mask."""
        part = object.__new__(UniformBatch)
        part._lead = self._lead
        part._set(self._packed[rows])
        return part

    def fits(self, layout: WireLayout) -> Array | None:
        """Which messages keep to the layout; None where all do, which is quickly seen."""
        guarded = _whole_guard(layout)
        return None if all_fit(self.words, guarded) else which_fit(self.words, guarded)


def put_side(
    columns: RowBatch,
    rows: Array,
    side: UniformBatch,
    log_times: Array,
    layout: WireLayout,
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
    faults = _fault_codes(columns.codebook, reader, side, layout)
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


def _put_seldom(columns: RowBatch, rows: Array, side: UniformBatch, layout: WireLayout) -> None:
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


def _framed(side: UniformBatch, layout: WireLayout) -> Any:
    if layout.framed is None:
        return True
    return side.number(layout.framed, "u1").astype(np.bool_)


def _fault_codes(
    codebook: Codebook, reader: MessageReader, side: UniformBatch, layout: WireLayout
) -> Array:
    """The number of each row's faults in the words; -1 where this version knows them not."""
    if not layout.fault_count:
        return np.zeros(1, np.int32)
    packed = np.zeros(len(side), np.uint32)
    for at in range(layout.fault_count):
        packed = packed << np.uint32(8) | side.number(layout.faults + at, "u1")
    found, inverse = np.unique(packed, return_inverse=True)
    count = layout.fault_count
    sets = [number.to_bytes(count, "big") for number in found.tolist()]
    return np.array([_fault_code(codebook, reader, numbers) for numbers in sets])[inverse]


def _fault_code(codebook: Codebook, reader: MessageReader, numbers: bytes) -> int:
    try:
        return codebook.fault_code(tuple(map(reader.fault, numbers)))
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


_NUMBER = 8
_SIGN = 0x80
"""The bit of a number's last byte that no offset has."""


def _model() -> WireLayout:
    """The layout of some topic's sound frames."""
    layout = WireLayouts(class_of(TOPICS[0]).DESCRIPTOR).usual
    assert layout is not None
    return layout


_MODEL = _model()


@lru_cache(maxsize=256)
def is_usual(layout: WireLayout) -> bool:
    """Whether messages of this layout are of sound frames, and all that makes the row is in place.

    So it is for every schema of ours; those of a file may be others.
    """
    plain = layout.time is layout.framed is layout.unordered is None and not layout.fault_count
    places = layout.offset, layout.delay, layout.raw, layout.raw_length
    wanted = _MODEL.offset, _MODEL.delay, _MODEL.raw, _MODEL.raw_length
    return plain and places == wanted and MESSAGE_HEAD + layout.raw + FRAME_LENGTH <= FRONT


@lru_cache(maxsize=256)
def _guard(layout: WireLayout, header: int) -> Guard:
    """That of the layout; besides, an offset below 2^63, and both ends of the frame."""
    mask, expected = bytearray(layout.mask), bytearray(layout.expected)
    mask[layout.offset + _NUMBER - 1] |= _SIGN
    for place, byte in ((layout.raw, header), (layout.raw + FRAME_LENGTH - 1, TAIL)):
        mask[place], expected[place] = 0xFF, byte
    return guard(mask, expected)


def which_usual(side: UniformBatch, layout: WireLayout) -> Array | None:
    """Which messages, one at least and all as long as the usual layout, keep to it and are of
    frames; None where all do."""
    words, headers = side.words, HEADERS.values()
    header = next(side.bytes_at(layout.raw, 1))[0]
    if header in headers and all_fit(words, _guard(layout, header)):
        return None
    each = [which_fit(words, _guard(layout, one)) for one in headers]
    return np.asarray(np.logical_or.reduce(each))


def put_usual(columns: RowBatch, rows: slice | Array, fronts: Array) -> None:
    """Fill in these rows from their fronts; all but times and ports."""
    columns.offset[rows] = _column(fronts, _MODEL.offset, "<i8")[rows]
    columns.delay_ns[rows] = _column(fronts, _MODEL.delay or 0, "<i8")[rows]
    columns.raw.view(RAW).reshape(-1)[rows] = _column(fronts, _MODEL.raw, RAW)[rows]


def _column(fronts: Array, place: int, kind: str | np.dtype[np.void]) -> Array:
    found: Array = np.ndarray((len(fronts),), kind, fronts, MESSAGE_HEAD + place, (FRONT,))
    return found


Readers = Mapping[int, MessageReader | None]

_FEW = 4
"""So few messages of one length are read one by one."""
_MOST_LENGTHS = 512


@dataclass(slots=True)
class DecodedColumns:
    """What came of some messages."""

    columns: RowBatch
    messages: int
    """Messages seen, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of ours."""
    losses: list[str] = field(default_factory=list)
    """What could not be read, one line each."""
    in_place: bool = False
    """Whether the columns are those that were to be filled in, and nothing stands beside them."""


def decode_columns(messages: MessageIndex, readers: Readers, columns: RowBatch) -> DecodedColumns:
    """The rows and events of the messages, in that order.

    Args:
        messages: those of one or more unpacked chunks.
        readers: by channel; None for channels of no interest.
        columns: blank ones, with room for a row of each message.

    Raises:
        KeyError: there is a message of a channel that `readers` does not know.
    """
    return _Gathering(messages, readers, columns).gathered()


class _Gathering:
    def __init__(self, messages: MessageIndex, readers: Readers, columns: RowBatch) -> None:
        self._messages, self._readers = messages, readers
        self._rows = columns
        self._kept = np.zeros(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._losses: list[str] = []
        self._first, self._last = 2**64, -1
        self._usual: list[tuple[Readers, Array]] = []
        self._channels = messages.number(CHANNEL_PLACE, "<u2").astype(np.intp)
        self._times = messages.number(LOG_TIME_PLACE, "<i8")
        self._timely = bool(self._times.min(initial=0) == 0)

    def gathered(self) -> DecodedColumns:
        for readers, rows in self._by_schema():
            for own, length in self._by_length(readers, self._unusual(readers, rows)):
                self._take(readers, own, length)
        self._take_usual()
        self._events.sort(key=lambda placed: placed[0])
        events = tuple(event for _, event in self._events)
        columns = self._rows.select(slice(None), events)
        whole = bool(self._kept.all())
        if not whole:
            columns = columns.select(self._kept, events)
        times = None if self._last < 0 else (self._first, self._last)
        in_place = whole and not columns.long and not events
        return DecodedColumns(columns, len(self._messages), times, self._losses, in_place)

    def _by_schema(self) -> Iterator[tuple[Readers, Array]]:
        """The rows of all channels that share a schema, and the readers of those channels."""
        counts = np.bincount(self._channels, minlength=1)
        present = np.flatnonzero(counts).tolist()
        groups: dict[int, dict[int, MessageReader]] = {}
        for channel in present:
            reader = self._readers[channel]
            if reader is not None:
                key = id(reader.layouts or reader)
                groups.setdefault(key, {})[channel] = reader
        if len(groups) == 1 and len(next(iter(groups.values()))) == len(present):
            yield next(iter(groups.values())), np.arange(len(self._messages))
            return
        if not groups:
            return
        codes = np.full(present[-1] + 1, len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[list(channels)] = code
        ends = np.cumsum([counts[list(channels)].sum() for channels in groups.values()])
        by_code = np.argsort(codes.take(self._channels), kind="stable")
        yield from zip(groups.values(), np.split(by_code[: ends[-1]], ends[:-1]), strict=True)

    def _by_length(self, readers: Readers, rows: Array) -> Iterator[tuple[Array, int]]:
        """Those of these rows whose messages are equally long; the few others are taken."""
        if not len(rows):
            return
        lengths = self._messages.lengths[rows]
        if (lengths == lengths[0]).all():
            yield rows, int(lengths[0])
            return
        found, counts = np.unique(lengths, return_counts=True)
        if len(found) > _MOST_LENGTHS:
            self._take_each(readers, rows)
            return
        for length, count in zip(found.tolist(), counts.tolist(), strict=True):
            same = rows[lengths == length]
            if count <= _FEW:
                self._take_each(readers, same)
            else:
                yield same, length

    def _unusual(self, readers: Readers, rows: Array) -> Array:
        """Put the usual messages of one schema by, and leave the others."""
        layouts = next(filter(None, readers.values())).layouts
        layout = None if layouts is None else layouts.usual
        if layout is None or not is_usual(layout) or not self._timely:
            return rows
        length = len(layout.mask)
        usual = self._messages.lengths.take(rows) == length
        own = rows if usual.all() else rows[usual]
        if not len(own):
            return rows
        side = UniformBatch(self._messages.records, self._messages.starts.take(own), length)
        fits = which_usual(side, layout)
        if fits is not None:
            usual[usual] = fits
            own = own[fits]
        self._usual.append((readers, own))
        return rows[:0] if len(own) == len(rows) else rows[~usual]

    def _take_usual(self) -> None:
        """All usual rows, of whatever schema, together and in their order."""
        count = sum(len(own) for _, own in self._usual)
        if not count:
            return
        at: Any = slice(None)
        if count < len(self._messages):
            usual = np.zeros(len(self._messages), np.bool_)
            for _, own in self._usual:
                usual[own] = True
            at = np.flatnonzero(usual)
        put_usual(self._rows, at, self._messages.fronts)
        times = self._times[at]
        self._rows.t_ns[at] = times
        self._stretch(int(times.min()), int(times.max()))
        self._kept[at] = True
        every = {
            channel: reader for readers, _ in self._usual for channel, reader in readers.items()
        }
        self._rows.port[at] = self._ports(every, at)

    def _take(self, readers: Readers, rows: Array, length: int) -> None:
        """Messages of one schema and one length."""
        reader = next(filter(None, readers.values()))
        if reader.layouts is not None:
            side = UniformBatch(self._messages.records, self._messages.starts[rows], length)
            for layout in reader.layouts.of_length(length):
                fits = side.fits(layout)
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

    def _take_side(
        self,
        readers: Readers,
        reader: MessageReader,
        rows: Array,
        side: UniformBatch,
        layout: WireLayout,
    ) -> Array:
        """Rows that keep to the layout; returns a mask of those that make no row all the same."""
        log_times = self._times.take(rows)
        good, times = put_side(self._rows, rows, side, log_times, layout, reader)
        if times is not None:
            own = rows[good]
            self._kept[own] = True
            self._rows.port[own] = self._ports(readers, own)
            self._stretch(*times)
        return np.asarray(~good)

    def _ports(self, readers: Readers, rows: Any) -> Any:
        ports = {channel: reader.port for channel, reader in readers.items() if reader is not None}
        codes = {channel: self._rows.codebook.port_code(port) for channel, port in ports.items()}
        if len(set(codes.values())) == 1:
            return next(iter(codes.values()))
        code_of_channel = np.zeros(max(codes) + 1, np.uint16)
        code_of_channel[list(codes)] = list(codes.values())
        return code_of_channel.take(self._channels[rows])

    def _take_each(self, readers: Readers, rows: Array) -> None:
        records = self._messages.records
        for row in rows.tolist():
            reader = readers[int(self._channels[row])]
            assert reader is not None
            body = int(self._messages.starts[row]) + MESSAGE_HEAD
            data = records[body : body + int(self._messages.lengths[row])]
            log_time = int(self._times[row].view(np.uint64))
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


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest that has one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32
