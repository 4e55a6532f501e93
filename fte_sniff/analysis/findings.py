"""Findings: the spans of time in which something is wrong, ranked.

A cause is a column of events by window (`events`), beside a column of the rows that could have been
events. `spans` finds where events are more frequent than elsewhere; flags, and events of a port,
are a finding wherever they are. `_series` lists every column of every cause, with its sentence:

    events -> _series -> _examined (spans, shares) -> ranked (one of each; effects left out)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, log
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np

from fte_sniff.analysis.events import (
    COLUMN_OF,
    RUNNING,
    EventCounts,
    Events,
    Windows,
    by_role,
    is_late,
)
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.relations import DEADLINE_NS, LATE, is_off_target
from fte_sniff.analysis.segments import Counts
from fte_sniff.analysis.spans import (
    ALPHA,
    MOST_SPANS,
    SERIES,
    BadSpan,
    divergence,
    spans_of,
    surprise,
)
from fte_sniff.analysis.table import MOTOR
from fte_sniff.errors import Joint, TranslatableText, listed, printable
from fte_sniff.i18n import later
from fte_sniff.protocol import PortEventKind
from fte_sniff.protocol.rows import Ints
from fte_sniff.protocol.spec import (
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    SUSPECT_FAULTS,
    Direction,
    Fault,
    Role,
    motor_bit,
    online_bit_text,
)


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


_EXPLAINS: Final[Mapping[Cause, str]] = {
    Cause.PORT: " ".join(Cause),
    Cause.SILENCE: "unanswered late off_target",
    Cause.DAMAGE: "damage unanswered late jump irregular_commands silence unlike_others",
    Cause.OFFLINE: "silence unanswered off_target",
    Cause.ERROR_FLAG: "off_target",
    Cause.IRREGULAR_COMMANDS: "unanswered late",
    Cause.OFF_TARGET: "jump",
    Cause.LATE: "unlike_others",
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
    def decided_ns(self) -> tuple[int, int]:
        """Its span, with the time after it that decides whether its last commands are answered."""
        return self.first_ns, self.last_ns + DEADLINE_NS

    def continues(self, other: Finding) -> bool:
        """Whether it is the other one, after a search among more rows."""
        topics = [(one.cause, one.port, one.motor, one.kind) for one in (self, other)]
        return topics[0] == topics[1] and self.overlap(other) > 0

    def overlap(self, other: Finding) -> float:
        """The common time, as a share of the shorter of both."""
        return max(self.covers(other), other.covers(self))

    def covers(self, other: Finding) -> float:
        """The common time, as a share of the other one's."""
        common = min(self.last_ns, other.last_ns) - max(self.first_ns, other.first_ns)
        whole = other.last_ns - other.first_ns
        return max(0.0, common / whole) if whole else float(common >= 0)


class _Test(NamedTuple):
    """When events of a cause are a finding."""

    least_share: float = 0.02
    """Share of rows that are events in a span, at least."""
    whole_share: float = inf
    """Share of events outside of spans from which on all of them are a finding."""
    sure: int = 0
    """Events that are a finding wherever they are; 0 if their frequency decides."""
    pause_ns: int = 10_000_000_000
    """Pause between sure events from which on they are of several spans."""
    senders: Direction = Direction.CONTROL
    """The direction of the frames whose port is named."""


_TESTS: Final[Mapping[Cause, _Test]] = {
    Cause.PORT: _Test(sure=1, pause_ns=60_000_000_000),
    Cause.SILENCE: _Test(0.3, whole_share=0.15),
    Cause.DAMAGE: _Test(whole_share=0.05),  # a sound line has none
    Cause.OFFLINE: _Test(sure=RUNNING, senders=Direction.FEEDBACK),
    Cause.ERROR_FLAG: _Test(sure=RUNNING, senders=Direction.FEEDBACK),
    Cause.UNANSWERED: _Test(whole_share=0.15),
    Cause.LATE: _Test(0.05),
    Cause.OFF_TARGET: _Test(0.3, senders=Direction.FEEDBACK),
    Cause.IRREGULAR_COMMANDS: _Test(0.1),
    Cause.JUMP: _Test(senders=Direction.FEEDBACK),
    Cause.UNLIKE_OTHERS: _Test(senders=Direction.FEEDBACK),
}

