"""Decoder of many messages at once into row columns.

Messages of one schema and one length are compared with the fixed layouts of that schema: one OR and
one AND reduction over all messages show whether they agree with a layout in every guarded bit. The
columns of the common layout, fault-free frames, are copied for all messages first, so that these
messages need the comparison only. Messages that fit no layout go through the protobuf codec.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from fte_sniff.protocol import FRAME_LENGTH, PortEvent
from fte_sniff.recording.messages.codec import MessageReader
from fte_sniff.recording.messages.index import (
    CHANNEL_OFFSET,
    LOG_TIME_OFFSET,
    MESSAGE_HEAD,
    MessageIndex,
    at_every_byte,
    field_view,
)
from fte_sniff.recording.messages.wire_layout import COMMON, WireLayout
from fte_sniff.row_batch import NO_TIME, Array, RowBatch

_RAW = np.dtype(f"V{FRAME_LENGTH}")
"""A frame as one opaque value, which numpy copies at once."""

_WORD = 8
_STRIPE = 64
_FEW = 4
"""Up to this many messages of one length are decoded one by one."""
_MOST_LENGTHS = 512

Readers = Mapping[int, MessageReader | None]

_Guard = tuple[Array, Array]
"""The mask of the guarded bits and their expected values, as 64-bit numbers."""


@lru_cache(maxsize=256)
def _guard_of(layout: WireLayout) -> _Guard:
    padding = bytes(-len(layout.mask) % _WORD)
    return (
        np.frombuffer(padding + layout.mask, "<u8"),
        np.frombuffer(padding + layout.expected, "<u8"),
    )


def _deviations(numbers: Array, guard: _Guard) -> Array:
    mask, expected = guard
    found: Array = numbers & mask
    found ^= expected
    return found


def _all_fit(numbers: Array, guard: _Guard) -> bool:
    """Whether every message agrees with the guard; `numbers` has a line for each message."""
    striped = len(numbers) // _STRIPE * _STRIPE
    if _deviations(numbers[striped:], guard).any():
        return False
    if not striped:
        return True
    # 64 messages in a line: numpy reduces long lines at the speed of memory.
    wide = numbers[:striped].reshape(-1, _STRIPE * numbers.shape[1])
    found = _deviations(np.bitwise_or.reduce(wide, axis=0).reshape(_STRIPE, -1), guard)
    found |= _deviations(np.bitwise_and.reduce(wide, axis=0).reshape(_STRIPE, -1), guard)
    return not found.any()


@dataclass(frozen=True, slots=True)
class UniformBatch:
    """Messages of one length."""

    packed: Array
    """The messages as opaque values, padded in front to whole 64-bit numbers."""
    padding: int

    @classmethod
    def of(cls, messages: MessageIndex, rows: Array) -> UniformBatch:
        """The messages of some rows, one at least."""
        length = int(messages.lengths[rows[0]])
        # The padding is the end of the MCAP header; an empty message has one number of it.
        padding = -length % _WORD if length else _WORD
        windows = at_every_byte(messages.records, padding + length, MESSAGE_HEAD - padding)
        return cls(windows[messages.starts[rows]], padding)

    def first(self) -> bytes:
        """The first message."""
        return bytes(self.packed[0].tobytes()[self.padding :])

    def select(self, rows: Array) -> UniformBatch:
        """Only the messages of a mask."""
        return UniformBatch(self.packed[rows], self.padding)

    def which_fit(self, layout: WireLayout) -> Array | None:
        """A mask of the messages that fit the layout; None if all do."""
        numbers = self.packed.view("<u8").reshape(len(self.packed), -1)
        guard = _guard_of(layout)
        if _all_fit(numbers, guard):
            return None
        return np.asarray(~_deviations(numbers, guard).any(axis=1))

    def field(self, offset: int, kind: str | np.dtype[Any]) -> Array:
        """The numbers at an offset of the messages."""
        return field_view(self.packed, self.padding + offset, kind)

    def raw(self, layout: WireLayout) -> Array:
        """The first ten bytes of each row, padded with zeros, as opaque values."""
        if layout.raw_length >= FRAME_LENGTH:
            return self.field(layout.raw, _RAW)
        raw = self.field(layout.raw, f"V{layout.raw_length}")
        return raw.astype(_RAW)

    def long_rows(self, layout: WireLayout) -> list[bytes]:
        """All bytes of each row."""
        found: list[bytes] = self.field(layout.raw, f"V{layout.raw_length}").tolist()
        return found


@dataclass(slots=True)
class DecodedColumns:
    """The rows and events of some messages."""

    columns: RowBatch
    messages: int
    """Number of messages, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of fte-sniff's messages."""
    in_place: bool
    """Whether the columns are those given to `decode_columns`, without long rows and events."""


def decode_columns(messages: MessageIndex, readers: Readers, columns: RowBatch) -> DecodedColumns:
    """Decode the messages of one or more unpacked chunks, in their order.

    `readers` are by channel id, None for channels of other topics; `columns` are blank, with a row
    for each message. Raises KeyError if `readers` lacks a channel, ValueError for a bad message.
    """
    return _Decoder(messages, readers, columns).decode()


