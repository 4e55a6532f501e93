"""`fte-sniff simulate`: a controller on a pseudo-terminal, to develop against.

The options come from the simulation's table of parameters.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import Field, fields
from pathlib import Path
from threading import Event
from typing import Any
from urllib.parse import urlencode

import click

from fte_sniff.capture.serial_port import BAUD_RANGE
from fte_sniff.capture.simulation import SimulationParameters
from fte_sniff.cli.input_files import FileName, print_notes, row_filter
from fte_sniff.cli.options import (
    Decorator,
    all_of,
    grouped_command,
    require_pseudo_terminals,
)
from fte_sniff.cli.streams import ending_signals, print_err
from fte_sniff.errors import FileError, UsageError, printable
from fte_sniff.protocol.spec import DEFAULT_BAUD, Direction
from fte_sniff.real_number import RealNumber

_FIXED = {"host": "off", "wire": Direction.FEEDBACK.value}
"""The host is the program that is being developed, and receives feedback only."""


def _option(parameter: Field[Any]) -> Decorator:
    return click.option(
        f"--{parameter.name.replace('_', '-')}",
        type=parameter.metadata["kind"],
        default=parameter.default,
        show_default=True,
        help=parameter.metadata["meaning"],
    )


@grouped_command(
    name="simulate", short_help="A controller on a pseudo-terminal, to develop against."
)
@click.option("--link", type=FileName(), help="Make this link to it.")
@click.option(
    "--baud",
    type=click.IntRange(*BAUD_RANGE),
    default=DEFAULT_BAUD,
    show_default=True,
    help="Bits/s.",
)
@click.option("--replay", type=FileName(), help="Play a recording once a program opens the device.")
@click.option(
    "--direction",
    type=click.Choice([str(direction) for direction in Direction]),
    help="With --replay: the frames to play.  [default: feedback]",
)
@click.option("--speed", type=RealNumber(0.01, 1000), help="With --replay: how fast.  [default: 1]")
@all_of(*(_option(one) for one in fields(SimulationParameters) if one.name not in _FIXED))
def command(
    link: Path | None,
    baud: int,
    replay: Path | None,
    direction: str | None,
    speed: float | None,
    **parameters: Any,
) -> None:
    """Simulate a controller on a pseudo-terminal, for a host program to open.

    The device's name goes to standard output. Four motors obey the commands that are written to
    it and send their feedback. With --replay, the frames of a recording are sent instead, with
    their timing.
    """
    require_pseudo_terminals("simulate", "`live sim://` has a simulated host too")
    if replay is not None:
        _replay(replay, link, direction or Direction.FEEDBACK, speed or 1.0)
        return
    if direction is not None or speed is not None:
        raise UsageError("--direction and --speed work with --replay; name a recording")
    from fte_sniff.capture.clock import Clock
    from fte_sniff.capture.serial_port import PortSettings
    from fte_sniff.capture.wiring import Wiring

    url = f"sim://?{urlencode(parameters | _FIXED)}"
    name = None if link is None else str(link)
    wiring = Wiring([url], PortSettings(baud), "bridge", name, reconnect=False)
    with wiring.open(Clock.tied()) as bridge, ending_signals(bridge.stop):
        device = bridge.device or ""
        click.echo(device)
        click.echo(f"a controller answers on {printable(device)}; Ctrl-C ends it", err=True)
        for _ in bridge:
            pass  # nothing is recorded


def _replay(path: Path, link: Path | None, direction: str, speed: float) -> None:
    """Play the frames of one direction of a recording, with its timing."""
    import numpy as np

    from fte_sniff.capture.bridge import HostEnd
    from fte_sniff.capture.player import play
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.recording.reader import Recording
    from fte_sniff.session.inputs import InputReading, recording_input

    wanted = row_filter(f"direction = '{direction}'")
    reading = InputReading([recording_input(Recording(path))], row_filter=wanted)
    frames = Rows.concat([item for item in reading if isinstance(item, Rows)])
    print_notes(reading)
    if not len(frames):
        raise FileError("{path} has no {direction} frames", path=path, direction=direction)
    seconds = (np.maximum.accumulate(frames.t_ns) - frames.t_ns.min()) / 1e9 / speed
    timed = zip(seconds.tolist(), (row.raw for row in frames), strict=True)
    stopped = Event()
    with closing(HostEnd(link)) as host, ending_signals(stopped.set):
        click.echo(host.name)
        print_err(f"{len(frames):,} {direction} frames wait for a program that opens {host.name}")
        written, refused = play(host, timed, stopped.is_set)
    print_err(f"played {written:,} bytes")
    if refused:
        print_err(f"{refused:,} bytes were lost: the program did not read them in time")
