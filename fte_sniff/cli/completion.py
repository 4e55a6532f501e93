"""`fte-sniff completion`, and the completion of ports and filters; shells complete files."""

from __future__ import annotations

import click

VARIABLE = "_FTE_SNIFF_COMPLETE"
"""The environment variable by which the script asks the program for completions."""


@click.command(name="completion", short_help="Print the completion script of a shell.")
@click.argument("shell", metavar="SHELL", type=click.Choice(("bash", "zsh", "fish")))
@click.pass_context
def command(context: click.Context, shell: str) -> None:
    """Print the script that completes commands, options, ports, files and filters.

    The lines for ~/.bashrc, for ~/.zshrc (after compinit), and a command for fish:

    \b
    eval "$(fte-sniff completion bash)"
    eval "$(fte-sniff completion zsh)"
    fte-sniff completion fish >~/.config/fish/completions/fte-sniff.fish
    """
    from click.shell_completion import get_completion_class

    root = context.find_root()
    script = get_completion_class(shell)
    assert script is not None
    click.echo(script(root.command, {}, str(root.info_name), VARIABLE).source())


def complete_port(_context: click.Context, _port: click.Parameter, start: str) -> list[str]:
    """The ports that are plugged in, by device and stable name, and the simulator."""
    from fte_sniff.capture.discovery import list_ports

    names = [name for port in list_ports() for name in (port.device, port.by_id) if name]
    return [name for name in (*names, "sim://") if name.startswith(start)]


def complete_filter(_context: click.Context, _filter: click.Parameter, start: str) -> list[str]:
    """Filters whose last word is complete."""
    from fte_sniff.analysis.filter.terms import completions

    return completions(start)
