"""Owns what the user says about the set-up that no row tells: the line's speed, pulses in a turn.

It must not know where it was said, nor what is done with it.
"""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.protocol import DEFAULT_BAUD


@dataclass(frozen=True, slots=True)
class Bench:
    """One set-up of line, controller and motors."""

    baud: int = DEFAULT_BAUD
    """Bits per second on every line."""
    resolution: float | None = None
    """Encoder pulses in one turn of a motor's shaft, more than 0; None where nobody said."""
    gear_ratio: float = 1.0
    """Turns of the motor's shaft in one turn of what it drives, more than 0."""

    def turns(self, pulses: int) -> float | None:
        """A position in turns (PROTOCOL.md, "Pulses and turns"); None without a resolution."""
        if self.resolution is None:
            return None
        return pulses / self.resolution / self.gear_ratio


NO_BENCH = Bench()
"""Nobody said anything about the set-up."""