_LEAST_RATIO: Final = 3.0
"""How much more frequent events are in a finding than elsewhere."""

_MOST: Final = 0.8
"""The share of events that are most of them."""

_LEAST_EVENTS: Final = 20

_CHANCE: Final = 0.001
"""Share of windows with a sure event by chance: a second of a flag is less than a minute of lost
answers."""


class _Seen(NamedTuple):
    """What a series has in a span."""

    own: slice
    """The windows of the span."""
    events: int
    rows: int
    usual: float
    first_ns: int
    last_ns: int


_Values = Mapping[str, object]


class _Series(NamedTuple):
    """The events of one cause by window, and how to describe a span of them."""

    cause: Cause
    counted: EventCounts
    rows: Ints
    """By window, the rows that could have been events."""
    form: str
    """Of the sentence, with names such as `events`, `rows`, `usual`, `motor`, `kind`."""
    filter: str
    motor: int | None = None
    kind: str | None = None
    port: str | None = None
    """None if the frames of the cause's senders tell it."""
    values: _Values | Callable[[_Seen], _Values] = MappingProxyType({})
    """Further values of the sentence; those of `form` and `filter` replace them."""
    sure: int = 0
    """Events at least, where not those of the test."""

    def described(self, seen: _Seen) -> tuple[TranslatableText, str]:
        """The sentence and the filter of a span."""
        values = dict(self.values(seen) if callable(self.values) else self.values)
        form, shown = values.pop("form", self.form), values.pop("filter", self.filter)
        names = {"motor": self.motor, "kind": self.kind, "usual": _usually(seen.usual)}
        numbers = {"events": f"{seen.events:,}", "rows": f"{seen.rows:,}"}
        return TranslatableText(str(form), **{**names, **numbers, **values}), str(shown)


def _sure_spans(series: _Series, test: _Test) -> Iterator[BadSpan]:
    """The spans of events that need no comparison, at most `MOST_SPANS`."""
    counted = series.counted
    hits = np.flatnonzero(counted.events)
    pauses = counted.low[hits[1:]] - counted.high[hits[:-1]]
    longest = np.argsort(-pauses, kind="stable")[: MOST_SPANS - 1]
    cuts = np.sort(longest[pauses[longest] > test.pause_ns]) + 1
    for own in np.split(hits, cuts) if len(hits) else ():
        events = int(counted.events[own].sum())
        if events >= (series.sure or test.sure):
            yield BadSpan(log(events) - len(own) * log(_CHANCE), int(own[0]), int(own[-1]))


def _examined(events: Events, series: _Series) -> Iterator[Finding]:
    counts, rows, test = series.counted.events, series.rows, _TESTS[series.cause]
    spans = [*_sure_spans(series, test)] if test.sure else spans_of(counts, rows > 0)
    outside = np.ones(len(rows), np.bool_)
    for _, first, last in spans:
        outside[first : last + 1] = False
    usual = int(counts[outside].sum()) / max(1, int(rows[outside].sum()))
    of_all = series.cause is not Cause.DAMAGE or series.motor is None
    if of_all and usual >= test.whole_share and counts.sum() >= _LEAST_EVENTS:
        hits = np.flatnonzero(counts)
        spans, usual = [BadSpan(float(counts.sum()), int(hits[0]), int(hits[-1]))], 0.0
    for score, first, last in spans:
        own = slice(first, last + 1)
        found = _finding(events, series, own, usual, score)
        least = max(test.least_share, _LEAST_RATIO * usual)
        if test.sure or found.events >= found.rows * least:
            yield found


