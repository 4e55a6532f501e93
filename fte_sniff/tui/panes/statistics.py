"""Statistics pane."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from typing import TYPE_CHECKING, Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.counters import Durations, TimeSeries
from fte_sniff.analysis.motor_stats import FlagStats
from fte_sniff.analysis.statistics import PortStats, Statistics, StreamStats
from fte_sniff.errors import printable
from fte_sniff.protocol import Direction, status_of
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.notices import event_words
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.table.columns import MARKS, RAISED_MARK
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import (
    UNKNOWN,
    clock_text,
    fit,
    fit_path,
    fit_right,
    rate_text,
    share_text,
    span_text,
    sparkline,
)

if TYPE_CHECKING:
    from fte_sniff.analysis.motor_stats import FlagCount


ERROR_BIT: Final = later("motor {motor}: ERROR bit {bit} set in {seen}")
NOT_ONLINE: Final = later("motor {motor}: not ONLINE in {seen}")
ONE_FRAME: Final = later("1 frame")
FRAMES: Final = later("{count:,} frames")
WHEN: Final = later("{frames}, {time}")
FROM_TO: Final = later("{start} to {end}")
LOST_ONCE: Final = later("lost once")
LOST: Final = later("lost {count:,} times")
ALL_IN_ORDER: Final = later("no ERROR bit was ever set, and every motor was always ONLINE")

When = Callable[[int | None], str]
"""The text of a time; a dash for none."""


def flag_words(flags: Sequence[FlagStats], when: When, *, in_order: bool) -> Iterator[str]:
    """A line for each thing that is not in order; `in_order` tells whether rows follow in time."""
    for one in flags:
        for bit, seen in one.error_bits.items():
            yield _(ERROR_BIT).format(motor=one.motor, bit=bit, seen=_seen(seen, when))
        if one.offline.frames:
            words = _(NOT_ONLINE).format(motor=one.motor, seen=_seen(one.offline, when))
            yield f"{words}; {_lost(one.times_lost)}" if in_order else words


def from_to(first_ns: int, last_ns: int | None, when: When) -> str:
    """`12:00:01.000 to 12:00:09.000`; one time where they are the same."""
    if first_ns == last_ns:
        return when(first_ns)
    return _(FROM_TO).format(start=when(first_ns), end=when(last_ns))


def _seen(seen: FlagCount, when: When) -> str:
    """`12 frames, 12:00:01.000 to 12:00:09.000`."""
    frames = _(ONE_FRAME) if seen.frames == 1 else _(FRAMES).format(count=seen.frames)
    if seen.first_ns is None:
        return frames
    return _(WHEN).format(frames=frames, time=from_to(seen.first_ns, seen.last_ns, when))


def _lost(times: int) -> str:
    return _(LOST_ONCE) if times == 1 else _(LOST).format(count=times)


PORT_ROWS: Final = later("{rows:,} rows, {bytes:,} bytes")
PORT_USE: Final = later("  {share} of the time used, at {baud:,} baud")
PORT_USE_OVER_TIME: Final = later("  use over time, at most {most}")
SILENCES: Final = later("  silences: ")
BETWEEN: Final = later(", ")
SILENCE: Final = later("{count:,} < {span}")
SILENCE_LAST: Final = later("{count:,} longer")
LONGEST: Final = later("  longest silence {span}, until {time}")
NO_SILENCE: Final = later("  never silent")
EVENT: Final = later("{event} {count:,} (last {time})")
EVENTS: Final = later("  port events: {events}")
NO_EVENTS: Final = later("  port events: none")
NO_FAULTS: Final = later("no faults")
FAULTS: Final = later("faults")
ROWS: Final = later("rows")
PER_CELL: Final = later("over time, from {start} to {end}")
NO_ROWS: Final = later("nothing came")
NO_TIMES: Final = later("  these rows have no times: no rates, no silences")
BEHIND: Final = later("reading: {rows:,} rows to go")
MISSED: Final = later("{rows:,} rows came too fast to be counted here")

STEPS_NS: Final = (100_000, 1_000_000, 10_000_000, 100_000_000, 1_000_000_000)
"""The durations by which silences are told apart."""

_NAME_WIDTH: Final = 19
_MILLISECONDS: Final = 3
_BOLD: Final = Style(bold=True)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of the table of streams."""

    head: str
    width: int
    cell: Callable[[StreamStats, When], str]


