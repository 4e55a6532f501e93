"""Owns what stands between the rows that a view gets of a capture.

It must not know how they travel. A view that is too slow misses rows: the oldest of those that
waited, so that they are missing right before the next that it gets.
"""

from __future__ import annotations

from collections.abc import Sequence

from fte_sniff.analysis.feed import Missing, Seam, SeamFinder
from fte_sniff.session.capturing.messages import Batch


class BatchSeams:
    """Finds the seams in each batch of a capture, batch by batch."""

    def __init__(self, ports: Sequence[str], baud: int) -> None:
        """No batch came yet; each port began with so many bits per second."""
        self._finder = SeamFinder()
        self._finder.begin(dict.fromkeys(ports, baud))
        self._not_shown = 0

    def of(self, batch: Batch) -> list[Seam]:
        """Those of the next batch, by place among its rows."""
        found = self._finder.seams(batch.rows, batch.events)
        if batch.not_shown > self._not_shown:
            self._not_shown = batch.not_shown
            found.insert(0, Missing(0))
        return found
