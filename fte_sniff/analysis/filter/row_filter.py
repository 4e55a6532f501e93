"""RowFilter: a compiled filter, applied to rows.

    motor = 1 AND rpm > 500             AND OR NOT, also && || !; == is =, <> is !=
    kind IN ('speed', 'position')       words are checked; also "speed", and speed without quotes
    malformed OR noise                  a word alone: the row's kind, direction, status or a fault
    faults = 'noise'                    among its faults; != is not among them; IN is any of them
    faults IS NULL                      no fault at all; also faults = ''
    faults LIKE '%trunc%'               in the faults joined by commas
    error = 0x0F, online & 0x01 = 0     hex and bits
    raw LIKE '%aa 0_%'                  whole bytes: % is any of them, _ any one hex digit; spaces
                                        and case of the hex do not matter
    time >= '2026-01-31 12:00'          in the zone of `--zone` (UTC), or with one; numbers are
                                        nanoseconds since 1970
    time > '12:00:05'                   that time of any day: rows later on their own day

As in SQL, a comparison with a null is null, and the filter drops the row: `kind != 'speed'` drops
damage. `kind IS DISTINCT FROM 'speed'` and `NOT speed` keep it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import tzinfo
from math import inf
from typing import Final

import polars as pl

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.facts import PreviousFrames
from fte_sniff.analysis.filter.parser import in_zone, parse
from fte_sniff.analysis.model import StreamChange
from fte_sniff.errors import FilterError, TranslatableText, printable
from fte_sniff.protocol import (
    COLUMNS,
    KINDS,
    ColumnType,
    Fault,
    PortEvent,
    PortEventKind,
    Row,
    Status,
    encode,
    status_of,
)
from fte_sniff.protocol.columns import DERIVED
from fte_sniff.protocol.rows import NO_FACT, Bools, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role

_TIMES: Final = frozenset(one.name for one in COLUMNS if one.type is ColumnType.TIME)


@dataclass(frozen=True, slots=True)
class RowFilter:
    """A compiled filter; made by `parse`."""

    text: str
    names: frozenset[str]
    """Columns that it reads; `mask` needs no others."""
    expression: pl.Expr = field(compare=False, repr=False)
    """True, false or null for every row of a `row_frame`."""

    @classmethod
    def parse(cls, text: str, zone: tzinfo | None = None) -> RowFilter:
        """Compile a filter; raises FilterError with the mistake, its position, and the fix.

        With a `zone`, the times in its `text` have the offset of it where they had none.
        """
        found = parse(text)
        if zone is not None and not _TIMES.isdisjoint(found.names):
            return cls.parse(in_zone(text, zone))
        try:
            made = cls(text, found.names, found.expr)
            made.matches(_TEST_ROWS)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            raise _refused(error) from None
        return made

    @property
    def needs_facts(self) -> bool:
        """Whether it reads a column that depends on other rows; see `analysis.facts`."""
        return not DERIVED.isdisjoint(self.names)

    @property
    def advice(self) -> str:
        """What the user probably wants instead, one line; empty if nothing."""
        motor = NAME_OF_ROLE[Role.MOTOR]
        words = set(re.findall(r"[a-z_]+", self.text.lower()))
        if motor not in words or words & DERIVED or words.isdisjoint(_DAMAGED):
            return ""
        return TranslatableText(
            "{motor} is empty in most damaged rows; {hint} is the motor that they probably"
            " belonged to",
            motor=motor,
            hint="motor_hint",
        )

    def mask(self, frame: pl.DataFrame) -> pl.Series:
        """Whether each row of a frame with `row_frame`'s columns passes; never null.

        Raises FilterError if the filter cannot be computed for these rows.
        """
        try:
            found = frame.select(passes=self.expression).to_series()
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            raise _refused(error) from None
        if len(found) != frame.height:  # polars evaluates a constant to one row
            found = found.new_from_index(0, frame.height)
        return found.fill_null(False)

    def matches(self, rows: Rows) -> Bools:
        """Whether each row passes; raises FilterError as `mask`."""
        return self.mask(row_frame(rows, self.names or ("offset",))).to_numpy()

    def select(self, rows: Rows) -> Rows:
        """The rows that pass, in order, and the port events between them."""
        return rows.select(self.matches(rows), rows.events)

    def stream(self) -> StreamFilter:
        """This filter, for rows that come one after the other."""
        return StreamFilter(self)


class StreamFilter:
    """A filter of rows that come one after the other, and do not wait for later ones.

    What depends on later rows is null; `previous` is known.
    """

    def __init__(self, row_filter: RowFilter) -> None:
        self._filter = row_filter
        self._previous = PreviousFrames() if row_filter.needs_facts else None

    def matches(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> Bools:
        """Whether each of the next rows passes; the changes are between them."""
        if self._previous is not None and not (rows.previous != NO_FACT).any():
            rows = self._previous.add(rows, changes)
        return self._filter.matches(rows)

    def select(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> Rows:
        """The rows that pass, in order, and the port events between them."""
        return rows.select(self.matches(rows, changes), rows.events)


_DAMAGED: Final = frozenset(
    {str(Status.MALFORMED), *(str(one) for one in Fault if status_of((one,)) is Status.MALFORMED)}
)
"""Words of filters for damaged rows."""


ALERT_INTERVAL_S: Final = 1.0
"""Shortest time between two signals of an alert, seconds."""


class Alert:
    """Counts the rows that match a filter, and decides when to signal them."""

    def __init__(self, row_filter: RowFilter) -> None:
        self._filter = row_filter.stream()
        self._due_s = -inf
        self.count = 0
        self.last: Row | None = None

    def observe(self, rows: Rows, now_s: float, _events: Sequence[PortEvent] = ()) -> bool:
        """Count the next rows; returns whether to signal now, by any monotonic clock, seconds."""
        if not len(rows):  # most polls of a quiet line
            return False
        (matching,) = self._filter.matches(rows).nonzero()
        if not len(matching):
            return False
        self.count += len(matching)
        self.last = rows[int(matching[-1])]
        is_due = now_s >= self._due_s
        if is_due:
            self._due_s = now_s + ALERT_INTERVAL_S
        return is_due


class SilenceAlert:
    """Counts the silences of wires that last some seconds, and signals each."""

    last: Row | None = None

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._due_s: dict[str, float] = {}
        """By wire that is silent: when its silence has lasted so long."""
        self.count = 0

    def observe(self, _rows: Rows, now_s: float, events: Sequence[PortEvent] = ()) -> bool:
        """Follow the next events; returns whether to signal now, by any monotonic clock."""
        for event in events:
            self._due_s.pop(event.port, None)
            if event.kind is PortEventKind.SILENT:
                self._due_s[event.port] = now_s + self._seconds - event.count / 1000
        due = [port for port, due_s in self._due_s.items() if due_s <= now_s]
        for port in due:
            del self._due_s[port]
        self.count += len(due)
        return bool(due)


def _refused(error: BaseException) -> FilterError:
    why = printable(str(error).split("\n", 1)[0][:120])
    return FilterError(
        "filter: it cannot be computed ({why}); compare fields with plain values", why=why
    )


def _test_rows() -> Iterator[Row]:
    """Rows of every kind with the lowest and highest values, and a row without values."""
    for kind in KINDS:
        for end in ("low", "high"):
            values = {field.name: getattr(field, end) for field in kind.fields}
            yield Row("port", 0, encode(kind, values), 0)
    yield Row("port", 0, b"", None, (Fault.NOISE, Fault.LINE_ERROR), framed=False)


_TEST_ROWS: Final = Rows.of(_test_rows())
