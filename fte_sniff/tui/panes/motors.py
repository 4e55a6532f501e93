"""Motors pane: a card for each motor with its target, feedback, flags and plots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from typing import Final

from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.motors import Flags, MotorEvent, MotorEvents, Motors, MotorState
from fte_sniff.analysis.plots import QUANTITIES, Traces
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.formats.cell_text import (
    UNKNOWN,
    clock_text,
    fit_right,
    padded,
    rate_text,
    short_number,
)
from fte_sniff.protocol import (
    KINDS,
    Direction,
    Field,
    FrameKind,
    Row,
    Status,
)
from fte_sniff.protocol.columns import LOOKS
from fte_sniff.protocol.rows import Ints
from fte_sniff.protocol.spec import FIELD_BY_NAME, NAME_OF_ROLE, Role, online_bit_text
from fte_sniff.tui.cells import RAISED_MARK, first_fitting, span_text, turns_text
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.painter import BOLD, PLAIN, Palette, Sign
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.panes.plot import (
    SCALE_CELLS,
    Curves,
    dots_across,
    fine_columns,
    has_values,
    plot,
    time_axis,
)

SECOND_NS: Final = 1_000_000_000

WINDOWS_NS: Final = tuple(
    seconds * SECOND_NS for seconds in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 14_400)
)

DEFAULT_WINDOW: Final = 3


@dataclass(frozen=True, slots=True)
class MotorsView:
    """State of the motors at one moment."""

    states: tuple[MotorState, ...]
    traces: Traces
    events: MotorEvents
    now_ns: int | None
    """The moment, nanoseconds since 1970 UTC; None where rows have no times."""
    window_ns: int
    line_setup: LineSetup
    zone: tzinfo = UTC
    end: str = ""
    full_range: bool = False
    chosen: int | None = None
    """The motor that has the whole pane; None for all that fit."""
    of_row: int | None = None
    """The motor of the cursor's row."""

    @property
    def window(self) -> tuple[int, int]:
        """Start and exclusive end of the plots, nanoseconds since 1970 UTC."""
        end = (self.now_ns or 0) + 1
        return end - self.window_ns, end

    def curves(self, state: MotorState, name: str, columns: int) -> Curves:
        """Curves of one quantity of a motor over the window, in that many columns."""
        motor, window = state.motor, self.window
        target, feedback = (
            self.traces.resample(motor, direction, name, window, columns)
            for direction in (Direction.CONTROL, Direction.FEEDBACK)
        )
        ended = self.traces.other_commands(motor, name, window, columns)
        first = self._target_before(state, name)
        return Curves(target, feedback, ended, first, self.window_ns / columns)

    def _target_before(self, state: MotorState, name: str) -> int | None:
        """The target at the start of the window, also where it is too old for the traces."""
        target, start = state.target, self.window[0]
        if target is not None and target.t_ns is not None and target.t_ns < start:
            return target.values[name] if target.kind.subject == name else None
        return self.traces.target_before(state.motor, name, start)

    def age_ns(self, t_ns: int | None) -> int | None:
        """Age of a time at the moment; None where it is unknown."""
        if t_ns is None or self.now_ns is None:
            return None
        return max(0, self.now_ns - t_ns)

    def clock(self, t_ns: int, digits: int = 3) -> str:
        """Time of day in the zone; without a fraction for 0 digits."""
        return clock_text(t_ns, digits, self.zone).rstrip(".")


ERRORS: Final = NAME_OF_ROLE[Role.ERRORS]
ONLINE: Final = later("online")
OFFLINE: Final = later("OFFLINE")
ERROR: Final = later("error {byte:02X}")
WINDOW: Final = (
    later("{rate} commands, last {span}: {unanswered:,} of {all:,} unanswered"),
    later("{rate}, last {span}: {unanswered:,} of {all:,} unanswered"),
    later("last {span}: {unanswered:,} of {all:,} unanswered"),
)
COMMANDS: Final = (
    later("{rate} commands, {unanswered:,} of {all:,} unanswered"),
    later("{rate} commands, {unanswered:,} unanswered"),
)
FEEDBACK: Final = (
    later("{rate} feedback, {p50} after the command (99 %: {p99})"),
    later("{rate} feedback, {p50} after, p99 {p99}"),
    later("{rate} feedback, {p50} p99 {p99}"),
)

