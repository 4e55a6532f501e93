"""Owns one motor in a rectangle of text: what it was asked, what it tells, and the plots.

It must not know Textual, nor how many motors stand side by side. The most useful lines come first;
what there is room for below them is for the plots, and where there is much room, for more words.

    motor 1 online error 04 b2 12:00:03
    target speed 1000 RPM
    now    998 RPM  2500 pulses 3.2 s ago
    12.5/s commands, 3 of 1,240 unanswered
    50.0/s feedback, 2.1 ms after, p99 4 ms
      1000 ⣀⡠⠤⠒⠒⠉⠉ ...
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.fields import subject
from fte_sniff.analysis.motors import MotorState
from fte_sniff.analysis.traces import QUANTITIES
from fte_sniff.protocol import KINDS, VALUE_FIELDS, Field, FrameKind, Status
from fte_sniff.tui.fitting import padded
from fte_sniff.tui.language import _, later
from fte_sniff.tui.motors.flag_lines import bit_lines, head_line, title_line
from fte_sniff.tui.motors.look import SECOND_NS, MotorsLook
from fte_sniff.tui.motors.plot import Strokes, dots_across, plot
from fte_sniff.tui.quantities import UNKNOWN, rate_text, span_text, turns_text
from fte_sniff.tui.table.cells import clock_text
from fte_sniff.tui.table.palette import Palette

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
_MILLISECONDS: Final = 3
_BOLD: Final = Style(bold=True)
_PLAIN: Final = Style.null()
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


def brief(look: MotorsLook, state: MotorState, width: int, palette: Palette) -> Text:
    """The motor in one line, where there is no room for more."""
    line = head_line(MOTOR_BRIEF, state, palette)
    reading = _reading(look, state, _asked_for(state), palette)
    line.append_text(Text.assemble(" ", reading, "  "))
    line.append_text(Text().join(_target(look, state, palette)))
    line.truncate(width, overflow="ellipsis")
    return line


def compact(
    look: MotorsLook, state: MotorState, width: int, height: int, palette: Palette
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


def words(look: MotorsLook, state: MotorState, size: CardSize, palette: Palette) -> list[Text]:
    """What is said of the motor above its plots."""
    lines = list(_words(look, state, size, palette))
    return lines if size.roomy else lines[: max(WORD_LINES, size.height - PLOT_LINES)]


def plots(look: MotorsLook, state: MotorState, size: CardSize, palette: Palette) -> list[Text]:
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


def _words(look: MotorsLook, state: MotorState, size: CardSize, palette: Palette) -> Iterator[Text]:
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


def _target(look: MotorsLook, state: MotorState, palette: Palette) -> Iterator[Text]:
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


def _target_line(look: MotorsLook, state: MotorState, width: int, palette: Palette) -> Text:
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


def _reading(look: MotorsLook, state: MotorState, name: str, palette: Palette) -> Text:
    reading, unit = state.present.get(name), _FIELD[name].unit
    if reading is None:
        return Text(f"{UNKNOWN} {unit}", style=palette.muted)
    text = Text.assemble((f"{reading.value} {unit}", _BOLD))
    turns = turns_text(reading.value, look.bench) if name == "pulses" else ""
    text.append(f" {turns}" if turns else "")
    return text.append_text(_age(look, reading.t_ns, palette))


def _age(look: MotorsLook, t_ns: int | None, palette: Palette) -> Text:
    """How old something is, where it is no longer fresh."""
    age = look.ago_ns(t_ns)
    if age is None or age < STALE_NS:
        return Text()
    return Text(" " + _(AGO).format(span=span_text(age)), style=palette.muted)


def _commands(look: MotorsLook, state: MotorState, width: int, palette: Palette) -> Text:
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
    look: MotorsLook,
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
