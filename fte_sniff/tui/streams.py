"""The page of streams: a line for each kind and motor on each port, then a few for each port.

kind            motor  port   frames   rate     Δt 50 %  Δt 99 %  answer   unanswered  values
speed               1            500   50.0/s   20 ms    21 ms    3 ms              0  rpm=1000
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import polars as pl
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.relations import AnswerState, answers, row_before, stream_keys
from fte_sniff.errors import listed, printable
from fte_sniff.formats.cell_text import UNKNOWN, fit, fit_right, rate_text
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _, later
from fte_sniff.protocol import KINDS, FrameKind, Status, status_of
from fte_sniff.protocol.rows import NO_TIME, Rows, faults_in
from fte_sniff.tui.cells import event_words, short_kind, span_text, value_parts
from fte_sniff.tui.pages import CHOSEN, LINE, Context, Page
from fte_sniff.tui.painter import PLAIN, Palette

MOST_ROWS: Final = 500_000
"""Rows of a file that are counted; `fte-sniff stats` counts all."""


@dataclass(frozen=True, slots=True)
class Stream:
    """The frames of one kind, to or from one motor, on one port."""

    port: str
    kind: FrameKind
    motor: int | None
    frames: int
    per_s: float | None
    p50_ns: float | None
    p99_ns: float | None
    """Percentiles of the periods."""
    answer_ns: float | None
    """The median answer time of commands."""
    unanswered: int | None
    raw: bytes
    """The last frame."""

    @property
    def condition(self) -> str:
        """The filter that shows it."""
        parts = [f"kind = '{self.kind.name}'"]
        parts += [f"motor = {self.motor}"] if self.motor is not None else []
        return " AND ".join([*parts, f"port = {quoted(self.port)}"])


def streams_in(rows: Rows, runs: Any) -> list[Stream]:
    """The streams of some rows, by port, kind and motor."""
    keys, before = stream_keys(rows), row_before(stream_keys(rows), runs)
    known = (before >= 0) & (rows.t_ns != NO_TIME)
    pairs = answers(rows, runs)
    kind_of = rows.kinds[pairs["command"].to_numpy()]
    pairs = pairs.with_columns(kind=pl.Series(kind_of), port=rows.port[pairs["command"].to_numpy()])
    found = []
    for key in np.unique(keys[keys >= 0]).tolist():
        at = np.flatnonzero(keys == key)
        last, kind = int(at[-1]), KINDS[rows.kinds[at[-1]]]
        motor = int(rows.nums[last]) if kind.names_motor else None
        measured = at[known[at]]
        periods = rows.t_ns[measured] - rows.t_ns[before[measured]]
        own = pairs.filter(kind=KINDS.index(kind), port=int(rows.port[last]))
        own = own if motor is None else own.filter(motor=motor)
        decided = own.filter(pl.col("state") <= AnswerState.UNANSWERED)
        total_ns = int(periods.sum())
        found.append(
            Stream(
                rows.ports[rows.port[last]],
                kind,
                motor,
                len(at),
                len(periods) * 1e9 / total_ns if total_ns > 0 else None,
                _percentile(periods, 50),
                _percentile(periods, 99),
                decided["delay_ns"].median(),  # type: ignore[arg-type]
                int((decided["state"] == AnswerState.UNANSWERED).sum()) if len(decided) else None,
                rows.raw[last, : rows.length[last]].tobytes(),
            )
        )
    return found


def _percentile(values: Any, percent: float) -> float | None:
    if not len(values):
        return None
    return float(np.percentile(values, percent, method="inverted_cdf"))


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
    _Column(later("Δt 50 %"), 8, lambda one, _width: span_text(one.p50_ns)),
    _VALUES,
    _Column(later("unanswered"), 10, lambda one, _width: _count(one.unanswered)),
    _Column(later("answer"), 8, lambda one, _width: span_text(one.answer_ns)),
    _Column(later("Δt 99 %"), 8, lambda one, _width: span_text(one.p99_ns)),
)
"""The most useful first; those that fit are shown."""


def _count(value: int | None) -> str:
    return UNKNOWN if value is None else f"{value:,}"


class StreamsPage(Page):
    """One table of what is on the wires."""

    NAME = "streams"
    REDRAW_S: ClassVar[float] = 0.5

    def __init__(self) -> None:
        self._streams: list[Stream] = []
        self._counted: tuple[object, ...] = ()
        self.at = 0

    @property
    def chosen(self) -> Stream | None:
        """The line to whose rows enter leads."""
        return self._streams[self.at] if self.at < len(self._streams) else None

    def move(self, by: int) -> bool:
        """Choose the next line, or the one before."""
        self.at = max(0, min(self.at + by, len(self._streams) - 1))
        return bool(self._streams)

    def titles(self, context: Context) -> Sequence[str]:
        """Which rows are counted."""
        start, end = self._range(context)
        title = _("streams, last 10 s")
        if context.view.finding is not None:
            title = _("streams in the span of the finding")
        elif not context.view.lives:
            title = _("streams, {count:,} rows", count=end - start)
        return [f"{title}   {_('enter: its rows   J K: another')}", title]

    @staticmethod
    def _range(context: Context) -> tuple[int, int]:
        view, span = context.view, context.span
        if view.finding is None and not view.lives:
            return max(0, view.store.next - MOST_ROWS), view.store.next
        return span.start, span.end

    def text(self, context: Context) -> Text:
        """The table, and lines about each port."""
        self._count(context)
        width, palette = context.size.width, context.palette
        several = len(context.view.store.ports) > 1
        columns = _fitting(width, several=several)
        lines = [Text(_line([_(column.head) for column, _w in columns], columns), palette.muted)]
        for number, one in enumerate(self._streams):
            cells = [column.cell(one, cells) for column, cells in columns]
            wrong = palette.statuses[Status.MALFORMED] if one.unanswered else PLAIN
            raised = palette.raised if one.kind.raised(one.raw) else wrong
            style: Style | str = CHOSEN if number == self.at else raised
            line = Text(_line(cells, columns), style)
            line.stylize(Style(meta={LINE: number}))
            lines.append(line)
        return Text("\n").join([*lines, Text(), *_port_lines(context, palette)])

    def _count(self, context: Context) -> None:
        """Count the rows that the filter shows, where they are not counted already."""
        (start, end), shown, store = self._range(context), context.view.shown, context.view.store
        counted = start, end, shown.matches, shown.count
        if counted == self._counted:
            return
        self._counted = counted
        rows, runs = store.batch(start, end), store.runs(start, end)
        if shown.matches is not None:
            own = shown.between(start, end) - start
            rows, runs = rows.select(own), runs.select(own)
        self._streams = streams_in(rows, runs)
        self.at = max(0, min(self.at, len(self._streams) - 1))


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


def _port_lines(context: Context, palette: Palette) -> Iterator[Text]:
    """Rows, use of the line, faults and events of each port."""
    view = context.view
    start, end = StreamsPage._range(context)
    rows = view.store.batch(start, end)
    for code, port in enumerate(rows.ports):
        own = rows.port == code
        line = Text(printable(port), "bold")
        timed = np.flatnonzero(own & rows.timed)
        if len(timed) > 1 and (span_ns := int(rows.t_ns[timed[-1]] - rows.t_ns[timed[0]])) > 0:
            busy = int(rows.length[timed].sum()) * view.byte_ns(port)
            line.append(f"  {rate_text(len(timed) * 1e9 / span_ns)}", "not bold")
            line.append(f"  {_('{share:.0%} of the line used', share=busy / span_ns)}", "not bold")
        yield line
        yield from _counts(_faults(rows, own), palette)
        events = {
            event_words(kind): count for (name, kind), count in view.events.items() if name == port
        }
        if events:
            texts = listed(f"{_(name)} {count:,}" for name, count in events.items())
            yield Text(f"  {_('port events: {events}', events=_(texts))}", palette.muted)


def _faults(rows: Rows, own: Any) -> Mapping[Any, int]:
    found: dict[Any, int] = {}
    for bits, count in zip(*np.unique(rows.faults[own], return_counts=True), strict=True):
        for fault in faults_in(int(bits)):
            found[fault] = found.get(fault, 0) + int(count)
    return found


def _counts(faults: Mapping[Any, int], palette: Palette) -> Iterator[Text]:
    for fault, count in faults.items():
        status = status_of((fault,))
        text = f"  {LOOKS[status].mark} {fault} {count:,}"
        yield Text(text, palette.statuses[status])
