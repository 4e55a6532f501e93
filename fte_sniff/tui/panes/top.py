"""Top view: one sorted line for each kind and motor, in place of the table.

kind        motor values      rate       Δt     count flags
speed           1 rpm=1000   50/s    20 ms    12,345
speed_feedba…   1 rpm=998    50/s    20 ms    12,340 online
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from time import monotonic
from typing import Any, ClassVar, Final

import numpy as np
from rich.segment import Segment
from rich.style import Style
from textual.binding import BindingType
from textual.events import Click
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from fte_sniff.analysis.counters import Floats
from fte_sniff.analysis.live_models import ShownStreams
from fte_sniff.analysis.motors import AnsweredCommands, MotorState
from fte_sniff.analysis.plots import QUANTITIES, Traces, usual_range
from fte_sniff.analysis.statistics import StreamStats
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import (
    BLOCKS,
    UNKNOWN,
    clock_text,
    fit,
    fit_right,
    rate_text,
    short_number,
    sparkline,
)
from fte_sniff.protocol import KINDS, Direction
from fte_sniff.protocol.spec import Role, motor_bit
from fte_sniff.tui.cells import RAISED_MARK, first_fitting, short_kind, span_text, value_parts
from fte_sniff.tui.commands import TOP, action_of, bindings
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import REVERSED, Palette, over_line
from fte_sniff.tui.panes.motors import ERROR, OFFLINE, ONLINE, SECOND_NS
from fte_sniff.tui.panes.pane import PaneContext

CURVE_NS: Final = 10 * SECOND_NS

STALE_NS: Final = 2 * SECOND_NS
"""Age of the last frame from which on a line is muted, unless its period is long."""

STALE_PERIODS: Final = 5
"""Periods without a frame after which a line is muted."""

RESORT_S: Final = 2.0
"""Shortest time between two orders, seconds: else lines with similar rates change places."""

STEP_ROWS: Final = 32_768
"""Rows that are counted at once with a filter."""

OLD: Final = 4
"""Drawings after which a changed byte is as muted as one that never changed."""

JITTER_FRAMES: Final = 64


@dataclass(frozen=True, slots=True)
class TopLine:
    """What a line shows."""

    stats: StreamStats
    motor: int | None
    """The motor that the kind names, or whose answers to a command to all are shown."""
    state: MotorState | None
    """The motor's, if there is one."""
    now_ns: int | None
    answers: AnsweredCommands | None = None
    """Of the commands of this kind; None for feedback."""
    curve: Floats = field(default_factory=lambda: np.empty(0), compare=False)
    ages: tuple[int, ...] = ()
    """For each byte the drawings since it changed, at most `OLD`."""

    @property
    def key(self) -> tuple[str, str, int]:
        """Identity of the line."""
        return self.stats.port, self.stats.kind.name, self.motor or 0

    @property
    def raw(self) -> bytes:
        """The last frame."""
        return self.stats.latest[0]

    @property
    def subject(self) -> str | None:
        """The quantity that the motor is about, if any."""
        name = self.stats.kind.subject
        return name if name in QUANTITIES and self.state is not None else None

    @property
    def target(self) -> int | None:
        """The motor's present target of that quantity."""
        if self.state is None or self.state.target is None or self.subject is None:
            return None
        target = self.state.target
        return target.values[self.subject] if target.kind.subject == self.subject else None

    @property
    def actual(self) -> int | None:
        """The motor's latest feedback of that quantity."""
        if self.state is None or self.subject is None:
            return None
        reading = self.state.present.get(self.subject)
        return None if reading is None else reading.value

    @property
    def rate(self) -> float | None:
        """Frames per second lately; after the end the mean."""
        lately = self.stats.lately_per_s
        return self.stats.per_s if lately is None else lately

    @property
    def rate_text(self) -> str:
        """The rate; a mean is `ø10.0/s`."""
        is_mean = self.stats.lately_per_s is None and self.rate is not None
        return ("ø" if is_mean else "") + rate_text(self.rate)

    @property
    def delta_ns(self) -> int | None:
        """The last period, or the longer time since the last frame."""
        recent = self.stats.recent_ns
        period = int(recent[-1] - recent[-2]) if len(recent) > 1 else None
        known = [ns for ns in (period, self.age_ns) if ns is not None]
        return max(known, default=None)

    @property
    def age_ns(self) -> int | None:
        """Time since the last frame."""
        if self.now_ns is None or self.stats.last_ns is None:
            return None
        return max(0, self.now_ns - self.stats.last_ns)

    @property
    def jitter_ns(self) -> float | None:
        """Range of the latest periods between their 5th and 95th percentile."""
        periods = np.sort(np.diff(self.stats.recent_ns[-JITTER_FRAMES:]))
        if len(periods) < 2:
            return None
        beyond = len(periods) // 20
        return float(periods[-1 - beyond] - periods[beyond])

    @property
    def is_stale(self) -> bool:
        """Whether frames have stopped to come."""
        recent, age = self.stats.recent_ns, self.age_ns
        if age is None or age <= STALE_NS:
            return False
        mean = (recent[-1] - recent[0]) / (len(recent) - 1) if len(recent) > 1 else 0.0
        return bool(age > STALE_PERIODS * mean)

    @property
    def delay_ns(self) -> int | None:
        """The median of the latest answer times."""
        return None if self.answers is None else self.answers.delay_p50_ns

    @property
    def unanswered(self) -> int | None:
        """Commands without an answer."""
        return None if self.answers is None else self.answers.unanswered

    @property
    def flags(self) -> tuple[int, bool] | None:
        """ERROR, and whether the motor is online, as its feedback says."""
        if self.stats.kind.direction is not Direction.FEEDBACK or self.stats.motor is None:
            return None
        values = {one.role: one.read(self.raw) for one in self.stats.kind.fields}
        online = values[Role.ONLINE] >> motor_bit(self.stats.motor) & 1
        return values[Role.ERRORS], bool(online)


