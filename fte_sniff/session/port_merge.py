"""Order rows of several ports; detect swapped wiring.

Each port's rows come in order, but late: a frame is known only when its last byte is, or when the
bytes behind it are. So a row waits until every other port is known to be past it:

    port A   ───a1──────────a2─────────●          heard up to ●, nothing undecided
    port B   ────────b1──────┊ ?? pending         its next row begins at ┊, or later
             given: a1, b1        waits: a2

A port with undecided bytes goes on where the first of them began. A port without goes on at most
`REACH_NS` before the time up to which it was heard, since an adapter hands on bytes late. What has
waited for `MOST_HELD_NS` is given all the same, so that no port can hold up another.

A row's bytes may have been on the wire as much earlier as its port's uncertainty says. Where that
reaches back to a row of another port, which of the two came first is not certain: both are marked.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Direction, Frame, PortEvent, PortEventKind, Row

Entry: TypeAlias = Row | PortEvent

REACH_NS = 20_000_000
"""How far before the time of a read its bytes may have begun, where reads before found none."""

MOST_HELD_NS = 1_000_000_000
"""How long a row waits for another port at most, nanoseconds of the ports' own times."""

_NEVER = -(2**63)
_ALWAYS = 2**63


class Ordering:
    """Puts the rows and events of several ports on one time line."""

    def __init__(self, uncertainty_ns: Mapping[str, int]) -> None:
        """An order for these ports.

        Args:
            uncertainty_ns: by port, how much earlier than they say its rows may have begun.
        """
        self._lanes = [_Lane(port, ns) for port, ns in uncertainty_ns.items()]
        self._lane_of = {lane.port: lane for lane in self._lanes}
        self._now_ns = _NEVER

    def put(self, port: str, entries: Sequence[Entry]) -> None:
        """Take what comes next from one port."""
        self._lane_of[port].waiting.extend(entries)

    def heard(self, port: str, t_ns: int, waits_since_ns: int | None, *, data: bool) -> None:
        """Take note that a port was read.

        Args:
            port: which.
            t_ns: when the read returned.
            waits_since_ns: when its first undecided byte began; None where there is none.
            data: whether the read brought bytes; no byte behind them began earlier.
        """
        self._now_ns = max(self._now_ns, t_ns)
        self._lane_of[port].hear(t_ns, waits_since_ns, data=data)

    def take(self) -> list[Entry]:
        """What is certain to be next, in order of time."""
        return self._take(self._now_ns - MOST_HELD_NS)

    def drain(self) -> list[Entry]:
        """All that waits, in order of time; nothing comes behind it."""
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
        """The port whose next row or event is the earliest; None where nothing waits."""
        found: _Lane | None = None
        for lane in self._lanes:
            if lane.waiting and (found is None or lane.next_time() < found.next_time()):
                found = lane
        return found


class _Lane:
    """One port: what waits, and from when on more can come."""

    def __init__(self, port: str, uncertainty_ns: int) -> None:
        self.port = port
        self.waiting: deque[Entry] = deque()
        self.last_ns = _NEVER
        """The time of the last row that was given."""
        self._uncertainty_ns = uncertainty_ns
        self._read_ns = self._next_ns = _NEVER

    def next_time(self) -> int:
        """When the first began that waits here."""
        return self.waiting[0].t_ns or 0

    def hear(self, t_ns: int, waits_since_ns: int | None, *, data: bool) -> None:
        if data:
            self._read_ns = max(self._read_ns, t_ns)
        silent_to_ns = max(self._read_ns, t_ns - REACH_NS)
        self._next_ns = silent_to_ns if waits_since_ns is None else waits_since_ns

    def is_past(self, t_ns: int) -> bool:
        """Whether whatever comes from here is certain to be behind that time."""
        return bool(self.waiting) or self._next_ns > t_ns + self._uncertainty_ns

    def may_swap(self, t_ns: int, other: _Lane) -> bool:
        """Whether a row of this port at `t_ns` may be before the other's last, or behind its next.

        The other's next row is the first that waits there, and not before `t_ns`.
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
        return TranslatableText(
            "{direction} frames on the wire that carries {own} frames: swapped "
            "or mixed wiring; each adapter's RX belongs on a wire of its own",
            direction=direction,
            own=own,
        )

    def _same_as_another(self, port: str, direction: Direction) -> str | None:
        for other, own in self._own.items():
            if other != port and own is direction:
                return TranslatableText(
                    "{direction} frames here and on {other} too: are both adapters on "
                    "the same wire? One RX belongs on each",
                    direction=direction,
                    other=other,
                )
        return None
