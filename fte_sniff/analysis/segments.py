"""Tables of a stream, one after the other, and the sum of what is counted in each.

A table has the rows around its own that their relations may depend on: before them the last second
and the last frames of every stream, after them a second. So its numbers are those of a single table
of all rows, and counts add up, over the segments of a file, files, processes and machines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
import polars as pl

from fte_sniff.analysis.relations import (
    DEADLINE_NS,
    NONE,
    last_of,
    port_keys,
    runs_of,
    stream_keys,
)
from fte_sniff.analysis.table import EMPTY, RowTest, Table
from fte_sniff.errors import printable
from fte_sniff.protocol.items import BaudChange, Change, Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import NO_TIME, Ints, Item, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns

SEGMENT_ROWS: Final = 1 << 16
"""Rows of a table, unless a test or the screen needs fewer."""

FRAMES_BEFORE: Final = 3
"""The last frames of a stream that events of later ones may depend on."""

MOST_ROWS: Final = 1 << 17
"""Rows of counts by window of time."""

UNTIMED_ROWS: Final = 1200
"""Rows without a time that count as a second: those of a full line."""


class Segments:
    """Cuts a stream into tables."""

    def __init__(
        self,
        most: int = SEGMENT_ROWS,
        *,
        baud: int | None = None,
        test: RowTest | None = None,
        keep: Callable[[Table], Ints] | None = None,
        every_ns: int = 0,
    ) -> None:
        """Begin a stream without rows.

        Args:
            most: rows from which on a table is complete.
            baud: of every port; None for that of the stream's `BaudChange`s.
            test: selects the rows, with their facts, that are counted; None for all.
            keep: the indices of further rows of a table that the next ones need.
            every_ns: time between the newest rows of two tables, at least; each costs a second.
        """
        self._most, self._baud, self._test, self._keep = most, baud, test, keep
        self._every_ns, self._latest_ns = every_ns, NO_TIME
        self._before = EMPTY
        """The last table, with only the rows that the next one needs."""
        self._items, self._count = list[Item | str](), 0
        """What came since, with the names of inputs; and its number of rows."""

    def begin(self, name: str) -> None:
        """Begin the next input of the stream."""
        self._items.append(name)

    def push(self, item: Item) -> Iterator[Table]:
        """Add the next item; yields the table that it completes."""
        self._items.append(item)
        self._count += len(item) if isinstance(item, Rows) else 0
        if not isinstance(item, Rows) or self._count < self._most:
            return
        latest_ns = int(item.t_ns.max(initial=NO_TIME))
        if 0 < latest_ns - self._latest_ns < self._every_ns:
            return
        self._latest_ns = latest_ns
        table = self.rest()
        stop = second_before(table.rows, len(table.rows))
        if stop > table.start:
            table = replace(table, stop=stop)
            yield table
            self._before = self._needed(table)
            self._items, self._count = [], 0

    def rest(self) -> Table:
        """The rows that wait, after those that were kept, as if the stream ended; it may go on."""
        before = self._before
        rows = Rows.concat([one for one in self._items if isinstance(one, Rows)])
        bauds, default = dict(before.bauds), self._baud or DEFAULT_BAUD
        byte_ns = np.array(
            [byte_time_ns(bauds.get(port, default)) for port in rows.ports] or [0], np.int64
        )[rows.port]
        source = np.full(len(rows), len(before.sources) - 1)
        sources, hidden_by = [*before.sources], [*before.hidden_by]
        changes, events, index = list[Change](), list[PortEvent](), 0
        for item in self._items:
            match item:
                case Rows():
                    index += len(item)
                case str():
                    sources.append(printable(item))
                    source[index:] += 1
                case PortEvent():
                    events.append(item)
                case Gap():
                    changes.append(Change(index, item))
                    hidden_by += [item.reason] if item.kind is GapKind.SELECTED else []
                case BaudChange() if self._baud is None:
                    bauds[item.port] = item.baud
                    own = rows.port[index:] == [*rows.ports, item.port].index(item.port)
                    byte_ns[index:][own] = byte_time_ns(item.baud)
        return replace(
            before,
            rows=Rows.concat([one for one in (before.rows, rows) if len(one)]),
            stop=len(before.rows) + len(rows),
            test=self._test,
            runs=np.append(before.runs, runs_of(rows, changes, before.runs)),
            byte_ns=np.append(before.byte_ns, byte_ns),
            source=np.append(before.source, source),
            sources=sources,
            events=events,
            bauds=bauds,
            hidden_by=hidden_by,
        )

    def _needed(self, table: Table) -> Table:
        """The rows of a table that the relations of later ones depend on."""
        kept = context_of(table)
        if self._keep is not None:
            kept = np.union1d(kept, self._keep(table))
        return replace(
            table,
            rows=table.rows.select(kept),
            runs=table.runs[kept],
            start=int(np.searchsorted(kept, table.stop)),
            stop=0,
            byte_ns=table.byte_ns[kept],
            source=table.source[kept],
            test=None,
        )


def second_before(rows: Rows, end: int) -> int:
    """The index from which on rows are less than a second before another one."""
    t_ns = rows.t_ns[:end]
    latest = int(t_ns.max(initial=NO_TIME))
    if latest == NO_TIME:
        return max(0, end - UNTIMED_ROWS)
    return int(np.argmax(t_ns >= latest - DEADLINE_NS))


def context_of(table: Table) -> Ints:
    """The indices of the rows that the relations of rows from `stop` on depend on, and of these.

    The last second before it; the last frames of every stream and rows with a time of every port,
    of all rows and of those that are selected; and the first row of the run.
    """
    stop = table.stop
    rows, recent = table.rows.select(slice(0, stop)), second_before(table.rows, stop)
    number = table.runs["number"][:stop]
    needed = np.arange(len(table.rows)) >= recent
    needed[np.searchsorted(number, number[-1:])] = True
    for keys in (stream_keys(rows), port_keys(rows)):
        needed[last_of(keys, FRAMES_BEFORE)] = True
        if table.selected is not None:
            needed[last_of(np.where(table.selected[:stop], keys, NONE), FRAMES_BEFORE)] = True
    return np.flatnonzero(needed)


# Sums

_ADDED: Final[Mapping[str, Callable[[pl.Expr], pl.Expr]]] = {
    "sum": pl.Expr.sum,
    "least": pl.Expr.min,
    "greatest": pl.Expr.max,
    "first": lambda one: one.drop_nulls().first(),
    "last": lambda one: one.drop_nulls().last(),
}
"""By the first word of a column's name, how its parts add up."""


