"""Polls a session and holds what the panes show."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import tzinfo
from functools import partial
from time import monotonic, monotonic_ns
from typing import TYPE_CHECKING, Final

from fte_sniff.analysis.counters import Rate, Tally
from fte_sniff.analysis.feed import (
    Feed,
    FeedState,
    FeedUpdate,
    LiveFeed,
    StaticFeed,
    StreamChange,
    shifted,
)
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import HitCounter, HitPosition, find_byte
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui.goto import Goal, ToDistance, ToOffset, ToRow, ToShare, ToTime, ToTimeOfDay
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.notices import event_words
from fte_sniff.tui.status_bar import StatusCounters
from fte_sniff.tui.table.viewport import Viewport
from fte_sniff.tui.table.widget import RowTable

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


ORDINARY = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})
"""Events that every recording has, and that are worth no word."""


@dataclass(frozen=True, slots=True)
class ViewUpdate:
    """What one look at the feed brought."""

    changed: bool
    """Whether other rows are shown now."""
    events: Sequence[PortEvent]
    ended: bool
    """Whether the feed ended since the look before."""
    trouble: str | None
    """What has gone wrong since the look before, although the feed runs on."""
    changes: Sequence[StreamChange] = ()
    """Gaps and baud changes between the rows that came, by index in the store."""


class ViewModel:
    """A feed and everything that came from it."""

    def __init__(self, feed: Feed, row_filter: RowFilter | None, store: RowStore) -> None:
        self.store = store
        self.store.shown.set_filter(row_filter)
        self.state = FeedState("")
        self._feed = feed
        self.tally = Tally()
        """The count of all rows that were taken in."""
        self._rate = Rate()
        self._frames = 0
        self._line_errors = 0
        self._events: Counter[PortEventKind] = Counter()
        self._per_second: float | None = None

    def look(self, now_ns: int, *, take: bool = True) -> ViewUpdate:
        """Take in what came, or leave it with the feed for this time.

        Args:
            now_ns: any rising clock's nanoseconds.
            take: whether rows may come.

        Raises:
            FteSniffError: the feed failed.
        """
        update = self._feed.poll() if take else FeedUpdate(self.state)
        ended = self.state.running and not update.state.running
        trouble = update.state.trouble if update.state.trouble != self.state.trouble else None
        self.state = update.state
        changes = shifted(update.changes, self.store.next)
        if update.rows:
            self.store.append(update.rows)
            self.tally.update(update.rows)
        for event in update.events:
            self._events[event.kind] += 1
        self._line_errors += sum(
            event.count for event in update.events if event.kind is PortEventKind.LINE_ERROR
        )
        changed = bool(update.rows) or bool(self.store.shown.pending)
        self.store.shown.filter_step()
        self._take_rate(now_ns)
        return ViewUpdate(changed, update.events, ended, trouble, changes)

    def _take_rate(self, now_ns: int) -> None:
        """Frames per second: now, on a wire; over the time covered, in what lies behind."""
        frames = self.state.rows - (self.tally.rows - self.tally.frames)
        self._rate.update(frames - self._frames, now_ns)
        self._frames = frames
        if self.state.running and self.state.live:
            self._per_second = self._rate.per_second(now_ns)
        elif self.tally.duration_ns:
            self._per_second = self.tally.frames * 1e9 / self.tally.duration_ns

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports that rows came from, in the order in which they came."""
        return tuple(self.tally.by_port)

    @property
    def start_ns(self) -> int | None:
        """The earliest time of a row, nanoseconds since 1970 UTC; None while no row has one."""
        return self.tally.first_ns

    def numbers(self, view: Viewport, hits: str = "") -> StatusCounters:
        """What the line of numbers tells; `hits` is what there is to say of a search."""
        return StatusCounters(
            rows=self.state.rows,
            frames_per_s=self._per_second,
            malformed=self.tally.malformed,
            malformed_share=self.tally.malformed_share,
            not_shown=self.state.not_shown,
            place=view.cursor + 1 if view.count else 0,
            following=view.following,
            below=view.below,
            line_errors=self._line_errors,
            hits=hits,
        )

    @property
    def events_words(self) -> str:
        """What a file tells of its ports beside their rows; empty where nothing is out of order."""
        if self.state.live or self._events.keys() <= ORDINARY:
            return ""
        told = ", ".join(
            f"{_(event_words(kind))} {count:,}"
            for kind, count in self._events.items()
            if kind not in ORDINARY
        )
        return _("port events while it was recorded: {told}; S tells more").format(told=told)

    @property
    def shown_words(self) -> str:
        """How many rows the filter lets through; empty where there is none."""
        if self.store.shown.filter is None:
            return ""
        form = _("{shown:,} of {all:,} rows")
        if self.store.shown.pending:
            form = _("{shown:,} of {all:,} rows, {pending:,} to go")
        count, pending = self.store.shown.count, self.store.shown.pending
        return form.format(shown=count, all=len(self.store), pending=pending)

    @property
    def empty_words(self) -> str:
        """Why there is nothing to see, where nothing is shown."""
        if self.store.shown.pending:
            return _("filtering ...")
        if len(self.store):
            return _("the filter hides all {count:,} rows; F shows them again").format(
                count=len(self.store)
            )
        return _("nothing came yet") if self.state.running else _("nothing came")

    def set_filter(self, row_filter: RowFilter | None, near: int | None) -> None:
        """Show only what the filter lets through, the rows near that index first."""
        self.store.shown.set_filter(row_filter, near)
        self.store.shown.filter_step()

    def moment_of(self, goal: Goal, cursor: int, zone: tzinfo) -> int | None:
        """The time that is meant, nanoseconds since 1970 UTC; None for other goals, or without.

        A time of day that names no zone is one of `zone`.
        """
        here = self._time_at(cursor)
        if here is None:
            return None
        match goal:
            case ToTime():
                return goal.t_ns
            case ToDistance():
                return here + goal.ns
            case ToTimeOfDay():
                return goal.clock.on_day_of(here, zone)
            case _:
                return None

    @property
    def shown_ends(self) -> tuple[int | None, int | None]:
        """The times of the first row that is shown, and of the last."""
        return self._time_at(0), self._time_at(max(0, self.store.shown.count - 1))

    def row_of(self, goal: Goal, cursor: int, zone: tzinfo) -> int | None:
        """The shown row that is meant, or None where there is no such row, or none has a time."""
        if isinstance(goal, ToRow):
            return goal.number - 1
        if isinstance(goal, ToShare):
            return round(goal.percent / 100 * max(0, self.store.shown.count - 1))
        if isinstance(goal, ToOffset):
            return self._holding(goal.offset, cursor)
        moment = self.moment_of(goal, cursor, zone)
        return None if moment is None else self._first_at(moment)

    def _holding(self, offset: int, cursor: int) -> int | None:
        if cursor >= self.store.shown.count:
            return None
        index = find_byte(self.store, self.store.shown.row(cursor).port, offset)
        return None if index is None else self.store.shown.position_of(index)

    def _first_at(self, t_ns: int) -> int:
        """The first shown row at or after a time; times are taken to rise."""
        low, high = 0, self.store.shown.count
        while low < high:
            middle = (low + high) // 2
            time = self._time_at(middle)
            if time is None or time < t_ns:
                low = middle + 1
            else:
                high = middle
        return min(low, max(0, self.store.shown.count - 1))

    def _time_at(self, row: int) -> int | None:
        return self.store.shown.row(row).t_ns if row < self.store.shown.count else None


