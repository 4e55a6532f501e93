"""Owns what a recording lacks while its disk fails, and when it is tried again.

It must not know files.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from math import inf

from fte_sniff.errors import FileError
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.encoding.stretches import Stretch

AGAIN_S, AGAIN_MOST_S = 3.0, 60.0
"""Seconds from a failure to the next attempt to record again: usually, and after many failures."""


class Patience:
    """When the next attempt to record is due.

    It is due every few seconds; later and later where each attempt succeeds but fails again soon.
    """

    def __init__(self) -> None:
        self._waits_s = AGAIN_S
        self._due_s = self._failed_s = -inf

    @property
    def over(self) -> bool:
        """Whether an attempt is due."""
        return time.monotonic() >= self._due_s

    def failed(self) -> None:
        """A recording that was under way failed."""
        now_s = time.monotonic()
        calm = now_s - self._failed_s > AGAIN_MOST_S
        self._waits_s = AGAIN_S if calm else min(2 * self._waits_s, AGAIN_MOST_S)
        self._failed_s = now_s
        self.tried()

    def tried(self) -> None:
        """An attempt was made."""
        self._due_s = time.monotonic() + self._waits_s


class Gap:
    """What was not recorded between two files."""

    def __init__(self, why: FileError) -> None:
        self.why = why
        self.entries = 0
        self.rows = 0
        self.first_ns = self.last_ns = 0

    def take(self, entries: Iterable[Row | PortEvent]) -> None:
        """Count what is not recorded."""
        for entry in entries:
            t_ns = entry.t_ns or 0
            if not self.entries:
                self.first_ns = self.last_ns = t_ns
            self.entries += 1
            self.rows += not isinstance(entry, PortEvent)
            self.first_ns, self.last_ns = min(self.first_ns, t_ns), max(self.last_ns, t_ns)

    def lose(self, rows: int, span_ns: tuple[int, int] | None) -> None:
        """Count rows that stood in a file that is gone."""
        if rows and span_ns is not None:
            self.entries = self.rows = rows
            self.first_ns, self.last_ns = span_ns

    def told(self) -> dict[str, str]:
        """The gap as the next file tells it."""
        return Stretch(self.rows, self.first_ns, self.last_ns, str(self.why)).told()
