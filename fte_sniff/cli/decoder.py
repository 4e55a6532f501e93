"""`fte-sniff decoder`: decoders for sigrok and Wireshark, from the frame table."""

from __future__ import annotations

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, UsageError, quoted, reason_of
from fte_sniff.formats.decoders import TOOLS


def _known(_context: click.Context, _argument: click.Parameter, tool: str) -> str:
    if tool not in TOOLS:
        raise UsageError(f"unknown decoder {quoted(tool)}; use one of {', '.join(TOOLS)}")
    return tool


@click.command(name="decoder", short_help="Print a decoder for sigrok or Wireshark.")
@click.argument("tool", metavar="|".join(TOOLS), callback=_known)
@click.option("--install", is_flag=True, help="Write it to the folder in which the tool looks.")
def command(tool: str, install: bool) -> None:
    """Print a decoder of the protocol for another tool.

    sigrok decodes captures of a logic analyser in PulseView and sigrok-cli. wireshark dissects what
    `decode -o NAME.pcapng` writes, in Wireshark and tshark.

    \b
    fte-sniff decoder sigrok --install
    fte-sniff decoder wireshark --install
    """
    from fte_sniff.session.save import replace_text

    found = TOOLS[tool]
    if not install:
        click.echo(found.text(), nl=False)
        return
    path = found.path()
    try:
        replace_text(path, found.text(), mode=0o644)
    except OSError as error:
        raise FileError(
            f"{path} cannot be written: {reason_of(error)};"
            f" print it with: fte-sniff decoder {tool} > FILE"
        ) from error
    print_err(f"{path} is written; {found.use}")
