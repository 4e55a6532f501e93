"""Findings: the spans of time in which something is wrong, ranked.

A case is a column of events by window (`events`), beside a column of the rows that could have been
events. `spans` finds where events are more frequent than elsewhere; flags, and events of a port,
are a finding wherever they are. `_CASES` lists every column of every cause, with its sentence:

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
    RUNNING,
    EventCounts,
    Events,
    Windows,
    is_more,
    named,
)
from fte_sniff.analysis.filter.terms import quoted
from fte_sniff.analysis.relations import LATE
from fte_sniff.analysis.segments import Counts
from fte_sniff.analysis.spans import MOST_SPANS, BadSpan, spans_of, surprise
from fte_sniff.errors import Joint, TranslatableText, listed, printable, unframed_text
from fte_sniff.i18n import later
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.rows import Ints
from fte_sniff.protocol.spec import (
    FEW_BYTES,
    MOTORS,
    SUSPECT_FAULTS,
    Direction,
    Fault,
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
    # Bytes that came damaged are not explained by those that did not come.
    Cause.PORT: " ".join(one for one in Cause if one is not Cause.DAMAGE),
    Cause.SILENCE: "unanswered late off_target",
    Cause.DAMAGE: "damage unanswered late jump irregular_commands silence unlike_others",
    Cause.OFFLINE: "silence unanswered off_target",
    Cause.ERROR_FLAG: "off_target",
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


# Cases: the columns of each cause, and how to describe a span of them

_LEAST_RATIO: Final = 3.0
"""How much more frequent events are in a finding than elsewhere."""

_MOST: Final = 0.8
"""The share of events that are most of them."""

_LEAST_EVENTS: Final = 20

_CHANCE: Final = 0.001
"""Share of windows with a sure event by chance: a second of a flag is less than a minute of lost
answers."""

UNLIKE: Final = 2.0
"""A motor is unlike the others if it is slower, or has more damage, by at least this factor."""

_LEAST_SLOWER_NS: Final = 2_000_000
"""How much slower it is at least."""

_Values = Mapping[str, object]


class _Case(NamedTuple):
    """Two columns of `events`, for each motor, kind or role in `{}`."""

    cause: Cause
    events: str
    rows: str
    """The rows that could have been events."""
    form: str
    """Of the sentence, with names such as `events`, `rows`, `usual`, `motor`, `kind`."""
    filter: str
    values: Callable[[_Series, slice], _Values] = lambda _series, _own: MappingProxyType({})
    """Further values of the sentence about some windows; `form` and `filter` replace those here."""
    least_share: float = 0.02
    """Share of rows that are events in a span, at least."""
    whole_share: float = inf
    """Share of events outside of spans from which on all of them are a finding."""
    sure: int = 0
    """Events that are a finding wherever they are; 0 if their frequency decides."""
    of_port: bool = False
    """Whether each port has the columns."""
    unlike: str = ""
    """The sentence about a motor with a share `UNLIKE` times that of each other one, throughout."""


class _Series(NamedTuple):
    """The events of a case: of one motor, kind or role, on one port."""

    case: _Case
    all: Events
    windows: Windows
    port: str | None
    names: Mapping[str, Any]
    counted: EventCounts
    rows: Ints
    """By window the rows that could have been events."""

    def events_in(self, name: str, own: slice) -> int:
        """The events of another column in some windows."""
        return int(self.windows[name.format(**self.names)].events[own].sum())

    @property
    def topic(self) -> tuple[str, str | None, str | None]:
        """What the series of several motors have in common."""
        return self.case.events, self.port, self.names.get("kind")

    @property
    def total(self) -> tuple[int, int]:
        """All events and rows."""
        return int(self.counted.events.sum()), int(self.rows.sum())


def _series_of(
    case: _Case, events: Events, windows: Windows, port: str | None = None
) -> Iterator[_Series]:
    for column, names in named(case.events):
        rows = windows[case.rows.format(**names)].events
        yield _Series(case, events, windows, port, names, windows[column], rows)


def _port_event(series: _Series, own: slice) -> _Values:
    once = {"form": "{meaning}"} if series.events_in(series.case.events, own) == 1 else {}
    return {"meaning": _PORT_EVENTS[PortEventKind(series.case.events)], **once}


def _damage(series: _Series, own: slice) -> _Values:
    events, found = series.events_in(series.case.events, own), list[str]()
    damage = [one for one in Fault if one not in SUSPECT_FAULTS]
    for of, words, least in (("fault", damage, 0.0), ("damaged", Direction, _MOST)):
        counts = {str(one): series.events_in(f"{of} {one}", own) for one in words}
        best = max(counts, key=lambda word: counts[word])
        found += [best] if counts[best] > least * events else []
    return {"what": listed(found)}


def _unanswered(series: _Series, own: slice) -> _Values:
    found = dict[str, object]()
    if series.events_in("missed {motor}", own) == series.total[1]:
        found["form"] = later(
            "motor {motor} answered none of {rows} commands; other motors answered"
        )
    if series.events_in("free", own):
        found["filter"] = "unanswered AND (motor = {motor} OR motor IS NULL)"
    return found


def _late(series: _Series, _own: slice) -> _Values:
    usual_ns = series.all.usual[series.names["motor"], series.names["kind"]]
    return {"limit": f"{LATE * usual_ns / 1e6:.3g}", "usual_ms": f"{usual_ns / 1e6:.2g}"}


def _error_bits(series: _Series, own: slice) -> _Values:
    bits = sum(1 << bit for bit in range(8) if series.events_in(f"raised {{motor}} bit {bit}", own))
    return {"bits": f"{bits:02X}"}


def _online_bit(series: _Series, _own: slice) -> _Values:
    motor = series.names["motor"]
    return {"bit": online_bit_text(motor), "mask": 1 << motor_bit(motor)}


def _silence(series: _Series, own: slice) -> _Values:
    inside, low, high = (one[own] for one in series.counted)
    is_whole = inside.sum() == series.rows[own].sum()
    ns = int(high.max() - low.min()) if is_whole else int(inside.sum()) * series.windows.width_ns
    return {"seconds": f"{ns / 1e9:.0f}"}


_PORT_EVENTS: Final = {
    PortEventKind.LINE_ERROR: TranslatableText("the UART reported errors"),
    PortEventKind.OVERRUN: TranslatableText("bytes were lost, since they were read too late"),
    PortEventKind.SILENT: TranslatableText("the wire was silent"),
    PortEventKind.SHARED: TranslatableText("another program had the port open"),
}
"""What happened to a port."""

_DAMAGED: Final = later("{events} of {rows} rows are damaged; {usual}; mostly {what}")
_IRREGULAR: Final = later(
    "{events} of {rows} periods of {kind} commands differ from the one before; {usual}"
)

_CASES: Final = (
    *(
        _Case(
            *(Cause.PORT, kind, "rows", later("{meaning}, {events} times")),
            "line_error" if kind is PortEventKind.LINE_ERROR else "",
            _port_event,
            sure=3 if kind is PortEventKind.LINE_ERROR else 1,  # a few may come from a plug
            of_port=True,
        )
        for kind in _PORT_EVENTS
    ),
    _Case(
        *(Cause.DAMAGE, "damaged", "rows", _DAMAGED),
        "malformed",
        _damage,
        whole_share=0.05,  # a sound line has none
        of_port=True,
    ),
    _Case(
        *(Cause.DAMAGE, "damaged {motor}", "rows {motor}", _DAMAGED),
        "malformed AND motor_hint = {motor}",
        _damage,
        of_port=True,
        unlike=later(
            "{own} % of the rows of motor {motor} are damaged, of the other motors {others} %"
        ),
    ),
    _Case(
        *(Cause.UNANSWERED, "missed {motor}", "asked {motor}"),
        later("motor {motor} answered {answered} of {rows} commands; {usual_answered}"),
        "unanswered AND motor = {motor}",
        _unanswered,
        whole_share=0.15,
    ),
    _Case(
        *(Cause.LATE, "late {motor} {kind}", "timed {motor} {kind}"),
        later(
            "{events} of {rows} answers of motor {motor} to {kind} took {limit} ms or longer;"
            " usually about {usual_ms} ms"
        ),
        "answer_ms >= {limit} AND kind = '{kind}' AND motor = {motor}",
        _late,
        least_share=0.05,
    ),
    _Case(
        *(Cause.ERROR_FLAG, "raised {motor}", "errors {motor}"),
        later("motor {motor} reported ERROR {bits} in {events} of {rows} frames; {usual}"),
        "motor = {motor} AND error != 0",
        _error_bits,
        sure=RUNNING,
    ),
    _Case(
        *(Cause.OFFLINE, "offline {motor}", "online"),
        later("{bit} was 0 in {events} of {rows} frames; {usual}"),
        "online & {mask} = 0",
        _online_bit,
        sure=RUNNING,
    ),
    _Case(
        *(Cause.SILENCE, "silent {motor}", "active {motor}"),
        later("motor {motor} sent no feedback for {seconds} s while commands went on"),
        "motor = {motor}",
        _silence,
        least_share=0.3,
        whole_share=0.15,
    ),
    _Case(
        *(Cause.OFF_TARGET, "off {role} {motor}", "held {role} {motor}"),
        later(
            "the {role} of motor {motor} was not near its target in {events} of {rows} s; {usual}"
        ),
        "motor = {motor}",
        least_share=0.3,
    ),
    _Case(
        *(Cause.JUMP, "jump {role} {motor}", "present {role} {motor}"),
        later(
            "the {role} of motor {motor} jumped and came back {events} times in {rows} frames:"
            " bytes changed on the line"
        ),
        "motor = {motor}",
    ),
    *(
        _Case(
            *(Cause.IRREGULAR_COMMANDS, f"irregular {of}", f"period {of}", _IRREGULAR, shown),
            least_share=0.1,
        )
        for of, shown in (
            ("{kind}", "kind = '{kind}'"),
            ("{motor} {kind}", "kind = '{kind}' AND motor = {motor}"),
        )
    ),
)

_SLOWER: Final = _Case(
    *(Cause.UNLIKE_OTHERS, "timed {motor} {kind}", "timed {motor} {kind}"),
    later("motor {motor} answers {kind} after {own} ms (median), the others after {others} ms"),
    "answer_ms >= {limit} AND kind = '{kind}' AND motor = {motor}",
)


# The search

_PAUSE_NS: Final = 60_000_000_000
"""Pause between sure events from which on they are of several spans."""


def _series(events: Events) -> Iterator[_Series]:
    """The events of all cases, where there are rows that could have been some."""
    for case in _CASES:
        places = events.ports.items() if case.of_port else ((None, events.windows),)
        for port, windows in places:
            yield from (one for one in _series_of(case, events, windows, port) if one.rows.any())


def _sure_spans(series: _Series) -> Iterator[BadSpan]:
    """The spans of events that need no comparison: one, if they are more than `MOST_SPANS`."""
    counts, low, high = series.counted
    hits = np.flatnonzero(counts)
    cuts = np.flatnonzero(low[hits[1:]] - high[hits[:-1]] > _PAUSE_NS) + 1
    for own in np.split(hits, cuts if len(cuts) < MOST_SPANS else 1):
        events = int(counts[own].sum())
        if events >= series.case.sure:
            yield BadSpan(log(events) - len(own) * log(_CHANCE), int(own[0]), int(own[-1]))


def _examined(series: _Series) -> Iterator[Finding]:
    (counts, _, _), rows, case = series.counted, series.rows, series.case
    hits = np.flatnonzero(counts)
    if not len(hits):
        return
    spans = [*_sure_spans(series)] if case.sure else spans_of(counts, rows > 0)
    outside = np.ones(len(rows), np.bool_)
    for _, first, last in spans:
        outside[first : last + 1] = False
    others = int(rows[outside].sum())
    usual = int(counts[outside].sum()) / others if others else None
    if (usual or 0.0) >= case.whole_share and counts.sum() >= _LEAST_EVENTS:
        spans, usual = [BadSpan(float(counts.sum()), int(hits[0]), int(hits[-1]))], None
    for score, first, last in spans:
        found = _finding(series, slice(first, last + 1), usual, score)
        least = max(case.least_share, _LEAST_RATIO * (usual or 0.0))
        if case.sure or found.events >= found.rows * least:
            yield found


def _finding(series: _Series, own: slice, usual: float | None, score: float) -> Finding:
    """The finding of a series in some windows; `usual` is None if it is all over the recording."""
    case, names = series.case, series.names
    inside, low, high = (one[own] for one in series.counted)
    ends = int(low.min()), int(high.max())
    events, rows = int(inside.sum()), int(series.rows[own].sum())
    values = {
        **names,
        "events": f"{events:,}",
        "rows": f"{rows:,}",
        "answered": f"{rows - events:,}",
        "usual": _usually(usual),
        "usual_answered": _usually(None if usual is None else 1 - usual),
        "form": case.form,
        "filter": case.filter,
        **case.values(series, own),
    }
    shown, form = (str(values.pop(name)) for name in ("filter", "form"))
    shown, text = shown.format(**values), TranslatableText(form, **values)
    if "motor" in names and form in (_DAMAGED, _IRREGULAR):
        text = TranslatableText("motor {motor}: {text}", motor=names["motor"], text=text)
    if series.port and len(series.all.ports) > 1:
        shown = f"{shown} AND port = {quoted(series.port)}".removeprefix(" AND ")
    port = series.port or (next(iter(series.all.ports)) if len(series.all.ports) == 1 else "")
    return Finding(
        *(case.cause, port, names.get("motor"), names.get("kind"), *ends),
        *(events, rows, round(usual or 0.0, 6)),
        *(text, shown, score),
    )


def _usually(share: float | None) -> TranslatableText:
    if share is None:
        return TranslatableText("throughout that time")
    if share < 0.0005:
        return TranslatableText("usually none")
    if share > 0.9995:
        return TranslatableText("usually all")
    digits = 2 if share < 0.5 else 3
    return TranslatableText("usually {percent} %", percent=f"{100 * share:.{digits}g}")


# A motor that is unlike the others all the time


def _slower(events: Events) -> Iterator[Finding]:
    """Motors whose median delay is at least twice that of each other one."""
    for (motor, kind), own in events.usual.items():
        medians = [ns for (of, name), ns in events.usual.items() if name == kind and of != motor]
        others = max(medians, default=inf)
        texts = {"own": f"{own / 1e6:.2g}", "others": f"{others / 1e6:.2g}"}
        names = {"motor": motor, "kind": kind, "limit": f"{UNLIKE * others / 1e6:.3g}", **texts}
        timed = events.windows[f"timed {motor} {kind}"]
        series = _Series(_SLOWER, events, events.windows, None, names, timed, timed.events)
        is_slower = own >= max(UNLIKE * others, others + _LEAST_SLOWER_NS)
        if is_slower and series.total[1] >= _LEAST_EVENTS:
            yield _finding(series, slice(None), 0.0, float(series.total[1]))


def _more(series: Sequence[_Series]) -> Iterator[Finding]:
    """Motors with a larger share of events than each other one."""
    for one in series:
        if not one.case.unlike:
            continue
        alike = [other.total for other in series if other is not one and other.topic == one.topic]
        alike = [total for total in alike if total[1] >= _LEAST_EVENTS]
        events, rows = own = one.total
        if not alike or events < _LEAST_EVENTS:
            continue
        most = max(alike, key=lambda total: total[0] / total[1])
        if is_more(own, most, 0.0, UNLIKE):
            others = most[0] / most[1]
            texts = {"own": f"{100 * events / rows:.2g}", "others": f"{100 * others:.2g}"}
            case = one.case._replace(cause=Cause.UNLIKE_OTHERS, form=one.case.unlike)
            # By window, as the scores of spans.
            score = np.count_nonzero(one.counted[0]) / events * surprise(most, own)
            unlike = one._replace(case=case, names={**one.names, **texts})
            yield _finding(unlike, slice(None), others, score)


@dataclass(frozen=True, slots=True)
class Report:
    """The findings in a table, and what was examined."""

    found: Sequence[Finding]
    """Best first."""
    extent: Mapping[str, Any]
    """`sum rows`, `sum frames`, `sum timed`, and the times `least t` and `greatest t`."""
    not_covered: Mapping[Cause, TranslatableText]
    """By cause, why it could not be examined."""

    def coverage(self) -> list[TranslatableText]:
        """What was examined, where nothing was found; what could not be, and why."""
        texts = list[TranslatableText]()
        covered = [cause for cause in Cause if cause not in self.not_covered]
        if not covered:
            why = next(iter(self.not_covered.values()))
            return [TranslatableText("nothing could be examined: {why}", why=why)]
        if not self.found:
            text = "no findings in {rows:,} rows; examined: {causes}"
            causes = listed(map(TranslatableText, covered))
            texts.append(TranslatableText(text, rows=self.extent["sum rows"], causes=causes))
        for causes, why in self.reasons():
            texts.append(TranslatableText("not examined: {causes}: {why}", causes=causes, why=why))
        return texts

    def reasons(self) -> Iterator[tuple[str, TranslatableText]]:
        """The causes that could not be examined, in a list for each reason."""
        for why in dict.fromkeys(self.not_covered.values()):
            causes = [one for one, text in self.not_covered.items() if text == why]
            yield listed(map(TranslatableText, causes)), why


def find(counts: Counts) -> Report:
    """Look for the spans in which something is wrong, in what `events.counted` counted."""
    events = Events(counts)
    missing = _uncovered(events)
    if len(missing) == len(Cause):
        return Report([], events.extent, missing)
    series = [*_series(events)]
    found = [
        *_lost_ports(events),
        *_without_frames(events),
        *(finding for one in series for finding in _examined(one)),
        *_slower(events),
        *_more(series),
    ]
    found = [one for one in found if one.cause not in missing]
    return Report(ranked(found), events.extent, missing)


def hidden_text(filters: Iterable[str]) -> TranslatableText:
    """Why a recording with the rows that some filters selected cannot be examined."""
    return TranslatableText(
        "the recording has only the rows for which this held: {filter}",
        filter=listed(map(printable, dict.fromkeys(filters)), Joint.AND),
    )


_FLAGS: Final = (Cause.ERROR_FLAG, Cause.OFFLINE, Cause.JUMP)
_OF_ANSWERS: Final = (
    *(Cause.UNANSWERED, Cause.LATE, Cause.SILENCE, Cause.OFF_TARGET, Cause.UNLIKE_OTHERS),
)


def _uncovered(events: Events) -> dict[Cause, TranslatableText]:
    """The causes that cannot be examined, and why."""
    of, total, text = events.extent, events.windows.total, TranslatableText
    asked, answered = any(total(f"commands {one}") for one in MOTORS), total("feedback")
    at_once = sum(one["control"].events > 0 for one in events.ports.values())
    several = text(
        "several ports had commands at the same time: which one feedback answers is not known"
    )
    reasons: Sequence[tuple[object, Iterable[Cause], TranslatableText]] = (
        (not of["sum rows"], Cause, text("the input has no rows")),
        (not of["sum frames"], [*Cause][1:], text("no row is a frame; is the baud rate right?")),
        (not of["sum timed"], Cause, text("no row has a time; try --start")),
        (events.hidden_by, [*Cause][1:], hidden_text(events.hidden_by)),
        (not asked, (Cause.IRREGULAR_COMMANDS,), text("commands are missing")),
        (not asked, _OF_ANSWERS, text("no command awaits an answer")),
        (not answered, _OF_ANSWERS, text("feedback is missing: only one wire was recorded")),
        (np.any(at_once > 1), _OF_ANSWERS, several),
        (not answered, _FLAGS, text("feedback is missing")),
    )
    missing = dict[Cause, TranslatableText]()
    for holds, causes, why in reasons:
        for cause in causes if holds else ():
            missing.setdefault(cause, why)
    return missing


def _without_frames(events: Events) -> Iterator[Finding]:
    """Ports on which only bytes without a frame came."""
    for one in events.noise:
        port, (first, last) = one["port"], (one["least t"], one["greatest t"])
        if one["sum bytes"] >= FEW_BYTES and not events.ports[port].total("frames"):
            ends, seconds = (one["least byte"], one["greatest byte"]), (last - first) // 10**9
            text = unframed_text(*ends, one["sum bytes"], seconds)
            rows = (one["sum rows"], one["sum rows"])
            shown = f"port = {quoted(port)}" if len(events.ports) > 1 else ""
            yield Finding(Cause.PORT, port, None, None, first, last, *rows, 1.0, text, shown, inf)


def _lost_ports(events: Events) -> Iterator[Finding]:
    for port, windows in events.ports.items():
        lost, again = windows[PortEventKind.LOST], windows[PortEventKind.FOUND_AGAIN]
        for at in np.flatnonzero(lost.events).tolist():
            ends = again.high[(again.events > 0) & (again.high >= lost.high[at])]
            text = TranslatableText("the port was lost and found again")
            if not len(ends):
                text = TranslatableText("the port was lost and not found again")
            first = int(lost.low[at])
            last = max(first, int(ends[0]) if len(ends) else events.extent["greatest t"])
            yield Finding(Cause.PORT, port, None, None, first, last, 1, 0, 0.0, text, "", inf)


# The ranking


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
    of_all: Callable[[list[_One]], Mapping[str, Any]],
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
            others = listed(one for one in motors if one != first.motor)
            text = TranslatableText(
                "{text}; likewise motors {others}", text=first.text, others=others
            )
            first = replace(first, motor=None, text=text, **of_all(group))
        merged.append(first)
    return merged


def _together(group: list[Finding]) -> Mapping[str, Any]:
    return {
        "first_ns": min(one.first_ns for one in group),
        "last_ns": max(one.last_ns for one in group),
        "events": sum(one.events for one in group),
        "rows": sum(one.rows for one in group),
        "filter": " OR ".join(f"({one.filter})" for one in group),
    }