MAX_BIT_LINES: Final = 4
"""Bit changes of ERROR that have a line each."""

TALL_LINES: Final = 20
"""Lines from which on a card lists bits and plots both quantities."""

TEXT_LINES: Final = 5

PLOT_LINES: Final = 2

LEAST_DOTS: Final = 10
"""Columns of dots of the smallest plot beside another."""

STALE_NS: Final = SECOND_NS
"""Age from which on a value is shown with its age."""

_LABEL_WIDTH: Final = 7
_KIND: Final = {kind.subject: kind for kind in reversed(KINDS)}
"""The first kind in the frame table about each quantity."""


@dataclass(frozen=True, slots=True)
class MotorCard:
    """Text and plots of one motor."""

    view: MotorsView
    state: MotorState
    palette: Palette

    def lines(self, height: int, width: int) -> list[Text]:
        """The text above the plots; cut on a card that is not tall."""
        tall = height >= TALL_LINES
        lines = list(self._text(width, tall))
        return lines if tall else lines[: max(TEXT_LINES, height - PLOT_LINES)]

    def compact(self, height: int, width: int) -> list[Text]:
        """The motor in fewer lines than a card has."""
        values = Text.assemble(" ", self._reading(self._quantity), "  ", *self._target())
        if height < 2:
            lines = [self._head(f"{self.state.motor}").append_text(values)]
        else:
            lines = list(self._text(width, tall=False))[:height]
            if height == 2:
                lines[1] = Text(" ").append_text(values)
        for line in lines:
            line.truncate(width, overflow="ellipsis")
        return lines

    def plots(self, height: int, width: int) -> list[Text]:
        """What the motor has values of in the window, above each other or side by side."""
        if height < 1 or dots_across(width) < 1 or self.view.now_ns is None:
            return []
        each = (width + 1) // len(QUANTITIES) - 1
        low = height < len(QUANTITIES) * (PLOT_LINES + 1) + 1
        names: Iterable[str] = QUANTITIES
        if low and dots_across(each) >= LEAST_DOTS:
            shown = self._shown(names, each)
            if len(shown) > 1:
                parts = (self._stacked({name: shown[name]}, height, each) for name in shown)
                return [Text(" ").join(line) for line in zip(*parts, strict=True)]
            names = list(shown)
        shown = self._shown(names, width)
        if low and len(shown) > 1:
            name = self._quantity if self._quantity in shown else next(iter(shown))
            shown = {name: shown[name]}
        return self._stacked(shown, height, width)

    def _shown(self, names: Iterable[str], width: int) -> dict[str, Curves]:
        """The quantities with values in the window, or else that of the mode."""
        fine = {name: self._curves(name, width) for name in names}
        shown = {name: curves for name, curves in fine.items() if has_values(curves)}
        return shown or {self._quantity: self._curves(self._quantity, width)}

    def _stacked(self, shown: Mapping[str, Curves], height: int, width: int) -> list[Text]:
        """Plots above each other, with one time axis."""
        names = list(shown)
        below = [self._axis(width)] if height > PLOT_LINES * len(names) else []
        below = self._lanes(width, height - PLOT_LINES * len(names) - len(below)) + below
        lines: list[Text] = []
        for number, name in enumerate(names):
            each = (height - len(below) - len(lines)) // (len(names) - number)
            caption = [self._caption(name)] if len(names) > 1 and each > PLOT_LINES else []
            lines += caption
            lines += self._plot(name, shown[name], each - len(caption), width, not caption)
        return lines + below

    def _lanes(self, width: int, height: int) -> list[Text]:
        """A line for each kind of event in the window, or one for all where lines are few."""
        across, view = width - SCALE_CELLS, self.view
        if across < 1 or height < 1:
            return []
        ticks = {
            event: view.events.ticks(self.state.motor, event, view.window, across)
            for event in MotorEvent
        }
        found = [event for event in MotorEvent if ticks[event].any()]
        if len(found) * 2 <= height:
            return [self._lane(ticks, [event]) for event in found]
        return [self._lane(ticks, found)] if found else []

    def _lane(self, ticks: Mapping[MotorEvent, Ints], events: Sequence[MotorEvent]) -> Text:
        """The signs of events at their times, the gravest of a cell; the label has all signs."""
        styles = {event: _style_of(event, self.palette) for event in events}
        count = short_number(sum(int(ticks[event].sum()) for event in events))
        signs = "".join(LANES[event] for event in events)
        forms = (f"{signs} {count}", f"{signs}{count}", f"{signs[0]}… {count}")
        label = first_fitting(forms, SCALE_CELLS - 1)
        line = Text(fit_right(label, SCALE_CELLS - 1) + " ", style=self.palette.muted)
        for cell in zip(*(ticks[event].tolist() for event in events), strict=True):
            worst = next((one for one, count in zip(events, cell, strict=True) if count), None)
            line.append(*((" ", None) if worst is None else (LANES[worst], styles[worst])))
        return line

    def _caption(self, name: str) -> Text:
        text = f"{_KIND[name].name} [{FIELD_BY_NAME[name].unit}]"
        return Text(text, style=self.palette.muted)

    def _axis(self, width: int) -> Text:
        span, half = span_text(self.view.window_ns), span_text(self.view.window_ns / 2)
        return time_axis(width, span, half, self.view.end, self.palette.muted)

    def _text(self, width: int, tall: bool) -> Iterator[Text]:
        yield self._title(width)
        yield self._target_line(width)
        names = sorted(QUANTITIES, key=lambda name: name != self._quantity)
        readings = [self._reading(name) for name in names]
        for reading in readings if tall else [Text("  ").join(readings)]:
            yield self._label(_("now")) + reading
        yield self._commands(width)
        yield self._feedback(width)
        if tall:
            yield from self._bit_lines()

    def _head(self, name: str) -> Text:
        state, wrong = self.state, self.palette.statuses[Status.MALFORMED] + BOLD
        text = Text.assemble((name, BOLD))
        if state.online is None:
            text.append(f" {_('online –')}", self.palette.muted)
        else:
            word, style = (_(ONLINE), PLAIN) if state.online else (_(OFFLINE), wrong)
            text.append(f" {word}", style)
        error = state.flags.get(ERRORS)
        if error is None:
            return text.append(f" {_('error –')}", self.palette.muted)
        return text.append(f" {_(ERROR, byte=error.byte)}", wrong if error.byte else PLAIN)

    def _title(self, width: int) -> Text:
        """The head with the latest change of the error byte."""
        text = self._head(_("motor {number}", number=self.state.motor))
        error = self.state.flags.get(ERRORS)
        changes = _changes(error) if error is not None else []
        if error is not None and changes:
            t_ns, bit = changes[0]
            value, second = error.byte >> bit & 1, self.view.clock(t_ns, 0)
            form = _("bit {bit} set {time}") if value else _("bit {bit} cleared {time}")
            forms = [form.format(bit=bit, time=time) for time in (self.view.clock(t_ns), second)]
            forms += [_(" since {time}", time=second).strip(), second]
            change = first_fitting(forms, width - text.cell_len - 1)
            text.append(f" {change}", self.palette.muted)
        return text

    def _bit_lines(self) -> Iterator[Text]:
        """Bits of ERROR that changed last, and the motor's bit of ONLINE."""
        state, error = self.state, self.state.flags.get(ERRORS)
        if error is not None:
            changes = _changes(error)
            for t_ns, bit in changes[:MAX_BIT_LINES]:
                form, value = _("  error bit {bit} is {value} since {time}"), error.byte >> bit & 1
                yield Text(form.format(bit=bit, value=value, time=self.view.clock(t_ns)))
            if not changes:
                yield Text(_("  no error bit ever changed"), style=self.palette.muted)
        if state.online is not None:
            own = _(online_bit_text(state.motor))
            if state.online_changed_ns is None:
                yield Text(_("  {bit} never changed", bit=own), style=self.palette.muted)
            else:
                form, value = _("  {bit} is {value} since {time}"), int(state.online)
                time = self.view.clock(state.online_changed_ns)
                yield Text(form.format(bit=own, value=value, time=time))

    def _label(self, word: str) -> Text:
        return Text.assemble((padded(word, _LABEL_WIDTH), self.palette.muted))

    def _target(self) -> Iterator[Text]:
        target = self.state.target
        if target is None:
            yield Text(UNKNOWN, style=self.palette.muted)
            return
        yield Text(target.kind.name, style=self.palette.kinds[target.kind.name])
        for field in _by_importance(target.kind):
            if field.name not in target.values:
                continue
            value = target.values[field.name]
            if target.kind.names_motor:
                yield Text(f" {value} {field.unit}{self._turns(field, value)}")
            else:
                yield Text(f" {field.option}={value}")

    def _turns(self, field: Field, value: int) -> str:
        is_position = field.role is Role.POSITION
        turns = turns_text(value, self.view.line_setup) if is_position else ""
        return f" {turns}" if turns else ""

    def _target_line(self, width: int) -> Text:
        """The target; where it fits, since when it is the same, and the last command's age."""
        line, target = Text.assemble(self._label(_("target")), *self._target()), self.state.target
        if target is None:
            return line
        since = Text()
        if target.since_ns is not None:
            time = self.view.clock(target.since_ns, 1)
            since.append(_(" since {time}", time=time), self.palette.muted)
        for more in (since, self._age(target.t_ns)):
            if line.cell_len + more.cell_len <= width:
                line.append_text(more)
        return line

    def _reading(self, name: str) -> Text:
        reading, field = self.state.present.get(name), FIELD_BY_NAME[name]
        if reading is None:
            return Text(f"{UNKNOWN} {field.unit}", style=self.palette.muted)
        turns = self._turns(field, reading.value)
        text = Text.assemble((f"{reading.value} {field.unit}", BOLD), turns)
        return text.append_text(self._age(reading.t_ns))

    def _age(self, t_ns: int | None) -> Text:
        """The age of a value, where it is stale."""
        age = self.view.age_ns(t_ns)
        if age is None or age < STALE_NS:
            return Text()
        return Text(" " + _("{span} ago", span=span_text(age)), style=self.palette.muted)

    def _commands(self, width: int) -> Text:
        state = self.state
        rate = _rate_or_count(state.commands_per_s, state.commands)
        wait_ns = self.view.age_ns(state.waiting_since_ns)
        if wait_ns is not None and wait_ns >= STALE_NS:
            text = _("{rate} commands, no answer for {span}", rate=rate, span=span_text(wait_ns))
            return Text(text, style=self.palette.statuses[Status.SUSPECT])
        if self.view.now_ns is None:
            total = state.answered + state.unanswered
            values = {"rate": rate, "unanswered": state.unanswered, "all": total}
            return Text(first_fitting((_(form, **values) for form in COMMANDS), width))
        counts = self.view.events.counts(state.motor, self.view.window)
        values = {"rate": rate, "unanswered": counts.unanswered, "all": counts.asked}
        values["span"] = span_text(self.view.window_ns)
        style = self.palette.statuses[Status.MALFORMED] if counts.unanswered else PLAIN
        return Text(first_fitting((_(form, **values) for form in WINDOW), width), style=style)

    def _feedback(self, width: int) -> Text:
        state = self.state
        values = {"rate": _rate_or_count(state.feedback_per_s, state.feedback)}
        values |= {"p50": span_text(state.delay_p50_ns), "p99": span_text(state.delay_p99_ns)}
        forms = (_("{rate} feedback"),) if state.delay_p50_ns is None else FEEDBACK
        return Text(first_fitting((_(form, **values) for form in forms), width))

    @property
    def _quantity(self) -> str:
        """The quantity of the motor's mode: of the last command, or of the newest feedback."""
        commanded = self.state.target.kind.subject if self.state.target is not None else None
        if commanded in QUANTITIES:
            return commanded
        present = self.state.present
        names = [name for name in QUANTITIES if name in present]
        return max(names, key=lambda name: present[name].t_ns or 0, default=QUANTITIES[0])

    def _curves(self, name: str, width: int) -> Curves:
        return self.view.curves(self.state, name, fine_columns(width))

    def _plot(self, name: str, curves: Curves, height: int, width: int, unit: bool) -> list[Text]:
        feedback = Style(color=self.palette.kinds[_KIND[name].name].color)
        text, full_range = FIELD_BY_NAME[name].unit if unit else "", self.view.full_range
        return plot(curves, feedback, self.palette, width, height, text, full_range=full_range)


