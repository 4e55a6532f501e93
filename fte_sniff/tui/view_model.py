"""View model: rows polled from a feed, their counts, and the times at which the feed is polled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic, monotonic_ns, thread_time
from typing import TYPE_CHECKING, Final

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.feed import Feed, FeedState, FeedUpdate, StaticFeed
from fte_sniff.analysis.model import Rate, StreamChange, Tally, shifted
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import HitCounter
from fte_sniff.errors import listed
from fte_sniff.protocol import PortEvent, PortEventKind, Rows
from fte_sniff.protocol.rows import NO_ROWS
from fte_sniff.session.replay import Playback
from fte_sniff.tui.cells import event_words
from fte_sniff.tui.i18n import _
from fte_sniff.tui.status_bar import StatusCounters
from fte_sniff.tui.table import RowTable, Viewport

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter, SilenceAlert


ROUTINE_EVENTS = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})
"""Events that every recording has; they are not reported."""


@dataclass(frozen=True, slots=True)
class ViewUpdate:
    """What one poll changed."""

    changed: bool
    events: Sequence[PortEvent]
    ended: bool
    """Whether the feed ended since the poll before."""
    trouble: str | None
    """A problem that is new since the poll before, although the feed continues."""
    rings: bool
    stream_changes: Sequence[StreamChange]
    """Gaps and baud changes among the new rows, by indices in the store."""
    rows: Rows
    first: int
    """Index of the first of these rows in the store."""
    played: Rows = NO_ROWS
    """The rows that playback reached."""


class ViewModel:
    """A feed, the store of its rows, and counts over them."""

    def __init__(
        self,
        feed: Feed,
        row_filter: RowFilter | None,
        store: RowStore,
        alert: Alert | SilenceAlert | None = None,
    ) -> None:
        self.store = store
        self.alert = alert
        self.store.view.set_filter(row_filter)
        self.state = FeedState("")
        self.tally = Tally()
        self._feed = feed
        self._rate = Rate()
        self._frames = 0
        self._line_errors = 0
        self._events: Counter[PortEventKind] = Counter()
        self.playback: Playback | None = None
        self._file_events: list[PortEvent] = []
        self._file_changes: list[StreamChange] = []
        self._events_played = 0
        """Number of `_file_events` that were forwarded during playback."""
        self._frames_per_s: float | None = None
        self._facts = Facts()
        self._recording_since_ns: int | None = None
        self.recorded_s = 0.0

    def poll(self, now_ns: int, *, take_rows: bool = True) -> ViewUpdate:
        """Store the new rows and count them; raises FteSniffError if the feed failed.

        `now_ns` is of any monotonic clock. Without `take_rows` new rows stay with the feed for now.
        """
        update = self._feed.poll() if take_rows else FeedUpdate(self.state)
        ended = self.state.running and not update.state.running
        trouble = update.state.trouble if update.state.trouble != self.state.trouble else None
        self.state = update.state
        first = self.store.loaded
        stream_changes = shifted(update.changes, first)
        if update.rows:
            self.store.append(update.rows)
            self.tally.observe(update.rows)
        self.store.landmarks.add(update.events, stream_changes)
        self._fill(self._facts.feed(update.rows, update.changes))
        if ended:
            self._fill(self._facts.interrupt())
        rings = self.state.live and self._rings(update.rows, now_ns, update.events)
        for event in update.events:
            self._events[event.kind] += 1
            if event.kind is PortEventKind.LINE_ERROR:
                self._line_errors += event.count
        events = update.events
        if not self.state.live:
            self._file_events += events
            self._file_changes += stream_changes
        changed = bool(update.rows) or bool(self.store.view.pending)
        played = NO_ROWS
        if self.playback is not None:
            played = self.playback.advance(now_ns)
            changed |= bool(len(played))
            rings = self._rings(played, now_ns)
            events = self._played_events(self.playback.t_ns)
        self.store.view.filter_step()
        self._update_rate(now_ns)
        self._update_recording(now_ns)
        return ViewUpdate(
            changed, events, ended, trouble, rings, stream_changes, update.rows, first, played
        )

    def _fill(self, facts: Rows) -> None:
        """Store the facts of the next rows."""
        if len(facts):
            self.store.fill(facts)

    def play(
        self, index: int, speed: float, now_ns: int
    ) -> tuple[Sequence[PortEvent], Sequence[StreamChange]]:
        """Play a file from a row on, while none is played.

        Returns the events before it, and all gaps and changes.
        """
        self.playback = Playback(self.store, index, speed, now_ns)
        self._events_played = 0
        return self._played_events(self.playback.t_ns), self._file_changes

    def stop_playback(self) -> Sequence[PortEvent]:
        """Show all rows again; returns the events that were not played."""
        if self.playback is None:
            return ()
        self.playback.stop()
        self.playback = None
        return self._file_events[self._events_played :]

    def _played_events(self, t_ns: int) -> Sequence[PortEvent]:
        """The events up to a time that were not forwarded yet."""
        start = self._events_played
        while self._events_played < len(self._file_events):
            if self._file_events[self._events_played].t_ns > t_ns:
                break
            self._events_played += 1
        return self._file_events[start : self._events_played]

    def _rings(self, rows: Rows, now_ns: int, events: Sequence[PortEvent] = ()) -> bool:
        return self.alert is not None and self.alert.observe(rows, now_ns / 1e9, events)

    def _update_recording(self, now_ns: int) -> None:
        state = self.state
        if state.live and state.running and state.recording is not None:
            if self._recording_since_ns is None:
                self._recording_since_ns = now_ns
            self.recorded_s = (now_ns - self._recording_since_ns) / 1e9

    def _update_rate(self, now_ns: int) -> None:
        """Frames per second: lately in a live capture, on average over a file."""
        frames = self.state.rows - (self.tally.rows - self.tally.frames)
        self._rate.observe(frames - self._frames, now_ns)
        self._frames = frames
        if self.state.running and self.state.live:
            self._frames_per_s = self._rate.per_second(now_ns)
        elif self.tally.duration_ns:
            self._frames_per_s = self.tally.frames * 1e9 / self.tally.duration_ns

    @property
    def at_rest(self) -> bool:
        """Whether no more rows come, and the filter has been applied to all."""
        is_playing = self.playback is not None and not self.playback.paused
        return not self.state.running and not self.store.view.pending and not is_playing

    @property
    def ports(self) -> tuple[str, ...]:
        """Ports of the rows, in order of appearance."""
        return self.tally.ports

    @property
    def start_ns(self) -> int | None:
        """Earliest time of a row, nanoseconds since 1970 UTC; None while no row has one."""
        return self.tally.first_ns

    def status_counters(
        self, viewport: Viewport, hits: str = "", health: str = "", time: str = ""
    ) -> StatusCounters:
        """Counters for the status line.

        `hits` is the text about the current search, `health` that about the motors, `time` that
        about the time of the top view.
        """
        play = self.playback
        tally = self.tally if play is None else play.tally
        return StatusCounters(
            rows=self.state.rows if play is None else len(self.store),
            frames_per_s=self._frames_per_s if play is None else play.frames_per_s,
            malformed=tally.malformed,
            malformed_share=tally.malformed_share,
            not_shown=self.state.not_shown,
            row_number=viewport.cursor + 1 if viewport.count else 0,
            following=viewport.following,
            below=viewport.below,
            line_errors=self._line_errors,
            hits=hits,
            is_mean=play is None and not (self.state.running and self.state.live),
            filtered=self.store.view.filter is not None,
            health=health,
            time=time,
        )

    @property
    def events_text(self) -> str:
        """Port events of a file, counted by kind; empty where there are only routine ones."""
        if self.state.live or self._events.keys() <= ROUTINE_EVENTS:
            return ""
        counts = _(
            listed(
                f"{_(event_words(kind))} {count:,}"
                for kind, count in self._events.items()
                if kind not in ROUTINE_EVENTS
            )
        )
        return _("port events while it was recorded: {events}; S shows more", events=counts)

    @property
    def filter_count(self) -> tuple[int, int, int] | None:
        """Rows that pass the filter, all rows, and those to go; None without a filter."""
        shown = self.store.view
        return None if shown.filter is None else (shown.count, len(self.store), shown.pending)

    @property
    def empty_text(self) -> str:
        """Why no row is shown."""
        if self.store.view.pending:
            return _("filtering ...")
        if len(self.store):
            count = len(self.store)
            return _("the filter hides all {count:,} rows; F shows them again", count=count)
        return _("nothing came yet") if self.state.running else _("nothing came")

    def set_filter(self, row_filter: RowFilter | None, near: int | None) -> None:
        """Show only rows that pass the filter; those near the index `near` are tested first."""
        self.store.view.set_filter(row_filter, near)
        self.store.view.filter_step()


STEP_PAUSE_S: Final = 0.005
"""Pause between two steps of counting, so that keys and drawing come first."""

RECOUNT_S: Final = 0.5


class HitStatus:
    """Counts the hits of the table's search step by step, for the status line."""

    def __init__(self, store: RowStore, table: RowTable) -> None:
        self._store, self._table = store, table
        self._counter: HitCounter | None = None
        self._counted: tuple[object, ...] = ()
        self._stepping = False
        self._due_s = 0.0

    def tick(self) -> None:
        """Count new rows; start again where the search, the columns or the filter changed."""
        search = self._table.search
        columns = frozenset(column.name for column in self._table.columns)
        wanted = (search, columns, self._store.view.filter)
        if wanted != self._counted:
            self._counted, self._due_s = wanted, 0.0
            test = search and partial(search.matches, columns=columns)
            self._counter = HitCounter(self._store, test) if test else None
        if self._counter is not None and not self._stepping and monotonic() >= self._due_s:
            self._step()

    def _step(self) -> None:
        self._stepping = self._counter is not None and self._counter.step()
        if self._stepping:
            self._table.set_timer(STEP_PAUSE_S, self._step)
        else:
            self._due_s = monotonic() + RECOUNT_S

    @property
    def text(self) -> str:
        """`hit 2 of 16` on a hit, else `16 hits`; empty without a search."""
        if self._counter is None or self._table.search is None:
            return ""
        index = self._table.cursor_index
        position = self._counter.position(-1 if index is None else index)
        if position.number is None:
            return _("{all:,} hits", all=position.total)
        return _("hit {number:,} of {all:,}", number=position.number, all=position.total)


