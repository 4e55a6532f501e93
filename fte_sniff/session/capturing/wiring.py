"""Owns the watch over which direction each of several wires carries.

It must not know how rows are made or where they go.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from fte_sniff.errors import Said
from fte_sniff.protocol import Direction, Frame, PortEvent, PortEventKind, Row

SETTLED = 10
"""Sound frames of one direction that make a wire that direction's."""

STRANGE = 3
"""Sound frames of the other direction upon which it is pointed out: one can be chance."""


class WiringWatch:
    """Points out, once a wire, that it carries what the other one should."""

    def __init__(self, ports: Sequence[str]) -> None:
        """Watch these ports; where there is only one it may carry anything."""
        self._counts: dict[str, Counter[Direction]] = {port: Counter() for port in ports}
        self._own: dict[str, Direction] = {}
        self._quiet = set(ports) if len(ports) < 2 else set()

    def look(self, port: str, rows: Iterable[Row]) -> list[PortEvent]:
        """What these rows, all of one port, give cause to point out."""
        if port in self._quiet:
            return []
        counts = self._counts[port]
        for row in rows:
            if isinstance(row, Frame) and not row.faults:
                counts[row.direction] += 1
                if detail := self._strange(port, row.direction):
                    self._quiet.add(port)
                    return [PortEvent(row.t_ns or 0, port, PortEventKind.WIRING, detail)]
        return []

    def _strange(self, port: str, direction: Direction) -> str | None:
        """What is strange now that one more frame of that direction came."""
        counts, own = self._counts[port], self._own.get(port)
        if own is None:
            if counts[direction] < SETTLED:
                return None
            self._own[port] = direction
            return self._same_as_another(port, direction)
        if direction is own or counts[direction] < STRANGE:
            return None
        return Said(
            "{direction} frames on the wire that carries {own} frames: swapped "
            "or mixed wiring; each adapter's RX belongs on a wire of its own",
            direction=direction,
            own=own,
        )

    def _same_as_another(self, port: str, direction: Direction) -> str | None:
        for other, own in self._own.items():
            if other != port and own is direction:
                return Said(
                    "{direction} frames here and on {other} too: are both adapters on "
                    "the same wire? One RX belongs on each",
                    direction=direction,
                    other=other,
                )
        return None
