"""`fte-sniff bridge`: sit between a host program and the controller, record and watch both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.capturing import capture_options, run_capture
from fte_sniff.cli.completion import complete_port
from fte_sniff.cli.input_files import FileName
from fte_sniff.cli.options import grouped_command, require_pseudo_terminals
from fte_sniff.cli.settings import load_settings

if TYPE_CHECKING:
    from fte_sniff.capture.bridge import Bridge
    from fte_sniff.capture.serial_port import PortSettings


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
    settings = load_settings()

    def bridge(port_settings: PortSettings) -> Bridge:
        from fte_sniff.capture.bridge import Bridge

        return Bridge(port, port_settings, link, reconnect=settings.live.get("reconnect", True))

    run_capture(bridge, (port,), settings, **options)
