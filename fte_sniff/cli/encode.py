"""`fte-sniff encode`: a frame's bytes from its values; one subcommand per frame kind.

Subcommands, options and help come from the frame table.
"""

from __future__ import annotations

from collections.abc import Callable

import click

from fte_sniff.protocol import KINDS, Field, FrameKind, encode, spaced_hex


class _Integer(click.ParamType[int]):
    """An integer in decimal, or in hex with 0x."""

    name = "integer"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> int:
        try:
            return int(str(value), 0)
        except ValueError:
            self.fail(f"{value!r} is no integer (write 15, -15 or 0x0F)", param, ctx)


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
    fte-sniff encode mecanum --vx 20 --vy -10 --wz 0
    fte-sniff encode reset
    """


def _option(field: Field) -> click.Option:
    names = [f"--{field.option}", field.name]
    text = f"{field.meaning} ({field.range_text})"
    if field.default is None:
        return click.Option(names, type=_Integer(), required=True, help=text)
    default = field.text(field.default)
    return click.Option(names, type=_Integer(), default=default, show_default=True, help=text)


def _cmd_option(kind: FrameKind) -> click.Option:
    cmds = " or ".join(map(str, kind.cmds))
    return click.Option(
        ["--cmd"], type=_Integer(), default=kind.cmds[0], show_default=True, help=f"CMD, {cmds}"
    )


def _printer(kind: FrameKind) -> Callable[..., None]:
    def print_frame(cmd: int | None = None, **values: int) -> None:
        click.echo(spaced_hex(encode(kind, values, cmd)))

    return print_frame


def _command_of(kind: FrameKind) -> click.Command:
    options = [_option(field) for field in kind.fields]
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
