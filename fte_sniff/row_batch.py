"""RowBatch: many rows as numpy columns, with dictionary-encoded ports and faults.

`RowBatch` is the only container of many rows: the framer's spans and the recording reader make it;
the store, filters, statistics and writers take it. Few rows stay a list: those of a live capture,
because making a batch costs about 30 µs, and those of a short log, because numpy and polars take
longer to load than the rows to write. A batch is a `Sequence[Row]`, so most code treats both alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from threading import Lock
from typing import Any, Final, Self, TypeAlias, TypeVar, overload

import numpy as np
import numpy.typing as npt

from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    VALUE_FIELDS,
    Damage,
    Direction,
    Fault,
    Frame,
    PortEvent,
    Row,
)
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.protocol.framer.tables import FAULT_SETS
from fte_sniff.protocol.framer.timestamps import ArrivalTime
from fte_sniff.protocol.spec import CMD_OFFSET, FTE_FORMAT, NAME_OF_ROLE, NUM_OFFSET, Role

Array: TypeAlias = npt.NDArray[Any]
Bools: TypeAlias = npt.NDArray[np.bool_]
Codes: TypeAlias = npt.NDArray[np.uint8]
Ints: TypeAlias = npt.NDArray[np.int64]

NO_TIME: Final = -(2**63)
"""Time, or read delay, of a row without one."""

NO_KIND: Final = len(KINDS)
"""The kind code of a row without a kind."""

NO_DIRECTION: Final = len(Direction)
"""The direction code of a row without a direction."""

_Key = TypeVar("_Key")

_ROWS_AT_ONCE: Final = 4096
"""Rows that iteration converts to objects at a time, so that it needs little memory."""


_MOST_FAULT_SETS: Final = 4096


class Codebook:
    """Dictionary encoding of ports and fault sets; safe for use by several threads."""

    def __init__(self) -> None:
        self.ports: list[str] = []
        self.faults: list[tuple[Fault, ...]] = []
        """Fault sets in the row's order, by code; code 0 is the empty set."""
        self._port_codes: dict[str, int] = {}
        self._fault_codes: dict[tuple[Fault, ...], int] = {}
        self._lock = Lock()
        self.fault_code(())

    def port_code(self, port: str) -> int:
        """The code of a port; an unknown port gets the next free code."""
        return _code_of(port, self._port_codes, self.ports, self._lock)

    def fault_code(self, faults: tuple[Fault, ...]) -> int:
        """The code of a fault set; an unknown set gets the next free code.

        Raises ValueError if there are too many.
        """
        if len(self.faults) >= _MOST_FAULT_SETS and faults not in self._fault_codes:
            raise ValueError("more combinations of faults than a recording has")
        return _code_of(faults, self._fault_codes, self.faults, self._lock)


def _code_of(key: _Key, codes: dict[_Key, int], keys: list[_Key], lock: Lock) -> int:
    code = codes.get(key)
    if code is None:
        with lock:
            code = codes.get(key, len(keys))
            if code == len(keys):
                keys.append(key)
                codes[key] = code
    return code


