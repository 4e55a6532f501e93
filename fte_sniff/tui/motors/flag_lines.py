"""Owns what a motor's card says of its flag bytes: online or not, ERROR, and when bits changed.

It must not know Textual, nor what else stands on the card.

    motor 1 online error 04 b2 12:00:03
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text

from fte_sniff.analysis.motors import Flags, MotorState
from fte_sniff.protocol import MOTORS, Status
from fte_sniff.tui.language import _, later
from fte_sniff.tui.motors.look import MotorsLook
from fte_sniff.tui.table.cells import clock_text
from fte_sniff.tui.table.palette import Palette

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


def title_line(look: MotorsLook, state: MotorState, width: int, palette: Palette) -> Text:
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


def bit_lines(look: MotorsLook, state: MotorState, palette: Palette) -> Iterator[Text]:
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
