"""A host and a controller with four motors, and the wire between them, as a pure model.

It must not know of ports, threads or the clock on the wall: time is a number that it counts itself,
so that the same parameters give the same bytes at the same times, anywhere.

    parameters   what can be asked of a simulation, with ranges and defaults
    motor        one motor: speed and position over time
    controller   four motors that obey control frames and tell feedback frames
    host         what a believable host sends, and when
    faults       bytes lost, bits flipped, noise: what goes wrong at the ear of the listener
    simulation   all of these on one wire: bytes with their times
"""

from fte_sniff.capture.simulator.controller import Controller
from fte_sniff.capture.simulator.parameters import (
    PARAMETERS,
    Parameter,
    SimulationParameters,
    parameters_help,
    parse_parameters,
)
from fte_sniff.capture.simulator.simulation import Simulation, TimedBytes, simulate

__all__ = [
    "PARAMETERS",
    "Controller",
    "Parameter",
    "Simulation",
    "SimulationParameters",
    "TimedBytes",
    "parameters_help",
    "parse_parameters",
    "simulate",
]
