"""`fte-sniff doctor`: what is wrong with this set-up, and the command that fixes it."""

from __future__ import annotations

import click

from fte_sniff.cli.completion import complete_port
from fte_sniff.cli.options import seconds_from
from fte_sniff.errors import UsageError, printable
from fte_sniff.i18n import translated
from fte_sniff.protocol.spec import DEFAULT_BAUD

EXIT_WRONG = 1


@click.command(name="doctor", short_help="What is wrong with this set-up, and how to fix it.")
@click.argument("port", required=False, shell_complete=complete_port)
@click.option(
    "-b",
    "--baud",
    type=click.INT,
    default=DEFAULT_BAUD,
    metavar="N",
    show_default=True,
    help="Bits/s.",
)
@click.option(
    "--duration",
    "seconds",
    type=seconds_from(0.1, 3600),
    default="3s",
    metavar="S",
    show_default=True,
    help="Listen for this long at most.",
)
@click.option("--probe", is_flag=True, help="Try the common bauds on what comes in.")
@click.pass_context
def command(
    context: click.Context, port: str | None, baud: int, seconds: float, probe: bool
) -> None:
    """Check whether an adapter is plugged in; with PORT, check that port, and show the fix.

    PORT is opened as `live` opens it, and listened to: what comes shows frames, damage, dead wires
    and other devices. Nothing is ever written. With --probe the port is set to other bauds too,
    until frames come. One finding a line: ok, warn (it could be better) or bad, and the fix after
    the arrow. Exit code 0: nothing is bad; 1: something is; 3: the port cannot be opened.

    \b
    fte-sniff doctor
    fte-sniff doctor /dev/ttyUSB0 --probe
    """
    if probe and port is None:
        raise UsageError("--probe needs a PORT to probe; 'fte-sniff ports' lists them")
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.session.doctor import Level, check_adapters, check_port

    if port is None:
        found = iter([check_adapters()])
    else:
        found = check_port(port, PortSettings(baud), seconds, probe=probe)
    wrong = False
    for one in found:
        fix = "" if one.fix is None else f"  ->  {translated(one.fix)}"
        click.echo(printable(f"{one.level:<4}  {one.about}: {translated(one.what)}{fix}"))
        wrong = wrong or one.level is Level.BAD
    context.exit(EXIT_WRONG if wrong else 0)
