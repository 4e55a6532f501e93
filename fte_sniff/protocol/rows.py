"""Rows: the one container of rows, as numpy columns; `Row`, one of them.

A row has at most 16 bytes, so every column has values of one size. A frame has ten bytes, a damaged
frame at most 14, and noise is cut every 16 bytes, like the lines of a hex dump:

    t_ns  offset  length  port  faults   framed  raw (16 bytes)            ... previous
     800     120      10     0  0        True    AA 01 01 03 E8 ... EE 00      -1
     950     130       6     0  1 << 4   False   AA 01 01 03 E8 00 00 00       -1

`port` is an index in `Rows.ports`; `faults` is a set of bits, in the order of `Fault`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Self, TypeAlias, cast, overload

import numpy as np
import numpy.typing as npt

from fte_sniff.protocol.items import BaudChange, Gap, PortEvent
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NUM_OFFSET,
    SUSPECT_FAULTS,
    VALUE_FIELDS,
    Direction,
    Fault,
    FrameKind,
    Status,
    status_of,
)

Array: TypeAlias = "npt.NDArray[Any]"
Bools: TypeAlias = "npt.NDArray[np.bool_]"
Codes: TypeAlias = "npt.NDArray[np.uint8]"
Ints: TypeAlias = "npt.NDArray[np.int64]"
Floats: TypeAlias = "npt.NDArray[np.float64]"

MOST_BYTES: Final = 16
"""Bytes of a row, at most; the width of the column `raw`."""

NO_TIME: Final = -(2**63)
"""Time, or read delay, of a row without one."""

END_NS: Final = 2**63
"""Times of rows are below this, nanoseconds since 1970 UTC: in the year 2262."""

NO_FACT: Final = -1
"""The value of a column of `FACTS` where nothing is known."""

NO_KIND: Final = len(KINDS)
"""The kind code of a row without a kind."""

KIND_OF: Final = np.full(1 << 16, NO_KIND, np.uint8)
"""By header * 256 + CMD: the index in `KINDS`, or `NO_KIND`."""
for (_header, _cmd), _kind in KIND_BY_HEADER_AND_CMD.items():
    KIND_OF[_header << 8 | _cmd] = KINDS.index(_kind)

IS_HEADER: Final = np.isin(np.arange(256), list(HEADERS.values()))
"""By byte: whether it can begin a frame."""

NO_DIRECTION: Final = len(Direction)
"""The direction code of a row without a direction."""

ARRAYS: Final[Mapping[str, tuple[np.dtype[Any], int]]] = {
    "t_ns": (np.dtype("i8"), NO_TIME),
    "offset": (np.dtype("i8"), 0),
    "delay_ns": (np.dtype("i8"), NO_TIME),
    "length": (np.dtype("u1"), FRAME_LENGTH),
    "port": (np.dtype("u2"), 0),
    "faults": (np.dtype("u2"), 0),
    "framed": (np.dtype("?"), True),
    "unordered": (np.dtype("?"), False),
    "raw": (np.dtype(("u1", (MOST_BYTES,))), 0),
    "answer_ns": (np.dtype("i4"), NO_FACT),
    "unanswered": (np.dtype("i1"), NO_FACT),
    "motor_hint": (np.dtype("i1"), NO_FACT),
    "previous": (np.dtype("i8"), NO_FACT),
}
"""The numpy type and the default of each column."""

_DEFAULTS: Final = {name: np.full(1, value, kind) for name, (kind, value) in ARRAYS.items()}

FACTS: Final = ("answer_ns", "unanswered", "motor_hint", "previous")
"""The columns that depend on other rows."""

_PAYLOAD: Final = slice(NUM_OFFSET + 1, FRAME_LENGTH - 1)
"""The bytes of a frame that hold its fields but the motor: at most eight."""

FAULT_BITS: Final = {fault: 1 << number for number, fault in enumerate(Fault)}
"""The bit of each fault in the column `faults`."""


def fault_bits(faults: Iterable[Fault]) -> int:
    """The value of the column `faults` for some faults."""
    return sum(FAULT_BITS[fault] for fault in set(faults))


def faults_in(bits: int) -> tuple[Fault, ...]:
    """The faults of a value of the column `faults`, in the order of `Fault`."""
    return tuple(fault for fault, bit in FAULT_BITS.items() if bits & bit)


def kind_of(headers: Codes, cmds: Codes) -> Codes:
    """The index in `KINDS` that each header and CMD name, or `NO_KIND`."""
    found: Codes = KIND_OF.take(headers.astype(np.uint16) << np.uint16(8) | cmds)
    return found


MALFORMED_BITS: Final = fault_bits(fault for fault in Fault if fault not in SUSPECT_FAULTS)
"""The bits of the faults that make a row unreadable."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row: a frame, or bytes that no frame contains."""

    port: str
    offset: int
    """Offset of the first byte in the port's stream, from 0."""
    raw: bytes
    """1 to 16 bytes."""
    t_ns: int | None
    """Start of the first byte on the wire, nanoseconds since 1970 UTC; never falls per port."""
    faults: tuple[Fault, ...] = ()
    framed: bool = True
    """Whether the bytes are a frame: a header and a tail in step with the stream."""
    delay_ns: int | None = field(default=None, compare=False)
    """Nanoseconds from `t_ns` until the read of the first byte returned."""
    unordered: bool = field(default=False, compare=False)
    """Whether a neighbouring row of another port may belong on the other side of this one: their
    times are closer than the two ports can resolve."""
    answer_ns: int | None = field(default=None, compare=False)
    """Nanoseconds from a command to its answer."""
    unanswered: bool | None = field(default=None, compare=False)
    """Whether a command had no answer by the deadline; None where that is not known."""
    motor_hint: int | None = field(default=None, compare=False)
    """The motor that a damaged row probably belonged to."""
    previous: int | None = field(default=None, compare=False)
    """The payload, as a number, of the frame before of this port, motor and kind."""

    @property
    def status(self) -> Status:
        """The status by the faults."""
        return status_of(self.faults)

    @property
    def direction(self) -> Direction | None:
        """The direction that a frame's header names."""
        return DIRECTION_OF_HEADER[self.raw[0]] if self.framed else None

    @property
    def cmd(self) -> int | None:
        """CMD of a frame as on the wire."""
        return self.raw[CMD_OFFSET] if self.framed else None

    @property
    def kind(self) -> FrameKind | None:
        """The frame kind; None if header and CMD name none."""
        key = (self.raw[0], self.raw[CMD_OFFSET]) if self.framed else (0, 0)
        return KIND_BY_HEADER_AND_CMD.get(key)

    @property
    def values(self) -> dict[str, int]:
        """The fields' values by row name, as on the wire even where out of range."""
        kind = self.kind
        return {one.name: one.read(self.raw) for one in kind.fields} if kind else {}


