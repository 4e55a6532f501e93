"""What the user says about the line and the motors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from fte_sniff.protocol.spec import DEFAULT_BAUD


@dataclass(frozen=True, slots=True)
class LineSetup:
    """What the user says about the line and the motors."""

    baud: int = DEFAULT_BAUD
    """Bits per second on every line."""
    resolution: float | None = None
    """Encoder pulses per turn of a motor's shaft, more than 0; None if unknown."""
    gear_ratio: float = 1.0
    """Turns of the motor's shaft per turn of its load, more than 0."""

    def turns(self, pulses: int) -> float | None:
        """A position in turns of the output shaft; None without a resolution.

        See docs/reference/protocol.md, "Pulses and turns".
        """
        if self.resolution is None:
            return None
        return pulses / self.resolution / self.gear_ratio


DEFAULT_SETUP: Final = LineSetup()
