"""`fte-sniff encode`: a frame's bytes from its values; one subcommand per frame kind.

Subcommands, options and help come from the frame table.
"""

from __future__ import annotations

import sys
from typing import Any

import click

from fte_sniff.cli.options import GroupedCommand
from fte_sniff.protocol.columns import spaced_hex
from fte_sniff.protocol.spec import KINDS, Field, FrameKind, encode


def integer(value: object) -> int:
    """An integer in decimal, or in hex with 0x; raises BadParameter."""
    try:
        return int(str(value), 0)
    except ValueError as error:
        fix = f"{value!r} is not an integer (write 15, -15 or 0x0F)"
        raise click.BadParameter(fix) from error


@click.group(name="encode", short_help="The bytes of a frame from its values.")
def command() -> None:
    """Print the bytes of a frame, as hex that `fte-sniff hex` decodes.

    \b
    fte-sniff encode speed --motor 1 --rpm 1000
    fte-sniff encode position --motor 2 --rpm 1000 --pulses 10000
    fte-sniff encode mecanum --vx 20 --vy -10 --wz 0
    fte-sniff encode reset
    """


def _option(field: Field) -> click.Option:
    default: dict[str, Any] = {"required": True}
    if field.default is not None:
        default = {"default": field.text(field.default), "show_default": True}
    return click.Option(
        [f"--{field.option}", field.name],
        type=integer,
        help=f"{field.meaning} ({field.range_text})",
        **default,
    )


def _command_of(kind: FrameKind) -> click.Command:
    def print_frame(raw: bool, cmd: int | None = None, **values: Any) -> None:
        frame = encode(kind, values, cmd)
        if raw:  # also to a terminal: a serial port is one
            sys.stdout.buffer.write(frame)
        else:
            click.echo(spaced_hex(frame))

    text = "The bytes themselves instead of hex, to send them: > /dev/ttyUSB0."
    options = [*map(_option, kind.fields), click.Option(["--raw"], is_flag=True, help=text)]
    if len(kind.cmds) > 1:
        text = f"CMD, {' or '.join(map(str, kind.cmds))}"
        default = kind.cmds[0]
        options.append(
            click.Option(["--cmd"], type=integer, default=default, show_default=True, help=text)
        )
    return GroupedCommand(
        kind.name,
        callback=print_frame,
        params=list(options),
        help=f"{kind.meaning[0].upper()}{kind.meaning[1:]} ({kind.direction} frame).",
        short_help=kind.meaning,
    )


for _kind in KINDS:
    command.add_command(_command_of(_kind))