class Rows(Sequence[Row]):
    """Rows as columns of equal length."""

    columns: Mapping[str, Array]
    """The columns by name, those of `ARRAYS`; each is an attribute, too."""
    ports: tuple[str, ...]
    """The ports by index; some may have no rows."""
    t_ns: Ints
    """Nanoseconds since 1970 UTC, or `NO_TIME`; int64."""
    offset: Ints
    """Offset of the row's first byte in its port's stream, int64."""
    delay_ns: Ints
    """Read delay, nanoseconds, or `NO_TIME`; int64."""
    length: Codes
    """Bytes of the row, 1 to 16; uint8."""
    port: Array
    """Index in `ports`, uint16."""
    faults: Array
    """The faults as bits (`fault_bits`), uint16; 0 for none."""
    framed: Bools
    """Whether the row is a frame."""
    unordered: Bools
    """Whether the row's order among rows of other ports is uncertain."""
    raw: Codes
    """The bytes, padded with zeros; uint8, shape (rows, 16)."""
    answer_ns: Array
    """Nanoseconds from a command to its answer, or `NO_FACT`; int32."""
    unanswered: Array
    """The motors that did not answer a command by the deadline, a bit each as in ONLINE, or
    `NO_FACT`; int8."""
    motor_hint: Array
    """The motor that a damaged row probably belonged to, or `NO_FACT`; int8."""
    previous: Ints
    """The `payloads` of the frame before of the same port, motor and kind, or `NO_FACT`; int64."""

    def __init__(self, columns: Mapping[str, Array], ports: tuple[str, ...]) -> None:
        """Rows of these columns, all of `ARRAYS`, each of its type; they are not copied."""
        self.columns, self.ports = columns, ports
        self.__dict__.update(columns)

    @classmethod
    def blank(cls, count: int, ports: tuple[str, ...] = ("",), **columns: Any) -> Self:
        """Rows with these columns (arrays or lists); the others have their defaults.

        Unknown columns raise KeyError, those of another length ValueError.
        """
        found = dict(_DEFAULTS)
        for name in ARRAYS.keys() - columns.keys():
            found[name] = found[name].repeat(count, axis=0)
        for name, values in columns.items():
            own = np.asarray(values, found[name].dtype)
            if own.shape != (count, *found[name].shape[1:]):
                raise ValueError(f"{name} has the shape {own.shape}, for {count} rows")
            found[name] = own
        return cls(found, ports)

    @classmethod
    def concat(cls, parts: Sequence[Rows]) -> Rows:
        """All rows, in order."""
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return cls.blank(0, ())
        ports = tuple(dict.fromkeys(port for part in parts for port in part.ports))
        recoded = [part.with_ports(ports).columns for part in parts]
        columns = {name: np.concatenate([own[name] for own in recoded]) for name in ARRAYS}
        return Rows(columns, ports)

    def with_ports(self, ports: tuple[str, ...]) -> Rows:
        """These rows with the indexes of other ports; raises ValueError if one is missing there."""
        codes = np.array([ports.index(port) for port in self.ports], np.uint16)
        return Rows({**self.columns, "port": codes[self.port]}, ports)

    def select(self, rows: slice | Array) -> Rows:
        """The rows of a slice, a mask or an array of indices."""
        return Rows({name: own[rows] for name, own in self.columns.items()}, self.ports)

    def replace(self, **columns: Array) -> Self:
        """These rows with other columns."""
        return type(self)({**self.columns, **columns}, self.ports)

    def __len__(self) -> int:
        return len(self.t_ns)

    def __repr__(self) -> str:
        return f"<{len(self)} rows>"

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> Rows: ...
    def __getitem__(self, at: int | slice) -> Row | Rows:
        """One row, or the rows of a slice."""
        if isinstance(at, slice):
            return self.select(at)
        index = range(len(self))[at]
        return next(iter(self.select(slice(index, index + 1))))

    def __iter__(self) -> Iterator[Row]:
        """The rows one by one; a few thousand become objects at once, so memory stays small."""
        for start in range(0, len(self), _ROWS_AT_ONCE):
            yield from self.select(slice(start, start + _ROWS_AT_ONCE))._rows()

    def _rows(self) -> Iterator[Row]:
        raw = self.raw.tobytes()
        lists = {name: own.tolist() for name, own in self.columns.items() if name != "raw"}
        faults = {bits: faults_in(bits) for bits in set(lists["faults"])}
        for at, length in enumerate(lists["length"]):
            unanswered = _known(lists["unanswered"][at])
            yield Row(
                self.ports[lists["port"][at]],
                lists["offset"][at],
                raw[at * MOST_BYTES : at * MOST_BYTES + length],
                _known(lists["t_ns"][at], NO_TIME),
                faults[lists["faults"][at]],
                lists["framed"][at],
                _known(lists["delay_ns"][at], NO_TIME),
                lists["unordered"][at],
                _known(lists["answer_ns"][at]),
                None if unanswered is None else unanswered > 0,
                _known(lists["motor_hint"][at]),
                _known(lists["previous"][at]),
            )

    # Times and sizes

    @property
    def timed(self) -> Bools:
        """Whether each row has a time."""
        return cast("Bools", self.t_ns != NO_TIME)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The earliest and the latest time of its rows; None if none of them has one."""
        times = self.t_ns[self.timed]
        return (int(times.min()), int(times.max())) if len(times) else None

    @property
    def used_ports(self) -> list[str]:
        """The ports that have rows."""
        return [self.ports[code] for code in np.unique(self.port).tolist()]

    def tobytes(self) -> bytes:
        """The bytes of all rows, concatenated."""
        return self.raw[np.arange(MOST_BYTES) < self.length[:, None]].tobytes()

    # Faults

    @property
    def is_malformed(self) -> Bools:
        """Which rows have a fault that makes them unreadable."""
        return cast("Bools", (self.faults & MALFORMED_BITS) != 0)

    @property
    def statuses(self) -> Codes:
        """The index in `Status` of each row's status."""
        return np.where(self.is_malformed, 2, self.faults != 0).astype(np.uint8)

    # The fields of frames; rows that are still filled in must not use these

    @cached_property
    def kinds(self) -> Codes:
        """The index in `KINDS` of each row's kind, `NO_KIND` without one."""
        kinds = kind_of(self.raw[:, 0], self.raw[:, CMD_OFFSET])
        kinds[~self.framed] = NO_KIND
        return kinds

    @property
    def directions(self) -> Codes:
        """The index in `Direction` of each row's direction, `NO_DIRECTION` without one."""
        codes: Codes = _DIRECTION_OF.take(self.raw[:, 0])
        codes[~self.framed] = NO_DIRECTION
        return codes

    @property
    def nums(self) -> Codes:
        """The byte at the place of NUM in each row."""
        return self.raw[:, NUM_OFFSET]

    def field(self, name: str) -> tuple[Array, Bools]:
        """A field in each row, as wide as on the wire, and a mask of the rows that have it."""
        return field_of(self.raw, self.kinds, name)

    @property
    def payloads(self) -> Ints:
        """The bytes between NUM and tail of each row as a number, most significant first."""
        wide = np.zeros((len(self), 8), np.uint8)
        wide[:, -_PAYLOAD.stop + _PAYLOAD.start :] = self.raw[:, _PAYLOAD]
        return wide.view(">i8").reshape(-1).astype(np.int64)

    def previous_field(self, name: str) -> tuple[Array, Bools]:
        """A field of the frame before of the same port, motor and kind, as `field`."""
        raw = self.raw.copy()
        wide = self.previous.astype(">i8").view(np.uint8).reshape(-1, 8)
        raw[:, _PAYLOAD] = wide[:, -_PAYLOAD.stop + _PAYLOAD.start :]
        values, has = field_of(raw, self.kinds, name)
        return values, has & (self.previous != NO_FACT)

    def raised(self) -> Bools:
        """Which rows are frames with a flag byte that is not in order, as `Field.raised`."""
        found: Bools = np.zeros(len(self), np.bool_)
        for flags in VALUE_FIELDS:
            if flags.legal_bits is not None:
                values, known = self.field(flags.name)
                found |= known & (values != flags.default)
        return found