def _number(value: int | None, width: int) -> str:
    return UNKNOWN if value is None else first_fitting((f"{value:,}", short_number(value)), width)


def _flags(line: TopLine, width: int) -> str:
    if line.flags is None:
        return ""
    error, online = line.flags
    word = _(ONLINE if online else OFFLINE)
    if not error:
        return word
    text = _(ERROR, byte=error)
    return text if online else first_fitting((f"{text} {word}", f"E{error:02X} {word}"), width)


def _quantities(line: TopLine, width: int) -> str:
    """The values with a unit; motor and flags have columns of their own."""
    parts = value_parts(line.stats.kind, line.raw, width, lambda field, _value: bool(field.unit))
    return " ".join(text for text, _field in parts)


def _curve(line: TopLine, width: int) -> str:
    """The values as blocks; outliers are as high or low as the usual range."""
    values, extent = line.curve, usual_range(line.curve)
    if extent is None:
        return ""
    low, high = extent
    share = (np.clip(values, low, high) - low) / (high - low) if high > low else values * 0 + 0.5
    # The lowest value is one block high: an empty cell has no value.
    levels = np.nan_to_num(1 + share * (BLOCKS - 1))
    return sparkline(levels.tolist(), width, full=BLOCKS)


@dataclass(frozen=True, slots=True)
class TopColumn:
    """A column of the view."""

    head: str
    width: int
    cell: Callable[[TopLine, int], str]
    key: Callable[[TopLine], float | str | None]
    """By which lines are sorted; None is last."""
    number: bool = True
    """Whether it is aligned to the right, and sorted from the greatest."""


_KIND: Final = TopColumn(
    later("kind"),
    11,
    lambda line, width: short_kind(line.stats.kind.name, width),
    lambda line: line.stats.kind.name,
    number=False,
)
_VALUES: Final = TopColumn(
    later("values"),
    16,
    _quantities,
    lambda line: line.raw[3:].hex(),
    number=False,
)
_TARGET: Final = TopColumn(
    later("target"), 6, lambda line, width: _number(line.target, width), lambda line: line.target
)
_ACTUAL: Final = TopColumn(
    later("actual"), 6, lambda line, width: _number(line.actual, width), lambda line: line.actual
)
_RATE: Final = TopColumn(
    later("rate"),
    8,
    lambda line, _width: line.rate_text,
    lambda line: line.rate,
)
_JITTER: Final = TopColumn(
    later("jitter"),
    8,
    lambda line, _width: span_text(line.jitter_ns),
    lambda line: line.jitter_ns,
)
_DELTA: Final = TopColumn(
    "Δt", 8, lambda line, _width: span_text(line.delta_ns), lambda line: line.delta_ns
)
_DELAY: Final = TopColumn(
    later("answer"),
    8,
    lambda line, _width: span_text(line.delay_ns) if line.answers else "",
    lambda line: line.delay_ns,
)
_UNANSWERED: Final = TopColumn(
    later("unanswered"),
    10,
    lambda line, width: _number(line.unanswered, width) if line.answers else "",
    lambda line: line.unanswered,
)
_COUNT: Final = TopColumn(
    later("count"), 9, lambda line, _width: f"{line.stats.count:,}", lambda line: line.stats.count
)
_FLAGS: Final = TopColumn(
    later("flags"),
    11,
    _flags,
    lambda line: None if line.flags is None else line.flags[0] + (not line.flags[1]),
    number=False,
)
_CURVE: Final = TopColumn(later("last 10 s"), 12, _curve, lambda line: line.actual, number=False)
_BYTES: Final = TopColumn(
    later("bytes"),
    29,
    lambda line, _width: line.raw.hex(" ").upper(),
    lambda line: line.raw.hex(),
    number=False,
)
_MOTOR: Final = TopColumn(
    later("motor"),
    5,
    lambda line, _width: f"{line.motor or ''}",
    lambda line: line.motor,
)
_PORT: Final = TopColumn(
    "port",
    12,
    lambda line, _width: printable(line.stats.port),
    lambda line: line.stats.port,
    number=False,
)

