"""`fte-sniff simulate`: a controller on a pseudo-terminal, to develop against.

The options come from the simulation's table of parameters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from fte_sniff.capture.serial_port import BAUD_RANGE
from fte_sniff.capture.simulation import PARAMETERS, Parameter, SimulationParameters
from fte_sniff.cli.input_files import FileName
from fte_sniff.cli.options import require_pseudo_terminals
from fte_sniff.cli.streams import ending_signals
from fte_sniff.errors import PortError, UsageError, printable
from fte_sniff.protocol import DEFAULT_BAUD, Direction

_DEFAULTS = {"host": "off", "wire": Direction.FEEDBACK.value}
"""Other defaults than `sim://`: here the host is the program that is being developed."""


def _option(parameter: Parameter) -> click.Option:
    return click.Option(
        [f"--{parameter.name}"],
        type=click.Choice([str(word) for word in parameter.words])
        if parameter.words
        else type(parameter.default),
        default=_DEFAULTS.get(parameter.name, parameter.default),
        show_default=True,
        help=f"{parameter.meaning} ({parameter.range_text})",
    )


def _run(link: Path | None, baud: int, **parameters: Any) -> None:
    require_pseudo_terminals("simulate", "`live sim://` has a simulated host too")
    from fte_sniff.capture.bridge import open_simulated

    try:
        simulated = SimulationParameters(**parameters)
        simulated.check_against(baud)
        if simulated.is_silent:
            raise UsageError(
                "--wire control needs a host, or no byte is sent: add --host on, or leave out "
                "--wire"
            )
    except PortError as error:
        raise UsageError(str(error).replace("sim://", "simulate")) from error
    with open_simulated(simulated, baud, link) as bridge, ending_signals(bridge.stop):
        device = bridge.device or ""
        click.echo(device)
        click.echo(f"a controller answers on {printable(device)}; Ctrl-C ends it", err=True)
        for _ in bridge:
            pass  # nothing is recorded


command = click.Command(
    "simulate",
    callback=_run,
    params=[
        click.Option(["--link"], type=FileName(), help="Make this link to it."),
        click.Option(
            ["--baud"],
            type=click.IntRange(*BAUD_RANGE),
            default=DEFAULT_BAUD,
            show_default=True,
            help="Bits/s.",
        ),
        *map(_option, PARAMETERS),
    ],
    short_help="A controller on a pseudo-terminal, to develop against.",
    help="Simulate a controller on a pseudo-terminal, for a host program to open.\n\n"
    "The device's name goes to standard output. Four motors obey the commands that are written to "
    "it and send their feedback.",
)