def _rate_or_count(per_s: float | None, count: int) -> str:
    """The rate; the number of frames where it is unknown, as after the end."""
    return f"{count:,}" if per_s is None else rate_text(per_s)


def _changes(flags: Flags) -> list[tuple[int, int]]:
    """Time and number of each bit that changed, the latest first."""
    changed = enumerate(flags.changed_ns)
    return sorted(((t_ns, bit) for bit, t_ns in changed if t_ns is not None), reverse=True)


def _by_importance(kind: FrameKind) -> list[Field]:
    """The fields of a command; the target is before its limit."""
    if not kind.names_motor:
        return list(kind.fields)
    return sorted(kind.fields, key=lambda field: field.name != kind.subject)


LANES: Final[Mapping[MotorEvent, str]] = {
    MotorEvent.UNANSWERED: Sign.UNANSWERED,
    MotorEvent.DAMAGE: LOOKS[Status.MALFORMED].mark,
    MotorEvent.LATE: ">",
    MotorEvent.FLAGS: RAISED_MARK,
}
"""Signs of events in their lanes, those of rows where rows have one."""


def _style_of(event: MotorEvent, palette: Palette) -> Style:
    if event is MotorEvent.FLAGS:
        return palette.raised
    status = Status.SUSPECT if event is MotorEvent.LATE else Status.MALFORMED
    return palette.statuses[status] + BOLD