def _finding(events: Events, series: _Series, own: slice, usual: float, score: float) -> Finding:
    """The finding of a series in some windows."""
    inside, low, high = (one[own] for one in series.counted)
    ends = int(low.min()), int(high.max())
    seen = _Seen(own, int(inside.sum()), int(series.rows[own].sum()), usual, *ends)
    text, shown = series.described(seen)
    port = series.port
    if port is None:
        port = _port_in(events, _TESTS[series.cause].senders, *ends)
    return Finding(
        *(series.cause, port, series.motor, series.kind, *ends, seen.events, seen.rows),
        *(round(usual, 6), text, shown, score),
    )


def _port_in(events: Events, senders: Direction, first_ns: int, last_ns: int) -> str:
    """The port with frames of a direction in a span; empty if there are several, or none."""
    found = []
    for port, windows in events.ports.items():
        starts = windows.starts_ns
        near = (starts <= last_ns) & (starts + windows.width_ns > first_ns)
        if windows[COLUMN_OF[senders]].events[near].any():
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
        for causes, why in self.reasons():
            texts.append(TranslatableText("not examined: {causes}: {why}", causes=causes, why=why))
        return texts

    def reasons(self) -> Iterator[tuple[str, TranslatableText]]:
        """The causes that could not be examined, in a list for each reason."""
        for why in dict.fromkeys(self.not_covered.values()):
            yield listed(one for one, text in self.not_covered.items() if text == why), why

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
    Cause.DAMAGE: later("malformed rows {count:,}"),
    Cause.ERROR_FLAG: later("frames with an ERROR flag {count:,}"),
    Cause.OFFLINE: later("frames that lack a bit of ONLINE {count:,}"),
    Cause.UNANSWERED: later("commands without an answer {count:,}"),
}


def find(counts: Counts, *, grows: bool = False) -> Report:
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
    found = [*lost, *(one for one in _all_of(events) if one.cause not in missing)]
    return Report(ranked(found), extent, missing, _counts(events, missing))


def _counts(events: Events, missing: Mapping[str, object]) -> dict[Cause, int]:
    windows = events.windows
    found = {
        Cause.DAMAGE: sum(one.total("damaged") for one in events.ports.values()),
        Cause.ERROR_FLAG: sum(windows.total(f"flagged {one}") for one in MOTORS),
        Cause.OFFLINE: windows.total("any offline"),
        Cause.UNANSWERED: sum(windows.total(f"missed {one}") for one in MOTORS),
    }
    return {cause: count for cause, count in found.items() if cause not in missing}


def hidden_text(filters: Iterable[str]) -> TranslatableText:
    """Why a recording with the rows that some filters selected cannot be examined."""
    return TranslatableText(
        "the recording has only the rows for which this held: {filter}",
        filter=listed(map(printable, dict.fromkeys(filters)), Joint.AND),
    )


def _uncovered(events: Events) -> Iterator[tuple[str, TranslatableText]]:
    """The causes that cannot be examined, and why."""
    windows, of_port = events.windows, [*events.ports.values()]
    feedback = windows.total("feedback")
    answers = (Cause.UNANSWERED, Cause.LATE, Cause.SILENCE, Cause.OFF_TARGET, Cause.UNLIKE_OTHERS)
    flags = (Cause.ERROR_FLAG, Cause.OFFLINE, Cause.JUMP)
    reasons = list[tuple[Sequence[Cause], TranslatableText]]()
    if events.hidden_by:
        reasons = [([one for one in Cause if one is not Cause.PORT], hidden_text(events.hidden_by))]
    elif not sum(windows.total(f"commands {motor}") for motor in MOTORS):
        reasons.append((answers, TranslatableText("no command awaits an answer")))
        reasons.append(([Cause.IRREGULAR_COMMANDS], TranslatableText("commands are missing")))
    elif not feedback:
        why = "feedback is missing: only one wire was recorded"
        reasons.append((answers, TranslatableText(why)))
    elif _at_the_same_time([one for one in of_port if one.total("commands")]):
        why = "several ports had commands at the same time: which one feedback answers is not known"
        reasons.append((answers, TranslatableText(why)))
    if not events.hidden_by and not feedback:
        reasons.append((flags, TranslatableText("feedback is missing")))
    for causes, text in reasons:
        yield from ((str(one), text) for one in causes)


