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
    Events,
    Windows,
    by_role,
    least_of,
)
from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.feed import BaudChange
from fte_sniff.analysis.model import RowModel
from fte_sniff.analysis.tally import RowCount
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.protocol import (
    FAULT_MEANINGS,
    KINDS,
    MOTORS,
    Direction,
    Gap,
    PortEvent,
    PortEventKind,
)
from fte_sniff.protocol.rows import Bools, Ints, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit

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
        {Cause.UNANSWERED, Cause.LATE, Cause.JUMP, Cause.IRREGULAR_COMMANDS, Cause.SILENCE}
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

_LEAST_EVENTS: Final = 20


_Describe: TypeAlias = Callable[[slice, int, int, float], tuple[TranslatableText, str]]
"""Sentence and filter of a span, for its windows, its events and rows, and the usual share."""


@dataclass(frozen=True, slots=True)
class _Series:
    """The counts of one cause by window, and how to describe a span of it."""

    cause: Cause
    events: Ints
    rows: Ints
    describe: _Describe
    port: str = ""
    motor: int | None = None
    kind: str | None = None
    whole_share: float | None = _WHOLE_SHARE
    """Share of events from which on all of them are a finding; None if they never are."""
    least_share: float = 0.02
    """Share of rows that are events in a finding."""


def _examined(
    windows: Windows, series: _Series, first_ns: int, last_ns: int, alpha: float
) -> Iterator[Finding]:
    exposed = series.rows > 0
    spans = spans_of(series.events, exposed, alpha)
    total = int(series.events.sum())
    outside = np.ones(len(exposed), np.bool_)
    for start, end, _ in spans:
        outside[start : end + 1] = False
    usual_rows = int(series.rows[outside].sum())
    usual = int(series.events[outside].sum()) / usual_rows if usual_rows else 0.0
    least = series.whole_share
    if least is not None and usual >= least and total >= _LEAST_EVENTS and len(exposed):
        hits = np.flatnonzero(series.events > 0)
        spans, usual = [(int(hits[0]), int(hits[-1]), float(total))], 0.0
    for start, end, score in spans:
        events, rows = (int(one[start : end + 1].sum()) for one in (series.events, series.rows))
        if events < rows * max(series.least_share, _LEAST_RATIO * usual):
            continue
        text, shown = series.describe(slice(start, end + 1), events, rows, usual)
        first = max(first_ns, int(windows.starts_ns[start]))
        last = min(last_ns, int(windows.starts_ns[end]) + windows.width_ns - 1)
        yield Finding(
            series.cause,
            series.port,
            series.motor,
            series.kind,
            first,
            last,
            events,
            rows,
            round(usual, 6),
            text,
            shown,
            score,
        )


class Findings(RowModel):
    """Looks for spans in which something is wrong."""

    CAUSES: Final = tuple(map(str, Cause))
    """The causes that it knows."""

    def __init__(self) -> None:
        self.total = RowCount()
        self.frames = 0
        self.events = Events()
        self._facts: Facts | None = Facts()

    @classmethod
    def of_facts(cls) -> Self:
        """For rows that have their facts already, such as those of a store."""
        found = cls()
        found._facts = None
        return found

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap):
            self._settle(change)
        self.events.observe_change(change)

    def _settle(self, gap: Gap | None = None) -> None:
        if self._facts is not None:
            rows = self._facts.interrupt(gap)
            if len(rows):
                self.events.observe(rows)

    def _observe(self, rows: Rows) -> None:
        self.total.observe(rows)
        self.frames += rows.counts("framed").get(True, 0)
        known = rows if self._facts is None else self._facts.feed(rows)
        if len(known):
            self.events.observe(known)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        self.events.observe_events(events)

    def merge(self, later: Self) -> None:
        """Add the rows that follow; no event spans the boundary."""
        self._settle()
        later._settle()
        self.total.merge(later.total)
        self.frames += later.frames
        self.events.merge(later.events)

    def found(self, alpha: float = ALPHA) -> list[Finding]:
        """The findings, best first."""
        self._settle()
        return self._found_in(self.events, alpha)

    def recent(self, since_ns: int, alpha: float = ALPHA) -> list[Finding]:
        """The findings in the rows from a time on, for a capture that runs; rows may follow."""
        return self._found_in(self.events.since(since_ns), alpha)

    def found_and_recent(self, recent_ns: int) -> tuple[list[Finding], list[Finding]]:
        """The findings about all rows and their last time, and those about that time alone.

        What is rare in hours may stand out in the last minutes, and the other way round. With a
        time of 0 there are only those about all rows. More rows may follow.
        """
        found = self._found_in(self.events, ALPHA)
        last_ns = self.total.last_ns
        if not recent_ns or last_ns is None:
            return found, []
        recent = self.recent(last_ns - recent_ns)
        return _ranked([*found, *recent]), recent

    def _found_in(self, events: Events, alpha: float) -> list[Finding]:
        if self.total.times is None or not self.frames:
            return []
        return _ranked(list(_all_of(events, *self.total.times, alpha)))

    def not_covered(self) -> dict[str, TranslatableText]:
        """By cause, why it could not be examined."""
        self._settle()
        if not self.total.rows:
            return dict.fromkeys(self.CAUSES, TranslatableText("there is no row"))
        if not self.frames:
            text = TranslatableText("no row is a frame; is the baud rate right?")
            return dict.fromkeys(self.CAUSES, text)
        if self.total.first_ns is None:
            return dict.fromkeys(self.CAUSES, TranslatableText("no row has a time; try --start"))
        return dict(_uncovered(self.events))

    def coverage(self, found: Sequence[Finding]) -> list[TranslatableText]:
        """What was examined, if there are no findings; what could not be, with the reasons."""
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
        text = TranslatableText("there is no command that awaits an answer")
        yield from ((str(one), text) for one in answers)
        yield str(Cause.IRREGULAR_COMMANDS), TranslatableText("there is no command")
    elif not feedback:
        text = TranslatableText("there is no feedback: only one wire was recorded")
        yield from ((str(one), text) for one in answers)
    elif _at_the_same_time(events, senders):
        text = TranslatableText(
            "several ports had commands at the same time: which one feedback answers is not known"
        )
        yield from ((str(one), text) for one in answers)
    if not feedback:
        flags = (Cause.ERROR_FLAG, Cause.OFFLINE, Cause.JUMP)
        yield from ((str(one), TranslatableText("there is no feedback")) for one in flags)


