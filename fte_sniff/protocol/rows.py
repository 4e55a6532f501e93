"""Rows: the one container of rows, as columns; `Frame` and `Damage`, one row each.

Rows      columns of equal length: what the framer and the readers emit, and all others read
Frame     ten bytes between a header and a tail (a row)
Damage    bytes that no frame contains (a row)
Codebook  the ports and fault sets that the columns `port` and `faults` are codes of

The columns are plain buffers, which the framer fills, and numpy arrays on first use. So a command
that shows a few rows does not load numpy, and the work on many rows is done by numpy.
"""

from __future__ import annotations

import sys
from array import array
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import accumulate, compress, repeat
from threading import Lock
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, TypeVar, overload

from fte_sniff.protocol.items import Chunk, PortEvent
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    FTE_FORMAT,
    HEADERS,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    NAME_OF_ROLE,
    NUM_OFFSET,
    VALUE_FIELDS,
    Direction,
    Fault,
    FrameKind,
    Role,
    Status,
    status_of,
)

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Array: TypeAlias = "npt.NDArray[Any]"
Bools: TypeAlias = "npt.NDArray[np.bool_]"
Codes: TypeAlias = "npt.NDArray[np.uint8]"
Ints: TypeAlias = "npt.NDArray[np.int64]"
Buffer: TypeAlias = Any
"""A column: a memoryview, an array or a numpy array, of the type that `COLUMNS` names."""


class Reading(NamedTuple):
    """A way to divide the bytes of a row into frames and damage; see `readings`."""

    reading: str
    """The segments, each with its kind or fault, and its bytes."""
    probability: float
    """0-1."""


@dataclass(frozen=True, slots=True)
class _Row:
    port: str
    offset: int
    """Offset of the first byte in the port's stream, from 0."""
    raw: bytes
    t_ns: int | None
    """Start of the first byte on the wire, nanoseconds since 1970 UTC; never falls per port."""
    faults: tuple[Fault, ...] = ()
    read_delay_ns: int | None = field(default=None, compare=False)
    """Nanoseconds from `t_ns` until the read of the first byte returned."""
    order_uncertain: bool = field(default=False, compare=False)
    """Whether a neighbouring row of another port may belong on the other side of this one: their
    times are closer than the two ports can resolve."""
    answer_ns: int | None = field(default=None, compare=False)
    """Nanoseconds from a command to its answer; see `analysis.facts`."""
    unanswered: bool | None = field(default=None, compare=False)
    """Whether a command had no answer by the deadline; None where that is not known."""
    motor_hint: int | None = field(default=None, compare=False)
    """The motor that a damaged row probably belonged to."""
    previous: int | None = field(default=None, compare=False)
    """The payload, as a number, of the frame before of this port, motor and kind."""
    readings: tuple[Reading, ...] | None = None
    """The best two readings of a damaged or ambiguous row; None if they were not computed."""

    @property
    def status(self) -> Status:
        """The status by the faults."""
        return status_of(self.faults)


@dataclass(frozen=True, slots=True)
class Frame(_Row):
    """Ten bytes whose framing holds: a header and a tail, in step with the stream."""

    @property
    def framed(self) -> bool:
        """Whether the bytes are a frame."""
        return True

    @property
    def direction(self) -> Direction:
        """The direction that the header names."""
        return DIRECTION_OF_HEADER[self.raw[0]]

    @property
    def kind(self) -> FrameKind | None:
        """The frame kind, or None if header and CMD name none."""
        return KIND_BY_HEADER_AND_CMD.get((self.raw[0], self.cmd))

    @property
    def cmd(self) -> int:
        """CMD as on the wire."""
        return self.raw[CMD_OFFSET]

    @property
    def values(self) -> dict[str, int]:
        """The fields' values by row name, as on the wire even where out of range."""
        kind = self.kind
        return {f.name: f.read(self.raw) for f in kind.fields} if kind else {}


@dataclass(frozen=True, slots=True)
class Damage(_Row):
    """Bytes that no frame contains: kept, labelled with their cause, never decoded."""

    @property
    def framed(self) -> bool:
        """Whether the bytes are a frame."""
        return False

    faults: tuple[Fault, ...]


Row: TypeAlias = Frame | Damage


NO_TIME: Final = -(2**63)
"""Time, or read delay, of a row without one."""

NO_KIND: Final = len(KINDS)
"""The kind code of a row without a kind."""