def _at_the_same_time(ports: Sequence[Windows]) -> bool:
    """Whether several ports have commands in the same windows."""
    shift = max((one.shift for one in ports), default=0)
    keys = [np.unique(one.starts_ns[one["commands"].events > 0] >> shift) for one in ports]
    return bool(keys) and len(np.unique(np.concatenate(keys))) < sum(map(len, keys))


def _all_of(events: Events) -> Iterator[Finding]:
    for series in _series(events):
        yield from _examined(events, series)
    for motor in MOTORS:
        yield from _slower(events, motor)
        yield from _more_late(events, motor)
        yield from _more_damaged(events, motor)


def _series(events: Events) -> Iterator[_Series]:
    windows, several = events.windows, len(events.ports) > 1
    for port, own in events.ports.items():
        yield from _of_port(own, port, f"port = {quoted(port)}" if several else "")
    for motor in MOTORS:
        yield _unanswered(windows, motor)
        yield from _late(events, motor)
        yield from _flags(windows, motor)
        yield from _silences(windows, motor)
        for role in (Role.SPEED, Role.POSITION):
            yield from _off_target(windows, motor, role)
            yield from _jumps(windows, motor, role)
    yield from _irregular(windows)


def _lost_ports(events: Events, last_ns: int, *, grows: bool) -> Iterator[Finding]:
    still = TranslatableText("the port was lost and not found again")
    if grows:
        still = TranslatableText("the port was lost and not found again so far")
    for port, start, end in events.lost:
        until = last_ns if end is None else end
        text = still if end is None else TranslatableText("the port was lost and found again")
        last = max(start, until)
        yield Finding(Cause.PORT, port, None, None, start, last, 1, 0, 0.0, text, "", inf)


_PORT_EVENTS: Final = {
    PortEventKind.LINE_ERROR: TranslatableText("the UART reported errors"),
    PortEventKind.OVERRUN: TranslatableText("bytes were lost, since they were read too late"),
    PortEventKind.SILENT: TranslatableText("the wire was silent"),
    PortEventKind.SHARED: TranslatableText("another program had the port open"),
}
"""What happened to a port."""


def _and(*conditions: str) -> str:
    return " AND ".join(filter(None, conditions))


def _of_port(windows: Windows, port: str, own_port: str) -> Iterator[_Series]:
    for motor in (None, *MOTORS):
        yield _damage(windows, port, own_port, motor)
    rows = windows["rows"].events
    for kind, meaning in _PORT_EVENTS.items():
        is_error = kind is PortEventKind.LINE_ERROR
        yield _Series(
            *(Cause.PORT, windows[kind], rows, later("{meaning}, {events} times")),
            filter=_and(Fault.LINE_ERROR if is_error else "", own_port),
            port=port,
            values={"meaning": meaning},
            sure=3 if is_error else 1,  # a few errors alone may come from a plug
        )


_DAMAGE: Final = [one for one in Fault if one not in SUSPECT_FAULTS]


def _damage(windows: Windows, port: str, own_port: str, motor: int | None) -> _Series:
    """The damaged rows of a port, or those that probably belong to one of its motors."""
    of = "" if motor is None else f" {motor}"

    def values(seen: _Seen) -> _Values:
        fault = _prevailing(windows, seen, "fault", _DAMAGE, 0.0)
        direction = _prevailing(windows, seen, "damaged", Direction, _MOST)
        usual = _usually(seen.usual)
        numbers = {"events": f"{seen.events:,}", "rows": f"{seen.rows:,}", "usual": usual}
        text = TranslatableText("{events} of {rows} rows are damaged; {usual}", **numbers)
        bursts = seen.events - int(windows["burst"].events[seen.own].sum())
        if motor is not None:
            text = TranslatableText("motor {motor}: {text}", motor=motor, text=text)
        elif 2 * bursts <= seen.events:
            text = TranslatableText("{text}; in {bursts} bursts", text=text, bursts=f"{bursts:,}")
        return {"text": text, "what": listed([fault, direction] if direction else [fault])}

    return _Series(
        *(Cause.DAMAGE, windows[f"damaged{of}"], windows[f"rows{of}"].events),
        later("{text}; mostly {what}"),
        _and("malformed", f"motor_hint ={of}" if of else "", own_port),
        motor,
        port=port,
        values=values,
    )