def _at_the_same_time(events: Events, ports: Sequence[str]) -> bool:
    """Whether several ports have commands in the same windows."""
    windows = [events.ports[port] for port in ports]
    shift = max((one.shift for one in windows), default=0)
    keys = [np.unique(one.starts_ns[one.count("commands") > 0] >> shift) for one in windows]
    return bool(keys) and len(np.unique(np.concatenate(keys))) < sum(map(len, keys))


def _ports_with(events: Events, what: str) -> list[str]:
    counts = {port: int(one.count(what).sum()) for port, one in events.ports.items()}
    return sorted((port for port, count in counts.items() if count), key=lambda port: -counts[port])


def _all_of(events: Events, first_ns: int, last_ns: int, alpha: float) -> Iterator[Finding]:
    yield from _lost_ports(events, last_ns)
    for port, windows in events.ports.items():
        for series in _port_series(port, windows):
            yield from _examined(windows, series, first_ns, last_ns, alpha)
    uncovered = dict(_uncovered(events))
    for series in _motor_series(events):
        if series.cause not in uncovered:
            yield from _examined(events.windows, series, first_ns, last_ns, alpha)


def _lost_ports(events: Events, last_ns: int) -> Iterator[Finding]:
    for port, start, end in events.lost:
        until = last_ns if end is None else end
        text = (
            TranslatableText("the port was lost and not found again")
            if end is None
            else TranslatableText("the port was lost and found again")
        )
        yield Finding(
            Cause.PORT, port, None, None, start, max(start, until), 1, 0, 0.0, text, "", inf
        )


_PORT_EVENTS: Final = {
    PortEventKind.LINE_ERROR: TranslatableText("the UART reported errors"),
    PortEventKind.OVERRUN: TranslatableText("bytes were lost, since they were read too late"),
}


def _port_series(port: str, windows: Windows) -> Iterator[_Series]:
    rows, damaged = windows.count("rows"), windows.count("damaged")

    def of_damage(own: slice, events: int, rows: int, usual: float) -> tuple[TranslatableText, str]:
        motor = _prevailing(windows, own, "hint", MOTORS)
        fault = _prevailing(windows, own, "fault", FAULT_MEANINGS, 0.0)
        direction = _prevailing(windows, own, "damaged", Direction)
        of_rows = TranslatableText(
            "{events} of {rows} rows are damaged; {usual}", **_numbers(events, rows, usual)
        )
        mostly = [fault, direction] if direction else [fault]
        if motor:
            mostly.append(TranslatableText("motor {motor}", motor=motor))
        what = listed(mostly)
        text = TranslatableText("{text}; mostly {what}", text=of_rows, what=what)
        hint = f" AND motor_hint = {motor}" if motor else ""
        return text, f"malformed{hint}"

    yield _Series(Cause.DAMAGE, damaged, rows, of_damage, port, whole_share=_WHOLE_DAMAGE)
    for kind, meaning in _PORT_EVENTS.items():
        counts = windows.count(kind)

        of_port = _sentence("{meaning}, {events} times", "line_error", meaning=meaning)
        exposed = np.maximum((rows > 0).astype(np.int64), counts)
        yield _Series(Cause.PORT, counts, exposed, of_port, port, whole_share=None, least_share=0.0)


