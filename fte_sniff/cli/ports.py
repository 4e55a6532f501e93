"""`fte-sniff ports`: list the serial ports."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from fte_sniff.cli.options import list_format_option
from fte_sniff.cli.streams import print_err
from fte_sniff.formats.writers import json_text

if TYPE_CHECKING:
    from fte_sniff.capture.discovery import PortListing


@click.command(name="ports", short_help="List the serial ports.")
@list_format_option
def command(form: str) -> None:
    """List the serial ports that are plugged in, who holds them, and whether you may open them.

    No port is opened. Of the programs that have one open, you see your own; root sees all.
    """
    from fte_sniff.capture.discovery import list_ports

    found = list_ports()
    lines = map(_json, found) if form == "jsonl" else _table(found)
    for line in lines:
        click.echo(line)
    for hint in _hints(found):
        print_err(hint)


def _json(port: PortListing) -> str:
    return json_text({**asdict(port), "state": port.state})


def _table(ports: Sequence[PortListing]) -> Iterator[str]:
    """The lines of a table; empty columns are left out."""
    columns = [(name, [cell(port) for port in ports]) for name, cell in _CELLS.items()]
    used = [(name, cells) for name, cells in columns if any(cells)]
    widths = [max(len(name), *map(len, cells)) for name, cells in used]
    for line in [[name for name, _ in used], *zip(*(cells for _, cells in used), strict=True)]:
        yield "  ".join(f"{c:<{w}}" for c, w in zip(line, widths, strict=True)).rstrip()


_CELLS: Mapping[str, Callable[[PortListing], str]] = {
    "device": lambda port: port.device,
    "state": lambda port: port.state,
    "held by": lambda port: ", ".join(map(str, port.holders)),
    "USB": lambda port: port.usb_ids or "",
    "at": lambda port: port.location or "",
    "serial": lambda port: port.serial_number or "",
    "description": lambda port: port.description or "",
    "by id": lambda port: port.by_id or "",
}


def _hints(ports: Sequence[PortListing]) -> Iterator[str]:
    from fte_sniff.capture.discovery import stray_adapters
    from fte_sniff.capture.port_errors import permission_fix
    from fte_sniff.session.doctor import PLUG_IN, stray_finding

    for port in ports:
        if not port.permitted:
            yield f"{port.device}: no permission: {permission_fix(port.device)}"
    strays = stray_adapters()
    for stray in strays:
        finding = stray_finding(stray)
        yield f"{finding.about}: {finding.what}: {finding.fix}"
    if not strays and all(port.vid is None for port in ports):
        what = "no USB adapter is" if ports else "no serial port is"
        yield f"{what} plugged in; {PLUG_IN}; sim:// simulates one"