def _prevailing(
    windows: Windows, seen: _Seen, of: str, names: Iterable[object], least: float
) -> str:
    """The name that most of the events have; empty if too few have the same."""
    counts = {str(name): int(windows[f"{of} {name}"].events[seen.own].sum()) for name in names}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] > least * seen.events else ""


def _usually(usual: float) -> TranslatableText:
    if usual < 0.0005:
        return TranslatableText("usually none")
    return TranslatableText("usually {percent} %", percent=f"{100 * usual:.2g}")


def _unanswered(windows: Windows, motor: int) -> _Series:
    def values(seen: _Seen) -> _Values:
        usual = TranslatableText("usually {percent} %", percent=f"{100 * (1 - seen.usual):.3g}")
        if seen.usual < 0.0005:
            usual = TranslatableText("usually all")
        found = {"answered": f"{seen.rows - seen.events:,}", "usual": usual}
        if seen.events == windows.total(f"asked {motor}"):
            found["form"] = later(
                "motor {motor} answered none of {rows} commands; other motors answered"
            )
        if windows[f"free {motor}"].events[seen.own].any():
            found["filter"] = f"unanswered AND ({MOTOR} = {motor} OR {MOTOR} IS NULL)"
        return found

    return _Series(
        *(Cause.UNANSWERED, windows[f"missed {motor}"], windows[f"asked {motor}"].events),
        later("motor {motor} answered {answered} of {rows} commands; {usual}"),
        f"unanswered AND {MOTOR} = {motor}",
        motor,
        values=values,
    )


def _late(events: Events, motor: int) -> Iterator[_Series]:
    for kind in KINDS:
        rows = events.windows[f"timed {motor} {kind.name}"].events
        usual_ns = events.usual.get((motor, kind.name))
        if usual_ns is None or rows.sum() < _LEAST_EVENTS:
            continue
        limit = f"{LATE * usual_ns / 1e6:.3g}"
        yield _Series(
            *(Cause.LATE, events.windows[f"late {motor} {kind.name}"], rows),
            later(
                "{events} of {rows} answers of motor {motor} to {kind} took {limit} ms or longer;"
                " usually about {usual_ms} ms"
            ),
            f"answer_ms >= {limit} AND kind = '{kind.name}' AND {MOTOR} = {motor}",
            motor,
            kind.name,
            values={"limit": limit, "usual_ms": f"{usual_ns / 1e6:.2g}"},
        )


# A motor that is unlike the others all the time

UNLIKE: Final = 2.0
"""A motor is unlike the others if it is slower, or has more damage, by at least this factor."""

_LEAST_SLOWER_NS: Final = 2_000_000
"""How much slower it is at least."""


def _slower(events: Events, motor: int) -> Iterator[Finding]:
    """A motor whose median delay is at least twice that of each other one."""
    for kind in KINDS:
        medians = {of: ns for (of, name), ns in events.usual.items() if name == kind.name}
        own, counted = medians.pop(motor, 0.0), events.windows[f"timed {motor} {kind.name}"]
        others = max(medians.values(), default=inf)
        if counted.events.sum() < _LEAST_EVENTS:
            continue
        if own < max(UNLIKE * others, others + _LEAST_SLOWER_NS):
            continue
        shown = f"answer_ms >= {UNLIKE * others / 1e6:.3g} AND kind = '{kind.name}'"
        series = _Series(
            *(Cause.UNLIKE_OTHERS, counted, counted.events),
            later(
                "motor {motor} answers {kind} after {own} ms (median), the others after {others} ms"
            ),
            f"{shown} AND {MOTOR} = {motor}",
            motor,
            kind.name,
            values={"own": f"{own / 1e6:.2g}", "others": f"{others / 1e6:.2g}"},
        )
        yield _finding(events, series, slice(None), 0.0, float(counted.events.sum()))