def _prevailing(
    windows: Windows, own: slice, of: str, names: Iterable[object], least: float = 0.8
) -> str:
    """The name that most of the counted rows have; empty if too few have the same."""
    counts = {str(name): int(windows.count(f"{of} {name}")[own].sum()) for name in names}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] > least * sum(counts.values()) else ""


def _usually(usual: float) -> TranslatableText:
    if usual < 0.0005:
        return TranslatableText("usually none")
    return TranslatableText("usually {percent} %", percent=f"{100 * usual:.2g}")


def _numbers(events: int, rows: int, usual: float) -> dict[str, object]:
    """The values that most sentences have."""
    return {"events": f"{events:,}", "rows": f"{rows:,}", "usual": _usually(usual)}


def _sentence(form: str, shown: str, **values: object) -> _Describe:
    """A sentence of `_numbers` and these values, and the filter of its rows."""

    def describe(own: slice, events: int, rows: int, usual: float) -> tuple[TranslatableText, str]:
        return TranslatableText(form, **_numbers(events, rows, usual), **values), shown

    return describe


def _motor_series(events: Events) -> Iterator[_Series]:
    senders, answerers = (_ports_with(events, what) for what in ("commands", "feedback"))
    sender, answerer = (one[0] if one else "" for one in (senders, answerers))
    windows = events.windows
    for motor in MOTORS:
        yield _unanswered(windows, motor, sender)
        yield from _late(windows, motor, sender)
        yield from _flags(events, motor, answerer)
        yield from _off_target(windows, motor, answerer)
        yield from _jumps(windows, motor, answerer)
    yield from _silences(windows, answerer)
    yield from _irregular(windows, sender)


_MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]


def _unanswered(windows: Windows, motor: int, port: str) -> _Series:
    asked, missed = windows.count(f"asked {motor}"), windows.count(f"missed {motor}")

    def describe(own: slice, events: int, rows: int, usual: float) -> tuple[TranslatableText, str]:
        share = TranslatableText("usually {percent} %", percent=f"{100 * (1 - usual):.3g}")
        text = TranslatableText(
            "motor {motor} answered {answered} of {rows} commands; {usual}",
            motor=motor,
            answered=f"{rows - events:,}",
            rows=f"{rows:,}",
            usual=TranslatableText("usually all") if usual < 0.0005 else share,
        )
        own_filter = f"{_MOTOR} = {motor}"
        if windows.count(f"free {motor}")[own].any():
            own_filter = f"({own_filter} OR {_MOTOR} IS NULL)"
        return text, f"unanswered AND {own_filter}"

    return _Series(Cause.UNANSWERED, missed, asked, describe, port, motor)


def _late(windows: Windows, motor: int, port: str) -> Iterator[_Series]:
    for kind in KINDS:
        grades = np.array(
            [windows.count(f"delay {motor} {kind.name} {one}") for one in range(GRADES)]
        )
        total = grades.sum(axis=1)
        if total.sum() < _LEAST_EVENTS:
            continue
        median = int(np.searchsorted(np.cumsum(total), total.sum() / 2))
        for grade in range(median + 2, min(median + 8, GRADES)):
            if not total[grade:].sum():
                continue
            limit = least_of(grade) * DELAY_UNIT_NS / 1e6
            usual_ms = least_of(median) * DELAY_UNIT_NS / 1e6
            describe = _sentence(
                "{events} of {rows} answers of motor {motor} to {kind} took {limit} ms or longer;"
                " usually about {usual_ms} ms",
                f"answer_ms >= {limit:.3f} AND {_MOTOR} = {motor}",
                motor=motor,
                kind=kind.name,
                limit=f"{limit:.3g}",
                usual_ms=f"{usual_ms:.2g}",
            )
            late, rows = grades[grade:].sum(axis=0), grades.sum(axis=0)
            yield _Series(
                Cause.LATE,
                late,
                rows,
                describe,
                port,
                motor,
                kind.name,
                whole_share=None,
                least_share=0.05,
            )