class _Decoder:
    def __init__(self, messages: MessageIndex, readers: Readers, columns: RowBatch) -> None:
        self._messages, self._readers, self._columns = messages, readers, columns
        self._kept = np.ones(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._channels = messages.field(CHANNEL_OFFSET, "<u2").astype(np.intp)
        self._log_times = messages.field(LOG_TIME_OFFSET, "<i8").copy()
        self._late = bool(self._log_times.min(initial=0) < 0)

    def decode(self) -> DecodedColumns:
        self._fill()
        for reader, rows in self._by_schema():
            for same in self._by_length(rows):
                self._decode_uniform(reader, same)
        own = self._log_times if self._kept.all() else self._log_times[self._kept]
        logged = own.view(np.uint64)
        times = (int(logged.min()), int(logged.max())) if len(logged) else None
        self._events.sort(key=lambda numbered: numbered[0])
        events = tuple(event for _, event in self._events)
        self._kept[[row for row, _ in self._events]] = False
        whole = bool(self._kept.all())
        columns = self._columns.select(slice(None) if whole else self._kept, events)
        in_place = whole and not columns.long
        return DecodedColumns(columns, len(self._messages), times, in_place)

    def _fill(self) -> None:
        """Fill the columns as if every message had the common layout."""
        columns, messages = self._columns, self._messages
        columns.t_ns[:] = self._log_times
        columns.offset[:] = messages.field(MESSAGE_HEAD + COMMON.offset, "<i8")
        columns.delay_ns[:] = messages.field(MESSAGE_HEAD + COMMON.delay, "<i8")
        columns.raw.view(_RAW).reshape(-1)[:] = messages.field(MESSAGE_HEAD + COMMON.raw, _RAW)

    def _by_schema(self) -> Iterator[tuple[MessageReader, Array]]:
        """A reader of each schema, and the rows of all its channels; sets the ports."""
        counts = np.bincount(self._channels, minlength=1)
        present = np.flatnonzero(counts).tolist()
        readers = {channel: self._readers[channel] for channel in present}
        groups: dict[int, list[int]] = {}
        ports = np.zeros(len(counts), np.uint16)
        for channel, reader in readers.items():
            if reader is not None:
                groups.setdefault(id(reader.layouts or reader), []).append(channel)
                ports[channel] = self._columns.codebook.port_code(reader.port)
        self._columns.port[:] = ports.take(self._channels)
        codes = np.full(len(counts), len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[channels] = code
        if len(groups) == 1 and all(readers.values()):
            by_code = np.arange(len(self._messages))
        else:
            by_code = np.argsort(codes.take(self._channels), kind="stable")
        first = 0
        for channels in groups.values():
            end = first + int(counts[channels].sum())
            reader = readers[channels[0]]
            assert reader is not None
            yield reader, by_code[first:end]
            first = end
        self._kept[by_code[first:]] = False

    def _by_length(self, rows: Array) -> Iterator[Array]:
        """The rows whose messages are equally long; decodes the few others."""
        lengths = self._messages.lengths.take(rows)
        if (lengths == lengths[0]).all():
            yield rows
            return
        found, counts = np.unique(lengths, return_counts=True)
        if len(found) > _MOST_LENGTHS:
            self._decode_each(rows)
            return
        for length, count in zip(found.tolist(), counts.tolist(), strict=True):
            same = rows[lengths == length]
            if count <= _FEW:
                self._decode_each(same)
            else:
                yield same

    def _decode_uniform(self, reader: MessageReader, rows: Array) -> None:
        if reader.layouts is not None:
            batch = UniformBatch.of(self._messages, rows)
            for layout in reader.layouts.like(batch.first()):
                fits = batch.which_fit(layout)
                if fits is None:
                    self._store(reader, rows, batch, layout)
                    return
                if fits.any():
                    self._store(reader, rows[fits], batch.select(fits), layout)
                    rows, batch = rows[~fits], batch.select(~fits)
        self._decode_each(rows)

    def _store(
        self, reader: MessageReader, rows: Array, batch: UniformBatch, layout: WireLayout
    ) -> None:
        if self._late and layout.time is None and (self._log_times[rows] < 0).any():
            raise ValueError("a time past the year 2262")
        if layout.is_common:
            return
        columns = self._columns
        if layout.time is not None:
            columns.t_ns[rows] = batch.field(layout.time, "<i8")
        columns.offset[rows] = batch.field(layout.offset, "<i8")
        columns.delay_ns[rows] = (
            NO_TIME if layout.delay is None else batch.field(layout.delay, "<i8")
        )
        columns.framed[rows] = layout.framed
        if layout.unordered is not None:
            columns.unordered[rows] = batch.field(layout.unordered, "u1")
        if layout.fault_count:
            columns.faults[rows] = self._fault_codes(reader, batch, layout)
        columns.raw.view(_RAW).reshape(-1)[rows] = batch.raw(layout)
        columns.length[rows] = layout.raw_length
        if layout.raw_length > FRAME_LENGTH:
            columns.long.update(zip(rows.tolist(), batch.long_rows(layout), strict=True))

    def _fault_codes(self, reader: MessageReader, batch: UniformBatch, layout: WireLayout) -> Array:
        packed = batch.field(layout.faults, f"V{layout.fault_count}")
        found, inverse = np.unique(packed, return_inverse=True)
        codebook = self._columns.codebook
        codes = [codebook.fault_code(tuple(map(reader.fault, one.tobytes()))) for one in found]
        return np.array(codes)[inverse]

    def _decode_each(self, rows: Array) -> None:
        records = self._messages.records
        for row in rows.tolist():
            reader = self._readers[int(self._channels[row])]
            assert reader is not None
            start = int(self._messages.starts[row]) + MESSAGE_HEAD
            message = records[start : start + int(self._messages.lengths[row])]
            entry = reader.entry(message, int(self._log_times[row].view(np.uint64)))
            if isinstance(entry, PortEvent):
                self._events.append((row, entry))
            else:
                self._columns.put(row, entry)


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest type for one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32
