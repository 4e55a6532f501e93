"""Rows with what the rows beside them decide, and the numbers that the analyses group and add up.

A table has its own rows, and around them the rows that their relations depend on:

    context                      own rows                       the second after them
    [last frames | last second)  [start ....................... stop)  [stop ......... ]

A column is computed when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from fte_sniff.analysis.dataframe import known_only
from fte_sniff.analysis.relations import (
    NAMES_MOTOR,
    NO_RUNS,
    NONE,
    Runs,
    answers,
    port_keys,
    row_before,
    stream_keys,
    with_facts,
)
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import NO_KIND, NO_ROWS, NO_TIME, Array, Bools, Ints, Rows
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    MOTORS,
    NAME_OF_ROLE,
    VALUE_FIELDS,
    Role,
    byte_time_ns,
)

RowTest: TypeAlias = Callable[[Rows], Bools]
"""Whether each row passes, such as `RowFilter.matches`."""

MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]
QUANTITIES: Final = tuple(field.name for field in VALUE_FIELDS if field.unit)
"""The fields that have a unit."""


@dataclass(frozen=True)
class Table:
    """Rows that are analysed together."""

    rows: Rows
    """With the rows before and after its own."""
    runs: Runs
    start: int
    stop: int
    """Half-open range of its own rows."""
    byte_ns: Ints
    """By row, nanoseconds of a byte."""
    source: Ints
    """By row, the index of its input in `sources`."""
    sources: Sequence[str] = ("",)
    """The names of the inputs so far; may be text from outside."""
    events: Sequence[PortEvent] = ()
    """The port events among its own rows."""
    bauds: Mapping[str, int] = field(default_factory=dict)
    """The present baud by port, where it is not the default."""
    test: RowTest | None = None
    """Selects the rows, with their facts, that are counted; None for all."""
    hidden_by: Sequence[str] = ()
    """The filters that selected the rows of recordings so far."""

    @classmethod
    def of(cls, rows: Rows, runs: Runs, baud: int = DEFAULT_BAUD) -> Table:
        """A table of rows of one input, all its own."""
        byte_ns, source = np.full(len(rows), byte_time_ns(baud)), np.zeros(len(rows), np.int64)
        return cls(rows, runs, 0, len(rows), byte_ns, source)

    @cached_property
    def selected(self) -> Bools | None:
        """Which of the rows are counted; None for all. All rows decide what is answered."""
        return None if self.test is None else self.test(self.with_facts)

    @cached_property
    def counted(self) -> Ints:
        """The indices of its own rows that are selected."""
        own = np.arange(self.start, self.stop)
        return own if self.selected is None else own[self.selected[self.start : self.stop]]

    @cached_property
    def all_answers(self) -> pl.DataFrame:
        """The answers of the commands in all rows."""
        return answers(self.rows, self.runs)

    @cached_property
    def answers(self) -> pl.DataFrame:
        """The answers of its own commands that are selected, with the times `t_ns`, `end_ns`."""
        found, counts = self.all_answers, np.zeros(len(self.rows), np.bool_)
        counts[self.counted] = True
        found = found.filter(pl.Series(counts[found["command"].to_numpy()], dtype=pl.Boolean))
        t_ns = np.append(self.rows.t_ns, NO_TIME)
        return found.with_columns(
            t_ns=times(t_ns[found["command"].to_numpy()]),
            end_ns=times(t_ns[found["answer"].to_numpy()]),
        )

    @cached_property
    def with_facts(self) -> Rows:
        """All rows with their facts."""
        return with_facts(self.rows, self.runs, self.all_answers)

    @cached_property
    def frame(self) -> pl.DataFrame:
        """Its counted rows, with names of ports and inputs, and other codes as in `Rows`.

        Columns: `t_ns`, `port`, `kind` (null if it names a motor that there is not), `motor`,
        `direction`, `faults`, `length`, `source`, the quantities, and what the row before decides,
        among those that are selected:

            end_ns      when the last byte ended
            period_ns   from the frame before of the same port, kind and motor
            step_ns     from the row before on the same port
            idle_ns     from the end of that row; silence, where it is more than 0
            used_ns     from that end to its own; from its start without a row before it
        """
        at = np.arange(self.stop)
        if self.selected is not None:
            at = at[self.selected[: self.stop]]
        own = np.searchsorted(at, self.start)
        rows, runs = self.rows.select(at), self.runs[at]
        t_ns, kinds = rows.t_ns, rows.kinds
        is_kind = (kinds != NO_KIND) & (~NAMES_MOTOR[kinds] | np.isin(rows.nums, MOTORS))
        ends_ns = np.where(rows.timed, t_ns + rows.length * self.byte_ns[at], NO_TIME)
        before = row_before(stream_keys(rows), runs)
        on_port = row_before(port_keys(rows), runs)
        begins_ns = np.where(on_port == NONE, t_ns, ends_ns[on_port] if len(at) else t_ns)
        columns = {
            "t_ns": times(t_ns),
            "port": _names(self.rows.ports, rows.port),
            "kind": known_only(kinds, is_kind),
            MOTOR: known_only(rows.nums, NAMES_MOTOR[kinds] & is_kind),
            "direction": pl.Series(rows.directions),
            "faults": pl.Series(rows.faults),
            "length": pl.Series(rows.length.astype(np.int64)),
            "source": _names(self.sources, self.source[at]),
            "end_ns": times(ends_ns),
            "period_ns": _since(t_ns, t_ns, before),
            "step_ns": _since(t_ns, t_ns, on_port),
            "idle_ns": _since(t_ns, ends_ns, on_port),
            "used_ns": _since(ends_ns, begins_ns, np.arange(len(at))),
            **{name: known_only(*rows.field(name)) for name in QUANTITIES},
        }
        return pl.DataFrame({name: one[own:] for name, one in columns.items()})


def _names(names: Sequence[str], codes: Array) -> pl.Series:
    return pl.Series(names, dtype=pl.String).gather(codes.astype(np.uint32))


def times(t_ns: Ints) -> pl.Series:
    """Times, null where they are `NO_TIME`."""
    return known_only(t_ns, t_ns != NO_TIME)


def _since(t_ns: Ints, earlier_ns: Ints, at: Ints) -> pl.Series:
    """The time from that of another row; null without one, or without times."""
    if not len(t_ns):
        return pl.Series([], dtype=pl.Int64)
    known = (at != NONE) & (t_ns != NO_TIME) & (earlier_ns[at] != NO_TIME)
    return known_only(np.where(known, t_ns - earlier_ns[at], 0), known)


EMPTY: Final = Table.of(NO_ROWS, NO_RUNS)
"""A table without rows."""
