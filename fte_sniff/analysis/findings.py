"""Findings: the spans of time in which something is wrong, ranked.

A cause is a count of events by window (`events.py`). A window is *bad* if its count reaches a
threshold. The detector scans all intervals of bad windows: given C bad windows of n, the number in
an interval with share p of the windows is Binomial(C, p) if nothing is wrong there, so

    P(c or more) <= exp(-C KL(c / C || p))

An interval is a finding if that bound, times the number of intervals, thresholds and series, is
less than `ALPHA`: the union bound, so no simulation is needed. Windows are counted, not events, so
that bursts of events, which depend on each other, count once. Several thresholds are tried: a low
one for rare events, a high one where single events are usual.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, log
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np

from fte_sniff.analysis.events import (
    DELAY_UNIT_NS,
    GRADES,
    RATIO_UNIT,
    RUNNING,
    Events,
    Windows,
    by_role,
    least_of,
)
from fte_sniff.analysis.facts import DEADLINE_NS, MOST_HELD, Facts, first_feedback
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.model import Model, RowCount, RowModel
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.protocol import (
    FAULT_MEANINGS,
    KINDS,
    MOTORS,
    Direction,
    Fault,
    Gap,
    PortEvent,
    PortEventKind,
)
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import NO_ROWS, NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit, online_bit_text

ALPHA: Final = 0.01
"""Bound on the probability of any false finding in a recording."""

_MOST_SPANS: Final = 5
"""Spans of one series."""

_LEAST_WINDOWS: Final = 3
"""Bad windows of a finding."""

_THRESHOLDS: Final = (1, 2, 3, 5, 8, 13, 21)
"""Events that make a window bad; the one with the highest score counts."""

_SERIES: Final = 100
"""Series for which the bound on false findings holds together."""

_LEAST_RATIO: Final = 3.0
"""How much more frequent events are in a finding than elsewhere."""


class Cause(StrEnum):
    """What is wrong."""

    PORT = "port"
    SILENCE = "silence"
    DAMAGE = "damage"
    OFFLINE = "offline"
    ERROR_FLAG = "error_flag"
    UNANSWERED = "unanswered"
    LATE = "late"
    OFF_TARGET = "off_target"
    IRREGULAR_COMMANDS = "irregular_commands"
    JUMP = "jump"


_EXPLAINS: Final[Mapping[Cause, frozenset[Cause]]] = {
    Cause.PORT: frozenset(Cause),
    Cause.SILENCE: frozenset({Cause.UNANSWERED, Cause.LATE, Cause.OFF_TARGET}),
    Cause.DAMAGE: frozenset(
        {
            *(Cause.DAMAGE, Cause.UNANSWERED, Cause.LATE, Cause.JUMP),
            *(Cause.IRREGULAR_COMMANDS, Cause.SILENCE),
        }
    ),
    Cause.OFFLINE: frozenset({Cause.SILENCE, Cause.UNANSWERED, Cause.OFF_TARGET}),
    Cause.ERROR_FLAG: frozenset({Cause.OFF_TARGET}),
    Cause.IRREGULAR_COMMANDS: frozenset({Cause.UNANSWERED, Cause.LATE}),
    Cause.OFF_TARGET: frozenset({Cause.JUMP}),
}
"""Causes whose findings in the same span are consequences of a cause."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One span in which something is wrong."""

    cause: Cause
    port: str
    """Text from outside; empty if it concerns all ports."""
    motor: int | None
    kind: str | None
    first_ns: int
    last_ns: int
    events: int
    rows: int
    """Rows, or commands, that could have been events."""
    usual: float
    """The share of events elsewhere, 0 to 1."""
    text: TranslatableText
    """One sentence for the user."""
    filter: str
    """Shows its rows."""
    score: float

    @property
    def about(self) -> str:
        """Its cause, and the motor if it is about one."""
        return f"{self.cause}, motor {self.motor}" if self.motor else str(self.cause)

    @property
    def decided_ns(self) -> tuple[int, int]:
        """Its span, with the time after it that decides whether its last commands are answered."""
        return self.first_ns, self.last_ns + DEADLINE_NS

    def continues(self, other: Finding) -> bool:
        """Whether it is the other one, after a search among more rows."""
        topics = [(one.cause, one.port, one.motor, one.kind) for one in (self, other)]
        return topics[0] == topics[1] and self.overlap(other) > 0

    def overlap(self, other: Finding) -> float:
        """The common time, as a share of the shorter of both."""
        common = min(self.last_ns, other.last_ns) - max(self.first_ns, other.first_ns)
        shorter = min(self.last_ns - self.first_ns, other.last_ns - other.first_ns)
        return max(0.0, common / shorter) if shorter else float(common >= 0)


class _Span(NamedTuple):
    start: int
    end: int
    """Half-open range of exposed windows."""
    score: float


def _divergence(share: float, expected: float) -> float:
    """Kullback-Leibler divergence of two shares of bad windows."""
    inside = share * log(share / expected) if share > 0 else 0.0
    return inside + ((1 - share) * log((1 - share) / (1 - expected)) if share < 1 else 0.0)