BREATH_S: Final = 0.005
"""Between two steps: keys and drawing come first."""

EVERY_S: Final = 0.5
"""Between two looks at what came."""

HIT: Final = later("hit {number:,} of {all:,}")
HITS: Final = later("{all:,} hits")
HIT_IN_MEMORY: Final = later("hit {number:,} of {all:,} in memory")
HITS_IN_MEMORY: Final = later("{all:,} hits in memory")
HITS_SO_FAR: Final = later("{all:,} hits so far")


class HitCount:
    """Counts for the search that the table has now."""

    def __init__(self, store: RowStore, table: RowTable) -> None:
        """Nothing is looked for yet."""
        self._store, self._table = store, table
        self._hits: HitCounter | None = None
        self._about: tuple[object, ...] = ()
        self._goes_on = self._caught_up = False
        self._due_s = 0.0

    def tick(self) -> None:
        """Begin anew where something else is looked for; else count what came."""
        search = self._table.search
        columns = frozenset(column.name for column in self._table.columns)
        about = (search, columns, self._store.shown.filter)
        if about != self._about:
            self._about, self._due_s, self._caught_up = about, 0.0, False
            test = search and partial(search.mask, columns=columns)
            self._hits = HitCounter(self._store, test) if test else None
        if self._hits is not None and not self._goes_on and monotonic() >= self._due_s:
            self._go_on()

    def _go_on(self) -> None:
        self._goes_on = self._hits is not None and self._hits.step()
        if self._goes_on:
            self._table.set_timer(BREATH_S, self._go_on)
        else:
            # What comes from now on is counted soon enough for nobody to be told that it is not.
            self._caught_up, self._due_s = True, monotonic() + EVERY_S

    @property
    def words(self) -> str:
        """How many hits there are, and which of them the cursor is on; empty without a search."""
        if self._hits is None or self._table.search is None:
            return ""
        index = self._table.cursor_index
        standing = self._hits.standing(-1 if index is None else index)
        return _(_form(standing, self._caught_up)).format(number=standing.number, all=standing.all)


