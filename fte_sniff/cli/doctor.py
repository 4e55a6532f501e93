"""`fte-sniff doctor`: what is wrong with this set-up, and the command that fixes it."""

from __future__ import annotations

from dataclasses import asdict
from itertools import chain

import click

from fte_sniff.cli.completion import complete_port
from fte_sniff.cli.options import list_format_option, seconds_from
from fte_sniff.errors import UsageError, printable
from fte_sniff.formats.writers import json_text
from fte_sniff.protocol.spec import DEFAULT_BAUD

EXIT_WRONG = 1


@click.command(name="doctor", short_help="What is wrong with this set-up, and how to fix it.")
@click.argument("port", required=False, shell_complete=complete_port)
@click.option(
    "-b", "--baud", type=click.INT, default=DEFAULT_BAUD, show_default=True, help="Bits/s."
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
@list_format_option
@click.pass_context
def command(
    context: click.Context, port: str | None, baud: int, seconds: float, probe: bool, form: str
) -> None:
    """Check the adapters of this machine, and show how to fix what is wrong.

    With PORT, that port is opened as `live` opens it, and listened to: what comes shows frames,
    damage, dead wires and other devices. Nothing is ever written. With --probe the port is set to
    other bauds too, until frames come. One finding a line: ok, warn (it could be better) or bad,
    and the fix after the arrow. Exit code 0: nothing is bad; 1: something is; 3: the port cannot be
    opened.

    \b
    fte-sniff doctor
    fte-sniff doctor /dev/ttyUSB0 --probe
    """
    if probe and port is None:
        raise UsageError("--probe needs a PORT to probe; 'fte-sniff ports' lists them")
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.session.doctor import Level, check_adapters, check_port

    found = check_adapters()
    if port is not None:
        found = chain(found, check_port(port, PortSettings(baud), seconds, probe=probe))
    wrong = False
    for one in found:
        fix = "" if one.fix is None else f"  ->  {one.fix}"
        line = printable(f"{one.level:<4}  {one.about}: {one.what}{fix}")
        click.echo(json_text(asdict(one)) if form == "jsonl" else line)
        wrong = wrong or one.level is Level.BAD
    context.exit(EXIT_WRONG if wrong else 0)