_ROWS_AT_ONCE: Final = 4096


def _known(value: int, missing: int = NO_FACT) -> int | None:
    return None if value == missing else value


_DIRECTION_OF: Final = np.full(256, NO_DIRECTION, np.uint8)
"""By header: the index in `Direction`, or `NO_DIRECTION`."""
_DIRECTION_OF[[HEADERS[direction] for direction in Direction]] = range(len(Direction))


def _layouts_of(name: str) -> list[tuple[int, np.dtype[Any], Bools]]:
    """The layouts of a field: start, type on the wire, and by kind code whether it has it there."""
    found: dict[tuple[int, str], Bools] = {}
    for code, kind in enumerate(KINDS):
        if (own := kind.field(name)) is not None:
            wire = own.start, f">{'i' if own.signed else 'u'}{own.size}"
            found.setdefault(wire, np.zeros(NO_KIND + 1, np.bool_))[code] = True
    return [(start, np.dtype(wire), having) for (start, wire), having in found.items()]


_LAYOUTS: Final = {one.name: _layouts_of(one.name) for one in VALUE_FIELDS}


def field_of(raw: Array, kinds: Array, name: str) -> tuple[Array, Bools]:
    """A field in the bytes of frames, and a mask of those that have it.

    `raw` is uint8, shape (rows, 10 or more); `kinds` are the codes of `Rows.kinds`. Values are 0
    where the mask is false. A field is big-endian (docs/reference/protocol.md, "Frames").
    """
    values = np.zeros(len(raw), _LAYOUTS[name][0][1].newbyteorder("="))
    known: Bools = np.zeros(len(raw), np.bool_)
    for start, wire, having in _LAYOUTS[name]:
        here = having.take(kinds)
        own = raw[:, start : start + wire.itemsize].view(wire)[:, 0].astype(values.dtype)
        values += own * here
        known |= here
    return values, known


NO_ROWS: Final = Rows.blank(0, ())

Item: TypeAlias = Rows | PortEvent | Gap | BaudChange
"""What a stream consists of: rows, and what happened between the rows before and after it."""