def _form(standing: HitPosition, caught_up: bool) -> str:
    if not caught_up:
        return HITS_SO_FAR
    if standing.left_out:
        return HITS_IN_MEMORY if standing.number is None else HIT_IN_MEMORY
    return HITS if standing.number is None else HIT


REST_S: Final = 1 / 25
"""Between two wakes at least, seconds: less than a live feed leaves between two batches."""


class WakeUp:
    """Calls back whenever a descriptor can be read from."""

    def __init__(self, descriptor: int, wake: Callable[[], object]) -> None:
        """Begin; to be called where an event loop runs, which calls `wake`."""
        self._descriptor, self._wake = descriptor, wake
        self._loop = asyncio.get_running_loop()
        self._rest: asyncio.TimerHandle | None = None
        self._listen()

    def end(self) -> None:
        """Wake nobody any more; may be called again."""
        self._loop.remove_reader(self._descriptor)
        if self._rest is not None:
            self._rest.cancel()

    def _listen(self) -> None:
        self._loop.add_reader(self._descriptor, self._woken)

    def _woken(self) -> None:
        # It stays readable until it is read, and that the feed does in its own time.
        self._loop.remove_reader(self._descriptor)
        self._rest = self._loop.call_later(REST_S, self._listen)
        self._wake()


TICK_S: Final = 1 / 20
"""Between two looks at the feed that the clock brings about: often enough, and yet calm."""

KEYS_NS: Final = 250_000_000
"""How long a file's rows, and the models, wait after a key: reading takes time from those keys."""


class PollInterval:
    """When a look at one feed is due."""

    def __init__(self, feed: Feed) -> None:
        """Nothing wakes the screen yet, and no key has come."""
        self._feed = feed
        self._waking: WakeUp | None = None
        self._woken = False
        self._key_at_ns = monotonic_ns() - KEYS_NS

    def listen(self, wake: Callable[[], object]) -> None:
        """Call back when the feed has something; to be called where an event loop runs."""
        if isinstance(self._feed, LiveFeed):
            self._waking = WakeUp(self._feed.descriptor, wake)

    def end(self) -> None:
        """Let the feed wake nobody any more; may be called again."""
        if self._waking is not None:
            self._waking.end()
            self._waking = None

    def woken(self) -> None:
        """The feed makes the screen look."""
        self._woken = True

    def strike(self) -> bool:
        """The clock strikes: whether to look, as the feed has not woken since it last did."""
        woken, self._woken = self._woken, False
        return not woken

    def key(self) -> None:
        """A key comes, and the rows of a file wait for it."""
        self._key_at_ns = monotonic_ns()
        if isinstance(self._feed, StaticFeed):
            self._feed.rest()

    @property
    def keys_come(self) -> bool:
        """Whether a key came just now."""
        return monotonic_ns() - self._key_at_ns < KEYS_NS