def _more_late(events: Events, motor: int) -> Iterator[Finding]:
    """A motor with more late answers than each other one."""
    windows = events.windows
    for kind in KINDS:
        late, answers = (
            {one: windows.total(f"{word} {one} {kind.name}") for one in MOTORS}
            for word in ("late", "timed")
        )
        others = {one: late[one] / answers[one] for one in MOTORS if one != motor and answers[one]}
        most = max(others, key=lambda one: others[one], default=motor)
        if not is_late((late[motor], answers[motor]), [(late[most], answers[most])]):
            continue
        limit = f"{LATE * events.usual[motor, kind.name] / 1e6:.3g}"
        counted = windows[f"late {motor} {kind.name}"]
        series = _Series(
            *(Cause.UNLIKE_OTHERS, counted, windows[f"timed {motor} {kind.name}"].events),
            later(
                "{own} % of the answers of motor {motor} to {kind} took {limit} ms or longer, twice"
                " the median, of the other motors at most {others} %"
            ),
            f"answer_ms >= {limit} AND kind = '{kind.name}' AND {MOTOR} = {motor}",
            motor,
            kind.name,
            values={
                "own": f"{100 * late[motor] / answers[motor]:.2g}",
                "others": f"{100 * others[most]:.2g}",
                "limit": limit,
            },
        )
        # By window, as the scores of spans.
        score = np.count_nonzero(counted.events) / late[motor]
        score *= surprise((late[most], answers[most]), (late[motor], answers[motor]))
        yield _finding(events, series, slice(None), others[most], score)


def _more_damaged(events: Events, motor: int) -> Iterator[Finding]:
    """A motor with at least twice the share of damaged rows of each other one."""
    for port, windows in events.ports.items():
        damaged = {one: windows.total(f"damaged {one}") for one in MOTORS}
        rows = {one: windows.total(f"rows {one}") for one in MOTORS}
        shares = {one: damaged[one] / rows[one] for one in MOTORS if rows[one] >= _LEAST_EVENTS}
        own, others = shares.pop(motor, 0.0), max(shares.values(), default=inf)
        if damaged[motor] < _LEAST_EVENTS or own < UNLIKE * others:
            continue
        inside, expected = damaged[motor] / sum(damaged.values()), rows[motor] / sum(rows.values())
        score = sum(damaged.values()) * divergence(inside, expected)
        if score < log(SERIES / ALPHA):
            continue
        series = _Series(
            *(Cause.UNLIKE_OTHERS, windows[f"damaged {motor}"], windows[f"rows {motor}"].events),
            later(
                "{own} % of the rows of motor {motor} are damaged, of the other motors {others} %"
            ),
            f"malformed AND motor_hint = {motor}",
            motor,
            port=port,
            values={"own": f"{100 * own:.2g}", "others": f"{100 * others:.2g}"},
        )
        yield _finding(events, series, slice(None), others, score)


