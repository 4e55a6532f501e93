"""Decoder of chunks into row columns, many messages at once.

First the message records are found:

    opcode u8 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64 | message

Messages of one schema and one length are compared with the fixed layouts of that schema: one OR and
one AND reduction over all messages show whether they agree with a layout in every guarded bit. The
columns of the common layout, fault-free frames, are copied for all messages first, so that these
messages need the comparison only. Messages that fit no layout go through the protobuf codec.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from mcap.opcode import Opcode

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import FRAME_LENGTH, PortEvent
from fte_sniff.recording.mcap.records import BEYOND_CHUNK, HEAD, NO_RECORD, RecordError
from fte_sniff.recording.messages.codec import ChannelReaders, MessageReader, reason_in
from fte_sniff.recording.messages.wire_layout import COMMON, WireLayout
from fte_sniff.row_batch import NO_TIME, Array, RowBatch

MESSAGE_HEAD = HEAD.size + 2 + 4 + 8 + 8
"""Bytes of a message record before the message."""

PREFIX = 64
"""Bytes copied of each message record: the head, and every field of the common layout. Numpy copies
64 bytes hardly slower than one number."""

LENGTH_OFFSET, CHANNEL_OFFSET, SEQUENCE_OFFSET, LOG_TIME_OFFSET = 1, 9, 11, 15
"""Offsets in a message record."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4

Definition = tuple[int, bytes]
"""Opcode and body of a schema or channel record."""

_DEFINITIONS = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones."""

    records: bytes
    starts: Array
    """Where each message record begins, rising."""
    lengths: Array
    """Of the messages, without their heads."""
    prefixes: Array
    """The first bytes of each record as opaque values; those of a short record run into the next.
    """
    most: int
    """The largest number of records that the chunks can hold."""
    definitions: list[Definition] = field(default_factory=list)
    without_head: int = 0
    """Number of messages that are too short to be one; they are not in the index."""

    def __len__(self) -> int:
        return len(self.starts)

    def slices(self, most: int, size: int) -> Iterator[MessageIndex]:
        """The messages; if they have more than `most` bytes, in slices of about `size` bytes."""
        cuts = [0, len(self)]
        if len(self.records) > most:
            bounds = np.arange(size, len(self.records), size)
            cuts[1:1] = np.searchsorted(self.starts, bounds).tolist()
        for first, end in pairwise(cuts):
            lengths, prefixes = self.lengths[first:end], self.prefixes[first:end]
            if first < end:
                starts = self.starts[first:end]
                yield MessageIndex(self.records, starts, lengths, prefixes, self.most)

    def field(self, offset: int, kind: str | np.dtype[Any]) -> Array:
        """The numbers at an offset of the records."""
        return field_view(self.prefixes, offset, kind)


def at_every_byte(records: bytes, size: int, first: int = 0) -> Array:
    """Overlapping opaque values of `size` bytes, one for every byte from `first` on."""
    count = max(0, len(records) - first - size + 1)
    found: Array = np.ndarray((count,), f"V{size}", records, first, (1,))
    return found


def field_view(packed: Array, offset: int, kind: str | np.dtype[Any]) -> Array:
    """A view of the numbers at an offset of opaque values."""
    if not len(packed):
        return np.empty(0, kind)
    found: Array = np.ndarray((len(packed),), kind, packed, offset, (packed.dtype.itemsize,))
    return found


def message_count(indexes: Sequence[bytes]) -> int:
    """The number of messages in the message index records of a chunk."""
    return sum(len(body) for body in indexes) // (2 * _ENTRY.itemsize)


def indexed_starts(indexes: Sequence[bytes], size: int) -> Array | None:
    """The starts in the message index records of a chunk, rising; None if they are impossible.

    index record:  channel u16 | bytes u32 | (log time u64, start u64) for each message

    `indexes` are the bodies of the records, `size` the bytes of the unpacked chunk.
    """
    entry = 2 * _ENTRY.itemsize
    if any(len(body) < _INDEX_HEAD or (len(body) - _INDEX_HEAD) % entry for body in indexes):
        return None
    named = [np.frombuffer(body, _ENTRY, offset=_INDEX_HEAD)[1::2] for body in indexes]
    # Chunks are smaller than 4 GiB, and numpy sorts short numbers much faster.
    starts = np.concatenate(named, dtype=np.uint32, casting="unsafe") if named else np.empty(0)
    if not len(starts) or starts.max() >= size:
        return None
    starts.sort()
    return starts.astype(np.int64)


def index_messages(records: bytes, starts: Array | None, most: int) -> MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones.

    `starts` are those of a message index, rising; they are ignored if they are wrong. `most` is the
    largest number of records.

    Raises RecordError if the records exceed the chunk, are none, or are too many.
    """
    found = None if starts is None else _confirmed(records, starts, most)
    if found is None:
        walked, definitions, _ = _walked(records, 0, len(records), most)
        found = _messages(records, np.array(walked, np.int64), most)
        found.definitions.extend(definitions)
    if len(found) and found.lengths.min() < 0:
        whole = found.lengths >= 0
        starts = found.starts[whole]
        short = len(found) - len(starts)
        definitions = found.definitions
        found = replace(_messages(records, starts, most), definitions=definitions)
        found = replace(found, without_head=short)
    return found


