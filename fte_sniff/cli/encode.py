"""`fte-sniff encode`: a frame's bytes from its values; one subcommand per frame kind.

Subcommands, options and help come from the frame table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from decimal import Decimal, InvalidOperation, localcontext
from typing import Any

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, shortened
from fte_sniff.protocol import KINDS, Field, FrameKind, encode, spaced_hex
from fte_sniff.protocol.spec import Role


class _Integer(click.ParamType[int]):
    """An integer in decimal, or in hex with 0x."""

    name = "integer"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        try:
            return int(str(value), 0)
        except ValueError:
            self.fail(f"{value!r} is not an integer (write 15, -15 or 0x0F)", param, ctx)


class _Decimal(click.ParamType[Decimal]):
    """A finite decimal number, optionally only one above a limit."""

    name = "number"

    def __init__(self, above: int | None = None) -> None:
        self._above = above

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Decimal:
        try:
            number = Decimal(str(value))
        except InvalidOperation:
            number = Decimal("nan")
        if not number.is_finite():
            self.fail(f"{value!r} is not a number (write 2.5 or -0.25)", param, ctx)
        if self._above is not None and number <= self._above:
            self.fail(f"{value!r} is not above {self._above}", param, ctx)
        return number


class _KindGroup(click.Group):
    """One subcommand per frame kind; accepts `speed_feedback` for `speed-feedback` too."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return super().get_command(ctx, cmd_name.replace("_", "-"))


@click.group(name="encode", cls=_KindGroup, short_help="The bytes of a frame from its values.")
def command() -> None:
    """Print the bytes of a frame, as hex that `fte-sniff hex` decodes.

    \b
    fte-sniff encode speed --motor 1 --rpm 1000
    fte-sniff encode position --motor 2 --rpm 1000 --pulses 10000
    fte-sniff encode position --motor 2 --rpm 1000 --turns 2.5 --resolution 500 --gear-ratio 30
    fte-sniff encode mecanum --vx 20 --vy -10 --wz 0
    fte-sniff encode reset
    """


def _options(field: Field) -> list[click.Option]:
    names = [f"--{field.option}", field.name]
    text = f"{field.meaning} ({field.range_text})"
    if _is_position(field):
        return [click.Option(names, type=_Integer(), help=text), *_turns_options(names[0])]
    if field.default is None:
        return [click.Option(names, type=_Integer(), required=True, help=text)]
    default = field.text(field.default)
    return [click.Option(names, type=_Integer(), default=default, show_default=True, help=text)]


def _is_position(field: Field) -> bool:
    """Whether the field counts pulses, so that its value can be given in turns."""
    return field.role is Role.POSITION


def _turns_options(instead_of: str) -> list[click.Option]:
    return [
        click.Option(
            ["--turns"],
            type=_Decimal(),
            help=f"Instead of {instead_of}: the position in turns of the output shaft.",
        ),
        click.Option(
            ["--resolution"],
            type=_Decimal(above=0),
            metavar="N",
            help="With --turns: pulses in one turn of the motor.",
        ),
        click.Option(
            ["--gear-ratio"],
            type=_Decimal(above=0),
            metavar="N",
            help="With --turns: turns of the motor in one turn of its output; 1 by default.",
        ),
    ]


def _cmd_option(kind: FrameKind) -> click.Option:
    cmds = " or ".join(map(str, kind.cmds))
    return click.Option(
        ["--cmd"], type=_Integer(), default=kind.cmds[0], show_default=True, help=f"CMD, {cmds}"
    )


def _raw_option() -> click.Option:
    text = "The bytes themselves instead of hex, to send them: > /dev/ttyUSB0."
    return click.Option(["--raw"], is_flag=True, help=text)


def _printer(kind: FrameKind) -> Callable[..., None]:
    def print_frame(raw: bool, cmd: int | None = None, **values: int) -> None:
        frame = encode(kind, values, cmd)
        if raw:  # also to a terminal: a serial port is one
            sys.stdout.buffer.write(frame)
        else:
            click.echo(spaced_hex(frame))

    position = next(filter(_is_position, kind.fields), None)
    if position is None:
        return print_frame

    def print_position(
        turns: Decimal | None,
        resolution: Decimal | None,
        gear_ratio: Decimal | None,
        **values: Any,
    ) -> None:
        pulses = values.pop(position.name)
        if turns is not None and pulses is not None:
            raise UsageError(f"give either --{position.option} or --turns, not both")
        if turns is not None:
            if resolution is None:
                raise UsageError("--turns needs --resolution, the pulses in one turn of the motor")
            pulses = _pulses(position, turns, resolution, gear_ratio or Decimal(1))
        elif resolution is not None or gear_ratio is not None:
            raise UsageError("--resolution and --gear-ratio need --turns")
        elif pulses is None:
            raise UsageError(f"give --{position.option}, or --turns with --resolution")
        print_frame(**values, **{position.name: pulses})

    return print_position


def _pulses(field: Field, turns: Decimal, resolution: Decimal, gear_ratio: Decimal) -> int:
    """The nearest number of pulses (docs/reference/protocol.md, "Pulses and turns").

    Reports on standard error where it is rounded; raises UsageError if it is out of range.
    """
    with localcontext() as context:
        context.clear_traps()  # what is too large becomes infinite
        exact = turns * resolution * gear_ratio
        nearest = exact.to_integral_value()
    text = f"{shortened(str(turns))} turns are {float(exact):.12g} {field.unit}"
    if not field.low <= nearest <= field.high:
        raise UsageError(f"{text}, out of range: {field.range_text}")
    if nearest != exact:
        print_err(f"fte-sniff: {text}; rounded to {nearest}")
    return int(nearest)


def _command_of(kind: FrameKind) -> click.Command:
    options = [option for field in kind.fields for option in _options(field)]
    options.append(_raw_option())
    if len(kind.cmds) > 1:
        options.append(_cmd_option(kind))
    return click.Command(
        kind.name.replace("_", "-"),
        callback=_printer(kind),
        params=list(options),
        help=f"{kind.meaning[0].upper()}{kind.meaning[1:]} ({kind.direction} frame).",
        short_help=kind.meaning,
    )


for _kind in KINDS:
    command.add_command(_command_of(_kind))