def _lengths(count: int) -> Ints:
    """Lengths of intervals, two an octave, up to half of all windows."""
    halves = np.unique(np.round(2 ** (np.arange(0, 64) / 2)).astype(np.int64))
    found: Ints = halves[(halves >= _LEAST_WINDOWS) & (halves <= max(_LEAST_WINDOWS, count // 2))]
    return found


def _best_span(bad: Bools) -> _Span | None:
    """The interval of bad windows that is least probable by chance."""
    count, total = len(bad), int(bad.sum())
    if total < _LEAST_WINDOWS or total == count:
        return None
    sums = np.concatenate(([0], np.cumsum(bad)))
    best = _Span(0, 0, 0.0)
    for length in _lengths(count).tolist():
        inside = sums[length:] - sums[:-length]
        at = int(inside.argmax())
        start, end = _trimmed(bad, at, at + length)
        span = _Span(start, end, _score(sums, start, end))
        best = max(best, span, key=lambda one: one.score)
    if best.end == best.start:
        return None
    return _extended(sums, bad, best)


def _trimmed(bad: Bools, start: int, end: int) -> tuple[int, int]:
    hits = np.flatnonzero(bad[start:end])
    return (start + int(hits[0]), start + int(hits[-1]) + 1) if len(hits) else (start, start)


def _score(sums: Ints, start: int, end: int) -> float:
    """Minus the logarithm of the bound on the probability of as many bad windows."""
    total, inside = int(sums[-1]), int(sums[end] - sums[start])
    share, expected = inside / total, (end - start) / (len(sums) - 1)
    if share <= expected or inside < _LEAST_WINDOWS:
        return 0.0
    return total * _divergence(share, expected)


def _extended(sums: Ints, bad: Bools, span: _Span) -> _Span:
    """The span with the bad windows beside it, while the score rises."""
    hits = np.flatnonzero(bad)
    while True:
        before = hits[: np.searchsorted(hits, span.start)][-1:]
        after = hits[np.searchsorted(hits, span.end) :][:1] + 1
        choices = [(int(at), span.end) for at in before] + [(span.start, int(at)) for at in after]
        inner = [_trimmed(bad, span.start + 1, span.end), _trimmed(bad, span.start, span.end - 1)]
        choices += [one for one in inner if one[1] > one[0]]
        spans = [_Span(start, end, _score(sums, start, end)) for start, end in choices]
        best = max(spans, key=lambda one: one.score, default=span)
        if best.score <= span.score:
            return span
        span = best


def spans_of(counts: Ints, exposed: Bools, alpha: float = ALPHA) -> list[tuple[int, int, float]]:
    """The spans in which a count is more frequent than usual, with their scores.

    Args:
        counts: events by window.
        exposed: the windows in which an event could have been.
        alpha: bound on the probability of a false one.

    Returns the first and the last window of each.
    """
    at, found = np.flatnonzero(exposed), list[tuple[int, int, float]]()
    own = counts[at]
    for _ in range(_MOST_SPANS):
        if len(at) < 2 * _LEAST_WINDOWS:
            break
        tried = [one for one in _THRESHOLDS if (own >= one).sum() >= _LEAST_WINDOWS]
        spans = [span for one in tried if (span := _best_span(own >= one)) is not None]
        best = max(spans, key=lambda one: one.score, default=None)
        intervals = len(at) * max(1, len(_lengths(len(at))))
        bound = log(intervals * len(_THRESHOLDS) * _SERIES / alpha)
        if best is None or best.score < bound:
            break
        found.append((int(at[best.start]), int(at[best.end - 1]), best.score))
        kept = np.ones(len(at), np.bool_)
        kept[best.start : best.end] = False
        at, own = at[kept], own[kept]
    return found


_WHOLE_SHARE: Final = 0.15
"""Share of events in all rows from which on all of them are a finding."""

_WHOLE_DAMAGE: Final = 0.05
"""As `_WHOLE_SHARE`, of damaged rows: a sound line has none."""

_MOST: Final = 0.8
"""The share of events that are most of them."""

_LEAST_EVENTS: Final = 20

_FLAG_PAUSE_NS: Final = 10_000_000_000
_ERROR_PAUSE_NS: Final = 60_000_000_000
"""With a longer pause between them, flags, or errors of a port, belong to different spans."""

_CHANCE: Final = 0.001
"""Share of rows that bear an event by chance, where one event alone says nothing."""


class _Counted(NamedTuple):
    """The number of events by window, and the times of the first and the last one."""

    events: Ints
    first_ns: Ints
    last_ns: Ints

    @classmethod
    def of(cls, windows: Windows, *names: str) -> _Counted:
        """The events of one or more columns together."""
        ranges = [windows.range_of(name) for name in names]
        return cls(
            np.sum([windows.count(name) for name in names], axis=0),
            np.min([low for low, _, _ in ranges], axis=0),
            np.max([high for _, high, _ in ranges], axis=0),
        )


class _Seen(NamedTuple):
    """What a series has in a span."""

    own: slice
    """The windows of the span."""
    events: int
    rows: int
    usual: float
    first_ns: int
    last_ns: int

    @property
    def numbers(self) -> dict[str, object]:
        """The values that most sentences have."""
        usual = _usually(self.usual)
        return {"events": f"{self.events:,}", "rows": f"{self.rows:,}", "usual": usual}


_Describe: TypeAlias = Callable[[_Seen], tuple[TranslatableText, str]]
"""Sentence and filter of a span."""


@dataclass(frozen=True, slots=True)
class _CauseCounts:
    """The counts of one cause by window, and how to describe a span of it."""

    cause: Cause
    counted: _Counted
    rows: Ints
    """By window, the rows that could have been events."""
    describe: _Describe
    port: str | None = None
    """None if the ports of `senders` tell it."""
    motor: int | None = None
    kind: str | None = None
    senders: Direction = Direction.CONTROL
    sure: int = 0
    """Events that are a finding wherever they are; 0 if their frequency decides."""
    pause_ns: int = _FLAG_PAUSE_NS
    """Pause between sure events from which on they are of several spans."""
    whole_share: float | None = None
    """Share of events from which on all of them are a finding; None if they never are."""
    least_share: float = 0.02
    """Share of rows that are events in a finding."""


def _sure_spans(series: _CauseCounts) -> Iterator[tuple[int, int, float]]:
    """The spans of events that need no comparison, at most `_MOST_SPANS`."""
    counted = series.counted
    hits = np.flatnonzero(counted.events)
    pauses = counted.first_ns[hits[1:]] - counted.last_ns[hits[:-1]]
    longest = np.argsort(-pauses, kind="stable")[: _MOST_SPANS - 1]
    cuts = np.sort(longest[pauses[longest] > series.pause_ns]) + 1
    for own in np.split(hits, cuts) if len(hits) else ():
        events = int(counted.events[own].sum())
        if events >= series.sure:
            yield int(own[0]), int(own[-1]), -events * log(_CHANCE)


def _examined(
    events: Events, windows: Windows, series: _CauseCounts, alpha: float
) -> Iterator[Finding]:
    counted, exposed = series.counted, series.rows > 0
    spans = list(_sure_spans(series)) if series.sure else spans_of(counted.events, exposed, alpha)
    total = int(counted.events.sum())
    outside = np.ones(len(exposed), np.bool_)
    for start, end, _ in spans:
        outside[start : end + 1] = False
    usual_rows = int(series.rows[outside].sum())
    usual = int(counted.events[outside].sum()) / usual_rows if usual_rows else 0.0
    least = series.whole_share
    if least is not None and usual >= least and total >= _LEAST_EVENTS:
        hits = np.flatnonzero(counted.events)
        spans, usual = [(int(hits[0]), int(hits[-1]), float(total))], 0.0
    for start, end, score in spans:
        own = slice(start, end + 1)
        inside = int(counted.events[own].sum())
        rows = int(series.rows[own].sum())
        too_few = inside < rows * max(series.least_share, _LEAST_RATIO * usual)
        if too_few and not series.sure:
            continue
        first_ns, last_ns = int(counted.first_ns[own].min()), int(counted.last_ns[own].max())
        text, shown = series.describe(_Seen(own, inside, rows, usual, first_ns, last_ns))
        port = series.port
        if port is None:
            port = _port_in(events, series.senders, first_ns, last_ns)
        yield Finding(
            series.cause,
            port,
            series.motor,
            series.kind,
            first_ns,
            last_ns,
            inside,
            rows,
            round(usual, 6),
            text,
            shown,
            score,
        )


_WHAT: Final = {Direction.CONTROL: "commands", Direction.FEEDBACK: "feedback"}
"""Columns of the windows of ports, by direction."""


def _port_in(events: Events, senders: Direction, first_ns: int, last_ns: int) -> str:
    """The port with frames of a direction in a span; empty if there are several, or none."""
    found = []
    for port, windows in events.ports.items():
        starts = windows.starts_ns
        near = (starts <= last_ns) & (starts + windows.width_ns > first_ns)
        if windows.count(_WHAT[senders])[near].any():
            found.append(port)
    return found[0] if len(found) == 1 else ""


class _Opening(Model):
    """The first rows, whose facts depend on rows before them that another model may have."""

    def __init__(self) -> None:
        self.rows = NO_ROWS
        """The rows that are not counted, and those after them that decide their facts."""
        self.count = 0
        """The number of those that are not counted."""
        self.is_open = True
        self._decided = NO_ROWS
        """Those whose facts are decided, while it is open."""

    def add(self, rows: Rows, known: Rows) -> Rows:
        """Add the next rows, and those that are decided now; returns those to count."""
        self.rows = _joined(self.rows, rows)
        self._decided = known = _joined(self._decided, known)
        # No command before the first feedback is unanswered, unless rows before have feedback.
        feedback = min(first_feedback(self.rows), MOST_HELD)
        count = max(_end_of_second(self.rows, 0), feedback)
        end = _end_of_second(self.rows, count)
        self.is_open = end >= len(self.rows) or len(known) < count
        if self.is_open:
            self.count = len(self.rows)
            return NO_ROWS
        self.rows, self.count, self._decided = self.rows[: end + 1], count, NO_ROWS
        return known[count:]

    def after(self, before: Rows) -> _Opening:
        """The opening of more rows, which begin with others."""
        found = self.copy()
        found.rows, found.count = _joined(before, self.rows), len(before) + self.count
        return found

    def with_facts(self, facts: Facts, waiting: int) -> Rows:
        """The rows that `facts` lets wait, and those that are not counted, with their facts."""
        return _joined(facts.feed(self.rows), facts.interrupt())[: waiting + self.count]


def _joined(*parts: Rows) -> Rows:
    return Rows.concat([one for one in parts if len(one)] or [NO_ROWS])


def _end_of_second(rows: Rows, start: int) -> int:
    """The first index of rows that no fact of the row at `start` depends on."""
    later = rows.t_ns[start:]
    timed = later[later != NO_TIME]
    if len(timed):
        beyond = np.flatnonzero(later > timed[0] + DEADLINE_NS)
        if len(beyond):
            return start + min(int(beyond[0]), MOST_HELD)
    return start + min(len(later), MOST_HELD)


class Findings(RowModel):
    """Looks for spans in which something is wrong."""

    CAUSES: Final = tuple(map(str, Cause))
    """The causes that it knows."""

    def __init__(self) -> None:
        self.total = RowCount()
        self.frames = 0
        self._events = Events()
        self._facts: Facts | None = Facts(previous=False)
        self._waiting = 0
        """Rows whose facts are not decided."""
        self._opening = _Opening()
        self.grows = False
        """Whether more rows are expected: a lost port may be found again."""

    @classmethod
    def of_facts(cls) -> Self:
        """For rows that have their facts already, such as those of a store."""
        found = cls()
        found._facts = None
        return found

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap) and self._facts is not None:
            known, self._waiting = self._facts.interrupt(change), 0
            if not self._opening.is_open:
                self._events.observe(known)
            self._opening.is_open = False
        self._events.observe_change(change)

    def _observe(self, rows: Rows) -> None:
        self.total.observe(rows)
        self.frames += int(rows.framed.sum())
        self._count(rows)

    def _count(self, rows: Rows) -> None:
        if self._facts is None:
            self._events.observe(rows)
            return
        known = self._facts.feed(rows)
        self._waiting += len(rows) - len(known)
        if self._opening.is_open:
            known = self._opening.add(rows, known)
        self._events.observe(known)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        self._events.observe_events(events)

    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""
        self.total.merge(later.total)
        self.frames += later.frames
        if self._facts is not None and later._facts is not None:
            if later._opening.is_open:
                self._count(later._opening.rows)
            else:
                self._follow(later._opening, later._facts, later._waiting)
        self._events.merge(later._events)

    def _follow(self, opening: _Opening, facts: Facts, waiting: int) -> None:
        """Continue with the facts of the rows that follow, of which all but some are counted."""
        if self._opening.is_open:
            self._opening = opening.after(self._opening.rows)
        elif self._facts is not None:
            self._events.observe(opening.with_facts(self._facts, self._waiting))
        self._facts, self._waiting = facts.copy(), waiting

    @property
    def events(self) -> Events:
        """The events of all rows; rows may follow."""
        if self._facts is None:
            return self._events
        found = Events()
        found.observe(self._opening.with_facts(Facts(previous=False), 0))
        found.merge(self._events)
        if not self._opening.is_open:
            found.observe(self._facts.copy().interrupt())
        return found

    def found(self, alpha: float = ALPHA) -> list[Finding]:
        """The findings, best first; rows may follow."""
        return self._found_in(self.events, alpha)

    def recent(self, since_ns: int, alpha: float = ALPHA) -> list[Finding]:
        """The findings in the rows from a time on; rows may follow."""
        return self._found_in(self.events.since(since_ns), alpha)

    def found_and_recent(self, recent_ns: int) -> tuple[list[Finding], list[Finding]]:
        """The findings about all rows and their last time, and those about that time alone.

        What is rare in hours may stand out in the last minutes, and the other way round. With a
        time of 0 there are only those about all rows. More rows may follow.
        """
        found = self.found()
        last_ns = self.total.last_ns
        if not recent_ns or last_ns is None:
            return found, []
        recent = self.recent(last_ns - recent_ns)
        return _ranked([*found, *recent]), recent

    def _found_in(self, events: Events, alpha: float) -> list[Finding]:
        if self.total.times is None or not self.frames:
            return []
        lost = list(_lost_ports(events, self.total.times[1], grows=self.grows))
        return _ranked([*lost, *_all_of(events, alpha)])

    def not_covered(self) -> dict[str, TranslatableText]:
        """By cause, why it could not be examined."""
        if not self.total.rows:
            return dict.fromkeys(self.CAUSES, TranslatableText("the input has no rows"))
        if not self.frames:
            text = TranslatableText("no row is a frame; is the baud rate right?")
            return dict.fromkeys(self.CAUSES, text)
        if self.total.first_ns is None:
            return dict.fromkeys(self.CAUSES, TranslatableText("no row has a time; try --start"))
        return dict(_uncovered(self.events))

    def counts(self) -> dict[Cause, int]:
        """By cause, the rows that bear an event alone, whether or not they are in a finding.

        Commands to several motors count once for each of them that did not answer.
        """
        events = self.events
        windows = events.windows
        found = {
            Cause.DAMAGE: sum(int(one.count("damaged").sum()) for one in events.ports.values()),
            Cause.ERROR_FLAG: int(windows.count("any raised").sum()),
            Cause.OFFLINE: int(windows.count("any offline").sum()),
            Cause.UNANSWERED: sum(int(windows.count(f"missed {one}").sum()) for one in MOTORS),
        }
        missing = dict(_uncovered(events))
        return {cause: count for cause, count in found.items() if cause not in missing}

    def _not_findings(self) -> Iterator[TranslatableText]:
        """What is counted, although it makes no finding."""
        found, counts = self.counts(), list[TranslatableText]()
        if count := found.get(Cause.DAMAGE):
            share = f"{100 * count / self.total.rows:.2g}"
            text = TranslatableText(
                "malformed rows {count:,} ({percent} %)", count=count, percent=share
            )
            counts.append(text)
        if count := found.get(Cause.ERROR_FLAG):
            counts.append(TranslatableText("frames with an ERROR flag {count:,}", count=count))
        if count := found.get(Cause.OFFLINE):
            counts.append(
                TranslatableText("frames that lack a bit of ONLINE {count:,}", count=count)
            )
        if count := found.get(Cause.UNANSWERED):
            counts.append(TranslatableText("commands without an answer {count:,}", count=count))
        if counts:
            yield TranslatableText(
                "too few, or too even over time, for a finding: {counts}", counts=listed(counts)
            )

    def coverage(self, found: Sequence[Finding]) -> list[TranslatableText]:
        """What was examined and counted, where nothing was found; what could not be, and why."""
        missing = self.not_covered()
        covered = [cause for cause in self.CAUSES if cause not in missing]
        texts: list[TranslatableText] = []
        if not covered:
            why = next(iter(missing.values()))
            return [TranslatableText("nothing could be examined: {why}", why=why)]
        if not found:
            rows, causes = self.total.rows, listed(covered)
            texts.append(
                TranslatableText(
                    "no findings in {rows:,} rows; examined: {causes}", rows=rows, causes=causes
                )
            )
            texts += self._not_findings()
        for why in dict.fromkeys(missing.values()):
            causes = listed(cause for cause, reason in missing.items() if reason == why)
            texts.append(TranslatableText("not examined: {causes}: {why}", causes=causes, why=why))
        return texts


def _uncovered(events: Events) -> Iterator[tuple[str, TranslatableText]]:
    windows, senders = events.windows, _ports_with(events, "commands")
    commands = sum(int(windows.count(f"commands {motor}").sum()) for motor in MOTORS)
    feedback = int(windows.count("feedback").sum())
    answers = (Cause.UNANSWERED, Cause.LATE, Cause.SILENCE, Cause.OFF_TARGET)
    if not commands:
        text = TranslatableText("no command awaits an answer")
        yield from ((str(one), text) for one in answers)
        yield str(Cause.IRREGULAR_COMMANDS), TranslatableText("commands are missing")
    elif not feedback:
        text = TranslatableText("feedback is missing: only one wire was recorded")
        yield from ((str(one), text) for one in answers)
    elif _at_the_same_time(events, senders):
        text = TranslatableText(
            "several ports had commands at the same time: which one feedback answers is not known"
        )
        yield from ((str(one), text) for one in answers)
    if not feedback:
        flags = (Cause.ERROR_FLAG, Cause.OFFLINE, Cause.JUMP)
        yield from ((str(one), TranslatableText("feedback is missing")) for one in flags)


def _at_the_same_time(events: Events, ports: Sequence[str]) -> bool:
    """Whether several ports have commands in the same windows."""
    windows = [events.ports[port] for port in ports]
    shift = max((one.shift for one in windows), default=0)
    keys = [np.unique(one.starts_ns[one.count("commands") > 0] >> shift) for one in windows]
    return bool(keys) and len(np.unique(np.concatenate(keys))) < sum(map(len, keys))


def _ports_with(events: Events, what: str) -> list[str]:
    counts = {port: int(one.count(what).sum()) for port, one in events.ports.items()}
    return sorted((port for port, count in counts.items() if count), key=lambda port: -counts[port])


def _all_of(events: Events, alpha: float) -> Iterator[Finding]:
    several = len(events.ports) > 1
    for port, windows in events.ports.items():
        for series in _port_series(port, windows, several=several):
            yield from _examined(events, windows, series, alpha)
    uncovered = dict(_uncovered(events))
    for series in _motor_series(events.windows):
        if series.cause not in uncovered:
            yield from _examined(events, events.windows, series, alpha)


def _lost_ports(events: Events, last_ns: int, *, grows: bool) -> Iterator[Finding]:
    still = TranslatableText("the port was lost and not found again")
    if grows:
        still = TranslatableText("the port was lost and not found again so far")
    for port, start, end in events.lost:
        until = last_ns if end is None else end
        text = still if end is None else TranslatableText("the port was lost and found again")
        yield Finding(
            Cause.PORT, port, None, None, start, max(start, until), 1, 0, 0.0, text, "", inf
        )


_PORT_EVENTS: Final = (
    (PortEventKind.LINE_ERROR, TranslatableText("the UART reported errors"), Fault.LINE_ERROR, 3),
    (
        PortEventKind.OVERRUN,
        TranslatableText("bytes were lost, since they were read too late"),
        "",
        1,
    ),
    (PortEventKind.SILENT, TranslatableText("the wire was silent"), "", 1),
    (PortEventKind.SHARED, TranslatableText("another program had the port open"), "", 1),
)
"""What happened, the filter of its rows, and how often at least it is a finding.

A few line errors alone may come from a plug.
"""


def _port_series(port: str, windows: Windows, *, several: bool) -> Iterator[_CauseCounts]:
    rows = windows.count("rows")
    own_port = f"port = {quoted(port)}" if several else ""
    yield _damage(windows, port, own_port)
    for motor in MOTORS:
        yield _damage(windows, port, own_port, motor)
    for kind, meaning, shown, least in _PORT_EVENTS:
        own_filter = " AND ".join(filter(None, (shown, own_port)))
        describe = _sentence("{meaning}, {events} times", own_filter, meaning=meaning)
        yield _CauseCounts(
            Cause.PORT,
            _Counted.of(windows, kind),
            rows,
            describe,
            port,
            sure=least,
            pause_ns=_ERROR_PAUSE_NS,
        )


def _damage(windows: Windows, port: str, own_port: str, motor: int | None = None) -> _CauseCounts:
    """The damaged rows of a port, or those that probably belong to one of its motors."""
    of = "" if motor is None else f" {motor}"
    hint = "" if motor is None else f"motor_hint = {motor}"
    shown = " AND ".join(filter(None, ("malformed", hint, own_port)))

    def describe(seen: _Seen) -> tuple[TranslatableText, str]:
        fault = _prevailing(windows, seen, "fault", FAULT_MEANINGS, 0.0)
        direction = _prevailing(windows, seen, "damaged", Direction)
        text = TranslatableText("{events} of {rows} rows are damaged; {usual}", **seen.numbers)
        bursts = seen.events - int(windows.count(f"burst {port}")[seen.own].sum())
        if motor is not None:
            text = TranslatableText("motor {motor}: {text}", motor=motor, text=text)
        elif 2 * bursts <= seen.events:
            text = TranslatableText("{text}; in {bursts} bursts", text=text, bursts=f"{bursts:,}")
        mostly = listed([fault, direction] if direction else [fault])
        return TranslatableText("{text}; mostly {what}", text=text, what=mostly), shown

    counted, rows = _Counted.of(windows, f"damaged{of}"), windows.count(f"rows{of}")
    whole = _WHOLE_DAMAGE if motor is None else None
    return _CauseCounts(Cause.DAMAGE, counted, rows, describe, port, motor, whole_share=whole)


def _prevailing(
    windows: Windows, seen: _Seen, of: str, names: Iterable[object], least: float = _MOST
) -> str:
    """The name that most of the events have; empty if too few have the same."""
    counts = {str(name): int(windows.count(f"{of} {name}")[seen.own].sum()) for name in names}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] > least * seen.events else ""


def _usually(usual: float) -> TranslatableText:
    if usual < 0.0005:
        return TranslatableText("usually none")
    return TranslatableText("usually {percent} %", percent=f"{100 * usual:.2g}")


def _sentence(form: str, shown: str, **values: object) -> _Describe:
    """A sentence of the numbers of a span and these values, and the filter of its rows."""

    def describe(seen: _Seen) -> tuple[TranslatableText, str]:
        return TranslatableText(form, **seen.numbers, **values), shown

    return describe


def _motor_series(windows: Windows) -> Iterator[_CauseCounts]:
    for motor in MOTORS:
        yield _unanswered(windows, motor)
        yield from _late(windows, motor)
        yield from _flags(windows, motor)
        yield from _off_target(windows, motor)
        yield from _jumps(windows, motor)
        yield from _silences(windows, motor)
    yield from _irregular(windows)


_MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]