NO_DIRECTION: Final = len(Direction)
"""The direction code of a row without a direction."""

FEW: Final = 20_000
"""Rows for which numpy is not loaded: it takes about as long as to handle them without."""

_FEWEST: Final = 50
"""Rows for which numpy is slower although it is loaded."""

_ROWS_AT_ONCE: Final = 4096
"""Rows that iteration converts to objects at a time, so that it needs little memory."""

_MOST_FAULT_SETS: Final = 4096

_Key = TypeVar("_Key")


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


COLUMNS: Final[Mapping[str, str]] = {
    "t_ns": "q",
    "offset": "q",
    "delay_ns": "q",
    "length": "I",
    "port": "H",
    "faults": "H",
    "framed": "?",
    "unordered": "?",
}
"""The type of each column but `raw`, as in `struct`, in the order of the columns."""


NO_FACT: Final = -1
"""The value of the columns of `FACTS` in a row without one."""

_PAYLOAD: Final = slice(NUM_OFFSET + 1, FRAME_LENGTH - 1)
"""The bytes of a frame that hold its fields but the motor: at most eight."""

FACTS: Final[Mapping[str, str]] = {
    "answer_ns": "i",
    "unanswered": "b",
    "motor_hint": "b",
    "previous": "q",
}
"""The type of each column that depends on other rows; rows have all of them, or none yet."""


class _LazyColumn:
    """A column as a numpy array, made on first use."""

    def __set_name__(self, _owner: type[Rows], name: str) -> None:
        self._name = name

    @overload
    def __get__(self, rows: None, owner: type[Rows]) -> _LazyColumn: ...
    @overload
    def __get__(self, rows: Rows, owner: type[Rows]) -> Array: ...
    def __get__(self, rows: Rows | None, owner: type[Rows]) -> Array | _LazyColumn:
        if rows is None:
            return self
        import numpy as np

        # The instance's attribute is found before this descriptor from now on.
        found = rows.__dict__[self._name] = np.asarray(rows.buffers[self._name])
        return found


class _FactColumn(_LazyColumn):
    """A column that depends on other rows; `NO_FACT` everywhere if it was not computed."""

    @overload
    def __get__(self, rows: None, owner: type[Rows]) -> _FactColumn: ...
    @overload
    def __get__(self, rows: Rows, owner: type[Rows]) -> Array: ...
    def __get__(self, rows: Rows | None, owner: type[Rows]) -> Array | _LazyColumn:
        if rows is None or rows.has_facts:
            return super().__get__(rows, owner)
        import numpy as np

        return np.full(len(rows), NO_FACT, np.dtype(FACTS[self._name]))


