"""Owns `--resolution`, `--gear-ratio` and `--baud`: what makes turns of pulses, and time of bytes.

It must not know a screen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import click

from fte_sniff.analysis.statistics import Bench
from fte_sniff.cli.options.remembered import Remembered
from fte_sniff.errors import UsageError
from fte_sniff.protocol import DEFAULT_BAUD


class _Positive(click.FloatRange):
    """A number above 0, and not without end."""

    name = "number"

    def __init__(self) -> None:
        super().__init__(min=0, min_open=True)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        number = float(super().convert(value, param, ctx))
        if not isfinite(number):
            self.fail(f"{value!r} is not a number above 0.", param, ctx)
        return number


def units_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Both options; positions are then shown in turns too: pulses / resolution / gear ratio."""
    resolution = click.option(
        "--resolution",
        type=_Positive(),
        metavar="N",
        help="Pulses in one turn of a motor: shows positions in turns too.",
    )
    gear_ratio = click.option(
        "--gear-ratio",
        type=_Positive(),
        metavar="N",
        help="Turns of a motor in one turn of its output; 1 by default.",
    )
    return resolution(gear_ratio(command))


def line_speed_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--baud` of what is read: of recordings only where they are not to be believed."""
    return click.option(
        "--baud",
        type=click.IntRange(min=1),
        help=f"Bits/s of every line, instead of what a recording says.  [default: {DEFAULT_BAUD}]",
    )(command)


def remembered_bench(
    settings: Remembered,
    ports: Sequence[str],
    resolution: float | None,
    gear_ratio: float | None,
    baud: int = DEFAULT_BAUD,
) -> Bench:
    """The set-up that the options tell, and where they do not, the settings of these ports.

    Raises:
        UsageError: the settings contradict each other, or there is a gear ratio, but no resolution.
    """
    if resolution is None:
        resolution = settings.defaults(ports, "resolution").resolution
    if resolution is not None and gear_ratio is None:
        gear_ratio = settings.defaults(ports, "gear_ratio").gear_ratio
    return bench_of(resolution, gear_ratio, baud)


def bench_of(resolution: float | None, gear_ratio: float | None, baud: int = DEFAULT_BAUD) -> Bench:
    """The set-up that the options tell.

    Raises:
        UsageError: a gear ratio is given, but no resolution.
    """
    if resolution is None and gear_ratio is not None:
        raise UsageError("--gear-ratio makes turns of pulses only together with --resolution")
    return Bench(baud, resolution, 1.0 if gear_ratio is None else gear_ratio)