def _messages(records: bytes, starts: Array, most: int) -> MessageIndex:
    prefixes = _prefixes(records, starts)
    lengths = field_view(prefixes, LENGTH_OFFSET, "<i8") - (MESSAGE_HEAD - HEAD.size)
    return MessageIndex(records, starts, lengths, prefixes, most)


def _prefixes(records: bytes, starts: Array) -> Array:
    """The bytes from each start on, padded with zeros at the end of the records."""
    last = len(records) - PREFIX
    if last < 0:
        return _prefixes(records.ljust(PREFIX, b"\0"), starts)
    whole = int(np.searchsorted(starts, last, "right"))
    if whole == len(starts):
        return at_every_byte(records, PREFIX)[starts]
    found = at_every_byte(records, PREFIX)[np.minimum(starts, last)]
    for row in range(whole, len(starts)):
        found[row] = np.void(records[int(starts[row]) :].ljust(PREFIX, b"\0"))
    return found


def _confirmed(records: bytes, starts: Array, most: int) -> MessageIndex | None:
    """The index if the records are contiguous and messages begin at these starts only."""
    if not len(starts) or starts[0] < 0 or starts[-1] > len(records) - MESSAGE_HEAD:
        return None
    found = _messages(records, starts, most)
    if (found.field(0, "u1") != Opcode.MESSAGE).any():
        return None
    ends = starts + found.lengths
    ends += MESSAGE_HEAD
    gaps = [(0, int(starts[0])), (int(ends[-1]), len(records))]
    between = np.flatnonzero(ends[:-1] != starts[1:])
    gaps[1:1] = zip(ends[between].tolist(), starts[between + 1].tolist(), strict=True)
    for start, end in gaps:
        try:
            messages, definitions, count = _walked(records, start, end, most)
        except RecordError:
            return None
        if messages:
            return None
        most -= count
        found.definitions.extend(definitions)
    return found


def _walked(
    records: bytes, start: int, end: int, most: int
) -> tuple[list[int], list[Definition], int]:
    """Message starts, definitions and the number of all records from `start` to `end`."""
    starts: list[int] = []
    definitions: list[Definition] = []
    at, count, message = start, 0, int(Opcode.MESSAGE)
    unpack = HEAD.unpack_from
    for _ in range(most + 1):
        if not 0 <= at <= end - HEAD.size:
            break
        opcode, length = unpack(records, at)
        after = at + HEAD.size + length
        if opcode == 0:
            raise RecordError(NO_RECORD)
        if after > end:
            break
        if opcode == message:
            starts.append(at)
        elif opcode in _DEFINITIONS:
            definitions.append((opcode, records[at + HEAD.size : after]))
        at, count = after, count + 1
    else:
        raise RecordError("a chunk of more records than its size can hold")
    if at != end:
        raise RecordError(BEYOND_CHUNK)
    return starts, definitions, count


_MOST_LOSSES = 20
_OTHER_LOSSES = TranslatableText("more could not be read")


