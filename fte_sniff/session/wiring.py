"""Detection of swapped or mixed wiring: which direction each port carries."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Direction, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Rows

SETTLED = 10
"""Valid frames of one direction after which a wire is known to carry it."""

UNEXPECTED = 3
"""Valid frames of the other direction after which it is reported; one can be chance."""


_DIRECTIONS = tuple(Direction)


class WiringWatch:
    """Reports once per wire that it carries the other wire's direction, or the same as another."""

    def __init__(self, ports: Sequence[str]) -> None:
        self._counts: dict[str, Counter[Direction]] = {port: Counter() for port in ports}
        self._own: dict[str, Direction] = {}
        self._quiet = set(ports) if len(ports) < 2 else set[str]()

    def observe(self, port: str, rows: Rows) -> list[PortEvent]:
        """Events that these rows of one port give rise to."""
        if port in self._quiet:
            return []
        counts = self._counts[port]
        valid = (rows.framed & (rows.faults == rows.codebook.fault_code(()))).nonzero()[0]
        for code, t_ns in zip(
            rows.directions[valid].tolist(), rows.t_ns[valid].tolist(), strict=True
        ):
            direction = _DIRECTIONS[code]
            counts[direction] += 1
            if detail := self._problem(port, direction):
                if direction is not self._own[port]:
                    self._quiet.add(port)
                return [PortEvent(t_ns, port, PortEventKind.WIRING, detail)]
        return []

    def _problem(self, port: str, direction: Direction) -> str | None:
        counts, own = self._counts[port], self._own.get(port)
        if own is None:
            if counts[direction] < SETTLED:
                return None
            self._own[port] = direction
            return self._same_as_another(port, direction)
        if direction is own or counts[direction] < UNEXPECTED:
            return None
        return TranslatableText(
            "{direction} frames on the wire that carries {own} frames: swapped "
            "or mixed wiring; connect each adapter's RX to its own wire",
            direction=direction,
            own=own,
        )

    def _same_as_another(self, port: str, direction: Direction) -> str | None:
        for other, own in self._own.items():
            if other != port and own is direction:
                return TranslatableText(
                    "{direction} frames here and on {other} too: are both adapters on "
                    "the same wire? Connect one RX to each",
                    direction=direction,
                    other=other,
                )
        return None