def _unanswered(windows: Windows, motor: int) -> _CauseCounts:
    def describe(seen: _Seen) -> tuple[TranslatableText, str]:
        share = TranslatableText("usually {percent} %", percent=f"{100 * (1 - seen.usual):.3g}")
        text = TranslatableText(
            "motor {motor} answered {answered} of {rows} commands; {usual}",
            motor=motor,
            answered=f"{seen.rows - seen.events:,}",
            rows=f"{seen.rows:,}",
            usual=TranslatableText("usually all") if seen.usual < 0.0005 else share,
        )
        own_filter = f"{_MOTOR} = {motor}"
        if windows.count(f"free {motor}")[seen.own].any():
            own_filter = f"({own_filter} OR {_MOTOR} IS NULL)"
        return text, f"unanswered AND {own_filter}"

    missed, asked = _Counted.of(windows, f"missed {motor}"), windows.count(f"asked {motor}")
    return _CauseCounts(
        Cause.UNANSWERED, missed, asked, describe, motor=motor, whole_share=_WHOLE_SHARE
    )


def _late(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    for kind in KINDS:
        names = [f"delay {motor} {kind.name} {grade}" for grade in range(GRADES)]
        grades = np.array([windows.count(name) for name in names])
        total = grades.sum(axis=1)
        if total.sum() < _LEAST_EVENTS:
            continue
        median = int(np.searchsorted(np.cumsum(total), total.sum() / 2))
        for grade in range(median + 2, min(median + 8, GRADES)):
            if not total[grade:].sum():
                continue
            limit, usual_ms = (least_of(one) * DELAY_UNIT_NS / 1e6 for one in (grade, median))
            describe = _sentence(
                "{events} of {rows} answers of motor {motor} to {kind} took {limit} ms or longer;"
                " usually about {usual_ms} ms",
                f"answer_ms >= {limit:g} AND kind = '{kind.name}' AND {_MOTOR} = {motor}",
                motor=motor,
                kind=kind.name,
                limit=f"{limit:g}",
                usual_ms=f"{usual_ms:.2g}",
            )
            yield _CauseCounts(
                Cause.LATE,
                _Counted.of(windows, *names[grade:]),
                grades.sum(axis=0),
                describe,
                motor=motor,
                kind=kind.name,
                least_share=0.05,
            )


def _flags(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    feedback, any_feedback = windows.count(f"feedback {motor}"), windows.count("feedback")
    errors, online = NAME_OF_ROLE[Role.ERRORS], NAME_OF_ROLE[Role.ONLINE]

    def of_error(seen: _Seen) -> tuple[TranslatableText, str]:
        bits = sum(
            1 << bit
            for bit in range(8)
            if windows.count(f"raised {motor} bit {bit}")[seen.own].any()
        )
        text = TranslatableText(
            "motor {motor} reported ERROR {bits} in {events} of {rows} frames; {usual}",
            **seen.numbers,
            motor=motor,
            bits=f"{bits:02X}",
        )
        return text, f"{_MOTOR} = {motor} AND {errors} != 0"

    of_online = _sentence(
        "{bit} was 0 in {events} of {rows} frames; {usual}",
        f"{online} & {1 << motor_bit(motor)} = 0",
        bit=online_bit_text(motor),
    )
    exposed = np.where(feedback.any(), any_feedback, 0)
    for cause, name, rows, describe in (
        (Cause.ERROR_FLAG, "raised", feedback, of_error),
        (Cause.OFFLINE, "offline", exposed, of_online),
    ):
        if rows.any():
            yield _CauseCounts(
                cause,
                _Counted.of(windows, f"{name} {motor}"),
                rows,
                describe,
                motor=motor,
                senders=Direction.FEEDBACK,
                sure=RUNNING,
            )


_EXPECTED: Final = 6
"""Feedback of a motor in a window from which on its absence is silence."""


def _silences(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    """Windows without feedback of a motor, in which commands to it went on."""
    commands = _Counted.of(windows, f"commands {motor}")
    feedback = _Counted.of(windows, f"feedback {motor}")
    active, answers = commands.events > 0, feedback.events > 0
    if not (active & answers).any():
        return
    usual = max(1, int(np.median(feedback.events[active & answers])))
    width = max(1, -(-_EXPECTED // usual))
    recent = np.convolve(feedback.events, np.ones(width), "full")[: len(answers)]
    silent = active & (recent < 0.5)

    def describe(seen: _Seen) -> tuple[TranslatableText, str]:
        seconds = seen.events * windows.width_ns
        if seen.events == seen.rows:
            seconds = seen.last_ns - seen.first_ns
        text = TranslatableText(
            "motor {motor} sent no feedback for {seconds} s while commands went on",
            motor=motor,
            seconds=f"{seconds / 1e9:.0f}",
        )
        return text, f"{_MOTOR} = {motor}"

    # It begins with the last feedback, unless the host paused meanwhile; and ends with the next.
    near = (width + 1) * windows.width_ns
    before = np.maximum.accumulate(feedback.last_ns)
    after = np.minimum.accumulate(feedback.first_ns[::-1])[::-1]
    first_ns, last_ns = commands.first_ns, commands.last_ns
    starts = windows.starts_ns
    counted = _Counted(
        silent.astype(np.int64),
        np.where(before > starts - near, before, first_ns),
        np.where(after < starts + windows.width_ns + near, after, last_ns),
    )
    yield _CauseCounts(
        Cause.SILENCE,
        counted,
        active.astype(np.int64),
        describe,
        motor=motor,
        whole_share=_WHOLE_SHARE,
        least_share=0.3,
    )


_SETTLES: Final = 3
"""Windows before one whose targets a motor may still move to."""


def _recent(values: Ints, known: Bools, width: int) -> Ints:
    """The highest value of each window and of `width` before it."""
    found = np.where(known, values, -(2**62))
    for by in range(1, width + 1):
        found[by:] = np.maximum(found[by:], np.where(known, values, -(2**62))[:-by])
    return found


def _off_target(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    """Windows in which all present values are outside of the range of the recent targets."""
    if len(windows) <= _SETTLES:
        return
    feedback = _Counted.of(windows, f"feedback {motor}")
    for role in (Role.SPEED, Role.POSITION):
        low, high, asked = windows.range_of(f"target {role} {motor}")
        least, greatest, known = windows.range_of(f"present {role} {motor}")
        free = windows.count(f"free {motor}") > 0
        settled = _recent(asked.astype(np.int64), asked, _SETTLES) > 0
        mixed = _recent(free.astype(np.int64), free, _SETTLES) > 0
        exposed = settled & known & ~mixed & asked
        if not exposed.any():
            continue
        top, bottom = _recent(high, asked, _SETTLES), -_recent(-low, asked, _SETTLES)
        size = np.maximum(np.abs(top), np.abs(bottom))
        near = np.maximum(size // 4, _TOLERANCE[role])
        off = exposed & ((least > top + near) | (greatest < bottom - near))
        if role is Role.POSITION:
            off &= greatest - least <= _TOLERANCE[role]
        describe = _sentence(
            "the {value} of motor {motor} was not near its target in {events} of {rows} s; {usual}",
            f"{_MOTOR} = {motor}",
            motor=motor,
            value=TranslatableText(role),
        )
        kinds = by_role(role, target=True)
        yield _CauseCounts(
            Cause.OFF_TARGET,
            _Counted(off.astype(np.int64), feedback.first_ns, feedback.last_ns),
            exposed.astype(np.int64),
            describe,
            motor=motor,
            kind=kinds[0].name if kinds else None,
            senders=Direction.FEEDBACK,
            least_share=0.3,
        )


_TOLERANCE: Final = {Role.SPEED: 15, Role.POSITION: 50}
"""How near a value is to its target at least, RPM and pulses."""


def _jumps(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    for role in (Role.SPEED, Role.POSITION):
        names = [f"jump {role} {motor} {grade}" for grade in range(GRADES)]
        counted = _Counted.of(windows, *names)
        if not counted.events.any():
            continue
        describe = _sentence(
            "the {value} of motor {motor} jumped and came back {events} times in {rows} frames:"
            " bytes changed on the line",
            f"{_MOTOR} = {motor}",
            motor=motor,
            value=TranslatableText(role),
        )
        kinds = by_role(role, target=False)
        yield _CauseCounts(
            Cause.JUMP,
            counted,
            windows.count(f"present {role} {motor}"),
            describe,
            motor=motor,
            kind=kinds[0].name if kinds else None,
            senders=Direction.FEEDBACK,
        )


def _irregular(windows: Windows) -> Iterator[_CauseCounts]:
    """Periods of commands that differ from the one before by half an octave, or by one."""
    prefix = "ratio "
    streams = {
        name[len(prefix) :].rpartition(" ")[0]
        for name in windows.names()
        if name.startswith(prefix)
    }
    for stream in sorted(streams):
        names = [f"{prefix}{stream} {grade}" for grade in range(GRADES)]
        number, name = stream.split(" ", 1)
        kind = next(one for one in KINDS if one.name == name)
        motor = int(number) if kind.names_motor else None
        shown = f"kind = '{name}'"
        if motor is None:
            describe = _sentence(
                "{events} of {rows} periods of {kind} commands differ from the one before; {usual}",
                shown,
                kind=name,
            )
        else:
            describe = _sentence(
                "motor {motor}: {events} of {rows} periods of {kind} commands differ from the one"
                " before; {usual}",
                f"{shown} AND {_MOTOR} = {motor}",
                kind=name,
                motor=motor,
            )
        for octaves in (0.5, 1.0):
            yield _CauseCounts(
                Cause.IRREGULAR_COMMANDS,
                _Counted.of(windows, *names[int(octaves * RATIO_UNIT) :]),
                _Counted.of(windows, *names).events,
                describe,
                motor=motor,
                kind=name,
                least_share=0.1,
            )


def _ranked(found: list[Finding]) -> list[Finding]:
    """One finding of each cause in a span, without those that another explains, best first."""
    kept: list[Finding] = []
    for one in sorted(found, key=lambda one: -one.score):
        if not any(_is_same(one, other) for other in kept):
            kept.append(one)
    kept = [one for one in kept if not any(_explains(other, one) for other in kept)]
    return _merged_motors(kept)


_SAME: Final = 0.5
"""The share of common time from which on two spans are about the same."""


def _is_same(one: Finding, other: Finding) -> bool:
    """Whether both are of one cause and motor: of other thresholds, kinds, or values."""
    own = (one.cause, one.port, one.motor) == (other.cause, other.port, other.motor)
    return own and one.overlap(other) >= _SAME


def _explains(one: Finding, other: Finding) -> bool:
    if one is other or other.cause not in _EXPLAINS.get(one.cause, frozenset()):
        return False
    if one.overlap(other) < _SAME:
        return False
    if one.cause is other.cause:
        return one.cause is Cause.DAMAGE and _includes(one, other)
    if one.cause is Cause.DAMAGE and other.cause in (Cause.UNANSWERED, Cause.SILENCE, Cause.LATE):
        return 2 * one.events >= other.events
    return None in (one.motor, other.motor) or one.motor == other.motor


def _includes(one: Finding, other: Finding) -> bool:
    """Whether one has what the other has: a motor most of the damage of its port, or the port."""
    if None not in (one.motor, other.motor) or one.motor is other.motor or one.port != other.port:
        return False
    whole, part = (one, other) if one.motor is None else (other, one)
    return (part.events >= _MOST * whole.events) == (part is one)


def _merged_motors(found: list[Finding]) -> list[Finding]:
    """Findings of most motors with one cause in one span are one about all of them."""
    merged, rest = list[Finding](), list(found)
    while rest:
        first = rest.pop(0)
        same = [
            one
            for one in rest
            if one.cause is first.cause
            and first.motor is not None
            and one.motor is not None
            and one.overlap(first) >= _SAME
        ]
        if len({one.motor for one in (first, *same)}) >= len(MOTORS) - 1:
            group = [first, *same]
            rest = [one for one in rest if one not in same]
            motors = sorted({one.motor for one in group if one.motor is not None})
            first = replace(
                first,
                motor=None,
                first_ns=min(one.first_ns for one in group),
                last_ns=max(one.last_ns for one in group),
                events=sum(one.events for one in group),
                rows=sum(one.rows for one in group),
                text=TranslatableText(
                    "motors {motors} alike: {text}",
                    motors=listed(motors),
                    text=first.text,
                ),
                filter=" OR ".join(f"({one.filter})" for one in group),
            )
        merged.append(first)
    return merged
