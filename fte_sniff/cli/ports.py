"""Owns `fte-sniff ports`: which serial ports there are.

It must not know how they are found, and opens none.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from fte_sniff.capture.listing import PortListing


@click.command(name="ports", short_help="List the serial ports.")
def command() -> None:
    """List the serial ports that are plugged in, who holds them, and whether you may open them."""
    from fte_sniff.capture.listing import list_ports

    found = list_ports()
    for port in found:
        click.echo("\n".join(_lines(port)))
    if not found:
        click.echo("no serial port is plugged in; sim:// simulates one", err=True)


def _lines(port: PortListing) -> Iterator[str]:
    from fte_sniff.capture.permission import way_in

    yield f"{port.device}  {port.description}".removesuffix("  n/a")
    facts = {
        "by id": port.by_id,
        "USB": " ".join(filter(None, (port.usb_ids, port.location))) or None,
        "serial": port.serial_number,
        "driver": port.driver,
        "held by": ", ".join(map(str, port.holders)) or None,
    }
    yield from (f"    {name:<8} {value}" for name, value in facts.items() if value)
    if not port.permitted:
        yield f"    no permission: {way_in(port.device)}"
