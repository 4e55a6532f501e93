"""Owns the simulated wire: host and controller take turns, and every byte has its time.

It must not read a clock or sleep. Who wants real time paces the bytes by their times.

The wire is a half-duplex bus, cut into slots of 1/rate seconds. Five slots are a round:

    host | motor 1 | motor 2 | motor 3 | motor 4 | host | motor 1 | ...

A slot whose owner has nothing to say, or who is not listened to, is silence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from fte_sniff.capture.simulator.controller import Controller
from fte_sniff.capture.simulator.faults import Faults
from fte_sniff.capture.simulator.host import Host
from fte_sniff.capture.simulator.parameters import SimulationParameters
from fte_sniff.protocol import DEFAULT_BAUD, FRAME_LENGTH, MOTORS, Direction, byte_time_ns, encode

_MOST_JITTER_NS = 400_000


@dataclass(frozen=True, slots=True)
class TimedBytes:
    """What is heard of one frame, or one run of noise, and when."""

    begins_ns: int
    """When its first byte began on the wire, nanoseconds since the start."""
    t_ns: int
    """When its last byte was over: when a read could return it, nanoseconds since the start."""
    data: bytes
    """The bytes as heard, faults applied; never empty."""
    sent: bytes
    """The frame as it was sent, before any fault; empty for noise."""


class Simulation:
    """An iterator of TimedBytes; its times never fall and its bytes never overlap.

    It is empty where nobody is ever heard, rather than to look for a first byte for ever.
    The controller may be given commands of one's own between two items: `controller.obey`.
    """

    def __init__(self, parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> None:
        """Start at time 0; raises PortError where `baud` cannot carry the parameters' rate."""
        parameters.check_against(baud)
        self.parameters = parameters
        self.controller = Controller(Random(f"{parameters.seed}/controller"))
        self._host = Host(Random(f"{parameters.seed}/host"))
        self._jitter_dice = Random(f"{parameters.seed}/jitter")
        self._faults = Faults(parameters.seed, parameters.drop, parameters.flip, parameters.noise)
        self._byte_ns = byte_time_ns(baud)
        self._free_at_ns = 0
        self._items = self._run()

    def __iter__(self) -> Iterator[TimedBytes]:
        return self

    def __next__(self) -> TimedBytes:
        return next(self._items)

    def _run(self) -> Iterator[TimedBytes]:
        if self.parameters.never_heard:
            return
        slot = heard = 0
        while True:
            sent = self._said_in(slot)
            begins_ns = self._begin_of(slot)
            slot += 1
            if not sent:
                continue
            yield from self._heard(sent, begins_ns)
            heard += 1
            if heard == self.parameters.frames:
                return

    def _begin_of(self, slot: int) -> int:
        slot_ns = 1_000_000_000 / self.parameters.rate
        slack_ns = max(0.0, slot_ns - FRAME_LENGTH * self._byte_ns)
        return int(slot * slot_ns + self._jitter_dice.random() * min(slack_ns, _MOST_JITTER_NS))

    def _said_in(self, slot: int) -> bytes | None:
        t_s = slot / self.parameters.rate
        self.controller.advance_to(t_s)
        motor = slot % (1 + len(MOTORS))
        if motor:
            feedback = self.controller.feedback(motor)
            return feedback if self.parameters.wire != Direction.CONTROL else None
        command = self._host.command_at(t_s) if self.parameters.host == "on" else None
        if command is None:
            return None
        # The faults are the listener's: the controller itself hears every command.
        self.controller.obey(*command)
        return encode(*command) if self.parameters.wire != Direction.FEEDBACK else None

    def _heard(self, sent: bytes, begins_ns: int) -> Iterator[TimedBytes]:
        noise = self._faults.noise()
        if noise:
            takes_ns = len(noise) * self._byte_ns
            yield self._on_the_wire(max(0, begins_ns - 2 * takes_ns), noise, takes_ns, b"")
        takes_ns = len(sent) * self._byte_ns
        yield self._on_the_wire(begins_ns, self._faults.damaged(sent), takes_ns, sent)

    def _on_the_wire(self, begins_ns: int, data: bytes, takes_ns: int, sent: bytes) -> TimedBytes:
        begins_ns = max(begins_ns, self._free_at_ns)
        self._free_at_ns = begins_ns + takes_ns
        return TimedBytes(begins_ns, self._free_at_ns, data, sent)


def simulate(parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> Iterator[TimedBytes]:
    """What a listener hears, with exact times; without end unless `parameters.frames` says so.

    Nothing at all where only a host is listened to, and there is none.

    Raises:
        PortError: a line of `baud` bits per second cannot carry the rate.
    """
    return Simulation(parameters, baud)
