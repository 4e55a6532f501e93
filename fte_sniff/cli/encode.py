"""`fte-sniff encode`: a frame's bytes from its values; one subcommand per frame kind.

Subcommands, options and help come from the frame table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import click

from fte_sniff.errors import UsageError
from fte_sniff.protocol import KINDS, Field, FrameKind, encode, spaced_hex
from fte_sniff.protocol.spec import Role
from fte_sniff.real_number import RealNumber


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


_POSITIVE = RealNumber(min=0, min_open=True, max=1e9)
_TURNS = tuple(
    click.Option([option], type=kind, metavar="N", help=text)
    for option, kind, text in (
        (
            "--turns",
            RealNumber(-1e18, 1e18),
            "Instead of --pulses: the position in turns of the output shaft.",
        ),
        ("--resolution", _POSITIVE, "With --turns: pulses in one turn of the motor."),
        (
            "--gear-ratio",
            _POSITIVE,
            "With --turns: turns of the motor in one turn of its output; 1 by default.",
        ),
    )
)


def _option(field: Field) -> click.Option:
    default = None if field.default is None else field.text(field.default)
    return click.Option(
        [f"--{field.option}", field.name],
        type=_Integer(),
        default=default,
        show_default=default is not None,
        help=f"{field.meaning} ({field.range_text})",
    )


def _printer(kind: FrameKind, position: Field | None) -> Callable[..., None]:
    def print_frame(
        raw: bool,
        cmd: int | None = None,
        turns: float | None = None,
        resolution: float | None = None,
        gear_ratio: float | None = None,
        **values: Any,
    ) -> None:
        if position is not None:
            pulses = values.pop(position.name)
            if (turns is None, resolution is None) != (pulses is not None,) * 2:
                raise UsageError(f"give --{position.option}, or --turns with --resolution")
            if turns is not None and resolution is not None:
                # docs/reference/protocol.md, "Pulses and turns"
                pulses = round(turns * resolution * (gear_ratio or 1))
            values[position.name] = pulses
        frame = encode(kind, values, cmd)
        if raw:  # also to a terminal: a serial port is one
            sys.stdout.buffer.write(frame)
        else:
            click.echo(spaced_hex(frame))

    return print_frame


def _command_of(kind: FrameKind) -> click.Command:
    position = next((field for field in kind.fields if field.role is Role.POSITION), None)
    text = "The bytes themselves instead of hex, to send them: > /dev/ttyUSB0."
    options = [*map(_option, kind.fields), *(_TURNS if position else ())]
    options.append(click.Option(["--raw"], is_flag=True, help=text))
    if len(kind.cmds) > 1:
        text = f"CMD, {' or '.join(map(str, kind.cmds))}"
        default = kind.cmds[0]
        options.append(
            click.Option(["--cmd"], type=_Integer(), default=default, show_default=True, help=text)
        )
    return click.Command(
        kind.name.replace("_", "-"),
        callback=_printer(kind, position),
        params=list(options),
        help=f"{kind.meaning[0].upper()}{kind.meaning[1:]} ({kind.direction} frame).",
        short_help=kind.meaning,
    )


for _kind in KINDS:
    command.add_command(_command_of(_kind))