def added(parts: Iterable[pl.DataFrame]) -> pl.DataFrame:
    """Counts of several parts, in the order of time, as those of one.

    A column with a name such as `sum rows` is added as its first word says; `until x` is the value
    that belongs to `greatest x`; the others are keys. Windows of time, a key `window`, become
    twice as long until there are at most `MOST_ROWS` rows.
    """
    frame = pl.concat(parts)
    names = [name for name in frame.columns if " " in name]
    keys = [name for name in frame.columns if name not in names]
    sums = [_sum_of(name) for name in names]
    if not keys:
        return frame.select(sums)
    found = frame.group_by(keys, maintain_order=True).agg(sums)
    while "window" in keys and len(found) > MOST_ROWS:
        bits = 1 + width_of(found["window"].to_numpy())
        longer = found.with_columns(pl.col("window") // (1 << bits) * (1 << bits))
        found = longer.group_by(keys, maintain_order=True).agg(sums)
    return found


def width_of(windows: Ints) -> int:
    """How often windows were made twice as long: their low bits that are all 0."""
    common = int(np.bitwise_or.reduce(windows, initial=0)) if len(windows) > 1 else 1
    return (common & -common).bit_length() - 1


def _sum_of(name: str) -> pl.Expr:
    word, _, of = name.partition(" ")
    if word == "until":
        return pl.col(name).get(pl.col(f"greatest {of}").arg_max())
    return _ADDED[word](pl.col(name))


Counts: TypeAlias = Mapping[str, pl.DataFrame]
"""What is counted in a part of a stream, by name; each is added by `added`."""


def extent_of(table: Table) -> Counts:
    """The number and the times of the counted rows, and the filters that hid others."""
    rows, at = table.rows, table.counted
    t_ns = rows.t_ns[at[rows.timed[at]]]
    ends = (int(t_ns.min()), int(t_ns.max())) if len(t_ns) else (None, None)
    numbers = (len(at), int(rows.framed[at].sum()), len(t_ns), *ends)
    names = ("sum rows", "sum frames", "sum timed", "least t", "greatest t")
    return {
        "extent": pl.DataFrame([numbers], dict.fromkeys(names, pl.Int64), orient="row"),
        "hidden": pl.DataFrame({"hidden_by": table.hidden_by}, {"hidden_by": pl.String}),
    }


def summed(parts: Iterable[Counts]) -> dict[str, pl.DataFrame]:
    """The counts of several parts, in the order of time, as those of one; empty without parts."""
    found = list(parts)
    return {name: added([part[name] for part in found]) for name in found[0]} if found else {}


@dataclass(frozen=True, slots=True)
class Analysis:
    """What is counted in each table of a stream.

    Made of functions with names, so that other processes and machines can count.
    """

    count: Callable[[Table], Counts]
    keep: Callable[[Table], Ints] | None = None
    """The indices of further rows of a table that the next ones need."""
