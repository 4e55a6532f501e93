"""Motor cards."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, tzinfo
from typing import Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.fields import subject
from fte_sniff.analysis.motors import Flags, Motors, MotorState
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.analysis.traces import QUANTITIES, Traces
from fte_sniff.protocol import KINDS, MOTORS, VALUE_FIELDS, Direction, Field, FrameKind, Status
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.panes.plot import Curves, Strokes, dots_across, plot
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import UNKNOWN, clock_text, padded, rate_text, span_text, turns_text

SECOND_NS: Final = 1_000_000_000

WINDOWS_NS: Final = tuple(
    seconds * SECOND_NS for seconds in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 14_400)
)
"""How far back the plots may look, nanoseconds."""

DEFAULT_WINDOW: Final = 3
"""Place of the window that is looked through first."""


@dataclass(frozen=True, slots=True)
class MotorsView:
    """The motors as they were at one moment."""

    states: tuple[MotorState, ...]
    traces: Traces
    now_ns: int | None
    """The moment, nanoseconds since 1970 UTC; None where rows have no times."""
    window_ns: int
    """How far back the plots look."""
    bench: LineSetup
    zone: tzinfo = UTC
    """Of times of day."""

    @property
    def window(self) -> tuple[int, int]:
        """Begin and end of what the plots show, nanoseconds since 1970 UTC; the end is outside."""
        end = (self.now_ns or 0) + 1
        return end - self.window_ns, end

    def curves(self, state: MotorState, name: str, columns: int) -> Curves:
        """One quantity of a motor over the window, in so many columns."""
        motor, window = state.motor, self.window
        asked, told = (
            self.traces.resample(motor, direction, name, window, columns)
            for direction in (Direction.CONTROL, Direction.FEEDBACK)
        )
        otherwise = self.traces.other_commands(motor, name, window, columns)
        standing = self._standing(state, name)
        return Curves(asked, told, otherwise, standing, self.window_ns / columns)

    def _standing(self, state: MotorState, name: str) -> int | None:
        """What was asked before the window, also where that is too long ago for the traces."""
        target, start = state.target, self.window[0]
        if target is not None and target.t_ns is not None and target.t_ns < start:
            return target.values[name] if subject(target.kind) == name else None
        return self.traces.target_before(state.motor, name, start)

    def ago_ns(self, t_ns: int | None) -> int | None:
        """How long before the moment something was; None where that is not known."""
        if t_ns is None or self.now_ns is None:
            return None
        return max(0, self.now_ns - t_ns)


def zoomed(place: int, by: int) -> int:
    """The place in `WINDOWS_NS` so many steps on, as far as there are any."""
    return min(max(0, place + by), len(WINDOWS_NS) - 1)


MOTOR: Final = later("motor {number}")
ONLINE: Final = later("online")
OFFLINE: Final = later("OFFLINE")
ONLINE_UNKNOWN: Final = later("online –")
ERROR: Final = later("error {byte:02X}")
ERROR_UNKNOWN: Final = later("error –")
BIT_SET: Final = later("bit {bit} set {time}")
BIT_CLEARED: Final = later("bit {bit} cleared {time}")
BIT_SHORT: Final = "b{bit}={value} {time}"
ERROR_BIT: Final = later("  error bit {bit} is {value} since {time}")
NO_ERROR_BIT: Final = later("  no error bit ever changed")
ONLINE_SINCE: Final = later("  ONLINE bit {bit} is {value} since {time}")
NO_ONLINE_CHANGE: Final = later("  ONLINE bit {bit} never changed")

MOST_BITS: Final = 4
"""Changes of bits of one byte that are told one by one."""

_MILLISECONDS: Final = 3
_BOLD: Final = Style(bold=True)
_PLAIN: Final = Style.null()


def head_line(form: str, state: MotorState, palette: Palette) -> Text:
    """Number, whether it is online, and the error byte."""
    wrong = palette.statuses[Status.MALFORMED] + _BOLD
    text = Text.assemble((form.format(number=state.motor), _BOLD))
    if state.online is None:
        text.append(f" {_(ONLINE_UNKNOWN)}", palette.muted)
    else:
        said, style = (_(ONLINE), _PLAIN) if state.online else (_(OFFLINE), wrong)
        text.append(f" {said}", style)
    error = state.flags.get("error")
    if error is None:
        return text.append(f" {_(ERROR_UNKNOWN)}", palette.muted)
    return text.append(f" {_(ERROR).format(byte=error.byte)}", wrong if error.byte else _PLAIN)


def title_line(look: MotorsView, state: MotorState, width: int, palette: Palette) -> Text:
    """The head with the latest change of the error byte, if it ever changed."""
    text, error = head_line(_(MOTOR), state, palette), state.flags.get("error")
    changes = _changes(error) if error is not None else []
    if error is not None and changes:
        (t_ns, bit), value = changes[0], error.byte >> changes[0][1] & 1
        form = _(BIT_SET if value else BIT_CLEARED)
        second = clock_text(t_ns, 0, look.zone).rstrip(".")
        forms = [form.format(bit=bit, time=clock_text(t_ns, _MILLISECONDS, look.zone))]
        forms.append(form.format(bit=bit, time=second))
        short = BIT_SHORT.format(bit=bit, value=value, time=second)
        fitting = (one for one in forms if text.cell_len + cell_len(one) < width)
        text.append(f" {next(fitting, short)}", palette.muted)
    return text


def _changes(flags: Flags) -> list[tuple[int, int]]:
    """When bits changed, and which, the latest first."""
    changed = enumerate(flags.changed_ns)
    return sorted(((t_ns, bit) for bit, t_ns in changed if t_ns is not None), reverse=True)


def bit_lines(look: MotorsView, state: MotorState, palette: Palette) -> Iterator[Text]:
    """The bits one by one; of those of ERROR, the latest changes."""
    error = state.flags.get("error")
    if error is not None:
        changes = _changes(error)
        for t_ns, bit in changes[:MOST_BITS]:
            yield _bit(ERROR_BIT, bit, error.byte, clock_text(t_ns, _MILLISECONDS, look.zone))
        if not changes:
            yield Text(_(NO_ERROR_BIT), style=palette.muted)
    if state.online is not None:
        bit = state.motor - MOTORS[0]
        if state.online_changed_ns is None:
            yield Text(_(NO_ONLINE_CHANGE).format(bit=bit), style=palette.muted)
        else:
            when = clock_text(state.online_changed_ns, _MILLISECONDS, look.zone)
            yield _bit(ONLINE_SINCE, bit, state.online << bit, when)


def _bit(form: str, bit: int, byte: int, when: str) -> Text:
    return Text(_(form).format(bit=bit, value=byte >> bit & 1, time=when))


MOTOR_BRIEF: Final = "{number}"
TARGET: Final = later("target")
NOW: Final = later("now")
NEVER_ASKED: Final = "–"
AGO: Final = later("{span} ago")
SINCE: Final = later(" since {time}")
COMMANDS: Final = (
    later("{rate} commands, {unanswered:,} of {all:,} unanswered"),
    later("{rate} commands, {unanswered:,} unanswered"),
)
WAITING: Final = later("{rate} commands, no answer for {span}")
FEEDBACK: Final = (
    later("{rate} feedback, {p50} after the command (99 %: {p99})"),
    later("{rate} feedback, {p50} after, p99 {p99}"),
    later("{rate} feedback, {p50} p99 {p99}"),
)
CAPTION: Final = "{kind} [{unit}]"

ROOMY_LINES: Final = 16
"""Lines from which on a card tells bits one by one, and plots both quantities."""

WORD_LINES: Final = 5
"""Lines of words on the smallest card."""

PLOT_LINES: Final = 2
"""Lines that a plot takes at least."""

STALE_NS: Final = SECOND_NS
"""From this age on a value is told with its age."""

_LABEL: Final = 7
_FIELD: Final = {field.name: field for field in VALUE_FIELDS}
_KIND: Final = {subject(kind): kind for kind in reversed(KINDS)}
"""The first kind in the table that is about a quantity."""


@dataclass(frozen=True, slots=True)
class CardSize:
    """The rectangle, in cells."""

    width: int
    height: int

    @property
    def roomy(self) -> bool:
        """Whether there is room for more words, and for both plots."""
        return self.height >= ROOMY_LINES


def brief(look: MotorsView, state: MotorState, width: int, palette: Palette) -> Text:
    """The motor in one line, where there is no room for more."""
    line = head_line(MOTOR_BRIEF, state, palette)
    reading = _reading(look, state, _asked_for(state), palette)
    line.append_text(Text.assemble(" ", reading, "  "))
    line.append_text(Text().join(_target(look, state, palette)))
    line.truncate(width, overflow="ellipsis")
    return line


def compact(
    look: MotorsView, state: MotorState, width: int, height: int, palette: Palette
) -> list[Text]:
    """The motor in fewer lines than a card has."""
    if height < 2:
        return [brief(look, state, width, palette)]
    lines = list(_words(look, state, CardSize(width, height), palette))[:height]
    if height == 2:
        reading = _reading(look, state, _asked_for(state), palette)
        lines[1] = Text.assemble("  ", reading, "  ", *_target(look, state, palette))
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    return lines


def words(look: MotorsView, state: MotorState, size: CardSize, palette: Palette) -> list[Text]:
    """What is said of the motor above its plots."""
    lines = list(_words(look, state, size, palette))
    return lines if size.roomy else lines[: max(WORD_LINES, size.height - PLOT_LINES)]


def plots(look: MotorsView, state: MotorState, size: CardSize, palette: Palette) -> list[Text]:
    """Both quantities where there is much room, else that which the motor is asked for."""
    if size.height < 1 or dots_across(size.width) < 1 or look.now_ns is None:
        return []
    if size.height < len(QUANTITIES) * (PLOT_LINES + 2):
        name = _asked_for(state)
        return _plot(look, state, name, size, palette, _FIELD[name].unit)
    lines: list[Text] = []
    for place, name in enumerate(QUANTITIES):
        height = (size.height - len(lines)) // (len(QUANTITIES) - place)
        caption = CAPTION.format(kind=_KIND[name].name, unit=_FIELD[name].unit)
        lines.append(Text(caption, style=palette.muted))
        lines += _plot(look, state, name, CardSize(size.width, height - 1), palette)
    return lines


def _words(look: MotorsView, state: MotorState, size: CardSize, palette: Palette) -> Iterator[Text]:
    yield title_line(look, state, size.width, palette)
    yield _target_line(look, state, size.width, palette)
    first = _asked_for(state)
    names = [first, *(name for name in QUANTITIES if name != first)]
    readings = [_reading(look, state, name, palette) for name in names]
    if size.roomy:
        yield from (_label(_(NOW), palette) + reading for reading in readings)
    else:
        yield _label(_(NOW), palette) + Text("  ").join(readings)
    yield _commands(look, state, size.width, palette)
    yield _feedback(state, size.width)
    if size.roomy:
        yield from bit_lines(look, state, palette)


def _label(word: str, palette: Palette) -> Text:
    return Text.assemble((padded(word, _LABEL), palette.muted))


def _target(look: MotorsView, state: MotorState, palette: Palette) -> Iterator[Text]:
    target = state.target
    if target is None:
        yield Text(NEVER_ASKED, style=palette.muted)
        return
    yield Text(target.kind.name, style=palette.kinds[target.kind.name])
    for field in _by_use(target.kind):
        if field.name not in target.values:
            continue
        value = target.values[field.name]
        if target.kind.names_motor:
            yield Text(f" {value} {field.unit}")
            turns = turns_text(value, look.bench) if field.name == "pulses" else ""
            yield Text(f" {turns}" if turns else "")
        else:
            yield Text(f" {field.option}={value}")


def _target_line(look: MotorsView, state: MotorState, width: int, palette: Palette) -> Text:
    """The target, with what has room: since when it is the same, and how old the last word is."""
    line = Text.assemble(_label(_(TARGET), palette), *_target(look, state, palette))
    target = state.target
    if target is None:
        return line
    since = Text()
    if target.since_ns is not None:
        time = clock_text(target.since_ns, 1, look.zone)
        since.append(_(SINCE).format(time=time), palette.muted)
    for more in (since, _age(look, target.t_ns, palette)):
        if line.cell_len + more.cell_len <= width:
            line.append_text(more)
    return line


def _by_use(kind: FrameKind) -> list[Field]:
    """The fields of a command; what the motor is asked for comes before how fast it may go."""
    if not kind.names_motor:
        return list(kind.fields)
    return sorted(kind.fields, key=lambda field: field.name != subject(kind))


def _reading(look: MotorsView, state: MotorState, name: str, palette: Palette) -> Text:
    reading, unit = state.present.get(name), _FIELD[name].unit
    if reading is None:
        return Text(f"{UNKNOWN} {unit}", style=palette.muted)
    text = Text.assemble((f"{reading.value} {unit}", _BOLD))
    turns = turns_text(reading.value, look.bench) if name == "pulses" else ""
    text.append(f" {turns}" if turns else "")
    return text.append_text(_age(look, reading.t_ns, palette))


def _age(look: MotorsView, t_ns: int | None, palette: Palette) -> Text:
    """How old something is, where it is no longer fresh."""
    age = look.ago_ns(t_ns)
    if age is None or age < STALE_NS:
        return Text()
    return Text(" " + _(AGO).format(span=span_text(age)), style=palette.muted)


def _commands(look: MotorsView, state: MotorState, width: int, palette: Palette) -> Text:
    rate, waits = rate_text(state.commands_per_s), look.ago_ns(state.waiting_since_ns)
    if waits is not None and waits >= STALE_NS:
        words = _(WAITING).format(rate=rate, span=span_text(waits))
        return Text(words, style=palette.statuses[Status.SUSPECT])
    every = state.answered + state.unanswered
    return _fitting(COMMANDS, width, rate=rate, unanswered=state.unanswered, all=every)


def _feedback(state: MotorState, width: int) -> Text:
    p50, p99 = span_text(state.delay_p50_ns), span_text(state.delay_p99_ns)
    return _fitting(FEEDBACK, width, rate=rate_text(state.feedback_per_s), p50=p50, p99=p99)


def _fitting(forms: Sequence[str], width: int, **values: object) -> Text:
    """The first of some sentences that has room; the last where none has."""
    told = [_(form).format(**values) for form in forms]
    return Text(next((words for words in told if cell_len(words) <= width), told[-1]))


def _asked_for(state: MotorState) -> str:
    """The quantity that the motor's mode is about: of the last command, or of what it tells."""
    asked = subject(state.target.kind) if state.target is not None else None
    if asked in QUANTITIES:
        return asked
    told = [name for name in QUANTITIES if name in state.present]
    return max(told, key=lambda name: state.present[name].t_ns or 0, default=QUANTITIES[0])