@dataclass(frozen=True, eq=False, repr=False)
class RowBatch(Sequence[Row]):
    """Rows as columns of equal length, and the port events between them."""

    codebook: Codebook
    t_ns: Array
    """Nanoseconds since 1970 UTC, or `NO_TIME`; int64."""
    offset: Array
    """Offset of the row's first byte in its port's stream, int64."""
    delay_ns: Array
    """Read delay, nanoseconds, or `NO_TIME`; int64."""
    length: Array
    """Bytes of the row, uint32."""
    port: Array
    """Code of the port, uint16."""
    faults: Array
    """Code of the fault set, uint16."""
    framed: Array
    """Whether the row is a Frame, bool; otherwise it is a Damage."""
    unordered: Array
    """Whether the row's order among rows of other ports is uncertain, bool."""
    raw: Array
    """The first ten bytes, padded with zeros; uint8, shape (rows, 10)."""
    long: dict[int, bytes] = field(default_factory=dict)
    """All bytes of the rows longer than ten, by index."""
    events: tuple[PortEvent, ...] = ()

    @classmethod
    def allocate(cls, codebook: Codebook, rows: int) -> Self:
        """Columns to fill in; the defaults are those of a sound frame with time and read delay."""
        return cls(
            codebook,
            t_ns=np.empty(rows, np.int64),
            offset=np.empty(rows, np.int64),
            delay_ns=np.zeros(rows, np.int64),
            length=np.full(rows, FRAME_LENGTH, np.uint32),
            port=np.empty(rows, np.uint16),
            faults=np.zeros(rows, np.uint16),
            framed=np.ones(rows, np.bool_),
            unordered=np.zeros(rows, np.bool_),
            raw=np.zeros((rows, FRAME_LENGTH), np.uint8),
        )

    @classmethod
    def from_rows(
        cls,
        rows: Sequence[Row],
        codebook: Codebook | None = None,
        events: Sequence[PortEvent] = (),
    ) -> RowBatch:
        """The batch of these rows; a batch is converted to the codebook."""
        if isinstance(rows, RowBatch):
            batch = rows if codebook is None else rows.recoded(codebook)
            return replace(batch, events=tuple(events))
        codebook = codebook or Codebook()
        raws = [row.raw for row in rows]
        first_bytes = b"".join([raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0") for raw in raws])
        return cls(
            codebook,
            t_ns=_times_or_none([row.t_ns for row in rows]),
            offset=np.array([row.offset for row in rows], np.int64),
            delay_ns=_times_or_none([row.read_delay_ns for row in rows]),
            length=np.array([len(raw) for raw in raws], np.uint32),
            port=np.array([codebook.port_code(row.port) for row in rows], np.uint16),
            faults=np.array([codebook.fault_code(row.faults) for row in rows], np.uint16),
            framed=np.array([isinstance(row, Frame) for row in rows], np.bool_),
            unordered=np.array([row.order_uncertain for row in rows], np.bool_),
            raw=np.frombuffer(first_bytes, np.uint8).reshape(-1, FRAME_LENGTH),
            long={at: raw for at, raw in enumerate(raws) if len(raw) > FRAME_LENGTH},
            events=tuple(events),
        )

    @classmethod
    def from_span(cls, span: DecidedSpan) -> RowBatch:
        """The rows that the framer decided."""
        codebook, rows = Codebook(), len(span)
        length, framed, faults = _segment_columns(span, rows, codebook)
        start = int(span.segments.starts[0]) if rows else span.start
        if (length == FRAME_LENGTH).all():
            offset = np.arange(start, start + rows * FRAME_LENGTH, FRAME_LENGTH)
            data = np.frombuffer(span.data, np.uint8, rows * FRAME_LENGTH, start - span.start)
            raw, long = data.reshape(-1, FRAME_LENGTH), dict[int, bytes]()
        else:
            ends = np.cumsum(length, dtype=np.int64)
            offset = start + ends - length
            raw = _first_bytes(span.data, offset - span.start, length)
            long = _long_rows(span, offset, length)
        t_ns, delay_ns = _times(span.times, offset)
        return cls(
            codebook,
            t_ns=t_ns,
            offset=offset,
            delay_ns=delay_ns,
            length=length,
            port=_constant(codebook.port_code(span.port), rows, np.uint16),
            faults=faults,
            framed=framed,
            unordered=_constant(False, rows, np.bool_),
            raw=raw,
            long=long,
        )

    @classmethod
    def concat(cls, batches: Sequence[RowBatch]) -> RowBatch:
        """All rows and events of at least one batch, in order."""
        if len(batches) == 1:
            return batches[0]
        codebook, long, start = batches[0].codebook, dict[int, bytes](), 0
        for batch in batches:
            long.update((start + at, raw) for at, raw in batch.long.items())
            start += len(batch)
        recoded = [batch.recoded(codebook) for batch in batches]
        arrays = {name: np.concatenate([getattr(b, name) for b in recoded]) for name in COLUMNS}
        events = tuple(event for batch in batches for event in batch.events)
        return cls(codebook, long=long, events=events, **arrays)

    def put(self, at: int, row: Row) -> None:
        """Fill in one row."""
        self.t_ns[at], self.delay_ns[at] = _times_or_none([row.t_ns, row.read_delay_ns])
        self.offset[at], self.length[at] = row.offset, len(row.raw)
        self.port[at] = self.codebook.port_code(row.port)
        self.faults[at] = self.codebook.fault_code(row.faults)
        self.framed[at], self.unordered[at] = isinstance(row, Frame), row.order_uncertain
        first = row.raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0")
        self.raw[at] = np.frombuffer(first, np.uint8)
        if len(row.raw) > FRAME_LENGTH:
            self.long[at] = row.raw

    def assign(self, start: int, batch: RowBatch) -> None:
        """Fill in rows from index `start` on with those of a batch of the same codebook."""
        rows = slice(start, start + len(batch))
        for name in COLUMNS:
            getattr(self, name)[rows] = getattr(batch, name)
        self.long.update((start + at, raw) for at, raw in batch.long.items())

    def __len__(self) -> int:
        return len(self.t_ns)

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> RowBatch: ...
    def __getitem__(self, at: int | slice) -> Row | RowBatch:
        if isinstance(at, slice):
            return self.select(at)
        index = range(len(self))[at]
        return next(self._rows(index, index + 1))

    def __iter__(self) -> Iterator[Row]:
        for start in range(0, len(self), _ROWS_AT_ONCE):
            yield from self._rows(start, min(start + _ROWS_AT_ONCE, len(self)))

    def _rows(self, start: int, end: int) -> Iterator[Row]:
        ports, faults = self.codebook.ports, self.codebook.faults
        raws = self.raw[start:end].tobytes()
        scalars = [getattr(self, name)[start:end].tolist() for name in COLUMNS[:-1]]
        for at, scalar in enumerate(zip(*scalars, strict=True)):
            t_ns, offset, delay, length, port, fault, framed, unordered = scalar
            first = at * FRAME_LENGTH
            yield (Frame if framed else Damage)(
                ports[port],
                offset,
                self.long[start + at] if length > FRAME_LENGTH else raws[first : first + length],
                None if t_ns == NO_TIME else t_ns,
                faults[fault],
                None if delay == NO_TIME else delay,
                unordered,
            )

    @property
    def timed(self) -> Bools:
        """Whether each row has a time."""
        found: Bools = self.t_ns != NO_TIME
        return found

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first row and the latest time; None if a row has none, or without rows."""
        if not len(self) or int(self.t_ns.min()) == NO_TIME:
            return None
        return int(self.t_ns[0]), int(self.t_ns.max())

    # The fields of frames; a batch that is still filled in must not use these

    @cached_property
    def kinds(self) -> Codes:
        """The index in `KINDS` of each row's kind, `NO_KIND` without one."""
        heads = self.raw[:, 0].astype(np.uint16) << np.uint16(8) | self.raw[:, CMD_OFFSET]
        kinds: Codes = _KIND_CODES.take(heads)
        kinds[~self.framed] = NO_KIND
        return kinds

    @property
    def directions(self) -> Codes:
        """The index in `Direction` of each row's direction, `NO_DIRECTION` without one."""
        codes: Codes = _DIRECTION_CODES[self.raw[:, 0]]
        codes[~self.framed] = NO_DIRECTION
        return codes

    @property
    def cmds(self) -> Codes:
        """CMD of each frame."""
        return self.raw[:, CMD_OFFSET]

    @property
    def nums(self) -> Codes:
        """NUM of each frame."""
        return self.raw[:, NUM_OFFSET]

    def field(self, name: str) -> tuple[Array, Bools]:
        """A field in each row, as wide as on the wire, and a mask of the rows that have it."""
        return _field_values(self.raw, self.kinds, name)

    def values(self, field: str | Role, rows: Ints) -> Ints:
        """One field, by name or role, of the rows at these indices, which all must have it."""
        name = NAME_OF_ROLE[field] if isinstance(field, Role) else field
        values, _ = _field_values(self.raw[rows], self.kinds[rows], name)
        return values.astype(np.int64)

    def value(self, name: str, row: int) -> int:
        """One field of the row at an index, which must have it."""
        return int(self.values(name, np.array([row]))[0])

    def raised(self) -> Bools:
        """Which rows are frames with a flag byte that is not in order, as `Field.raised`."""
        found: Bools = np.zeros(len(self), np.bool_)
        for flags in VALUE_FIELDS:
            if flags.legal_bits is not None:
                values, known = self.field(flags.name)
                found |= known & (values != flags.default)
        return found

    def select(self, rows: slice | Array, events: tuple[PortEvent, ...] = ()) -> RowBatch:
        """The rows of a slice, a mask or an array of indices, with these events."""
        arrays = {name: getattr(self, name)[rows] for name in COLUMNS}
        long: dict[int, bytes] = {}
        if self.long:
            at = np.flatnonzero(arrays["length"] > FRAME_LENGTH)
            old = np.arange(len(self))[rows][at]
            long = {new: self.long[of] for new, of in zip(at.tolist(), old.tolist(), strict=True)}
        return RowBatch(self.codebook, long=long, events=events, **arrays)

    def recoded(self, codebook: Codebook) -> RowBatch:
        """The same rows with the codes of another codebook."""
        if codebook is self.codebook:
            return self
        ports = np.array([codebook.port_code(port) for port in self.codebook.ports], np.uint16)
        faults = np.array([codebook.fault_code(one) for one in self.codebook.faults], np.uint16)
        if _is_identity(ports) and _is_identity(faults):
            return replace(self, codebook=codebook)
        return replace(self, codebook=codebook, port=ports[self.port], faults=faults[self.faults])

    def tobytes(self) -> bytes:
        """The bytes of all rows, concatenated."""
        inline = np.ascontiguousarray(self.raw)
        length = np.minimum(self.length, FRAME_LENGTH)
        if (length < FRAME_LENGTH).any():
            inline = inline[np.arange(FRAME_LENGTH) < length[:, None]]
        inline, ends = inline.reshape(-1), np.cumsum(length, dtype=np.int64)
        parts, start = list[bytes](), 0
        for at, raw in sorted(self.long.items()):
            parts += [inline[start : ends[at]].tobytes(), raw[FRAME_LENGTH:]]
            start = ends[at]
        return b"".join([*parts, inline[start:].tobytes()])

    def end_offsets(self) -> dict[str, int]:
        """By port, the offset after the last byte of its last row."""
        found = {}
        for code in np.flatnonzero(np.bincount(self.port)):
            last = np.flatnonzero(self.port == code)[-1]
            found[self.codebook.ports[code]] = int(self.offset[last]) + int(self.length[last])
        return found


Rows: TypeAlias = list[Row] | RowBatch
"""A list where rows are few, so that numpy need not be loaded for them."""

COLUMNS: Final = tuple(one.name for one in fields(RowBatch) if one.type == "Array")
"""The names of the columns, in their order; `raw` is the last."""

FieldLayout: TypeAlias = tuple[int, int, bool]
"""Start and size of a field, and whether it is signed."""


def _field_layouts() -> dict[str, dict[FieldLayout, Bools]]:
    """By field name: its layouts, each with a mask of the kinds."""
    layouts: dict[str, dict[FieldLayout, Bools]] = {}
    for code, kind in enumerate(KINDS):
        for one in kind.fields:
            kinds = layouts.setdefault(one.name, {}).setdefault(
                (one.start, one.size, one.signed), np.zeros(len(KINDS) + 1, np.bool_)
            )
            kinds[code] = True
    return layouts


def _direction_codes() -> Codes:
    codes = np.full(256, NO_DIRECTION, np.uint8)
    for code, direction in enumerate(Direction):
        codes[HEADERS[direction]] = code
    return codes


_DIRECTION_CODES: Final = _direction_codes()
_KIND_CODES: Final = np.frombuffer(FTE_FORMAT.kind_codes(NO_KIND), np.uint8)
_FIELD_LAYOUTS: Final = _field_layouts()


def _field_values(raw: Array, kinds: Codes, name: str) -> tuple[Array, Bools]:
    (layout, having), *others = _FIELD_LAYOUTS[name].items()
    values, known = read_field(raw, *layout), having.take(kinds)
    for layout, having in others:
        here = having.take(kinds)
        np.copyto(values, read_field(raw, *layout), where=here)
        known |= here
    return values, known


def read_field(raw: Array, start: int, size: int, signed: bool) -> Array:
    """One field in the first bytes of every row; it is big-endian.

    See docs/reference/protocol.md, "Frames".
    """
    wire = np.dtype(f">{'i' if signed else 'u'}{size}")
    if not len(raw):
        return np.empty(0, wire.newbyteorder("="))
    found: Array = np.ndarray((len(raw),), wire, np.ascontiguousarray(raw), start, (FRAME_LENGTH,))
    return found.astype(wire.newbyteorder("="))


def _times_or_none(times: Sequence[int | None]) -> Ints:
    return np.array([NO_TIME if time is None else time for time in times], np.int64)


def _is_identity(codes: npt.NDArray[np.integer]) -> bool:
    return bool((codes == np.arange(len(codes))).all())


class RowBuffer:
    """A large batch that is reserved part by part, so that parts need not be copied together."""

    def __init__(self, codebook: Codebook, rows: int) -> None:
        self._whole = RowBatch.allocate(codebook, rows)
        self._used = 0

    def reserve(self, rows: int) -> RowBatch:
        """The next part to fill in; a separate batch where the buffer is full."""
        start = self._used
        self._used += rows
        if self._used > len(self._whole):
            return RowBatch.allocate(self._whole.codebook, rows)
        return self._whole[start : self._used]

    def filled(self) -> RowBatch | None:
        """All reserved parts as one batch; None if the buffer could not hold them all."""
        return self._whole[: self._used] if self._used <= len(self._whole) else None


_FIRST_BYTES: Final = np.dtype(f"V{FRAME_LENGTH}")
"""The first ten bytes of a row, copied as one item."""

_SOUND_FRAME: Final = 1
"""The code of segments that are frames without a fault."""

_OWN_BITS: Final = np.tri(FRAME_LENGTH, k=-1, dtype=np.uint8) * np.uint8(0xFF)
"""By length of a short row, the mask of its own bytes among ten."""


def _constant(value: int, rows: int, dtype: npt.DTypeLike) -> Array:
    """A read-only column of one value that takes no memory a row."""
    return np.broadcast_to(np.array(value, dtype), rows)


def _segment_columns(
    span: DecidedSpan, rows: int, codebook: Codebook
) -> tuple[Array, Array, Array]:
    starts, counts, codes = (
        np.frombuffer(memoryview(numbers), np.int64) if len(numbers) else np.zeros(0, np.int64)
        for numbers in (span.segments.starts, span.segments.counts, span.segments.codes)
    )
    other = (codes != _SOUND_FRAME).nonzero()[0]
    at, codes = np.cumsum(counts)[other] - 1, codes[other]
    sets, which = np.unique(codes >> 1, return_inverse=True)
    set_codes = [codebook.fault_code(FAULT_SETS[number]) for number in sets.tolist()]
    length, framed, faults = (
        np.full(rows, FRAME_LENGTH, np.uint32),
        np.ones(rows, np.bool_),
        np.zeros(rows, np.uint16),
    )
    length[at] = np.diff(starts, append=np.int64(span.segments.end))[other]
    framed[at] = codes & 1
    faults[at] = np.array(set_codes, np.uint16)[which]
    return length, framed, faults


def _first_bytes(data: bytes, starts: Array, length: Array) -> Array:
    rows = np.empty(len(starts), _FIRST_BYTES)
    reach = len(data) - FRAME_LENGTH + 1
    whole = len(starts) if reach > starts[-1] else int(np.searchsorted(starts, max(reach, 0)))
    if whole:
        rows[:whole] = np.ndarray((reach,), _FIRST_BYTES, data, 0, (1,))[starts[:whole]]
    raw = rows.view(np.uint8).reshape(-1, FRAME_LENGTH)
    for row in range(whole, len(starts)):
        last = data[starts[row] :][:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0")
        raw[row] = np.frombuffer(last, np.uint8)
    short = (length < FRAME_LENGTH).nonzero()[0]
    if len(short):
        raw[short] &= _OWN_BITS[length[short]]
    return raw


def _long_rows(span: DecidedSpan, offset: Array, length: Array) -> dict[int, bytes]:
    rows = (length > FRAME_LENGTH).nonzero()[0]
    starts = offset[rows] - span.start
    ends = starts + length[rows]
    return {
        row: span.data[start:end]
        for row, start, end in zip(rows.tolist(), starts.tolist(), ends.tolist(), strict=True)
    }


def _times(marks: Sequence[ArrivalTime], offset: Array) -> tuple[Array, Array]:
    if all(mark.t_ns is None for mark in marks):
        none = _constant(NO_TIME, len(offset), np.int64)
        return none, none
    stop, floor, byte = (
        np.array([getattr(mark, name) for mark in marks], np.int64)
        for name in ("stop", "floor_ns", "byte_ns")
    )
    read = np.array([mark.t_ns or 0 for mark in marks], np.int64)
    own = np.searchsorted(stop, offset, side="right")
    known = np.array([mark.t_ns is not None for mark in marks])[own]
    delay = (stop[own] - offset) * byte[own]
    t_ns, floor = read[own] - delay, floor[own]
    early = t_ns < floor
    t_ns[early] = floor[early]
    delay[early] = np.maximum(read[own][early] - floor[early], 0)
    t_ns[~known] = delay[~known] = NO_TIME
    return t_ns, delay
