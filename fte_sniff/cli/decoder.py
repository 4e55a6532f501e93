"""`fte-sniff decoder`: decoders for sigrok and Wireshark, from the frame table."""

from __future__ import annotations

import click

from fte_sniff.errors import UsageError, quoted
from fte_sniff.formats.decoders import TOOLS


def _known(_context: click.Context, _argument: click.Parameter, tool: str) -> str:
    if tool not in TOOLS:
        raise UsageError(f"unknown decoder {quoted(tool)}; use one of {', '.join(TOOLS)}")
    return tool


@click.command(name="decoder", short_help="Print a decoder for sigrok or Wireshark.")
@click.argument("tool", metavar="|".join(TOOLS), callback=_known)
def command(tool: str) -> None:
    """Print a decoder of the protocol for another tool.

    sigrok decodes captures of a logic analyser in PulseView and sigrok-cli. wireshark dissects what
    `decode -o NAME.pcapng` writes, in Wireshark and tshark.

    \b
    fte-sniff decoder sigrok > ~/.local/share/libsigrokdecode/decoders/fte/__init__.py
    fte-sniff decoder wireshark > ~/.local/lib/wireshark/plugins/fte.lua
    """
    click.echo(TOOLS[tool](), nl=False)