COLUMNS: Final = (
    *(_KIND, _MOTOR, _PORT, _VALUES, _TARGET, _ACTUAL, _RATE, _JITTER, _DELTA, _DELAY),
    *(_UNANSWERED, _COUNT, _FLAGS, _CURVE, _BYTES),
)

ALWAYS: Final = (_KIND, _MOTOR)

BY_USE: Final = (
    *(_VALUES, _RATE, _FLAGS, _DELTA, _COUNT),
    *(_TARGET, _ACTUAL, _JITTER, _DELAY, _UNANSWERED, _CURVE, _BYTES),
)
"""Further columns, the most useful first."""

WIDEST: Final = ((_VALUES, 19), (_KIND, 17), (_FLAGS, 16), (_VALUES, 24), (_CURVE, 200))
"""Columns that take the cells that are left, each up to a width."""


def columns_for(width: int, ports: int) -> list[tuple[TopColumn, int]]:
    """The columns that fit whole into `width` cells, with their widths."""
    shown = list(ALWAYS)
    for column in (*[_PORT] * (ports > 1), *BY_USE):
        if _total(*shown, column) > width:
            break
        shown.append(column)
    widths = {column: column.width for column in COLUMNS if column in shown}
    left = max(0, width - _total(*shown))
    for column, most in WIDEST:
        if column in widths:
            more = min(left, most - widths[column])
            widths[column] += more
            left -= more
    return list(widths.items())


def _total(*columns: TopColumn) -> int:
    """Cells of the mark and of columns with one cell between them."""
    return sum(column.width + 1 for column in columns)


