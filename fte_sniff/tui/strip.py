"""The motor strip: which motor is in trouble, at a glance.

1 ok           speed    1000 →  998 RPM   answers 100 %   p99 3.1 ms
3 unanswered   speed    1000 →  612 RPM   answers  71 %   p99 5.9 ms   since 12:00:30
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from rich.style import Style
from rich.text import Text
from textual.events import Click
from textual.reactive import reactive
from textual.widget import Widget

from fte_sniff.analysis.motors import MotorState, Trouble
from fte_sniff.formats.cell_text import UNKNOWN, fit, padded
from fte_sniff.i18n import _
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import FIELD_BY_NAME, MOTORS, Direction, Status
from fte_sniff.tui.painter import BOLD, PLAIN, Palette

LOW: Final = 20
"""Lines of the terminal from which on each motor has a line."""

_WARNINGS: Final = frozenset({Trouble.LATE, Trouble.OFF_TARGET})


def style_of(trouble: Trouble, palette: Palette) -> Style:
    """The colour of a motor's state."""
    match trouble:
        case Trouble.NONE:
            return palette.good
        case Trouble.UNKNOWN:
            return palette.muted
        case one if one in _WARNINGS:
            return palette.statuses[Status.SUSPECT] + BOLD
        case _:
            return palette.statuses[Status.MALFORMED] + BOLD


def target_text(state: MotorState) -> str:
    """Mode, target → present value, and unit; a dash for what is unknown."""
    target = state.target
    asked = target.kind if target else None
    subject = asked.subject if asked and asked.names_motor else None
    goal = f"{target.values[subject]}" if target and subject else ""
    present = latest(state, subject)
    reported = present.kind if present else None
    kind = asked or reported
    if kind is None:
        return UNKNOWN
    subject = subject or (reported.subject if reported else None)
    now = f"{present.values[subject]}" if present and subject else UNKNOWN
    mode = kind.name.removesuffix(f"_{Direction.FEEDBACK}")
    unit = FIELD_BY_NAME[subject].unit if subject else ""
    return f"{fit(mode, 8)} {goal:>6} → {now:>6} {padded(unit, 6)}"


def latest(state: MotorState, subject: str | None) -> Row | None:
    """The latest feedback about a quantity, or about any."""
    found = [one for one in state.present if one.kind and subject in (None, one.kind.subject)]
    return max(found, key=lambda one: one.t_ns or 0, default=None)


def motor_line(
    state: MotorState,
    width: int,
    palette: Palette,
    clock: Callable[[int], str],
    since_ns: int | None = None,
) -> Text:
    """State, target and feedback, and answers and since when as far as there is room.

    The time of the answers comes first where these are late.
    """
    asked = state.answered + state.unanswered
    line = Text.assemble(
        f" {state.motor} ",
        (fit(_(state.text), 12), style_of(state.trouble, palette)),
        f" {target_text(state)}",
    )
    answers = _("answers {percent:>3.0f} %", percent=100 * state.answered / asked) if asked else ""
    is_wrong = state.trouble in (Trouble.UNANSWERED, Trouble.SILENT)
    wrong = palette.statuses[Status.MALFORMED] if is_wrong else PLAIN
    delay = f"p99 {state.delay_p99_ns / 1e6:.1f} ms" if state.delay_p99_ns is not None else ""
    since = _("since {time}", time=clock(since_ns)) if since_ns is not None else ""
    shares, times = Text(padded(answers, 13), wrong), Text(padded(delay, 11), palette.muted)
    parts = [shares, Text(since), times]
    if width >= line.cell_len + sum(part.cell_len + 2 for part in parts):
        parts = [shares, times, Text(since)]
    elif state.trouble is Trouble.LATE:
        parts = [Text(padded(delay, 13), style_of(state.trouble, palette)), Text(since)]
    for part in parts:
        if part and line.cell_len + 2 + part.cell_len <= width:
            line.append("  ").append_text(part)
    return line


def strip_text(
    states: Sequence[MotorState],
    size: tuple[int, int],
    palette: Palette,
    clock: Callable[[int], str],
    since: dict[int, int],
    chosen: int | None = None,
) -> Text:
    """All motors in `size` (width and height): a line for each, or one line of four cells."""
    width, height = size
    lines = [motor_line(one, width, palette, clock, since.get(one.motor)) for one in states]
    if height < len(states):
        cells = [
            Text(f" {one.motor} ").append(
                fit(_(one.text), width // len(states) - 3), style_of(one.trouble, palette)
            )
            for one in states
        ]
        lines = [Text().join(cells)]
    for state, line in zip(states, lines, strict=False):
        if height >= len(states) and state.motor == chosen:
            line.pad_right(width - line.cell_len)
            line.stylize("reverse")
    text = Text("\n").join(lines)
    text.no_wrap, text.overflow = True, "crop"
    return text


class MotorStrip(Widget, can_focus=True, inherit_bindings=False):
    """The motors; with the focus, one of them is chosen."""

    text: reactive[Text] = reactive(Text)
    chosen: reactive[int] = reactive(MOTORS[0])

    def render(self) -> Text:
        """The lines."""
        return self.text

    def move(self, by: int) -> None:
        """Choose the next motor (`by` 1) or the one before (-1)."""
        self.chosen = min(max(MOTORS[0], self.chosen + by), MOTORS[-1])

    async def on_click(self, event: Click) -> None:
        """Choose the motor that was clicked; a double click filters."""
        at = event.y if self.size.height > 1 else event.x * len(MOTORS) // max(1, self.size.width)
        self.chosen = MOTORS[min(at, len(MOTORS) - 1)]
        if event.chain == 2:
            await self.run_action("app.command('app.open')")
