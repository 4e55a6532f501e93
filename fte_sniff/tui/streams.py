"""The page of streams: a line for each kind and motor on each port, then a few for each port.

kind            motor  port   frames   rate     Δt 50 %  Δt 99 %  answer   unanswered  values
speed               1            500   50.0/s   20 ms    21 ms    3 ms              0  rpm=1000
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import polars as pl
from rich.text import Text

from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.relations import NAMES_MOTOR, AnswerState
from fte_sniff.analysis.table import EMPTY, Table
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import UNKNOWN, fit, fit_right, rate_text
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _, later
from fte_sniff.protocol.rows import fault_bits
from fte_sniff.protocol.spec import KINDS, Fault, FrameKind, Status, status_of
from fte_sniff.tui.cells import short_kind, span_text, value_parts
from fte_sniff.tui.pages import Context, ListPage
from fte_sniff.tui.painter import PLAIN, REVERSED

MOST_ROWS: Final = 500_000
"""Rows of a file that are counted; `fte-sniff stats` counts all."""


@dataclass(frozen=True, slots=True)
class Stream:
    """The frames of one kind, to or from one motor, on one port."""

    port: str
    kind: FrameKind
    motor: int | None
    raw: bytes
    """The last frame."""
    frames: int
    per_s: float | None
    p50_ns: float | None
    p99_ns: float | None
    """Percentiles of the periods."""
    answer_ns: float | None
    """The median answer time of commands."""
    unanswered: int | None

    @property
    def condition(self) -> str:
        """The filter that shows it."""
        parts = [f"kind = '{self.kind.name}'"]
        parts += [f"motor = {self.motor}"] if self.motor is not None else []
        return " AND ".join([*parts, f"port = {quoted(self.port)}"])


KEYS: Final = ("port", "kind", "motor")


def streams_in(table: Table) -> list[Stream]:
    """The streams of a table, by port, kind and motor."""
    rows, period, keys = table.rows, pl.col("period_ns"), pl.col(KEYS).cast(pl.Int64)
    at, frames = table.counted, table.frame.with_columns(at=table.counted)
    frames = frames.with_columns(port=rows.port[at]).with_columns(keys).drop_nulls("kind")
    found = frames.group_by(KEYS).agg(
        pl.col("at").last(),
        pl.len(),
        (1e9 / period.filter(period > 0).mean()).alias("per_s"),
        period.quantile(0.5, "equiprobable").alias("p50"),
        period.quantile(0.99, "equiprobable").alias("p99"),
    )
    asked = table.answers.filter(pl.col("state") <= AnswerState.UNANSWERED)
    names_motor = pl.Series(NAMES_MOTOR[asked["kind"].to_numpy()], dtype=pl.Boolean)
    asked = asked.with_columns(
        port=pl.Series(rows.port[asked["command"].to_numpy()]),
        motor=pl.when(names_motor).then("motor"),
    )
    answers = asked.group_by(keys).agg(
        pl.col("delay_ns").median(), (pl.col("state") == AnswerState.UNANSWERED).sum()
    )
    found = found.join(answers, on=KEYS, how="left", nulls_equal=True).sort(KEYS)
    return [
        Stream(
            rows.ports[port],
            KINDS[kind],
            motor,
            rows.raw[at, : rows.length[at]].tobytes(),
            *numbers,
        )
        for port, kind, motor, at, *numbers in found.iter_rows()
    ]


@dataclass(frozen=True, slots=True)
class _Column:
    head: str
    width: int
    cell: Callable[[Stream, int], str]
    is_number: bool = True


_VALUES: Final = _Column(
    later("values"),
    12,
    lambda one, width: " ".join(
        text for text, _field in value_parts(one.kind, one.raw, width, lambda f, _v: bool(f.unit))
    ),
    is_number=False,
)
COLUMNS: Final = (
    _Column(later("kind"), 17, lambda one, width: short_kind(one.kind.name, width), False),
    _Column(later("motor"), 5, lambda one, _width: f"{one.motor or ''}"),
    _Column(later("port"), 12, lambda one, _width: printable(one.port), False),
    _Column(later("frames"), 9, lambda one, _width: f"{one.frames:,}"),
    _Column(later("rate"), 8, lambda one, _width: rate_text(one.per_s)),
    _Column(later("unanswered"), 10, lambda one, _width: _count(one.unanswered)),
    _Column(later("Δt 50 %"), 8, lambda one, _width: span_text(one.p50_ns)),
    _VALUES,
    _Column(later("answer"), 8, lambda one, _width: span_text(one.answer_ns)),
    _Column(later("Δt 99 %"), 8, lambda one, _width: span_text(one.p99_ns)),
)
"""The most useful first; those that fit are shown."""


def _count(value: int | None) -> str:
    return UNKNOWN if value is None else f"{value:,}"


class StreamsPage(ListPage[Stream]):
    """One table of what is on the wires."""

    NAME = "streams"

    def __init__(self) -> None:
        super().__init__()
        self._table = EMPTY
        self._counted: tuple[object, ...] = ()

    def title(self, context: Context) -> str:
        """Which rows are counted."""
        start, end = self._range(context)
        title = _("streams, last 10 s")
        if context.view.finding is not None:
            title = _("streams in the span of the finding")
        elif not context.view.lives:
            title = _("streams, {count:,} rows", count=end - start)
        return f"{title}   {_('enter: its rows   J K: another')}"

    @staticmethod
    def _range(context: Context) -> tuple[int, int]:
        view, span = context.view, context.span
        if view.finding is None and not view.lives:
            return max(0, view.store.next - MOST_ROWS), view.store.next
        return span.start, span.end

    def text(self, context: Context) -> Text:
        """The table, and lines about each port."""
        self._count(context)
        width, palette = context.size.width, context.table.palette
        several = len(context.view.store.ports) > 1
        columns = _fitting(width, several=several)
        lines = [Text(_line([_(column.head) for column, _w in columns], columns), palette.muted)]
        for number, one in enumerate(self.listed):
            cells = [column.cell(one, cells) for column, cells in columns]
            wrong = palette.statuses[Status.MALFORMED] if one.unanswered else PLAIN
            raised = palette.raised if one.kind.raised(one.raw) else wrong
            style = REVERSED if number == self.at else raised
            lines.append(Text(_line(cells, columns), style + self.meta(number)))
        return Text("\n").join([*lines, Text(), *_port_lines(self._table, context)])

    def _count(self, context: Context) -> None:
        """Count the rows that the filter shows, where they are not counted already."""
        (start, end), view = self._range(context), context.view
        counted = start, end, view.shown.matches, view.shown.count
        if counted == self._counted:
            return
        self._counted, rows = counted, view.store.batch(start, end)
        byte_ns = np.array([view.byte_ns(port) for port in rows.ports] or [0.0])[rows.port]
        table = replace(Table.of(rows, view.store.runs(start, end)), byte_ns=byte_ns)
        if view.shown.matches is not None:
            selected = np.zeros(len(rows), np.bool_)
            selected[view.shown.between(start, end) - start] = True
            table = replace(table, test=lambda _rows: selected)
        self._table, self.listed = table, streams_in(table)
        self.choose(self.at)


def _fitting(width: int, *, several: bool) -> list[tuple[_Column, int]]:
    found, left = [], width
    for column in COLUMNS:
        if column.head == "port" and not several:
            continue
        if column.width + 1 > left:
            break
        found.append((column, column.width))
        left -= column.width + 1
    return [
        (column, cells + (min(left, 28) if column is _VALUES else 0)) for column, cells in found
    ]


def _line(texts: Sequence[str], columns: Sequence[tuple[_Column, int]]) -> str:
    pairs = zip(texts, columns, strict=True)
    cells = ((fit_right if column.is_number else fit)(text, n) for text, (column, n) in pairs)
    return " ".join(cells)


def _port_lines(table: Table, context: Context) -> Iterator[Text]:
    """Rows, use of the line, and faults of each port."""
    palette = context.table.palette
    for port in table.rows.ports:
        own = table.frame.filter(pl.col("port") == port)
        line = Text(printable(port), "bold")
        busy_ns = (pl.col("end_ns") - pl.col("t_ns")).sum()
        rate, use = own.select(
            1e9 / pl.col("step_ns").mean(), use=busy_ns / pl.col("used_ns").sum()
        ).row(0)
        if rate is not None:
            line.append(f"  {rate_text(rate)}", "not bold")
            line.append(f"  {_('{share:.0%} of the line used', share=use)}", "not bold")
        yield line
        for fault in Fault:
            bit, status = fault_bits([fault]), status_of((fault,))
            if count := own.filter(pl.col("faults") & bit != 0).height:
                text = f"  {LOOKS[status].mark} {fault} {count:,}"
                yield Text(text, palette.statuses[status])
