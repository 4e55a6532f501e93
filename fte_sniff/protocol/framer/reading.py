"""Owns what a decided stretch of bytes is: the parts of a reading, before they become rows.

It must not know how a reading was found.
"""

from __future__ import annotations

from typing import NamedTuple

from fte_sniff.protocol.rows import Fault


class Stretch(NamedTuple):
    """A part of the chosen reading: what becomes one row (neighbouring noise becomes one)."""

    start: int
    stop: int
    framed: bool
    faults: tuple[Fault, ...]
    probability: float
    """That of a whole frame; 0 for anything else."""

    @property
    def certain(self) -> bool:
        """Whether it is a whole frame, and is to be believed."""
        return self.framed and not self.faults