def _plot(
    look: MotorsView,
    state: MotorState,
    name: str,
    size: CardSize,
    palette: Palette,
    unit: str = "",
) -> list[Text]:
    curves = look.curves(state, name, dots_across(size.width))
    told = Style(color=palette.kinds[_KIND[name].name].color)
    strokes = Strokes(told=told, asked=palette.asked, scale=palette.muted)
    return plot(curves, strokes, size.width, size.height, unit)


TITLE: Final = later("motors, {span}: line told, dots asked")
AS_OF: Final = later("as of row {row:,}, {time} - G: end")
AS_OF_ROW: Final = later("as of row {row:,} - G: end")
HINT: Final = later("z Z: time   J K: scroll   esc: close")
BEHIND: Final = later("reading: {rows:,} rows to go")

FOUR_ABREAST: Final = 160
"""Cells from which on all motors stand side by side."""

TWO_ABREAST: Final = 68
"""Cells from which on two motors stand side by side."""

LEAST_LINES: Final = 7
"""Lines of a card at least; where there are fewer, the pane scrolls."""

GAP: Final = 2
"""Cells between two cards."""


def grid(look: MotorsView, width: int, height: int, palette: Palette) -> Text:
    """All motors in so many cells; in more lines where they do not fit."""
    abreast = 4 if width >= FOUR_ABREAST else 2 if width >= TWO_ABREAST else 1
    rows = -(-len(look.states) // abreast)
    if abreast == 1 and height < len(look.states) * WORD_LINES:
        return Text("\n").join(_compact(look, width, height, palette))
    size = CardSize((width + GAP) // abreast - GAP, max(LEAST_LINES, height // rows))
    lines: list[Text] = []
    for first in range(0, len(look.states), abreast):
        for parts in zip(
            *_row(look, look.states[first : first + abreast], size, palette), strict=True
        ):
            for part in parts[:-1]:
                part.pad_right(size.width + GAP - part.cell_len)
            lines.append(Text().join(parts))
    return Text("\n").join(lines)


def _compact(look: MotorsView, width: int, height: int, palette: Palette) -> Iterator[Text]:
    """One below the other in all lines that there are; the first motors get what is left over."""
    each, more = divmod(height, len(look.states))
    for place, state in enumerate(look.states):
        yield from compact(look, state, width, each + (place < more), palette)


def _row(
    look: MotorsView, states: Sequence[MotorState], size: CardSize, palette: Palette
) -> Iterator[list[Text]]:
    """Cards side by side, equally long; their plots begin on one line."""
    said = [words(look, state, size, palette) for state in states]
    most = min(size.height, max(len(lines) for lines in said))
    for state, lines in zip(states, said, strict=True):
        lines = lines[:most] + [Text() for _ in range(most - len(lines))]
        lines += plots(look, state, CardSize(size.width, size.height - most), palette)
        lines += [Text() for _ in range(size.height - len(lines))]
        for line in lines:
            line.truncate(size.width, overflow="ellipsis")
        yield lines


def _as_of(sight: PaneContext) -> str:
    """Which row is looked at, and the way to the newest; empty where that is looked at."""
    if sight.following or sight.row is None:
        return ""
    if sight.row.t_ns is None:
        return _(AS_OF_ROW).format(row=sight.place)
    time = clock_text(sight.row.t_ns, _MILLISECONDS, sight.zone)
    return _(AS_OF).format(row=sight.place, time=time)


@dataclass(frozen=True, slots=True)
class _Past:
    """What was found out about a row of the past, so that it is found out once."""

    index: int
    window_ns: int
    motors: Motors
    traces: Traces


class MotorsPane(Pane):
    """All motors at the cursor's row, or now."""

    EVERY_S = 1 / 6

    def __init__(self) -> None:
        super().__init__(HINT)
        self._window = DEFAULT_WINDOW
        self._past: _Past | None = None

    def zoom(self, by: int) -> None:
        """Look further back (by 1), or less far (by -1)."""
        self._window = zoomed(self._window, by)

    def see(self, sight: PaneContext) -> None:
        """Draw the motors as they were when the cursor's row had come."""
        title = _(TITLE).format(span=span_text(WINDOWS_NS[self._window]))
        as_of = _as_of(sight)
        self.entitle(*((f"{title}   {as_of}", as_of) if as_of else (title,)))
        look = self._look(sight)
        if look is None:
            self.draw(Text(_(BEHIND).format(rows=sight.models.pending)))
            return
        room = self.room
        self.draw(grid(look, room.width, room.height, sight.palette))

    def _look(self, sight: PaneContext) -> MotorsView | None:
        models, now_ns, window_ns = sight.models, sight.now_ns, WINDOWS_NS[self._window]
        if sight.following or sight.index is None:
            self._past = None
            motors, traces = models.motors, models.traces
        else:
            past = self._looked_back(sight, sight.index, window_ns)
            if past is None:
                return None
            motors, traces = past.motors, past.traces
        states = tuple(motors.states(now_ns))
        return MotorsView(states, traces, now_ns, window_ns, sight.bench, sight.zone)

    def _looked_back(self, sight: PaneContext, index: int, window_ns: int) -> _Past | None:
        past = self._past
        if past is not None and (past.index, past.window_ns) == (index, window_ns):
            return past
        motors = sight.models.motors_at(index)
        if motors is None:
            return None
        traces = sight.models.traces_at(index, (sight.now_ns or 0) - window_ns)
        self._past = _Past(index, window_ns, motors, traces)
        return self._past