class TopView(ScrollView):
    """The lines, which are drawn a few times a second.

    In place of Textual's DataTable (8.2), which formats all cells again after any change: 18 lines
    of 12 columns take 30 ms there and 9 ms here.
    """

    BINDINGS: ClassVar[list[BindingType]] = bindings(TOP)
    ALLOW_SELECT = False
    COMPONENT_CLASSES: ClassVar[set[str]] = {"top-view--cursor", "top-view--head"}
    REDRAW_S: ClassVar[float] = 0.25

    def __init__(self) -> None:
        super().__init__()
        self.display = False
        self._shown: ShownStreams | None = None
        self._columns: list[tuple[TopColumn, int]] = []
        self._lines: list[TopLine] = []
        self._sort: TopColumn | None = None
        self._reverse = False
        self._sorted_at_s = -RESORT_S
        self._cursor: tuple[str, str, int] | None = None
        self._palette: Palette | None = None
        self._pending = 0
        self._newest_ns: int | None = None
        self._zone: tzinfo = UTC
        self._base = self._cursor_style = Style.null()

    @property
    def is_behind(self) -> bool:
        """Whether rows that the filter shows were not counted yet, or a changed byte fades."""
        fading = any(0 <= age < OLD for line in self._lines for age in line.ages)
        return fading or (self._shown is not None and bool(self._pending))

    def draw(self, context: PaneContext) -> None:
        """Draw the streams that the filter shows."""
        streams = self._streams(context)
        self._ports = len({one.port for one in streams})
        self.fit_columns()
        curve = next((cells for column, cells in self._columns if column is _CURVE), 0)
        states = {one.motor: one for one in context.models.motors.states(context.newest_ns)}
        before = {line.key: line for line in self._lines}
        lines = [
            self._line(one, motor, before, states, context, curve)
            for one in streams
            for motor in _motors_of(one, states)
        ]
        self._newest_ns, self._zone = context.newest_ns, context.zone
        self._lines = self._sorted(lines)
        self._palette = context.palette
        self.virtual_size = Size(self.scrollable_size.width, len(lines) + 1)
        self.refresh()

    def fit_columns(self) -> None:
        """Show the columns that fit; the lines stay as they are."""
        self._columns = columns_for(self.scrollable_size.width, self._ports)
        self.virtual_size = self.virtual_size.with_width(self.scrollable_size.width)
        self.refresh()

    def time_text(self, *, live: bool) -> str:
        """The time whose numbers are shown; empty without times."""
        if self._newest_ns is None:
            return ""
        if live:
            return _("now")
        return _("as of {time}", time=clock_text(self._newest_ns, 3, self._zone))

    def _streams(self, context: PaneContext) -> list[StreamStats]:
        if context.store.view.filter is None:
            self._shown, self._pending = None, context.models.pending
            return context.models.statistics.streams(context.rates_ns)
        if self._shown is None:
            self._shown = ShownStreams(context.store)
        self._shown.step(STEP_ROWS)
        self._pending = self._shown.pending
        return self._shown.stats(context.rates_ns)

    def _line(
        self,
        stats: StreamStats,
        motor: int | None,
        before: Mapping[tuple[str, str, int], TopLine],
        states: dict[int, MotorState],
        context: PaneContext,
        curve: int,
    ) -> TopLine:
        state, answers = states.get(motor or 0), None
        if stats.kind.direction is Direction.CONTROL and state is not None:
            answers = state.answers.get(stats.kind.cmds[0])
        values = _values(stats, context.models.traces, context.newest_ns, curve)
        line = TopLine(stats, motor, state, context.newest_ns, answers, values)
        return replace(line, ages=_ages(line, before.get(line.key)))

    def _sorted(self, lines: list[TopLine]) -> list[TopLine]:
        """The lines in a new order where that is due, else in that of the last drawing."""
        by_key, order = {line.key: line for line in lines}, [line.key for line in self._lines]
        is_due = monotonic() >= self._sorted_at_s + RESORT_S
        if is_due or by_key.keys() != set(order):
            self._sorted_at_s = monotonic()
            return self._resorted(lines)
        return [by_key[key] for key in order]

    def _resorted(self, lines: list[TopLine]) -> list[TopLine]:
        column = self._sort
        if column is None:
            return lines[::-1] if self._reverse else lines
        keys: dict[tuple[str, str, int], Any] = {line.key: column.key(line) for line in lines}
        known = [line for line in lines if keys[line.key] is not None]
        known.sort(key=lambda line: keys[line.key], reverse=column.number is not self._reverse)
        return known + [line for line in lines if keys[line.key] is None]

    # Drawing

    def render_lines(self, crop: Region) -> list[Strip]:
        """Lines of a part of the view."""
        self._base = self.rich_style
        self._cursor_style = self.get_component_rich_style("top-view--cursor")
        if self._palette is not None and self._palette.few_colors:
            self._cursor_style = self._base + REVERSED
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        """The head, a line, or a blank."""
        width, at = self.scrollable_size.width, y + round(self.scroll_y) - 1
        if y == 0:
            return self._head(width)
        if at < len(self._lines) and self._palette is not None:
            line = self._lines[at]
            chosen = at == self._cursor_at
            style = self._cursor_style if chosen else self._base
            runs = self._runs(line, self._palette, chosen=chosen)
            strip = Strip([Segment(text, over_line(style, own)) for text, own in runs])
            return strip.adjust_cell_length(width, style)
        if at == len(self._lines) and self._pending:
            text = _("reading: {rows:,} rows to go", rows=self._pending)
            return Strip([Segment(fit(text, width), self._base)], width)
        return Strip.blank(width, self._base)

    def _head(self, width: int) -> Strip:
        style = self.get_component_rich_style("top-view--head")
        text = ""
        for column, cells in self._columns:
            head = _(column.head)
            if column is self._sort:
                down = column.number is not self._reverse
                head = f"{fit(head, cells - 1).rstrip()}{'▼' if down else '▲'}"
            text += " " + (fit_right if column.number else fit)(head, cells)
        return Strip([Segment(fit(text, width), style)], width)

    def _runs(self, line: TopLine, palette: Palette, *, chosen: bool) -> list[tuple[str, Style]]:
        stale, kind = line.is_stale and not chosen, palette.kinds[line.stats.kind.name]
        raised = line.stats.kind.raised(line.raw)
        runs = [(RAISED_MARK, palette.raised_mark) if raised else (" ", Style.null())]
        for number, (column, cells) in enumerate(self._columns):
            gap = " " if number else ""
            if column is _BYTES:
                runs += [(gap, Style.null()), *self._bytes(line, palette)]
                continue
            text = (fit_right if column.number else fit)(column.cell(line, cells), cells)
            style = Style.null()
            if (column is _FLAGS and raised) or (column is _UNANSWERED and line.unanswered):
                style = palette.raised
            elif stale:
                style = palette.muted
            elif column in (_KIND, _CURVE):
                style = kind
            runs.append((gap + text, style))
        return runs

    def _bytes(self, line: TopLine, palette: Palette) -> list[tuple[str, Style]]:
        styles = [palette.aged(Style.null(), age) for age in line.ages]
        cells = [(f"{byte:02X}", style) for byte, style in zip(line.raw, styles, strict=True)]
        gaps = [(" ", Style.null()) for _cell in cells]
        return [one for pair in zip(cells, gaps, strict=True) for one in pair][:-1]

    # Keys and mouse

    @property
    def _cursor_at(self) -> int:
        keys = [line.key for line in self._lines]
        return keys.index(self._cursor) if self._cursor in keys else 0

    def action_move_line(self, by: int) -> None:
        """Move the cursor by lines."""
        if self._lines:
            at = min(max(0, self._cursor_at + by), len(self._lines) - 1)
            self._cursor = self._lines[at].key
            height = max(1, self.scrollable_size.height - 1)
            top = min(max(round(self.scroll_y), at - height + 1), at)
            self.scroll_to(y=top, animate=False)
            self.refresh()

    def action_page_lines(self, by: int) -> None:
        """Move the cursor by windows."""
        self.action_move_line(by * max(1, self.scrollable_size.height - 2))

    def action_sort(self, by: int) -> None:
        """Sort by the next column or the previous one; before the first is the usual order."""
        orders = [None, *(column for column, _cells in self._columns if column is not _CURVE)]
        at = orders.index(self._sort) if self._sort in orders else 0
        self._sort_by(orders[(at + by) % len(orders)], reverse=False)

    def action_reverse(self) -> None:
        """Sort the other way round."""
        self._sort_by(self._sort, reverse=not self._reverse)

    def _sort_by(self, column: TopColumn | None, *, reverse: bool) -> None:
        self._sort, self._reverse, self._sorted_at_s = column, reverse, monotonic()
        self._lines = self._resorted(sorted(self._lines, key=_natural))
        self.refresh()

    @property
    def condition(self) -> str | None:
        """Filter for the rows of the line under the cursor; None without lines."""
        if not self._lines:
            return None
        line = self._lines[self._cursor_at]
        conditions = [f"kind = '{line.stats.kind.name}'"]
        if line.stats.motor is not None:
            conditions.append(f"motor = {line.stats.motor}")
        return " AND ".join(conditions)

    async def on_click(self, event: Click) -> None:
        """Sort by the clicked head; put the cursor on the clicked line, or choose it."""
        if event.y == 0:
            self._on_head_clicked(event.x)
            return
        at = event.y + round(self.scroll_y) - 1
        if at < len(self._lines):
            self.action_move_line(at - self._cursor_at)
            if event.chain == 2:
                await self.run_action(action_of("app.choose"))

    def _on_head_clicked(self, x: int) -> None:
        end = 1
        for column, cells in self._columns:
            end += cells + 1
            if x < end:
                self._sort_by(column, reverse=column is self._sort and not self._reverse)
                return