class Rows(Sequence["Row"]):
    """Rows as columns of equal length, and the port events between them."""

    codebook: Codebook
    buffers: Mapping[str, Buffer]
    """The columns but `raw`, for code that does not load numpy."""
    long: dict[int, bytes]
    """All bytes of the rows longer than ten, by index; `raw` has the first ten."""
    events: tuple[PortEvent, ...]
    readings: dict[int, tuple[Reading, ...]]
    """The readings of rows by index, where they were computed."""
    t_ns = _LazyColumn()
    """Nanoseconds since 1970 UTC, or `NO_TIME`; int64."""
    offset = _LazyColumn()
    """Offset of the row's first byte in its port's stream, int64."""
    delay_ns = _LazyColumn()
    """Read delay, nanoseconds, or `NO_TIME`; int64."""
    length = _LazyColumn()
    """Bytes of the row, uint32."""
    port = _LazyColumn()
    """Code of the port, uint16."""
    faults = _LazyColumn()
    """Code of the fault set, uint16."""
    framed = _LazyColumn()
    """Whether the row is a Frame, bool; otherwise it is a Damage."""
    unordered = _LazyColumn()
    """Whether the row's order among rows of other ports is uncertain, bool."""
    answer_ns = _FactColumn()
    """Nanoseconds from a command to its answer, int32, or `NO_FACT`."""
    unanswered = _FactColumn()
    """The motors that did not answer a command by the deadline, a bit each as in ONLINE, or
    `NO_FACT`; int8."""
    motor_hint = _FactColumn()
    """The motor that a damaged row probably belonged to, or `NO_FACT`; int8."""
    previous = _FactColumn()
    """The `payloads` of the frame before of the same port, motor and kind, or `NO_FACT`; int64."""

    def __init__(
        self,
        codebook: Codebook,
        columns: Mapping[str, Buffer],
        raw: Array | bytes | memoryview,
        long: dict[int, bytes] | None = None,
        events: tuple[PortEvent, ...] = (),
        readings: dict[int, tuple[Reading, ...]] | None = None,
    ) -> None:
        """Rows of these columns, which all of `COLUMNS` are in, and all of `FACTS` or none.

        `raw` holds the first ten bytes of each row, padded with zeros. `long` and `readings` are
        not copied.
        """
        self.codebook = codebook
        self.buffers = columns
        self._raw = memoryview(raw) if isinstance(raw, bytes) else raw
        self.long = {} if long is None else long
        self.events = events
        self.readings = {} if readings is None else readings

    @classmethod
    def allocate(cls, codebook: Codebook, rows: int) -> Rows:
        """Columns to fill in; the defaults are those of a sound frame with time and read delay."""
        import numpy as np

        return cls(
            codebook,
            {
                "t_ns": np.empty(rows, np.int64),
                "offset": np.empty(rows, np.int64),
                "delay_ns": np.zeros(rows, np.int64),
                "length": np.full(rows, FRAME_LENGTH, np.uint32),
                "port": np.empty(rows, np.uint16),
                "faults": np.zeros(rows, np.uint16),
                "framed": np.ones(rows, np.bool_),
                "unordered": np.zeros(rows, np.bool_),
            },
            np.zeros((rows, FRAME_LENGTH), np.uint8),
        )

    @classmethod
    def from_rows(
        cls,
        rows: Iterable[Row] = (),
        codebook: Codebook | None = None,
        events: Iterable[PortEvent] = (),
    ) -> Rows:
        """The columns of single rows."""
        rows = list(rows)
        found = cls.from_values(
            codebook or Codebook(),
            [row.t_ns for row in rows],
            [row.port for row in rows],
            [row.offset for row in rows],
            [row.raw for row in rows],
            [row.faults for row in rows],
            [isinstance(row, Frame) for row in rows],
        )
        columns: dict[str, Buffer] = {
            "delay_ns": array("q", [_or_no_time(row.read_delay_ns) for row in rows]),
            "unordered": _flags(row.order_uncertain for row in rows),
        }
        for name, code in FACTS.items():
            facts = [getattr(row, name) for row in rows]
            if any(fact is not None for fact in facts):
                columns[name] = array(code, [NO_FACT if one is None else one for one in facts])
        if not columns.keys().isdisjoint(FACTS):
            columns = {**no_facts(len(rows)), **columns}
        readings = {at: row.readings for at, row in enumerate(rows) if row.readings is not None}
        return found.with_columns(events=events, **columns).with_readings(readings)

    @classmethod
    def from_values(
        cls,
        codebook: Codebook,
        times: Sequence[int | None],
        ports: Iterable[str],
        offsets: Sequence[int],
        raws: Sequence[bytes],
        faults: Iterable[tuple[Fault, ...]],
        framed: Sequence[bool],
    ) -> Rows:
        """The columns of these values, without read delays."""
        columns = {
            "t_ns": array("q", map(_or_no_time, times)),
            "offset": array("q", offsets),
            "delay_ns": array("q", [NO_TIME]) * len(raws),
            "length": array("I", map(len, raws)),
            "port": array("H", map(codebook.port_code, ports)),
            "faults": array("H", map(codebook.fault_code, faults)),
            "framed": _flags(framed),
            "unordered": _flags([False] * len(raws)),
        }
        first = b"".join([raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0") for raw in raws])
        long = {at: raw for at, raw in enumerate(raws) if len(raw) > FRAME_LENGTH}
        return cls(codebook, columns, first, long)

    @classmethod
    def concat(cls, parts: Sequence[Rows]) -> Rows:
        """All rows and events, in order."""
        if len(parts) == 1:
            return parts[0]
        codebook = parts[0].codebook if parts else Codebook()
        starts = list(accumulate(map(len, parts), initial=0))
        long = {
            start + at: raw
            for start, part in zip(starts, parts, strict=False)
            for at, raw in part.long.items()
        }
        readings = {
            start + at: one
            for start, part in zip(starts, parts, strict=False)
            for at, one in part.readings.items()
        }
        events = tuple(event for part in parts for event in part.events)
        recoded = [part.recoded(codebook) for part in parts]
        columns = {
            name: _typed(b"".join([part.buffers[name] for part in recoded]), code)
            for name, code in COLUMNS.items()
        }
        if any(part.has_facts for part in parts):
            facts = [part.buffers if part.has_facts else no_facts(len(part)) for part in parts]
            for name, code in FACTS.items():
                columns[name] = _typed(b"".join([one[name] for one in facts]), code)
        raw = b"".join([part.raw_bytes for part in parts])
        return cls(codebook, columns, raw, long, events, readings)

    def with_columns(
        self,
        codebook: Codebook | None = None,
        events: Iterable[PortEvent] | None = None,
        **columns: Buffer,
    ) -> Rows:
        """These rows with other columns, another codebook or other events."""
        return Rows(
            codebook or self.codebook,
            {**self.buffers, **columns},
            self._raw,
            self.long,
            self.events if events is None else tuple(events),
            self.readings,
        )

    def with_facts(self, facts: Mapping[str, Buffer]) -> Rows:
        """These rows with the columns of `FACTS`."""
        return self.with_columns(**facts)

    def with_readings(self, readings: dict[int, tuple[Reading, ...]]) -> Rows:
        """These rows with the readings of some of them, by index."""
        if not readings:
            return self
        return Rows(self.codebook, self.buffers, self._raw, self.long, self.events, readings)

    def assign(self, start: int, rows: Rows) -> None:
        """Fill what `allocate` made, from index `start` on, with rows of its codebook."""
        own = slice(start, start + len(rows))
        for name in (*COLUMNS, "raw"):
            getattr(self, name)[own] = getattr(rows, name)
        self.long.update((start + at, raw) for at, raw in rows.long.items())
        self.readings.update((start + at, one) for at, one in rows.readings.items())

    @property
    def has_facts(self) -> bool:
        """Whether the columns of `FACTS` were computed."""
        return "unanswered" in self.buffers

    @property
    def column_names(self) -> tuple[str, ...]:
        """The columns that it has, but `raw`."""
        return (*COLUMNS, *(FACTS if self.has_facts else ()))

    def __len__(self) -> int:
        return len(self.buffers["t_ns"])

    def __repr__(self) -> str:
        return f"<{len(self)} rows>"

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> Rows: ...
    def __getitem__(self, at: int | slice) -> Row | Rows:
        if isinstance(at, int):
            index = range(len(self))[at]
            return next(self._rows(index, index + 1))
        start, stop, step = at.indices(len(self))
        if step != 1:
            return self.select(at)
        stop = max(start, stop)
        return Rows(
            self.codebook,
            {name: column[start:stop] for name, column in self.buffers.items()},
            self.raw_bytes[FRAME_LENGTH * start : FRAME_LENGTH * stop],
            {row - start: raw for row, raw in self.long.items() if start <= row < stop},
            readings={
                row - start: one for row, one in self.readings.items() if start <= row < stop
            },
        )

    def __iter__(self) -> Iterator[Row]:
        for start in range(0, len(self), _ROWS_AT_ONCE):
            yield from self._rows(start, min(start + _ROWS_AT_ONCE, len(self)))

    def _rows(self, start: int, end: int) -> Iterator[Row]:
        ports, faults = self.codebook.ports, self.codebook.faults
        raws = bytes(self.raw_bytes[FRAME_LENGTH * start : FRAME_LENGTH * end])
        scalars = [self.buffers[name][start:end].tolist() for name in COLUMNS]
        facts: Iterable[tuple[int | None, ...]] = repeat((None,) * len(FACTS), end - start)
        if self.has_facts:
            facts = zip(*(_optional(self.buffers[name][start:end]) for name in FACTS), strict=True)
        columns = zip(zip(*scalars, strict=True), facts, strict=True)
        for at, (scalar, (answer_ns, unanswered, motor_hint, previous)) in enumerate(columns):
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
                answer_ns,
                None if unanswered is None else bool(unanswered),
                motor_hint,
                previous,
                self.readings.get(start + at),
            )

    def __reduce__(self) -> tuple[Any, tuple[object, ...]]:
        """Pickle for another process: the columns, and the ports and fault sets in them."""
        return _received, (
            tuple(self.codebook.ports),
            tuple(self.codebook.faults),
            tuple(bytes(self.buffers[name]) for name in self.column_names),
            bytes(self.raw_bytes),
            self.long,
            self.events,
            self.readings,
        )

    @cached_property
    def raw(self) -> Codes:
        """The first ten bytes, padded with zeros; uint8, shape (rows, 10)."""
        import numpy as np

        return np.asarray(self._raw).reshape(-1, FRAME_LENGTH)

    @cached_property
    def raw_bytes(self) -> memoryview:
        """The bytes of `raw`, one row after the other, for code that does not load numpy."""
        raw = self._raw
        return raw if isinstance(raw, memoryview) else raw.reshape(-1).data

    def prefers_numpy(self) -> bool:
        """Whether arrays are the faster way: rows are many, or numpy is loaded."""
        return len(self) > FEW or (len(self) > _FEWEST and "numpy" in sys.modules)

    @property
    def timed(self) -> Bools:
        """Whether each row has a time."""
        found: Bools = self.t_ns != NO_TIME
        return found

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first row and the latest time; None if a row has none, or without rows."""
        known = self.extent
        first = int(self.buffers["t_ns"][0]) if known else NO_TIME
        return (first, known[1]) if known and known[2] == len(self) else None

    @property
    def extent(self) -> tuple[int, int, int] | None:
        """The earliest and the latest time, and the number of rows with one; None without any."""
        if self.prefers_numpy():
            t_ns = self.t_ns
            if int(t_ns.min()) == NO_TIME:
                t_ns = t_ns[self.timed]
            return (int(t_ns.min()), int(t_ns.max()), len(t_ns)) if len(t_ns) else None
        times = [t_ns for t_ns in self.buffers["t_ns"].tolist() if t_ns != NO_TIME]
        return (min(times), max(times), len(times)) if times else None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The earliest and the latest time of its rows and events; None if none of them has one."""
        times = [event.t_ns for event in self.events]
        if (extent := self.extent) is not None:
            times += extent[:2]
        return (min(times), max(times)) if times else None

    @property
    def first_ns(self) -> int | None:
        """The time of its first row or event, whichever is earlier; None without both."""
        times = [event.t_ns for event in self.events[:1]]
        if len(self):
            times.append(int(self.buffers["t_ns"][0]))
        return min(times, default=None)

    def split_at(self, t_ns: int) -> tuple[Rows, Rows]:
        """The rows before the first one that has this time or a later one, and the others.

        Events go to the part with the rows of their time.
        """
        late = (at for at, own in enumerate(self.buffers["t_ns"].tolist()) if own >= t_ns)
        at = next(late, len(self))
        early = tuple(event for event in self.events if event.t_ns < t_ns)
        later = tuple(event for event in self.events if event.t_ns >= t_ns)
        return self[:at].with_columns(events=early), self[at:].with_columns(events=later)

    @property
    def size(self) -> int:
        """The number of bytes of all rows."""
        if self.prefers_numpy():
            return int(self.length.sum())
        return sum(self.buffers["length"].tolist())

    def counts(self, name: str) -> dict[int, int]:
        """By value, the number of rows that have it in a column of codes or flags."""
        if not self.prefers_numpy():
            return Counter(self.buffers[name].tolist())
        import numpy as np

        counts = np.bincount(getattr(self, name))
        return {code: int(counts[code]) for code in counts.nonzero()[0].tolist()}

    def head_counts(self) -> dict[tuple[int, int], int]:
        """By header and CMD, the number of frames that have them."""
        if not self.prefers_numpy():
            raw = bytes(self.raw_bytes)
            heads = zip(raw[::FRAME_LENGTH], raw[CMD_OFFSET::FRAME_LENGTH], strict=True)
            return Counter(compress(heads, self.buffers["framed"].tolist()))
        import numpy as np

        counts = np.bincount(_heads(self.raw)[self.framed])
        return {divmod(head, 256): int(counts[head]) for head in counts.nonzero()[0].tolist()}

    def ports(self) -> list[str]:
        """The ports of the rows."""
        return [self.codebook.ports[code] for code in self.counts("port")]

    # The fields of frames; rows that are still filled in must not use these

    @cached_property
    def kinds(self) -> Codes:
        """The index in `KINDS` of each row's kind, `NO_KIND` without one."""
        kinds: Codes = _field_tables().kinds.take(_heads(self.raw))
        kinds[~self.framed] = NO_KIND
        return kinds

    @property
    def directions(self) -> Codes:
        """The index in `Direction` of each row's direction, `NO_DIRECTION` without one."""
        codes: Codes = _field_tables().directions[self.raw[:, 0]]
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

    @property
    def payloads(self) -> Ints:
        """The bytes between NUM and tail of each row as a number, most significant first."""
        import numpy as np

        wide = np.zeros((len(self), 8), np.uint8)
        wide[:, -_PAYLOAD.stop + _PAYLOAD.start :] = self.raw[:, _PAYLOAD]
        return wide.view(">i8").reshape(-1).astype(np.int64)

    def previous_field(self, name: str) -> tuple[Array, Bools]:
        """A field of the frame before of the same port, motor and kind, as `field`."""
        import numpy as np

        known = self.previous != NO_FACT
        raw = self.raw.copy()
        wide = np.ascontiguousarray(self.previous, ">i8").view(np.uint8).reshape(-1, 8)
        raw[:, _PAYLOAD] = wide[:, -_PAYLOAD.stop + _PAYLOAD.start :]
        values, has = _field_values(raw, self.kinds, name)
        return values, has & known

    def values(self, field: str | Role, rows: Ints) -> Ints:
        """One field, by name or role, of the rows at these indices, which all must have it."""
        import numpy as np

        name = NAME_OF_ROLE[field] if isinstance(field, Role) else field
        values, _ = _field_values(self.raw[rows], self.kinds[rows], name)
        return values.astype(np.int64)

    def value(self, name: str, row: int) -> int:
        """One field of the row at an index, which must have it."""
        import numpy as np

        return int(self.values(name, np.array([row]))[0])

    def raised(self) -> Bools:
        """Which rows are frames with a flag byte that is not in order, as `Field.raised`."""
        import numpy as np

        found: Bools = np.zeros(len(self), np.bool_)
        for flags in VALUE_FIELDS:
            if flags.legal_bits is not None:
                values, known = self.field(flags.name)
                found |= known & (values != flags.default)
        return found

    def select(self, rows: slice | Array, events: tuple[PortEvent, ...] = ()) -> Rows:
        """The rows of a slice, a mask or an array of indices, with these events."""
        import numpy as np

        columns = {
            name: np.ascontiguousarray(getattr(self, name)[rows]) for name in self.column_names
        }
        long: dict[int, bytes] = {}
        if self.long:
            at = np.flatnonzero(columns["length"] > FRAME_LENGTH)
            old = np.arange(len(self))[rows][at]
            long = {new: self.long[of] for new, of in zip(at.tolist(), old.tolist(), strict=True)}
        readings: dict[int, tuple[Reading, ...]] = {}
        if self.readings:
            chosen = enumerate(np.arange(len(self))[rows].tolist())
            readings = {new: self.readings[of] for new, of in chosen if of in self.readings}
        return Rows(self.codebook, columns, self.raw[rows], long, events, readings)

    def recoded(self, codebook: Codebook) -> Rows:
        """These rows with the codes of another codebook."""
        if codebook is self.codebook:
            return self
        ports = [codebook.port_code(port) for port in self.codebook.ports]
        faults = [codebook.fault_code(one) for one in self.codebook.faults]
        found = self.with_columns(codebook)
        for name, codes in (("port", ports), ("faults", faults)):
            if codes != [*range(len(codes))]:
                found = found.with_columns(**{name: _looked_up(codes, self, name)})
        return found

    def tobytes(self) -> bytes:
        """The bytes of all rows, concatenated."""
        if self.counts("length") == {FRAME_LENGTH: len(self)}:
            return bytes(self.raw_bytes)
        if not self.prefers_numpy():
            return b"".join([row.raw for row in self])
        import numpy as np

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
        for code in self.counts("port"):
            last = (self.port == code).nonzero()[0][-1]
            found[self.codebook.ports[code]] = int(self.offset[last]) + int(self.length[last])
        return found


def _looked_up(codes: list[int], rows: Rows, name: str) -> Buffer:
    if not rows.prefers_numpy():
        return array("H", [codes[code] for code in rows.buffers[name].tolist()])
    import numpy as np

    found: Array = np.array(codes, np.uint16).take(getattr(rows, name))
    return found


def _received(
    ports: Iterable[str],
    faults: Iterable[tuple[Fault, ...]],
    columns: Iterable[bytes],
    raw: bytes,
    long: dict[int, bytes],
    events: tuple[PortEvent, ...],
    readings: dict[int, tuple[Reading, ...]],
) -> Rows:
    """The rows that another process pickled."""
    codebook = Codebook()
    for port in ports:
        codebook.port_code(port)
    for one in faults:
        codebook.fault_code(one)
    typed = zip({**COLUMNS, **FACTS}.items(), columns, strict=False)
    buffers = {name: _typed(column, code) for (name, code), column in typed}
    return Rows(codebook, buffers, raw, long, events, readings)


def no_facts(rows: int) -> dict[str, Buffer]:
    """The columns of `FACTS` for rows whose facts are not known."""
    return {name: array(code, [NO_FACT]) * rows for name, code in FACTS.items()}


def _optional(facts: Buffer) -> list[int | None]:
    return [None if fact == NO_FACT else fact for fact in facts.tolist()]


def _or_no_time(value: int | None) -> int:
    return NO_TIME if value is None else value


def _flags(values: Iterable[bool]) -> Buffer:
    return _typed(bytes(values), "?")


def _typed(data: bytes, code: str) -> Buffer:
    """The numbers in the data as a buffer of a type that `COLUMNS` names."""
    return memoryview(data).cast(code)  # type: ignore[call-overload]


NO_ROWS: Final = Rows.concat([])


# The fields of frames, as numpy columns

FieldLayout: TypeAlias = tuple[int, int, bool]
"""Start and size of a field, and whether it is signed."""


@dataclass(frozen=True)
class _FieldTables:
    kinds: Codes
    """By header * 256 + CMD: the index in `KINDS`, or `NO_KIND`."""
    directions: Codes
    """By header: the index in `Direction`, or `NO_DIRECTION`."""
    layouts: Mapping[str, Mapping[FieldLayout, Bools]]
    """By field name: its layouts, each with a mask of the kinds."""


@cache
def _field_tables() -> _FieldTables:
    import numpy as np

    directions = np.full(256, NO_DIRECTION, np.uint8)
    for code, direction in enumerate(Direction):
        directions[HEADERS[direction]] = code
    layouts: dict[str, dict[FieldLayout, Bools]] = {}
    for code, kind in enumerate(KINDS):
        for one in kind.fields:
            kinds = layouts.setdefault(one.name, {}).setdefault(
                (one.start, one.size, one.signed), np.zeros(len(KINDS) + 1, np.bool_)
            )
            kinds[code] = True
    kind_codes = np.frombuffer(FTE_FORMAT.kind_codes(NO_KIND), np.uint8)
    return _FieldTables(kind_codes, directions, layouts)


def _heads(raw: Codes) -> npt.NDArray[np.uint16]:
    import numpy as np

    heads: npt.NDArray[np.uint16] = raw[:, 0].astype(np.uint16) << np.uint16(8)
    return heads | raw[:, CMD_OFFSET]


def _field_values(raw: Array, kinds: Codes, name: str) -> tuple[Array, Bools]:
    import numpy as np

    (layout, having), *others = _field_tables().layouts[name].items()
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
    import numpy as np

    wire = np.dtype(f">{'i' if signed else 'u'}{size}")
    if not len(raw):
        return np.empty(0, wire.newbyteorder("="))
    found: Array = np.ndarray((len(raw),), wire, np.ascontiguousarray(raw), start, (FRAME_LENGTH,))
    return found.astype(wire.newbyteorder("="))


class LineErrorMarker:
    """Adds `line_error` to the rows of one port for which the UART reported errors."""

    def __init__(self) -> None:
        self._next_offset = 0
        self._errors: deque[tuple[int, int]] = deque()
        """Half-open ranges of stream offsets with errors, rising; those of future rows."""

    def observe(self, chunk: Chunk) -> None:
        """Note the errors of a chunk; call before `mark` for the rows that the chunk completes."""
        self._errors.extend(
            (self._next_offset + start, self._next_offset + stop)
            for start, stop in chunk.line_errors
        )
        self._next_offset += len(chunk.data)

    def mark(self, rows: Rows) -> Rows:
        """The rows, with `line_error` where errors were; call in stream order."""
        if not self._errors or not len(rows):
            return rows
        codes = rows.buffers["faults"].tolist()
        starts, lengths = rows.buffers["offset"].tolist(), rows.buffers["length"].tolist()
        for at, (start, length) in enumerate(zip(starts, lengths, strict=True)):
            while self._errors and self._errors[0][1] <= start:
                self._errors.popleft()
            if self._errors and self._errors[0][0] < start + length:
                faults = rows.codebook.faults[codes[at]]
                codes[at] = rows.codebook.fault_code((*faults, Fault.LINE_ERROR))
        return rows.with_columns(faults=array("H", codes))