def _flags(windows: Windows, motor: int) -> Iterator[_Series]:
    feedback, anyone = windows[f"feedback {motor}"].events, windows["feedback"].events
    errors, online = NAME_OF_ROLE[Role.ERRORS], NAME_OF_ROLE[Role.ONLINE]

    def bits(seen: _Seen) -> _Values:
        counts = [windows[f"raised {motor} bit {bit}"].events for bit in range(8)]
        raised = sum(1 << bit for bit, own in enumerate(counts) if own[seen.own].any())
        return {"bits": f"{raised:02X}"}

    if feedback.any():
        yield _Series(
            *(Cause.ERROR_FLAG, windows[f"raised {motor}"], feedback),
            later("motor {motor} reported ERROR {bits} in {events} of {rows} frames; {usual}"),
            f"{MOTOR} = {motor} AND {errors} != 0",
            motor,
            values=bits,
        )
        yield _Series(
            *(Cause.OFFLINE, windows[f"offline {motor}"], anyone),
            later("{bit} was 0 in {events} of {rows} frames; {usual}"),
            f"{online} & {1 << motor_bit(motor)} = 0",
            motor,
            values={"bit": online_bit_text(motor)},
        )


_EXPECTED: Final = 6
"""Feedback of a motor in a window from which on its absence is silence."""