def _natural(line: TopLine) -> tuple[str, int, int]:
    return line.stats.port, KINDS.index(line.stats.kind), line.motor or 0


def _motors_of(stats: StreamStats, states: Mapping[int, MotorState]) -> Sequence[int | None]:
    """The motors of a stream's lines: those that answer a command to all, with a line for each."""
    if stats.kind.names_motor or stats.kind.direction is not Direction.CONTROL:
        return (stats.motor,)
    cmd = stats.kind.cmds[0]
    return [motor for motor, state in states.items() if cmd in state.answers] or (None,)


def _ages(line: TopLine, before: TopLine | None) -> tuple[int, ...]:
    """For each byte the drawings since it changed; `before` is the line as it is drawn now."""
    raw, ages = line.stats.latest[-1], (OLD,) * len(line.raw)
    if before is not None:
        raw, ages = before.raw, before.ages
    return tuple(
        0 if now != then else min(OLD, age + 1)
        for now, then, age in zip(line.raw, raw, ages, strict=True)
    )


def _values(stats: StreamStats, traces: Traces, now_ns: int | None, columns: int) -> Floats:
    """The quantity that the kind is about, over the last seconds."""
    subject = stats.kind.subject
    if not columns or now_ns is None or stats.motor is None or subject not in QUANTITIES:
        return np.empty(0)
    window = (now_ns + 1 - CURVE_NS, now_ns + 1)
    return traces.resample(stats.motor, stats.kind.direction, subject, window, columns).last
