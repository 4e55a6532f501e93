"""Statistics pane: rates, line use, silences, flags and faults of all rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from itertools import accumulate, pairwise
from typing import Final, NamedTuple

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.counters import Counts, Durations
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.motors import FLAGS_IN_ORDER, TimeText, flag_texts
from fte_sniff.analysis.statistics import FaultStats, PortStats, StreamStats
from fte_sniff.errors import listed, printable
from fte_sniff.formats.cell_text import (
    UNKNOWN,
    cell_edges,
    clock_text,
    fit,
    fit_path,
    fit_right,
    rate_text,
    share_text,
    sparkline,
    wrap,
)
from fte_sniff.protocol import KINDS, Direction, status_of
from fte_sniff.protocol.columns import LOOKS
from fte_sniff.tui.cells import RAISED_MARK, event_words, span_text
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import BOLD, Palette
from fte_sniff.tui.panes.findings import finding_lines
from fte_sniff.tui.panes.pane import HINT as PANE_HINT
from fte_sniff.tui.panes.pane import Pane, PaneContext

SILENCE_STEPS_NS: Final = (100_000, 1_000_000, 10_000_000, 100_000_000, 1_000_000_000)

POINTER: Final = "▼"

_NAME_WIDTH: Final = 19
_MILLISECONDS: Final = 3
_SHOWN_AS: Final = next(kind.name for kind in KINDS if kind.subject)
"""The kind whose colour the use of the line has."""


@dataclass(frozen=True, slots=True)
class _NumberColumn:
    head: str
    width: int
    cell: Callable[[StreamStats, TimeText], str]


def _percentile(percent: float) -> Callable[[StreamStats, TimeText], str]:
    return lambda stream, _when: span_text(stream.periods.percentile_ns(percent))


_LATELY: Final = _NumberColumn(
    later("lately"), 8, lambda stream, _when: rate_text(stream.lately_per_s)
)

COLUMNS: Final = (
    _NumberColumn(later("frames"), 9, lambda stream, _when: f"{stream.count:,}"),
    _LATELY,
    _NumberColumn(later("mean"), 8, lambda stream, _when: rate_text(stream.per_s)),
    _NumberColumn(later("period"), 8, _percentile(50)),
    _NumberColumn(later("jitter"), 8, lambda stream, _when: span_text(stream.jitter_ns)),
    _NumberColumn(later("longest"), 8, lambda stream, _when: span_text(stream.periods.longest_ns)),
    _NumberColumn(later("until"), 12, lambda stream, when: when(stream.periods.longest_at_ns)),
    _NumberColumn("5 %", 8, _percentile(5)),
    _NumberColumn("95 %", 8, _percentile(95)),
    _NumberColumn("99 %", 8, _percentile(99)),
)
"""Numbers of a stream, the most useful first. The period is the median; the jitter is the
difference of the 95th and the 5th percentile."""


@dataclass(frozen=True, slots=True)
class StatisticsPage:
    """The statistics as text."""

    models: LiveModels
    rates_ns: int | None
    width: int
    palette: Palette
    zone: tzinfo = UTC
    chosen: int | None = None
    """Cell of the faults over time that the user looks at."""

    @property
    def text(self) -> Text:
        """All lines, cut to the width."""
        lines = list(self._lines())
        for line in lines:
            line.truncate(self.width, overflow="ellipsis")
        return Text("\n").join(lines)

    def _when(self, t_ns: int | None) -> str:
        return UNKNOWN if t_ns is None else clock_text(t_ns, _MILLISECONDS, self.zone)

    def _muted(self, text: str) -> Text:
        return Text(text, style=self.palette.muted)

    def _lines(self) -> Iterator[Text]:
        models, statistics = self.models, self.models.statistics
        if models.pending:
            yield self._muted(_("reading: {rows:,} rows to go", rows=models.pending))
        if models.missed:
            text = _("{rows:,} rows arrived too fast to be counted here", rows=models.missed)
            yield self._muted(text)
        ports, streams = statistics.ports(), statistics.streams(self.rates_ns)
        if not ports:
            yield self._muted(_("nothing came"))
            return
        flags = models.flags.stats()
        raised = [_(text) for text in flag_texts(flags, self._when, in_order=True)]
        if models.found:
            yield Text(_("findings"), style=BOLD)
            for finding in models.found:
                yield from finding_lines(finding, self.width, self.palette, self.zone)
        if raised:
            # One line near the top, so that nobody has to scroll to an error, or past errors.
            motors = [one.motor for one in flags if one.error_bits or one.offline.rows]
            text = _("ERROR was set or ONLINE missing: motors {motors}; details at the end")
            if len(motors) == 1:
                text = _("ERROR was set or ONLINE missing: motor {motors}; details at the end")
            yield self._raised(text.format(motors=_(listed(motors))))
        yield from self._faults()
        yield Text()
        for port in ports:
            yield from self._port(port)
            of_port = [stream for stream in streams if stream.port == port.port]
            if of_port:
                yield from self._streams(of_port)
            yield from self._quiet(port)
            yield Text()
        if raised:
            yield from map(self._raised, raised)
        elif any(one.kind.direction is Direction.FEEDBACK for one in streams):
            yield Text(_(FLAGS_IN_ORDER))

    def _raised(self, line: str) -> Text:
        mark = (RAISED_MARK, self.palette.raised_mark)
        return Text.assemble(mark, " ", (line, self.palette.raised))

    def _port(self, port: PortStats) -> Iterator[Text]:
        rows = _("{rows:,} rows, {bytes:,} bytes", rows=port.rows, bytes=port.bytes)
        name = fit_path(printable(port.port), max(8, self.width - cell_len(rows) - 2))
        yield Text.assemble((name, BOLD), "  ", rows)
        if port.first_ns is None:
            yield self._muted(_("  these rows have no times: no rates, no silences"))
        elif port.share is None:
            yield self._muted(_("  too few rows for rates and silences"))
        else:
            text = _("  {share} of the time used, at {baud:,} baud")
            yield Text(text.format(share=share_text(port.share), baud=port.baud))
            yield self._use_over_time(port.share_over_time)

    def _quiet(self, port: PortStats) -> Iterator[Text]:
        if port.share is not None:
            yield from self._silences(port.silences)
        if port.events:
            form = _("{event} {count:,} (last {time})")
            events = [
                form.format(
                    event=_(event_words(one.kind)), count=one.count, time=self._when(one.last_ns)
                )
                for one in port.events
            ]
            yield from self._in_lines(_("  port events: "), events)
        else:
            yield self._muted(_("  port events: none"))

    def _use_over_time(self, use: Counts) -> Text:
        most = share_text(max(use.values, default=0.0))
        label = _("  use over time, at most {most}", most=most) + " "
        line = sparkline(use.values, self.width - cell_len(label), full=1)
        return Text.assemble(label, (line, Style(color=self.palette.kinds[_SHOWN_AS].color)))

    def _silences(self, silences: Durations) -> Iterator[Text]:
        if silences.longest_ns is None or silences.longest_at_ns is None:
            yield Text(_("  never silent"))
            return
        until = self._when(silences.longest_at_ns)
        span = span_text(silences.longest_ns)
        yield Text(_("  longest silence {span}, until {time}", span=span, time=until))
        counts = [
            _("{count:,} < {span}", count=silences.between(low, high), span=span_text(high))
            for low, high in pairwise((0, *SILENCE_STEPS_NS))
        ]
        longer = silences.between(SILENCE_STEPS_NS[-1], 2.0**63)
        counts.append(_("{count:,} longer", count=longer))
        yield from self._in_lines(_("  silences: "), counts)

    def _in_lines(self, label: str, items: Sequence[str]) -> Iterator[Text]:
        """The items after a label; on further lines, below the first item."""
        width, lines = self.width - cell_len(label), list[str]()
        for number, item in enumerate(items):
            comma = _(", ") if number + 1 < len(items) else ""
            if lines and cell_len(lines[-1] + item + comma.rstrip()) <= width:
                lines[-1] += item + comma
            else:
                *others, last = wrap(item, width - cell_len(comma.rstrip()))
                lines += [*others, last + comma]
        for number, line in enumerate(lines):
            yield Text((" " * cell_len(label) if number else label) + line.rstrip())

    def _streams(self, streams: Sequence[StreamStats]) -> Iterator[Text]:
        known = [one for one in COLUMNS if one is not _LATELY or self.rates_ns is not None]
        ends = accumulate((column.width + 1 for column in known), initial=_NAME_WIDTH + 2)
        columns = [one for one, end in zip(known, [*ends][1:], strict=True) if end <= self.width]
        head = "".join(f" {fit_right(_(column.head), column.width)}" for column in columns)
        yield self._muted(f"  {fit(_('kind and motor'), _NAME_WIDTH)}{head}")
        for stream in streams:
            kind = stream.kind.name
            name = kind if stream.motor is None else f"{kind} {stream.motor}"
            cells = "".join(
                f" {fit_right(column.cell(stream, self._when), column.width)}" for column in columns
            )
            yield Text.assemble("  ", (fit(name, _NAME_WIDTH), self.palette.kinds[kind]), cells)

    def _faults(self) -> Iterator[Text]:
        faults = self.models.statistics.faults()
        if not faults:
            yield Text(_("no faults"))
            return
        head = f"{fit(_('faults'), _NAME_WIDTH + 2)} {fit_right(_('rows'), COLUMNS[0].width)}"
        line = Text(head, style=BOLD)
        cells = fault_cells(faults, self.width)
        chosen = None if self.chosen is None or not cells else min(self.chosen, len(cells) - 1)
        if cells:
            start, end = self._span(cells[0].start_ns, cells[-1].end_ns)
            text = _("over time, from {start} to {end}", start=start, end=end)
            line.append(f"  {text}", self.palette.muted)
        yield line
        if chosen is not None:
            yield self._pointer(cells[chosen], chosen)
        for fault in faults:
            status = status_of((fault.fault,))
            style = self.palette.statuses[status]
            count = fit_right(f"{fault.count:,}", COLUMNS[0].width)
            yield Text.assemble(
                (LOOKS[status].mark, self.palette.marks[status]),
                " ",
                (fit(fault.fault.value, _NAME_WIDTH), style),
                f" {count}  ",
                (sparkline(fault.over_time.values, _over_time_width(self.width)), style),
            )

    def _span(self, *ends_ns: int) -> tuple[str, str]:
        start, end = (clock_text(t_ns, 0, self.zone)[:8] for t_ns in ends_ns)
        return start, end

    def _pointer(self, cell: FaultCell, at: int) -> Text:
        """A line that points at the chosen cell, whose values stay as they are."""
        start, end = self._span(cell.start_ns, cell.end_ns)
        text = _("{start} to {end}; enter: its rows", start=start, end=end)
        before = self.width - _over_time_width(self.width) + at
        after = f"{POINTER} {text}"
        if before + cell_len(after) <= self.width:
            return Text(" " * before + after)
        left = f"{text} {POINTER}"
        return Text(" " * max(0, before + 1 - cell_len(left)) + left)


def _over_time_width(width: int) -> int:
    """Cells of the faults over time, beside their names and counts."""
    return width - (_NAME_WIDTH + 2 + 1 + COLUMNS[0].width) - 2


class FaultCell(NamedTuple):
    """A cell of the faults over time."""

    start_ns: int
    """Nanoseconds since 1970 UTC."""
    end_ns: int
    rows: float
    """Rows with a fault; one with several faults counts several times."""


def fault_cells(faults: Sequence[FaultStats], width: int) -> list[FaultCell]:
    """The cells of the faults over time; none if the rows have no times."""
    every = [fault.over_time for fault in faults]
    if not every or not every[0].values or _over_time_width(width) < 1:
        return []
    start_ns, window_ns, values = every[0]
    edges = cell_edges(len(values), _over_time_width(width))
    return [
        FaultCell(
            start_ns + window_ns * first,
            start_ns + window_ns * end,
            sum(sum(counts.values[first:end]) for counts in every),
        )
        for first, end in pairwise(edges)
    ]


class StatisticsPane(Pane):
    """Numbers over all rows, independent of the filter and the cursor."""

    NAME = "statistics"
    REDRAW_S = 0.5
    HINT = later("h l enter: a time   J K: scroll   esc: close")

    def __init__(self) -> None:
        super().__init__()
        self._chosen: int | None = None
        self._cells: list[FaultCell] = []

    @property
    def hint(self) -> str:
        """Without faults over time, no time can be chosen."""
        return self.HINT if self._cells else PANE_HINT

    def aside(self, by: int) -> bool:
        """Choose a cell of the faults over time: first the fullest, then those beside it."""
        if not self._cells:
            return False
        if self._chosen is None:
            self._chosen = max(range(len(self._cells)), key=lambda at: self._cells[at].rows)
        else:
            self._chosen = max(0, min(self._chosen + by, len(self._cells) - 1))
        return True

    def forget_choice(self) -> None:
        """Choose no cell."""
        self._chosen = None

    @property
    def chosen_span(self) -> tuple[int, int] | None:
        """Start and end of the chosen cell, nanoseconds since 1970 UTC; None without one."""
        if self._chosen is None or self._chosen >= len(self._cells):
            return None
        cell = self._cells[self._chosen]
        return cell.start_ns, cell.end_ns

    def draw(self, context: PaneContext) -> None:
        """Draw the current numbers."""
        width, palette = self.page_size.width, context.palette
        self._cells = fault_cells(context.models.statistics.faults(), width)
        self.set_title("   ".join(filter(None, (_("statistics of all rows"), context.merged_text))))
        page = StatisticsPage(
            context.models, context.rates_ns, width, palette, context.zone, self._chosen
        )
        self.set_page(page.text)
