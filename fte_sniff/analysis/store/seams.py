"""Owns what stands between two rows: rows that are missing there, and another pace from there on.

It must not know what is measured, nor how it is found out that rows are missing. Across a seam
nothing is measured: what lies there is neither silence nor a period.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from fte_sniff.analysis.columns.fields import Ints
from fte_sniff.analysis.columns.packing import Codebook, PackedRows, pack
from fte_sniff.protocol import PortEvent, PortEventKind, Row

BREAKS: Final = frozenset({PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN})
"""Events at which bytes of a port are missing."""


@dataclass(frozen=True, slots=True)
class Missing:
    """Rows are missing: nothing is measured across."""

    place: int
    """Of the row behind the seam, among those that it is told with."""
    port: str | None = None
    """On which wire; None on all of them."""


@dataclass(frozen=True, slots=True)
class Pace:
    """From here on a port has another speed."""

    place: int
    """Of the first row at that speed, among those that it is told with."""
    port: str
    baud: int


Seam: TypeAlias = Missing | Pace


def shifted(seams: Iterable[Seam], by: int) -> list[Seam]:
    """The same, where so many rows stand before those that they were told with."""
    return [
        Missing(seam.place + by, seam.port)
        if isinstance(seam, Missing)
        else Pace(seam.place + by, seam.port, seam.baud)
        for seam in seams
    ]


class SeamFinder:
    """Finds the seams among rows that come in pieces, by what is told beside them."""

    def __init__(self) -> None:
        """Nothing is known of any port."""
        self._bauds: dict[str, int] = {}
        self._gaps: deque[int] = deque()

    def begin(
        self, bauds: Mapping[str, int], left_out: Iterable[tuple[int, int]] = ()
    ) -> list[Seam]:
        """The rows to come are of an input that tells this; the seams before its first row.

        Of ports whose baud was told, later changes of it are followed.

        Args:
            bauds: bits per second by port.
            left_out: from when to when rows came that the input does not hold, nanoseconds since
                1970 UTC.
        """
        ends = (t_ns for first, last in left_out for t_ns in (first, last + 1))
        self._gaps = deque(sorted(ends))
        # What the next file of a capture tells is how it began, not how it went on.
        new = {port: baud for port, baud in bauds.items() if self._bauds.get(port) != baud}
        self._bauds.update(new)
        return [Pace(0, port, baud) for port, baud in new.items()]

    def seams(self, rows: Sequence[Row], events: Sequence[PortEvent] = ()) -> list[Seam]:
        """Those among the next rows and behind the last of them, rising.

        Args:
            rows: the next rows.
            events: what happened to ports among them.
        """
        told = [(event.t_ns, seam) for event in events for seam in self._of_event(event)]
        if not told and not self._gaps:
            return []
        times = _rising_times(rows)
        found = [
            seam for t_ns, one in told for seam in shifted([one], int(np.searchsorted(times, t_ns)))
        ]
        while self._gaps:
            place = int(np.searchsorted(times, self._gaps[0]))
            if place == len(times):
                break
            found.append(Missing(place))
            while self._gaps and self._gaps[0] <= times[place]:
                self._gaps.popleft()
        return sorted(found, key=lambda seam: seam.place)

    def _of_event(self, event: PortEvent) -> Iterable[Seam]:
        if event.kind in BREAKS:
            yield Missing(0, event.port)
        if event.kind is PortEventKind.BAUD_CHANGED and event.count and event.port in self._bauds:
            yield Pace(0, event.port, event.count)


def _rising_times(rows: Sequence[Row]) -> Ints:
    """By row, the latest time up to it: the first row from a time on can be searched for."""
    t_ns = rows.t_ns if isinstance(rows, PackedRows) else pack(rows, Codebook())[0]["t_ns"]
    return np.asarray(np.maximum.accumulate(t_ns.astype(np.int64)))