FOUR_COLUMNS: Final = 160
"""Cells from which on all cards are side by side."""

TWO_COLUMNS: Final = 68
"""Cells from which on two cards are side by side."""

MIN_CARD_LINES: Final = 7
"""Lines of a card; where there are fewer, the pane scrolls."""

LEAST_CARD: Final = 10
"""Lines of a card below which one motor has the whole pane."""

GAP: Final = 2


def grid(view: MotorsView, width: int, height: int, palette: Palette) -> Text:
    """All cards in `width` cells; in more than `height` lines where they do not fit."""
    cards = [MotorCard(view, state, palette) for state in view.states]
    columns = 4 if width >= FOUR_COLUMNS else 2 if width >= TWO_COLUMNS else 1
    if columns == 1 and view.chosen is None and height < len(cards) * TEXT_LINES:
        each, rest = divmod(height, len(cards))
        texts = (card.compact(each + (n < rest), width) for n, card in enumerate(cards))
        return Text("\n").join(line for lines in texts for line in lines)
    card_height = max(MIN_CARD_LINES, height // -(-len(cards) // columns))
    if view.chosen is not None or (height > MIN_CARD_LINES and card_height < LEAST_CARD):
        motor = _motor_of(view) if view.chosen is None else view.chosen
        cards = [card for card in cards if card.state.motor == motor]
        columns, card_height = 1, height
    card_width = (width + GAP) // columns - GAP
    lines: list[Text] = []
    for first in range(0, len(cards), columns):
        row = _card_row(cards[first : first + columns], card_height, card_width)
        for parts in zip(*row, strict=True):
            for part in parts[:-1]:
                part.pad_right(card_width + GAP - part.cell_len)
            lines.append(Text().join(parts))
    return Text("\n").join(lines)


def _motor_of(view: MotorsView) -> int:
    """The motor with the most events in the window, else that of the row, else the first."""

    def rank(state: MotorState) -> tuple[int, bool]:
        counts = view.events.counts(state.motor, view.window)
        return sum(counts.events.values()), state.motor == view.of_row

    return max(view.states, key=rank).motor


def _card_row(cards: Sequence[MotorCard], height: int, width: int) -> Iterator[list[Text]]:
    """Cards of one height; their plots begin on the same line."""
    texts = [card.lines(height, width) for card in cards]
    text_height = min(height, max(len(lines) for lines in texts))
    for card, lines in zip(cards, texts, strict=True):
        lines = lines[:text_height] + [Text() for _ in range(text_height - len(lines))]
        lines += card.plots(height - text_height, width)
        lines += [Text() for _ in range(height - len(lines))]
        for line in lines:
            line.truncate(width, overflow="ellipsis")
        yield lines


def _as_of(context: PaneContext) -> str:
    """The row whose time is shown, and the key to the end; empty while rows come at the end."""
    if context.following and context.rates_ns is None and context.newest_ns is not None:
        return _("at the end, {time}", time=clock_text(context.newest_ns, 3, context.zone))
    if context.following or context.row is None:
        return ""
    if context.row.t_ns is None:
        return _("as of row {row:,} - G: end", row=context.row_number)
    time = clock_text(context.row.t_ns, 3, context.zone)
    return _("as of row {row:,}, {time} - G: end", row=context.row_number, time=time)


class MotorsPane(Pane):
    """All motors at the cursor's row, or now."""

    NAME = "motors"
    REDRAW_S = 1 / 6
    HINT = later("1-4: one motor   z Z: time   r: range   esc: close")

    def __init__(self) -> None:
        super().__init__()
        self._window = DEFAULT_WINDOW
        self._full_range = False
        self.chosen: int | None = None
        """The motor that has the whole screen; None for all."""
        self._past: tuple[int, int, Motors, Traces, MotorEvents] | None = None
        """State at the index of a row, with traces and events over a time span."""

    def zoom(self, by: int) -> None:
        """Plot a longer (`by` 1) or shorter (-1) time span."""
        self._window = min(max(0, self._window + by), len(WINDOWS_NS) - 1)

    def switch_range(self) -> None:
        """Plot outliers too, or leave them out."""
        self._full_range = not self._full_range

    def draw(self, context: PaneContext) -> None:
        """Draw the motors as they were at the cursor's row."""
        title = _("motors, {span}: line actual, dashes target")
        if self._full_range:
            title = _("motors, {span}, full range: line actual, dashes target")
        title = title.format(span=span_text(WINDOWS_NS[self._window]))
        as_of = _as_of(context)
        parts = [part for part in (title, context.merged_text, as_of) if part]
        self.set_title(*("   ".join(parts[first:]) for first in range(len(parts))))
        view = self._view(context)
        if view is None:
            self.set_page(Text(_("reading: {rows:,} rows to go", rows=context.models.pending)))
            return
        size = self.page_size
        self.set_page(grid(view, size.width, size.height, context.palette))

    def _view(self, context: PaneContext) -> MotorsView | None:
        models, now_ns, window_ns = context.models, context.now_ns, WINDOWS_NS[self._window]
        motors, traces, events = models.motors, models.traces, models.events
        if context.following or context.index is None:
            self._past = None
        else:
            wanted = (context.index, window_ns)
            if self._past is None or self._past[:2] != wanted:
                past = models.motors_at(context.index)
                if past is None:
                    return None
                since_ns = (now_ns or 0) - window_ns
                self._past = (*wanted, past, *models.past(context.index, since_ns))
            motors, traces, events = self._past[2:]
        end = _("now")
        if _as_of(context):
            end = clock_text(now_ns or 0, 3, context.zone)
        return MotorsView(
            tuple(motors.states(now_ns)),
            traces,
            events,
            now_ns,
            window_ns,
            context.line_setup,
            context.zone,
            end,
            self._full_range,
            self.chosen,
            None if context.row is None or context.following else _motor_of_row(context.row),
        )


def _motor_of_row(row: Row) -> int | None:
    """The motor that a row names or, if it is damaged, probably belonged to."""
    values = row.values
    return values.get(NAME_OF_ROLE[Role.MOTOR], row.motor_hint)
