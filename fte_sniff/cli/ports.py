"""`fte-sniff ports`: list the serial ports."""

from __future__ import annotations

import click

from fte_sniff.cli.streams import print_err


@click.command(name="ports", short_help="List the serial ports.")
def command() -> None:
    """List the serial ports that are plugged in, who holds them, and whether you may open them.

    No port is opened. Of the programs that have one open, you see your own; root sees all.
    """
    from fte_sniff.capture.discovery import PortListing, list_ports
    from fte_sniff.capture.port_errors import permission_fix
    from fte_sniff.session.doctor import PLUG_IN

    ports = list_ports()
    names = (name.replace("_", " ") for name in PortListing._fields)
    columns = [column for column in zip(names, *ports, strict=True) if any(column[1:])]
    widths = [max(map(len, column)) for column in columns]
    for line in zip(*columns, strict=True):
        padded = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        click.echo("  ".join(padded).rstrip())
    for port in ports:
        if port.state == "forbidden":
            print_err(f"{port.device}: no permission: {permission_fix(port.device)}")
    if not any(port.usb_ids for port in ports):
        print_err(f"no USB adapter is plugged in; {PLUG_IN}; sim:// simulates one")
