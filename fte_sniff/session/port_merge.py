"""Merge the rows of several ports by time; detect swapped wiring.

The rows of each port are in order, but late: a frame is known only with its last byte, or with the
bytes after it. So a row waits until every other port is known to have passed its time:

    port A   ───a1──────────a2─────────●          read up to ●, nothing undecided
    port B   ────────b1──────┊ ?? pending         its next row begins at ┊, or later
             emitted: a1, b1      waits: a2

The next row of a port with undecided bytes begins at the first of them. The next row of a port
without may begin up to `REACH_NS` before its last read, because an adapter delivers bytes late. A
row waits at most `MOST_HELD_NS`, so that no port can block another.

The bytes of a row may have been on the wire earlier by the uncertainty of its port. If that reaches
a row of another port, their order is uncertain, and both are marked.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Direction, Frame, PortEvent, PortEventKind, Row

Entry: TypeAlias = Row | PortEvent

REACH_NS = 20_000_000
"""How long before a read its bytes may have begun, if earlier reads were empty."""

MOST_HELD_NS = 1_000_000_000
"""Longest time that a row waits for another port, in nanoseconds of the ports' times."""

_NEVER = -(2**63)
_ALWAYS = 2**63


class PortMerge:
    """Merges the rows and events of several ports by time (a k-way merge with watermarks)."""

    def __init__(self, uncertainty_ns: Mapping[str, int]) -> None:
        """Create a merge; by port, how much earlier than their times its rows may have begun."""
        self._lanes = [_Lane(port, ns) for port, ns in uncertainty_ns.items()]
        self._lane_of = {lane.port: lane for lane in self._lanes}
        self._now_ns = _NEVER

    def put(self, port: str, entries: Sequence[Entry]) -> None:
        """Append the next rows and events of one port."""
        self._lane_of[port].waiting.extend(entries)

    def advance(self, port: str, t_ns: int, waits_since_ns: int | None, *, data: bool) -> None:
        """Advance the watermark of a port after a read that returned at `t_ns`.

        `waits_since_ns` is when its first undecided byte began, None without undecided bytes.
        `data` is whether the read returned bytes; later bytes did not begin earlier.
        """
        self._now_ns = max(self._now_ns, t_ns)
        self._lane_of[port].advance(t_ns, waits_since_ns, data=data)

    def ready(self) -> list[Entry]:
        """Remove and return the entries whose order is settled."""
        return self._take(self._now_ns - MOST_HELD_NS)

    def drain(self) -> list[Entry]:
        """Remove and return all entries; none follow."""
        return self._take(_ALWAYS)

    def _take(self, overdue_ns: int) -> list[Entry]:
        taken: list[Entry] = []
        while True:
            lane = self._earliest()
            if lane is None:
                return taken
            t_ns = lane.next_time()
            certain = True
            for other in self._lanes:
                if other is not lane:
                    if t_ns > overdue_ns and not other.is_past(t_ns):
                        return taken
                    certain = certain and not lane.may_swap(t_ns, other)
            entry = lane.waiting.popleft()
            if not isinstance(entry, PortEvent):
                lane.last_ns = t_ns
                if not certain:
                    entry = _uncertain(entry)
            taken.append(entry)

    def _earliest(self) -> _Lane | None:
        found: _Lane | None = None
        for lane in self._lanes:
            if lane.waiting and (found is None or lane.next_time() < found.next_time()):
                found = lane
        return found


class _Lane:
    def __init__(self, port: str, uncertainty_ns: int) -> None:
        self.port = port
        self.waiting: deque[Entry] = deque()
        self.last_ns = _NEVER
        self._uncertainty_ns = uncertainty_ns
        self._read_ns = self._next_ns = _NEVER

    def next_time(self) -> int:
        return self.waiting[0].t_ns or 0

    def advance(self, t_ns: int, waits_since_ns: int | None, *, data: bool) -> None:
        if data:
            self._read_ns = max(self._read_ns, t_ns)
        silent_to_ns = max(self._read_ns, t_ns - REACH_NS)
        self._next_ns = silent_to_ns if waits_since_ns is None else waits_since_ns

    def is_past(self, t_ns: int) -> bool:
        return bool(self.waiting) or self._next_ns > t_ns + self._uncertainty_ns

    def may_swap(self, t_ns: int, other: _Lane) -> bool:
        """True if a row at `t_ns` may precede the other's last row, or follow its next one.

        The other's next row is the first that waits there; it is not before `t_ns`.
        """
        if t_ns - other.last_ns <= self._uncertainty_ns:
            return True
        for following in other.waiting:
            if not isinstance(following, PortEvent):
                return (following.t_ns or 0) - t_ns <= other._uncertainty_ns
        return False


def _uncertain(row: Row) -> Row:
    """The row, marked. `dataclasses.replace` would take five times as long."""
    make = type(row)
    return make(row.port, row.offset, row.raw, row.t_ns, row.faults, row.read_delay_ns, True)


SETTLED = 10
"""Valid frames of one direction after which a wire is known to carry it."""

UNEXPECTED = 3
"""Valid frames of the other direction after which it is reported; one can be chance."""


class WiringWatch:
    """Reports once per wire that it carries the other wire's direction, or the same as another."""

    def __init__(self, ports: Sequence[str]) -> None:
        self._counts: dict[str, Counter[Direction]] = {port: Counter() for port in ports}
        self._own: dict[str, Direction] = {}
        self._quiet = set(ports) if len(ports) < 2 else set()

    def observe(self, port: str, rows: Iterable[Row]) -> list[PortEvent]:
        """Events that these rows of one port give rise to."""
        if port in self._quiet:
            return []
        counts = self._counts[port]
        for row in rows:
            if isinstance(row, Frame) and not row.faults:
                counts[row.direction] += 1
                if detail := self._problem(port, row.direction):
                    if row.direction is not self._own[port]:
                        self._quiet.add(port)
                    return [PortEvent(row.t_ns or 0, port, PortEventKind.WIRING, detail)]
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
