"""The page of motors: for each its state, its target and feedback as curves, and its events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl
from rich.table import Table
from rich.text import Text

from fte_sniff.analysis.motors import MotorState, Trouble
from fte_sniff.analysis.plots import envelope, motor_values
from fte_sniff.analysis.relations import AnswerState, answers, with_late
from fte_sniff.formats.cell_text import clock_text, fit_right, short_number
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _
from fte_sniff.protocol.rows import Ints, Rows
from fte_sniff.protocol.spec import (
    FIELD_BY_NAME,
    KINDS,
    NAME_OF_ROLE,
    VALUE_FIELDS,
    Direction,
    Role,
    Status,
)
from fte_sniff.tui.cells import RAISED_MARK, span_text
from fte_sniff.tui.curves import HOLD_NS, SCALE_CELLS, Curves, dots_across, held, plot, time_axis
from fte_sniff.tui.pages import Context, Page, text_of
from fte_sniff.tui.painter import BOLD, PLAIN, Palette, Sign
from fte_sniff.tui.strip import latest, style_of, target_text
from fte_sniff.tui.view import AROUND

SECOND_NS: Final = 1_000_000_000

WINDOWS_NS: Final = tuple(
    seconds * SECOND_NS for seconds in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600)
)

DEFAULT_WINDOW: Final = 3

QUANTITIES: Final = tuple(
    field.name for field in VALUE_FIELDS if any(one.subject == field.name for one in KINDS)
)
"""The fields that a motor has a target of: speed and position."""

FOUR_COLUMNS: Final = 160
TWO_COLUMNS: Final = 68
"""Cells from which on four, or two, cards are side by side."""

LEAST_CARD: Final = 8
"""Lines of a card below which one motor has the whole pane."""

GAP: Final = 2

LANES: Final[Mapping[str, str]] = {
    "unanswered": Sign.UNANSWERED.value,
    "damage": LOOKS[Status.MALFORMED].mark,
    "late": ">",
    "flags": RAISED_MARK,
}
"""Signs of events over time, the most serious first: those of rows, where rows have one."""


@dataclass(frozen=True)
class _Drawing:
    """What all cards share."""

    rows: Rows
    """Those of the plotted time, and some before."""
    events: Mapping[tuple[int, str], Ints]
    """The times of events by motor and name."""
    plotted: tuple[int, int]
    """Start and end of the plots."""
    axis: Sequence[str]
    context: Context

    @property
    def palette(self) -> Palette:
        return self.context.table.palette

    def curves(self, motor: int, name: str, columns: int) -> Curves:
        """Target and feedback of a quantity."""
        found, firsts = [], []
        for direction in (Direction.CONTROL, Direction.FEEDBACK):
            t_ns, values = motor_values(self.rows, motor, direction, name)
            found.append(envelope(t_ns, values, self.plotted, columns))
            before = int(np.searchsorted(t_ns, self.plotted[0]))
            firsts.append(float(values[before - 1]) if before else np.nan)
        per_column = (self.plotted[1] - self.plotted[0]) / columns
        return Curves(
            held(found[0], firsts[0]), held(found[1], columns=max(1, round(HOLD_NS / per_column)))
        )


class MotorsPage(Page):
    """All motors, or one."""

    NAME = "motors"

    def __init__(self) -> None:
        self.window = DEFAULT_WINDOW
        """The number in `WINDOWS_NS` of the time that is plotted."""
        self.chosen: int | None = None
        """The motor that has the whole pane; None for all that fit."""

    def zoom(self, by: int) -> None:
        """Plot more time (`by` 1), or less (-1)."""
        self.window = min(max(0, self.window + by), len(WINDOWS_NS) - 1)

    def title(self, context: Context) -> str:
        """The plotted time, and what the curves are."""
        span = span_text(self._plotted_ns(context))
        title = _("motors, {span}: line feedback, dots target", span=span)
        return f"{title}   {_('1-4: one motor   z Z: time')}"

    def _plotted_ns(self, context: Context) -> int:
        """The window; as many times longer for a finding as it needs to be in the middle."""
        finding, usual = context.view.finding, WINDOWS_NS[DEFAULT_WINDOW]
        if finding is not None:
            usual = 2 * max(finding.last_ns - finding.first_ns, usual)
        return usual * WINDOWS_NS[self.window] // WINDOWS_NS[DEFAULT_WINDOW]

    def text(self, context: Context) -> Text:
        """The cards of the motors."""
        if context.span.now_ns is None:
            return Text(_("no row here has a time"))
        drawing = self._drawing(context, context.span.now_ns)
        width, height = context.size
        columns = 4 if width >= FOUR_COLUMNS else 2 if width >= TWO_COLUMNS else 1
        states, each = context.states, height * columns // len(context.states)
        if self.chosen is not None or each < LEAST_CARD:
            motor = self.chosen or _most_troubled(states).motor
            states, columns, each = [one for one in states if one.motor == motor], 1, height
        card = (width + GAP) // columns - GAP
        table = Table.grid(padding=(0, GAP, 0, 0))
        for _column in range(columns):
            table.add_column(width=card, no_wrap=True)
        cards = [Text("\n").join(_card(one, drawing, card, each)) for one in states]
        for first in range(0, len(cards), columns):
            table.add_row(*cards[first : first + columns])
        return text_of(table, width=width + GAP)

    def _drawing(self, context: Context, now_ns: int) -> _Drawing:
        store, finding = context.view.store, context.view.finding
        length = self._plotted_ns(context)
        end_ns, last = now_ns, _("now")
        if finding is not None:  # in the middle, unless the rows end before
            latest_ns = context.view.last_ns or now_ns
            end_ns = min((finding.first_ns + finding.last_ns + length) // 2, latest_ns)
        if finding is not None or not (context.table.viewport.following and context.view.lives):
            last = clock_text(end_ns, 3, context.table.look.shown_zone)
        plotted = (end_ns - length, end_ns + 1)
        start = max(0, store.index_at(plotted[0]) - AROUND)
        end = context.span.end if finding is None else store.index_at(plotted[1])
        rows = store.batch(start, end)
        axis = (f"-{span_text(length)}", f"-{span_text(length // 2)}", last)
        return _Drawing(rows, _events(rows, store.runs(start, end)), plotted, axis, context)


def _most_troubled(states: Sequence[MotorState]) -> MotorState:
    return min(states, key=lambda one: [*Trouble].index(one.trouble))


def _events(rows: Rows, runs: object) -> dict[tuple[int, str], Ints]:
    """The times of the events of each motor, by motor and name of the lane."""
    pairs = with_late(answers(rows, runs))  # type: ignore[arg-type]
    found = {}
    errors, has_errors = rows.field(NAME_OF_ROLE[Role.ERRORS])
    for motor in range(1, 5):
        own = pairs.filter(pl.col("motor") == motor)
        missed = own.filter(pl.col("state") == AnswerState.UNANSWERED)["command"].to_numpy()
        late = own.filter(pl.col("late"))["answer"].to_numpy()
        found[motor, "unanswered"] = rows.t_ns[missed]
        found[motor, "late"] = rows.t_ns[late]
        found[motor, "damage"] = rows.t_ns[rows.motor_hint == motor]
        raised = has_errors & (errors != 0) & (rows.nums == motor)
        found[motor, "flags"] = rows.t_ns[raised]
    return found


def _card(state: MotorState, drawing: _Drawing, width: int, height: int) -> list[Text]:
    """State and plots of one motor in exactly `height` lines."""
    head = Text(_("motor {number}", number=state.motor), BOLD)
    head.append(f"  {_(state.text)}", style_of(state.trouble, drawing.palette))
    head.append(f"  {' '.join(target_text(state).split())}", PLAIN)
    lines = [head, *_plots(state, drawing, width, height - 1)]
    return [*lines, *(Text() for _ in range(height - len(lines)))][:height]


def _plots(state: MotorState, drawing: _Drawing, width: int, height: int) -> list[Text]:
    """The quantities with values, above each other, with one time axis and the events."""
    columns = dots_across(width)
    if not columns or height < 2:
        return []
    made = {name: drawing.curves(state.motor, name, columns) for name in QUANTITIES}
    shown = {name: one for name, one in made.items() if one.has_values}
    if not shown:
        return []
    present = latest(state, None)
    mode = present.kind.subject if present and present.kind else None
    if height < 4 * len(shown):
        name = mode if mode in shown else next(iter(shown))
        shown = {name: shown[name]}
    below = [time_axis(width, drawing.axis, drawing.palette.muted)] if height > 2 else []
    if height > 3:
        below = [*_lanes(state.motor, drawing, columns // 2), *below]
    lines: list[Text] = []
    for number, (name, curves) in enumerate(shown.items()):
        each = (height - len(below) - len(lines)) // (len(shown) - number)
        unit, size = FIELD_BY_NAME[name].unit, (width, each)
        lines += plot(curves, drawing.palette, size, unit)
    return lines + below


def _lanes(motor: int, drawing: _Drawing, cells: int) -> list[Text]:
    """A line with the signs of events at their times, the most serious of a cell."""
    (start, end), palette = drawing.plotted, drawing.palette
    signs, counts, found = [" "] * cells, 0, ""
    for name, sign in reversed([*LANES.items()]):
        t_ns = drawing.events[motor, name]
        t_ns = t_ns[(t_ns >= start) & (t_ns < end)]
        counts, found = counts + len(t_ns), (sign if len(t_ns) else "") + found
        for at in np.unique((t_ns - start) * cells // (end - start)).tolist():
            signs[at] = sign
    if not counts:
        return []
    label = fit_right(f"{found} {short_number(counts)}", SCALE_CELLS - 1)
    style = palette.statuses[Status.MALFORMED]
    return [Text(f"{label} ", palette.muted).append("".join(signs), style + BOLD)]