def _silences(windows: Windows, motor: int) -> Iterator[_Series]:
    """Windows without feedback of a motor, in which commands to it went on."""
    commands, feedback = windows[f"commands {motor}"], windows[f"feedback {motor}"]
    active, answers = commands.events > 0, feedback.events > 0
    if not (active & answers).any():
        return
    usual = max(1, int(np.median(feedback.events[active & answers])))
    width = max(1, -(-_EXPECTED // usual))
    recent = np.convolve(feedback.events, np.ones(width), "full")[: len(answers)]
    silent = active & (recent < 0.5)

    def values(seen: _Seen) -> _Values:
        is_whole = seen.events == seen.rows
        ns = seen.last_ns - seen.first_ns if is_whole else seen.events * windows.width_ns
        return {"seconds": f"{ns / 1e9:.0f}"}

    # It begins with the last feedback, unless the host paused meanwhile; and ends with the next.
    starts, near = windows.starts_ns, (width + 1) * windows.width_ns
    before = np.maximum.accumulate(feedback.high)
    after = np.minimum.accumulate(feedback.low[::-1])[::-1]
    counted = EventCounts(
        silent.astype(np.int64),
        np.where(before > starts - near, before, commands.low),
        np.where(after < starts + windows.width_ns + near, after, commands.high),
    )
    yield _Series(
        *(Cause.SILENCE, counted, active.astype(np.int64)),
        later("motor {motor} sent no feedback for {seconds} s while commands went on"),
        f"{MOTOR} = {motor}",
        motor,
        values=values,
    )


_SETTLES: Final = 3
"""Windows before one whose targets a motor may still move to."""


def _recent(values: Ints) -> Ints:
    """The highest value of each window and of `_SETTLES` before it."""
    padded = np.concatenate((np.full(_SETTLES, -(2**62)), values))
    found: Ints = np.lib.stride_tricks.sliding_window_view(padded, _SETTLES + 1).max(axis=1)
    return found


def _off_target(windows: Windows, motor: int, role: Role) -> Iterator[_Series]:
    """Windows in which all present values are outside of the range of the recent targets."""
    feedback, free = windows[f"feedback {motor}"], windows[f"free {motor}"].events
    target, present = windows[f"target {role} {motor}"], windows[f"present {role} {motor}"]
    asked = target.events > 0
    exposed = asked & (present.events > 0) & (_recent(free) <= 0)
    if not exposed.any():
        return
    lows = -_recent(np.where(asked, -target.low, -(2**62)))
    highs = _recent(np.where(asked, target.high, -(2**62)))
    off = exposed & is_off_target((present.low, present.high), (lows, highs), role)
    yield _Series(
        Cause.OFF_TARGET,
        EventCounts(off.astype(np.int64), feedback.low, feedback.high),
        exposed.astype(np.int64),
        later(
            "the {value} of motor {motor} was not near its target in {events} of {rows} s; {usual}"
        ),
        f"{MOTOR} = {motor}",
        motor,
        by_role(role, target=True)[0].name,
        values={"value": TranslatableText(role)},
    )


def _jumps(windows: Windows, motor: int, role: Role) -> Iterator[_Series]:
    counted = windows[f"jump {role} {motor}"]
    if counted.events.any():
        yield _Series(
            *(Cause.JUMP, counted, windows[f"present {role} {motor}"].events),
            later(
                "the {value} of motor {motor} jumped and came back {events} times in {rows} frames:"
                " bytes changed on the line"
            ),
            f"{MOTOR} = {motor}",
            motor,
            by_role(role, target=False)[0].name,
            values={"value": TranslatableText(role)},
        )


_UNEVEN: Final = later(
    "{events} of {rows} periods of {kind} commands differ from the one before; {usual}"
)
_UNEVEN_OF_MOTOR: Final = later(
    "motor {motor}: {events} of {rows} periods of {kind} commands differ from the one before;"
    " {usual}"
)


def _irregular(windows: Windows) -> Iterator[_Series]:
    """Periods of commands that differ from the one before."""
    for kind in KINDS:
        for motor in MOTORS if kind.names_motor else MOTORS[:1]:
            own, of = motor if kind.names_motor else None, f"{motor} {kind.name}"
            yield _Series(
                *(Cause.IRREGULAR_COMMANDS, windows[f"irregular {of}"]),
                windows[f"period {of}"].events,
                _UNEVEN_OF_MOTOR if own else _UNEVEN,
                _and(f"kind = '{kind.name}'", f"{MOTOR} = {motor}" if own else ""),
                own,
                kind.name,
            )


def ranked(found: list[Finding]) -> list[Finding]:
    """One finding of each cause in a span, without those that another explains, best first."""
    kept: list[Finding] = []
    for one in sorted(found, key=lambda one: -one.score):
        if not any(_is_same(one, other) for other in kept):
            kept.append(one)
    kept = [one for one in kept if not any(_explains(other, one) for other in kept)]
    return of_most_motors(kept, _is_common, _together)


_SAME: Final = 0.5
"""The share of common time from which on two spans are about the same."""


def _is_same(one: Finding, other: Finding) -> bool:
    """Whether both are of one cause and motor: of other thresholds, kinds, or values."""
    own = (one.cause, one.port, one.motor) == (other.cause, other.port, other.motor)
    return own and one.overlap(other) >= _SAME


def _is_common(one: Finding, other: Finding) -> bool:
    return one.cause is other.cause and one.overlap(other) >= _SAME


def _explains(one: Finding, other: Finding) -> bool:
    if one is other or other.cause not in _EXPLAINS.get(one.cause, "").split():
        return False
    if one.covers(other) < _SAME:
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


_One = TypeVar("_One", bound=Any)


def of_most_motors(
    found: Iterable[_One],
    is_alike: Callable[[_One, _One], bool],
    of_all: Callable[[list[_One], tuple[int, ...]], Mapping[str, Any]],
) -> list[_One]:
    """What is alike of most motors, as one about all of them.

    Args:
        found: frozen dataclasses with `motor` and `text`; the first of a group stands for it.
        is_alike: whether two of different motors belong together.
        of_all: the fields of one about some motors, made of a group.
    """
    merged, rest = list[_One](), list(found)
    while rest:
        first = rest.pop(0)
        group = [first, *(one for one in rest if one.motor and is_alike(one, first))]
        motors = tuple(sorted({one.motor for one in group if first.motor}))
        if len(motors) >= len(MOTORS) - 1:
            rest = [one for one in rest if one not in group]
            form = "motors {motors} alike: {text}"
            text = TranslatableText(form, motors=listed(motors), text=first.text)
            first = replace(first, motor=None, text=text, **of_all(group, motors))
        merged.append(first)
    return merged


def _together(group: list[Finding], _motors: tuple[int, ...]) -> Mapping[str, Any]:
    return {
        "first_ns": min(one.first_ns for one in group),
        "last_ns": max(one.last_ns for one in group),
        "events": sum(one.events for one in group),
        "rows": sum(one.rows for one in group),
        "filter": " OR ".join(f"({one.filter})" for one in group),
    }
