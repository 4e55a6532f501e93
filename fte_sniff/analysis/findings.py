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
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from fte_sniff.analysis.events import COLUMN_OF, RUNNING, Events, Windows, by_role, counted
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.relations import DEADLINE_NS, LATE, is_off_target
from fte_sniff.analysis.segments import Counts, summed
from fte_sniff.analysis.table import MOTOR, Table
from fte_sniff.errors import Joint, TranslatableText, listed, printable
from fte_sniff.protocol import FAULT_MEANINGS, PortEventKind
from fte_sniff.protocol.rows import Bools, Ints
from fte_sniff.protocol.spec import (
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    Direction,
    Fault,
    Role,
    motor_bit,
    online_bit_text,
)

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
    UNLIKE_OTHERS = "unlike_others"


_EXPLAINS: Final[Mapping[Cause, frozenset[Cause]]] = {
    Cause.PORT: frozenset(Cause),
    Cause.SILENCE: frozenset({Cause.UNANSWERED, Cause.LATE, Cause.OFF_TARGET}),
    Cause.DAMAGE: frozenset(
        {
            *(Cause.DAMAGE, Cause.UNANSWERED, Cause.LATE, Cause.JUMP),
            *(Cause.IRREGULAR_COMMANDS, Cause.SILENCE, Cause.UNLIKE_OTHERS),
        }
    ),
    Cause.OFFLINE: frozenset({Cause.SILENCE, Cause.UNANSWERED, Cause.OFF_TARGET}),
    Cause.ERROR_FLAG: frozenset({Cause.OFF_TARGET}),
    Cause.IRREGULAR_COMMANDS: frozenset({Cause.UNANSWERED, Cause.LATE}),
    Cause.OFF_TARGET: frozenset({Cause.JUMP}),
    Cause.LATE: frozenset({Cause.UNLIKE_OTHERS}),
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


def divergence(share: float, expected: float) -> float:
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
    return total * divergence(share, expected)


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


def _port_in(events: Events, senders: Direction, first_ns: int, last_ns: int) -> str:
    """The port with frames of a direction in a span; empty if there are several, or none."""
    found = []
    for port, windows in events.ports.items():
        starts = windows.starts_ns
        near = (starts <= last_ns) & (starts + windows.width_ns > first_ns)
        if windows.count(COLUMN_OF[senders])[near].any():
            found.append(port)
    return found[0] if len(found) == 1 else ""


@dataclass(frozen=True, slots=True)
class Report:
    """The findings in a table, and what was examined."""

    found: Sequence[Finding]
    """Best first."""
    extent: Mapping[str, Any]
    """`sum rows`, `sum frames`, `sum timed`, and the times `least t` and `greatest t`."""
    not_covered: Mapping[str, TranslatableText]
    """By cause, why it could not be examined."""
    counts: Mapping[Cause, int]
    """By cause, the rows that bear an event alone, whether or not they are in a finding."""

    def coverage(self) -> list[TranslatableText]:
        """What was examined and counted, where nothing was found; what could not be, and why."""
        missing, texts = self.not_covered, list[TranslatableText]()
        covered = [cause for cause in Cause if cause not in missing]
        if not covered:
            why = next(iter(missing.values()))
            return [TranslatableText("nothing could be examined: {why}", why=why)]
        if not self.found:
            text = "no findings in {rows:,} rows; examined: {causes}"
            texts.append(
                TranslatableText(text, rows=self.extent["sum rows"], causes=listed(covered))
            )
            texts += self._not_findings()
        for why in dict.fromkeys(missing.values()):
            causes = listed(cause for cause, reason in missing.items() if reason == why)
            texts.append(TranslatableText("not examined: {causes}: {why}", causes=causes, why=why))
        return texts

    def _not_findings(self) -> Iterator[TranslatableText]:
        """What is counted, although it makes no finding."""
        counts = [
            TranslatableText(_COUNTED_AS[cause], count=count)
            for cause, count in self.counts.items()
            if count
        ]
        if counts:
            text = "counted, but not concentrated at any time: {counts}"
            yield TranslatableText(text, counts=listed(counts))


_COUNTED_AS: Final = {
    Cause.DAMAGE: "malformed rows {count:,}",
    Cause.ERROR_FLAG: "frames with an ERROR flag {count:,}",
    Cause.OFFLINE: "frames that lack a bit of ONLINE {count:,}",
    Cause.UNANSWERED: "commands without an answer {count:,}",
}


def find(counts: Counts, alpha: float = ALPHA, *, grows: bool = False) -> Report:
    """Look for the spans in which something is wrong, in what `events.counted` counted.

    `grows` is whether rows may follow.
    """
    events = Events(counts)
    extent, why = events.extent, TranslatableText("")
    if not extent["sum rows"]:
        why = TranslatableText("the input has no rows")
    elif not extent["sum frames"]:
        why = TranslatableText("no row is a frame; is the baud rate right?")
    elif not extent["sum timed"]:
        why = TranslatableText("no row has a time; try --start")
    if why:
        return Report([], extent, dict.fromkeys(map(str, Cause), why), {})
    lost = list(_lost_ports(events, extent["greatest t"], grows=grows))
    missing = dict(_uncovered(events))
    found = [*lost, *(one for one in _all_of(events, alpha) if one.cause not in missing)]
    return Report(ranked(found), extent, missing, _counts(events, missing))


def find_in(tables: Iterable[Table], *, grows: bool = False) -> Report:
    """`find` in tables, of which there is at least one."""
    return find(summed(map(counted, tables)), grows=grows)


def _counts(events: Events, missing: Mapping[str, object]) -> dict[Cause, int]:
    windows = events.windows
    found = {
        Cause.DAMAGE: sum(int(one.count("damaged").sum()) for one in events.ports.values()),
        Cause.ERROR_FLAG: int(windows.count("any raised").sum()),
        Cause.OFFLINE: int(windows.count("any offline").sum()),
        Cause.UNANSWERED: sum(int(windows.count(f"missed {one}").sum()) for one in MOTORS),
    }
    return {cause: count for cause, count in found.items() if cause not in missing}


def hidden_text(filters: Iterable[str]) -> TranslatableText:
    """Why a recording with the rows that some filters selected cannot be examined."""
    return TranslatableText(
        "the recording has only the rows for which this held: {filter}",
        filter=listed(map(printable, dict.fromkeys(filters)), Joint.AND),
    )


def _uncovered(events: Events) -> Iterator[tuple[str, TranslatableText]]:
    if events.hidden_by:
        text = hidden_text(events.hidden_by)
        yield from ((str(one), text) for one in Cause if one is not Cause.PORT)
        return
    windows, senders = events.windows, _ports_with(events, "commands")
    commands = sum(int(windows.count(f"commands {motor}").sum()) for motor in MOTORS)
    feedback = int(windows.count("feedback").sum())
    answers = (Cause.UNANSWERED, Cause.LATE, Cause.SILENCE, Cause.OFF_TARGET, Cause.UNLIKE_OTHERS)
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
    for series in _motor_series(events):
        yield from _examined(events, events.windows, series, alpha)
    for motor in MOTORS:
        yield from _slower(events, motor)
        yield from _more_damaged(events, motor)


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
        bursts = seen.events - int(windows.count("burst")[seen.own].sum())
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


def _motor_series(events: Events) -> Iterator[_CauseCounts]:
    windows = events.windows
    for motor in MOTORS:
        yield _unanswered(windows, motor)
        yield from _late(events, motor)
        yield from _flags(windows, motor)
        yield from _off_target(windows, motor)
        yield from _jumps(windows, motor)
        yield from _silences(windows, motor)
    yield from _irregular(windows)


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
        if seen.events == int(windows.count(f"asked {motor}").sum()):
            form = "motor {motor} answered none of {rows} commands; other motors answered"
            text = TranslatableText(form, motor=motor, rows=f"{seen.rows:,}")
        own_filter = f"{MOTOR} = {motor}"
        if windows.count(f"free {motor}")[seen.own].any():
            own_filter = f"({own_filter} OR {MOTOR} IS NULL)"
        return text, f"unanswered AND {own_filter}"

    missed, asked = _Counted.of(windows, f"missed {motor}"), windows.count(f"asked {motor}")
    return _CauseCounts(
        Cause.UNANSWERED, missed, asked, describe, motor=motor, whole_share=_WHOLE_SHARE
    )


def _late(events: Events, motor: int) -> Iterator[_CauseCounts]:
    for kind in KINDS:
        rows = events.windows.count(f"timed {motor} {kind.name}")
        usual_ns = events.usual.get((motor, kind.name))
        if usual_ns is None or rows.sum() < _LEAST_EVENTS:
            continue
        limit = LATE * usual_ns / 1e6
        describe = _sentence(
            "{events} of {rows} answers of motor {motor} to {kind} took {limit} ms or longer;"
            " usually about {usual_ms} ms",
            f"answer_ms >= {limit:.3g} AND kind = '{kind.name}' AND {MOTOR} = {motor}",
            motor=motor,
            kind=kind.name,
            limit=f"{limit:.3g}",
            usual_ms=f"{usual_ns / 1e6:.2g}",
        )
        yield _CauseCounts(
            Cause.LATE,
            _Counted.of(events.windows, f"late {motor} {kind.name}"),
            rows,
            describe,
            motor=motor,
            kind=kind.name,
            least_share=0.05,
        )


# A motor that is unlike the others all the time

UNLIKE: Final = 2.0
"""A motor is unlike the others if it is slower, or has more damage, by at least this factor."""

_LEAST_SLOWER_NS: Final = 2_000_000
"""How much slower it is at least."""


def _slower(events: Events, motor: int) -> Iterator[Finding]:
    """A motor whose median delay is at least twice that of each other one."""
    windows = events.windows
    for kind in KINDS:
        own = events.usual.get((motor, kind.name))
        others = [
            ns for (of, name), ns in events.usual.items() if name == kind.name and of != motor
        ]
        rows = int(windows.count(f"timed {motor} {kind.name}").sum())
        if own is None or not others or rows < _LEAST_EVENTS:
            continue
        if own < max(UNLIKE * max(others), max(others) + _LEAST_SLOWER_NS):
            continue
        text = TranslatableText(
            "motor {motor} answers {kind} after {own} ms (median), the others after {others} ms",
            motor=motor,
            kind=kind.name,
            own=f"{own / 1e6:.2g}",
            others=f"{max(others) / 1e6:.2g}",
        )
        shown = f"answer_ms >= {UNLIKE * max(others) / 1e6:.3g} AND kind = '{kind.name}'"
        counted = _Counted.of(windows, f"timed {motor} {kind.name}")
        yield _throughout(events, motor, counted, text, f"{shown} AND {MOTOR} = {motor}", kind.name)


def _more_damaged(events: Events, motor: int) -> Iterator[Finding]:
    """A motor with at least twice the share of damaged rows of each other one."""
    for port, windows in events.ports.items():
        damaged = {one: int(windows.count(f"damaged {one}").sum()) for one in MOTORS}
        rows = {one: int(windows.count(f"rows {one}").sum()) for one in MOTORS}
        shares = {one: damaged[one] / rows[one] for one in MOTORS if rows[one] >= _LEAST_EVENTS}
        others = max((share for one, share in shares.items() if one != motor), default=None)
        if others is None or motor not in shares or damaged[motor] < _LEAST_EVENTS:
            continue
        inside, expected = damaged[motor] / sum(damaged.values()), rows[motor] / sum(rows.values())
        score = sum(damaged.values()) * divergence(inside, expected)
        if shares[motor] < UNLIKE * others or score < log(_SERIES / ALPHA):
            continue
        text = TranslatableText(
            "{own} % of the rows of motor {motor} are damaged, of the other motors {others} %",
            motor=motor,
            own=f"{100 * shares[motor]:.2g}",
            others=f"{100 * others:.2g}",
        )
        counted = _Counted.of(windows, f"damaged {motor}")
        shown = f"malformed AND motor_hint = {motor}"
        one = _throughout(events, motor, counted, text, shown)
        yield replace(one, port=port, rows=rows[motor], usual=round(others, 6), score=score)


def _throughout(
    events: Events,
    motor: int,
    counted: _Counted,
    text: TranslatableText,
    shown: str,
    kind: str | None = None,
) -> Finding:
    first_ns, last_ns = int(counted.first_ns.min()), int(counted.last_ns.max())
    port, count = _port_in(events, Direction.FEEDBACK, first_ns, last_ns), int(counted.events.sum())
    return Finding(
        Cause.UNLIKE_OTHERS,
        port,
        motor,
        kind,
        first_ns,
        last_ns,
        count,
        count,
        0.0,
        text,
        shown,
        float(count),
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
        return text, f"{MOTOR} = {motor} AND {errors} != 0"

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
        return text, f"{MOTOR} = {motor}"

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
        targets = -_recent(-low, asked, _SETTLES), _recent(high, asked, _SETTLES)
        off = exposed & is_off_target((least, greatest), targets, role)
        describe = _sentence(
            "the {value} of motor {motor} was not near its target in {events} of {rows} s; {usual}",
            f"{MOTOR} = {motor}",
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


def _jumps(windows: Windows, motor: int) -> Iterator[_CauseCounts]:
    for role in (Role.SPEED, Role.POSITION):
        counted = _Counted.of(windows, f"jump {role} {motor}")
        if not counted.events.any():
            continue
        describe = _sentence(
            "the {value} of motor {motor} jumped and came back {events} times in {rows} frames:"
            " bytes changed on the line",
            f"{MOTOR} = {motor}",
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
    """Periods of commands that differ from the one before."""
    for kind in KINDS:
        for motor in MOTORS if kind.names_motor else MOTORS[:1]:
            rows = windows.count(f"period {motor} {kind.name}")
            shown, whose = f"kind = '{kind.name}'", ""
            if kind.names_motor:
                shown, whose = f"{shown} AND {MOTOR} = {motor}", "motor {motor}: "
            describe = _sentence(
                f"{whose}{{events}} of {{rows}} periods of {{kind}} commands differ from the one"
                " before; {usual}",
                shown,
                kind=kind.name,
                motor=motor,
            )
            yield _CauseCounts(
                Cause.IRREGULAR_COMMANDS,
                _Counted.of(windows, f"irregular {motor} {kind.name}"),
                rows,
                describe,
                motor=motor if kind.names_motor else None,
                kind=kind.name,
                least_share=0.1,
            )


def ranked(found: list[Finding]) -> list[Finding]:
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