def _at(percent: float) -> Callable[[StreamStats, When], str]:
    return lambda numbers, _when: span_text(numbers.periods.percentile_ns(percent))


def _longest_at(numbers: StreamStats, when: When) -> str:
    return when(numbers.periods.longest_at_ns)


COLUMNS: Final = (
    _Column(later("frames"), 9, lambda numbers, _when: f"{numbers.count:,}"),
    _Column(later("lately"), 8, lambda numbers, _when: rate_text(numbers.lately_per_s)),
    _Column(later("mean"), 8, lambda numbers, _when: rate_text(numbers.per_s)),
    _Column(later("period"), 8, _at(50)),
    _Column(later("jitter"), 8, lambda numbers, _when: span_text(numbers.jitter_ns)),
    _Column(later("longest"), 8, lambda numbers, _when: span_text(numbers.periods.longest_ns)),
    _Column(later("until"), 12, _longest_at),
    _Column("5 %", 8, _at(5)),
    _Column("95 %", 8, _at(95)),
    _Column("99 %", 8, _at(99)),
)
"""What is told of a stream, the most useful first: the period is the median, the jitter the
distance of the 5 percent shortest to the 5 percent longest periods."""

STREAMS_HEAD: Final = later("kind and motor")


@dataclass(frozen=True, slots=True)
class StatisticsText:
    """What the page is about."""

    statistics: Statistics
    flags: Sequence[FlagStats]
    """Of every motor."""
    now_ns: int | None
    behind: int
    """Rows that are not counted yet."""
    missed: int
    """Rows that never will be."""
    zone: tzinfo = UTC
    """Of times of day."""

    def when(self, t_ns: int | None) -> str:
        """The time of day; a dash for none."""
        return UNKNOWN if t_ns is None else clock_text(t_ns, _MILLISECONDS, self.zone)


def page(told: StatisticsText, width: int, palette: Palette) -> Text:
    """All numbers, for so many cells."""
    lines = list(_lines(told, width, palette))
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    return Text("\n").join(lines)


def _lines(told: StatisticsText, width: int, palette: Palette) -> Iterator[Text]:
    if told.behind:
        yield Text(_(BEHIND).format(rows=told.behind), style=palette.muted)
    if told.missed:
        yield Text(_(MISSED).format(rows=told.missed), style=palette.muted)
    ports, streams = told.statistics.ports(), told.statistics.streams(told.now_ns)
    if not ports:
        yield Text(_(NO_ROWS), style=palette.muted)
        return
    trouble = list(_flags(told, palette))
    if trouble:
        # What is wrong with a motor is not to be scrolled to.
        yield from (*trouble, Text())
    for port in ports:
        yield from _port(port, told.when, width, palette)
        own = [stream for stream in streams if stream.port == port.port]
        if own:
            yield from _streams(own, told.when, width, palette)
        yield Text()
    yield from _faults(told, width, palette)
    if not trouble and any(one.kind.direction is Direction.FEEDBACK for one in streams):
        yield Text(_(ALL_IN_ORDER))


def _port(port: PortStats, when: When, width: int, palette: Palette) -> Iterator[Text]:
    rows = _(PORT_ROWS).format(rows=port.rows, bytes=port.bytes)
    name = fit_path(printable(port.port), max(8, width - cell_len(rows) - 2))
    yield Text.assemble((name, _BOLD), "  ", rows)
    if port.share is None:
        yield Text(_(NO_TIMES), style=palette.muted)
    else:
        yield Text(_(PORT_USE).format(share=share_text(port.share), baud=port.baud))
        yield _use_over_time(port.share_over_time, width, palette)
        yield from _silences(port.silences, when, width)
    if port.events:
        said = (
            _(EVENT).format(
                event=_(event_words(event.kind)),
                count=event.count,
                time=when(event.last_ns),
            )
            for event in port.events
        )
        yield Text(_(EVENTS).format(events=_(BETWEEN).join(said)))
    else:
        yield Text(_(NO_EVENTS), style=palette.muted)