TICK_S: Final = 1 / 20
"""Interval at which the clock polls the feed, seconds."""

SHARE_OF_CORE: Final = 0.12
"""Processor time that new rows of a capture may take on the screen, as a share of a core; if a
frame takes longer, the next rows wait."""

LONGEST_INTERVAL_S: Final = 0.25
"""Longest time that they wait for that, seconds."""

REST_TICKS: Final = 10
"""Ticks of the clock in one poll of a feed that has ended, while the user does nothing."""

INPUT_PAUSE_NS: Final = 1_000_000_000
"""How long after a key or a move of the mouse every tick polls."""

KEY_PAUSE_NS: Final = 250_000_000
"""How long a file's rows and the models wait after a key, since reading delays the next keys."""


class PollInterval:
    """Decides at which ticks of the clock the feed is polled."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._skipped = 0
        """Ticks since the last poll, at rest."""
        self._last_input_ns = monotonic_ns()
        self._last_key_ns = monotonic_ns() - KEY_PAUSE_NS
        self._used_s = thread_time()
        """Processor time of the event loop's thread up to the last poll."""
        self._rests_until_s = 0.0

    def on_clock(self, *, at_rest: bool = False, captures: bool = False) -> bool:
        """Whether to poll at this tick.

        Where nothing can change without the user, `at_rest`, most ticks are skipped. Where a
        capture runs, the ticks are skipped in which the screen would take too much of a core.
        """
        if at_rest and monotonic_ns() - self._last_input_ns > INPUT_PAUSE_NS:
            self._skipped = (self._skipped + 1) % REST_TICKS
            return self._skipped == 0
        now_s = monotonic()
        if captures and now_s < self._rests_until_s:
            return False
        before_s, self._used_s = self._used_s, thread_time()
        needed_s = min((self._used_s - before_s) / SHARE_OF_CORE, LONGEST_INTERVAL_S)
        # The time until this tick counts for the next wait, so that the mean is the share.
        self._rests_until_s = max(self._rests_until_s, now_s - TICK_S) + needed_s
        return True

    def on_input(self) -> None:
        """Note a key or a move of the mouse."""
        self._last_input_ns = monotonic_ns()

    def on_key(self) -> None:
        """Note a key press; a file stops reading for a moment."""
        self._last_key_ns = monotonic_ns()
        if isinstance(self._feed, StaticFeed):
            self._feed.rest()

    @property
    def key_was_recent(self) -> bool:
        """Whether a key was pressed within `KEY_PAUSE_NS`."""
        return monotonic_ns() - self._last_key_ns < KEY_PAUSE_NS
