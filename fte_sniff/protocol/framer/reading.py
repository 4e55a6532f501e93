"""Owns what a decided stretch of bytes is: the parts of a reading, before they become rows.

It must not know how a reading was found.
"""

from __future__ import annotations

from typing import final

from mypy_extensions import i64, mypyc_attr


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Stretch:
    """A part of the chosen reading: what becomes one row (neighbouring noise becomes one)."""

    def __init__(
        self, start: i64, stop: i64, framed: bool, faults: i64, probability: float
    ) -> None:
        self.start = start
        self.stop = stop
        self.framed = framed
        self.faults = faults
        """A number of `fault_sets`."""
        self.probability = probability
        """That of a whole frame; 0 for anything else."""

    @property
    def certain(self) -> bool:
        """Whether it is a whole frame, and is to be believed."""
        return self.framed and self.faults == 0

    def called(self, faults: i64) -> Stretch:
        """The same with other faults."""
        return Stretch(self.start, self.stop, self.framed, faults, self.probability)