def _flags(events: Events, motor: int, port: str) -> Iterator[_Series]:
    windows = events.windows
    feedback, any_feedback = windows.count(f"feedback {motor}"), windows.count("feedback")
    errors, online = NAME_OF_ROLE[Role.ERRORS], NAME_OF_ROLE[Role.ONLINE]

    of_error = _sentence(
        "motor {motor} reported ERROR {bits} in {events} of {rows} frames; {usual}",
        f"{_MOTOR} = {motor} AND {errors} != 0",
        motor=motor,
        bits=f"{events.bytes.get((f'error {motor}', motor), 0):02X}",
    )
    of_online = _sentence(
        "motor {motor} was not ONLINE in {events} of {rows} frames; {usual}",
        f"{online} & {1 << motor_bit(motor)} = 0",
        motor=motor,
    )
    yield _Series(
        Cause.ERROR_FLAG, windows.count(f"error {motor}"), feedback, of_error, port, motor
    )
    exposed = np.where(feedback.any(), any_feedback, 0)
    offline = windows.count(f"offline {motor}")
    yield _Series(Cause.OFFLINE, offline, exposed, of_online, port, motor)


_EXPECTED: Final = 6
"""Feedback of a motor in a window from which on its absence is silence."""


def _silences(windows: Windows, port: str) -> Iterator[_Series]:
    """Windows without feedback of a motor, in which commands went on."""
    commands = sum(windows.count(f"commands {motor}") for motor in MOTORS)
    for motor in MOTORS:
        feedback = windows.count(f"feedback {motor}")
        active = np.asarray(commands) > 0
        if not feedback.any() or not active.any():
            continue
        usual = (
            float(np.median(feedback[active & (feedback > 0)]))
            if (active & (feedback > 0)).any()
            else 0
        )
        width = max(1, -(-_EXPECTED // max(1, int(usual))))
        recent = np.convolve(feedback, np.ones(width), "full")[: len(feedback)]
        silent = active & (recent < 0.5)

        def describe(
            own: slice, events: int, rows: int, usual: float, motor: int = motor
        ) -> tuple[TranslatableText, str]:
            text = TranslatableText(
                "motor {motor} sent no feedback for {seconds} s while commands went on",
                motor=motor,
                seconds=f"{events * windows.width_ns / 1e9:.0f}",
            )
            return text, f"{_MOTOR} = {motor}"

        yield _Series(
            Cause.SILENCE,
            silent.astype(np.int64),
            active.astype(np.int64),
            describe,
            port,
            motor,
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


def _off_target(windows: Windows, motor: int, port: str) -> Iterator[_Series]:
    """Windows in which all present values are outside of the range of the recent targets."""
    if len(windows) <= _SETTLES:
        return
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
        yield _Series(
            Cause.OFF_TARGET,
            off.astype(np.int64),
            exposed.astype(np.int64),
            describe,
            port,
            motor,
            kinds[0].name if kinds else None,
            whole_share=None,
            least_share=0.3,
        )


_TOLERANCE: Final = {Role.SPEED: 15, Role.POSITION: 50}
"""How near a value is to its target at least, RPM and pulses."""


def _jumps(windows: Windows, motor: int, port: str) -> Iterator[_Series]:
    for role in (Role.SPEED, Role.POSITION):
        stream = f"{role} {motor}"
        grades = np.array([windows.count(f"jump {stream} {one}") for one in range(GRADES)])
        if not grades.any():
            continue
        describe = _sentence(
            "the {value} of motor {motor} jumped and came back {events} times in {rows} frames:"
            " bytes changed on the line",
            f"{_MOTOR} = {motor}",
            motor=motor,
            value=TranslatableText(role),
        )
        kinds = by_role(role, target=False)
        yield _Series(
            Cause.JUMP,
            grades.sum(axis=0),
            windows.count(f"steps {stream}"),
            describe,
            port,
            motor,
            kinds[0].name if kinds else None,
            whole_share=None,
        )


def _irregular(windows: Windows, port: str) -> Iterator[_Series]:
    """Periods of commands that differ from the one before by half an octave, or by one."""
    prefix = "ratio "
    streams = {
        name[len(prefix) :].rpartition(" ")[0]
        for name in windows.names()
        if name.startswith(prefix)
    }
    for stream in sorted(streams):
        grades = np.array([windows.count(f"{prefix}{stream} {one}") for one in range(GRADES)])
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
            events = grades[int(octaves * RATIO_UNIT) :].sum(axis=0)
            yield _Series(
                Cause.IRREGULAR_COMMANDS,
                events,
                grades.sum(axis=0),
                describe,
                port,
                motor,
                name,
                whole_share=None,
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
    if one.cause is other.cause or one.overlap(other) < _SAME:
        return False
    if one.cause is Cause.DAMAGE and other.cause in (Cause.UNANSWERED, Cause.SILENCE):
        return 2 * one.events >= other.events
    return None in (one.motor, other.motor) or one.motor == other.motor


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