class Losses(Counter[str]):
    """Unreadable messages by reason; beyond 20 different reasons, the others are one."""

    def append(self, text: str, count: int = 1) -> None:
        """Count a loss."""
        listed = text in self or len(self) < _MOST_LOSSES
        self[text if listed else _OTHER_LOSSES] += count

    def merge(self, other: Losses) -> None:
        """Count the losses of another counter."""
        for text, count in other.items():
            self.append(text, count)

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each text."""
        return tuple(
            text
            if count == 1
            else TranslatableText("{loss} ({count} times)", loss=text, count=count)
            for text, count in self.items()
        )


_RAW = np.dtype(f"V{FRAME_LENGTH}")
"""A frame as one opaque value, which numpy copies at once."""

_WORD = 8
_STRIPE = 64
_FEW = 48
"""Up to this many messages of one length are decoded one by one."""
_MOST_LENGTHS = 512
_PER_SLOW_MESSAGE = 4
"""One in this number of the records that a chunk can hold may be decoded alone."""

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
    losses: Losses


def decode_columns(
    messages: MessageIndex, readers: ChannelReaders, columns: RowBatch
) -> DecodedColumns:
    """Decode the messages of one or more unpacked chunks, in their order.

    `columns` are blank, with a row for each message.
    """
    return _Decoder(messages, readers, columns).decode()


class _Decoder:
    def __init__(self, messages: MessageIndex, readers: ChannelReaders, columns: RowBatch) -> None:
        self._messages, self._readers, self._columns = messages, readers, columns
        self._kept = np.ones(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._by_channel: dict[int, MessageReader] = {}
        self._losses = Losses()
        self._slow_left = _FEW + messages.most // _PER_SLOW_MESSAGE
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
        return DecodedColumns(columns, len(self._messages), times, in_place, self._losses)

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
        groups: dict[int, list[int]] = {}
        ports = np.zeros(len(counts), np.uint16)
        for channel in present:
            reader = self._readers.get(channel)
            if isinstance(reader, MessageReader):
                self._by_channel[channel] = reader
                groups.setdefault(id(reader.layouts or reader), []).append(channel)
                ports[channel] = self._columns.codebook.port_code(reader.port)
            elif reader is not None:
                self._losses.append(reader, int(counts[channel]))
        self._columns.port[:] = ports.take(self._channels)
        codes = np.full(len(counts), len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[channels] = code
        if len(groups) == 1 and len(self._by_channel) == len(present):
            by_code = np.arange(len(self._messages))
        else:
            by_code = np.argsort(codes.take(self._channels), kind="stable")
        first = 0
        for channels in groups.values():
            end = first + int(counts[channels].sum())
            yield self._by_channel[channels[0]], by_code[first:end]
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
        if self._late:
            late = self._log_times[rows] < 0
            self._decode_each(rows[late])
            rows = rows[~late]
        if reader.layouts is not None and len(rows):
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
        if layout.is_common:
            return
        columns = self._columns
        if layout.fault_count:
            codes = self._fault_codes(reader, batch, layout)
            if codes is None:
                self._decode_each(rows)
                return
            columns.faults[rows] = codes
        if layout.time is not None:
            columns.t_ns[rows] = batch.field(layout.time, "<i8")
        columns.offset[rows] = batch.field(layout.offset, "<i8")
        columns.delay_ns[rows] = (
            NO_TIME if layout.delay is None else batch.field(layout.delay, "<i8")
        )
        columns.framed[rows] = layout.framed
        if layout.unordered is not None:
            columns.unordered[rows] = batch.field(layout.unordered, "u1")
        columns.raw.view(_RAW).reshape(-1)[rows] = batch.raw(layout)
        columns.length[rows] = layout.raw_length
        if layout.raw_length > FRAME_LENGTH:
            columns.long.update(zip(rows.tolist(), batch.long_rows(layout), strict=True))

    def _fault_codes(
        self, reader: MessageReader, batch: UniformBatch, layout: WireLayout
    ) -> Array | None:
        """The codes of the fault sets; None if there is an unknown fault, or too many sets."""
        packed = batch.field(layout.faults, f"V{layout.fault_count}")
        found, inverse = np.unique(packed, return_inverse=True)
        try:
            sets = [tuple(map(reader.fault, one.tobytes())) for one in found]
            codes = np.array([self._columns.codebook.fault_code(one) for one in sets])
        except ValueError:
            return None
        return codes[inverse]

    def _decode_each(self, rows: Array) -> None:
        records = self._messages.records
        if len(rows) > self._slow_left:
            too_many = rows[self._slow_left :]
            self._kept[too_many] = False
            text = TranslatableText("messages that take too long to decode, for their size")
            self._losses.append(text, len(too_many))
            rows = rows[: self._slow_left]
        self._slow_left -= len(rows)
        for row in rows.tolist():
            reader = self._by_channel[int(self._channels[row])]
            start = int(self._messages.starts[row]) + MESSAGE_HEAD
            message = records[start : start + int(self._messages.lengths[row])]
            try:
                entry = reader.entry(message, int(self._log_times[row].view(np.uint64)))
                if isinstance(entry, PortEvent):
                    self._events.append((row, entry))
                else:
                    self._columns.put(row, entry)
            except ValueError as error:
                self._kept[row] = False
                why = reason_in(error)
                text = TranslatableText("{topic}: {why}", topic=reader.topic, why=why)
                self._losses.append(text)


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest type for one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32