def _use_over_time(use: TimeSeries, width: int, palette: Palette) -> Text:
    most = max(use.values, default=0.0)
    words = _(PORT_USE_OVER_TIME).format(most=share_text(most)) + " "
    line = sparkline(use.values, width - cell_len(words))
    return Text.assemble(words, (line, Style(color=palette.kinds["speed"].color)))


def _silences(silences: Durations, when: When, width: int) -> Iterator[Text]:
    if silences.longest_ns is None or silences.longest_at_ns is None:
        yield Text(_(NO_SILENCE))
        return
    until = when(silences.longest_at_ns)
    yield Text(_(LONGEST).format(span=span_text(silences.longest_ns), time=until))
    told, low = [], 0
    for high in STEPS_NS:
        told.append(_(SILENCE).format(count=silences.between(low, high), span=span_text(high)))
        low = high
    told.append(_(SILENCE_LAST).format(count=silences.between(low, 2.0**63)))
    line = lead = _(SILENCES)
    for place, one in enumerate(told):
        end = "" if place == len(told) - 1 else _(BETWEEN)
        if cell_len(line + one + end) > width:
            yield Text(line)
            line = " " * cell_len(lead)
        line += one + end
    yield Text(line)


def _streams(
    streams: Sequence[StreamStats], when: When, width: int, palette: Palette
) -> Iterator[Text]:
    columns, room = [], width - _NAME_WIDTH - 2
    for column in COLUMNS:
        room -= column.width + 1
        if room < 0:
            break
        columns.append(column)
    head = "".join(f" {fit_right(_(column.head), column.width)}" for column in columns)
    yield Text(f"  {fit(_(STREAMS_HEAD), _NAME_WIDTH)}{head}", style=palette.muted)
    for stream in streams:
        name = stream.kind.name if stream.motor is None else f"{stream.kind.name} {stream.motor}"
        cells = "".join(
            f" {fit_right(column.cell(stream, when), column.width)}" for column in columns
        )
        style = palette.kinds[stream.kind.name]
        yield Text.assemble("  ", (fit(name, _NAME_WIDTH), style), cells)


def _flags(told: StatisticsText, palette: Palette) -> Iterator[Text]:
    for words in flag_words(told.flags, told.when, in_order=True):
        yield Text.assemble((RAISED_MARK, palette.raised_mark), " ", (words, palette.raised))


def _faults(told: StatisticsText, width: int, palette: Palette) -> Iterator[Text]:
    faults = told.statistics.faults()
    if not faults:
        yield Text(_(NO_FAULTS))
        return
    over_time = faults[0].over_time
    head = f"{fit(_(FAULTS), _NAME_WIDTH + 2)} {fit_right(_(ROWS), COLUMNS[0].width)}"
    line = Text(head, style=_BOLD)
    room = width - cell_len(head) - 2
    if over_time.values:
        end = over_time.start_ns + over_time.slot_ns * len(over_time.values)
        start, end_text = (clock_text(t_ns, 0, told.zone)[:8] for t_ns in (over_time.start_ns, end))
        words = _(PER_CELL).format(start=start, end=end_text)
        line.append(f"  {words}", palette.muted)
    yield line
    for numbers in faults:
        status = status_of((numbers.fault,))
        style = palette.statuses[status]
        name = fit(numbers.fault.value, _NAME_WIDTH)
        count = fit_right(f"{numbers.count:,}", COLUMNS[0].width)
        spark = sparkline(numbers.over_time.values, room)
        yield Text.assemble(
            (MARKS[status], palette.marks[status]),
            " ",
            (name, style),
            f" {count}  ",
            (spark, style),
        )


TITLE: Final = later("statistics of all rows")
HINT: Final = later("J K: scroll   esc: close")


class StatisticsPane(Pane):
    """The numbers over all rows, whatever the filter shows and wherever the cursor is."""

    EVERY_S = 0.5

    def __init__(self) -> None:
        super().__init__(HINT)

    def see(self, sight: PaneContext) -> None:
        """Draw the numbers as they are now."""
        self.entitle(_(TITLE))
        models = sight.models
        told = StatisticsText(
            models.statistics,
            models.flags.stats(),
            sight.newest_ns,
            models.pending,
            models.missed,
            sight.zone,
        )
        self.draw(page(told, self.room.width, sight.palette))
