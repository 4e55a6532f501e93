"""`fte-sniff bridge`: sit between a host program and the controller, record and watch both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fte_sniff.cli.capturing import capture_options, run_capture
from fte_sniff.cli.completion import complete_port
from fte_sniff.cli.input_files import FileName
from fte_sniff.cli.options import grouped_command, require_pseudo_terminals
from fte_sniff.cli.settings import load_settings


@grouped_command(name="bridge", short_help="Sit between a host program and the controller.")
@click.argument("port", shell_complete=complete_port)
@click.option("--link", type=FileName(), help="Make this link for host programs.")
@capture_options
def command(port: str, link: Path | None, **options: Any) -> None:
    """Sit between a host program and the controller at PORT; record and watch both directions.

    The host program opens a pseudo-terminal instead of PORT; its name is printed, and --link gives
    it a fixed name. Every byte is forwarded at once in both directions. PORT has the rate of
    --baud, whatever the host program sets; it has no DTR and RTS, so --dtr and --rts set
    them. The host program's wire is called `host`, the controller's PORT. A PORT that is lost hangs
    up the host program; with --link it is waited for, and can be opened again.

    \b
    fte-sniff bridge /dev/ttyUSB0 --link /tmp/motors
    fte-sniff bridge "sim://?host=off" --plain
    """
    require_pseudo_terminals("bridge", "`live PORT PORT` watches both wires with two adapters")
    path = None if link is None else str(link)
    run_capture((port,), load_settings(), way="bridge", link=path, **options)
