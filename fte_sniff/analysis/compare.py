"""What changed between two recordings, or two sets of them: a firmware, a robot, a day.

Each side is counted by blocks of time, and a number is compared with what it varies by inside of a
side. A change is named if it is more than chance and large enough to matter:

    share   the difference is `SIGMAS` standard errors of the blocks, and the events are improbable
            by `LEAST_SCORE` if both sides had one share (bound on the binomial distribution)
    time    the difference is larger than that between any two of `PARTS` parts of one side
    values  both sides had the same targets, and the reported range differs by a quarter
    finding one side has it, the other one has none of this cause and motor

Periods longer than `PAUSE` medians are pauses of the host: they count for no rate and no period.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, log, log2
from typing import Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis import events
from fte_sniff.analysis.durations import COARSE, FINE, JITTER, Durations, binned, bins_of, chosen
from fte_sniff.analysis.events import Events, Windows
from fte_sniff.analysis.findings import Cause, find, hidden_text, of_most_motors
from fte_sniff.analysis.segments import Analysis, Counts
from fte_sniff.analysis.spans import surprise
from fte_sniff.analysis.table import MOTOR, Table
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.i18n import later
from fte_sniff.protocol.rows import Ints
from fte_sniff.protocol.spec import KINDS, MOTORS, NAME_OF_ROLE, Direction, Fault, Role

BLOCK: Final = 34
"""A block has 2 to this power of nanoseconds, about 17 s."""

PERIODS: Final = 32
"""As `BLOCK`, of the windows in which periods are counted: about 4 s."""

PARTS: Final = 8
"""Parts of a side, between which times vary; a side needs half of them with enough values."""

LEAST_VALUES: Final = 20
"""Values of a part, at least."""

PAUSE: Final = 4.0
SIGMAS: Final = 5.0
LEAST_SCORE: Final = 10.0
"""Minus the logarithm of the probability of a change by chance."""

ALIKE: Final = 0.5
"""Motors change alike if one changes at least by this share of another."""

SAME_TARGETS: Final = 0.1
OTHER_RANGE: Final = 0.25
_OUTLIERS: Final = 0.05
"""Share of the windows that are left out at each end of a range: bits that flipped unseen."""

_LEAST_SHARE: Final = 0.002
_LEAST_RATIO: Final = 1.5


class _Time(NamedTuple):
    """A number of a distribution of durations, and what matters of it."""

    form: str
    percents: tuple[float, float]
    """The difference of these percentiles; that of 0 is 0. The mean, if both are 0."""
    least_ratio: float
    least_ns: float


_MEDIAN, _P99 = (0.0, 50.0), (0.0, 99.0)
_TIMES: Final[Mapping[str, _Time]] = {
    "period": _Time(
        later("{what} come every {after} ms (median), before every {before} ms"),
        *(_MEDIAN, 0.03, 100_000),
    ),
    "rate": _Time(
        later("{what}: {after} in a second, before {before}"), *((0.0, 0.0), 0.03, 100_000)
    ),
    "period_p99": _Time(
        later("{what} come after up to {after} ms (99 %), before {before} ms"),
        *(_P99, 0.25, 2_000_000),
    ),
    "jitter": _Time(
        later("the period of {what} varies by {after} ms, before {before} ms"),
        *(JITTER, 0.5, 1_000_000),
    ),
    "delay": _Time(
        later("answers to {what} take {after} ms (median), before {before} ms"),
        *(_MEDIAN, 0.1, 200_000),
    ),
    "delay_p99": _Time(
        later("99 % of the answers to {what} within {after} ms, before {before} ms"),
        *(_P99, 0.25, 1_000_000),
    ),
}
"""The measures of times; a rate is compared by the mean period."""

_SHARES: Final[Mapping[str, str]] = {
    "unanswered": later("{after} % of the commands {what} have no answer, before {before} %"),
    "damage": later("{after} % of the rows are {what}, before {before} %"),
    "error_flag": later("{after} % of the feedback {what} has an ERROR flag, before {before} %"),
    "offline": later("{after} % of the feedback lacks the bit {what} in ONLINE, before {before} %"),
    "silence": later("{after} % of the {what} come after a silence, before {before} %"),
}
"""The measures of shares."""

_TOO_FEW: Final = later(
    "{measure} of {kinds}: too few rows; each side needs {least} of each, over {seconds} s"
)

MEASURES: Final = (*_TIMES, *_SHARES, "values", "findings")
"""What is compared."""


def counted(table: Table) -> Counts:
    """The counts of a table: those of `events`, and the periods by port, kind, motor and window."""
    own, keys = table.frame.drop_nulls(["kind", "t_ns"]), ("port", "kind", MOTOR)
    periods = own["period_ns"].fill_null(0).to_numpy()
    found = own.group_by(
        *keys,
        window=pl.col("t_ns") // (1 << PERIODS),
        bin=pl.Series(np.where(periods > 0, bins_of(periods, COARSE), _NO_PERIOD), dtype=pl.Int64),
    ).agg(pl.len().cast(pl.Int64).alias("sum count"))
    return {
        **events.counted(table),
        **binned("delays", table.answers, ["motor", "kind"], "delay_ns", "end_ns"),
        **binned("periods", own, keys, "period_ns", "t_ns"),
        "periods": found,
    }


ANALYSIS: Final = Analysis(counted)

_NO_PERIOD: Final = -1
"""The bin of frames without one before them."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number of both sides, in seconds, 1/s, a share, or the unit of a field."""

    measure: str
    """One of `MEASURES`."""
    port: str
    """Of the side before; text from outside; empty if it concerns all ports."""
    motor: int | None
    kind: str | None
    """Of frame, or a fault, or a field."""
    before: float | None
    after: float | None
    text: str
    """One sentence, as if it had changed."""
    strength: float = 0.0
    """How much of a change it is: less than 1 may be chance, or is too little to matter."""
    size: float = 0.0
    """How much it changed, to compare measures."""

    @property
    def score(self) -> float:
        """How much it changed; 0 if that may be chance, or is too little to matter."""
        return self.size if self.strength >= 1 else 0.0

    def is_like(self, other: Number) -> bool:
        """Whether it changed as another one of its measure and kind did, at least half as much."""
        own, that = ((one.after or 0.0) - (one.before or 0.0) for one in (self, other))
        is_same = (self.measure, self.kind) == (other.measure, other.kind) and own * that >= 0
        return is_same and min(abs(own), abs(that)) >= ALIKE * max(abs(own), abs(that))


class Comparison(NamedTuple):
    """What changed, and what was compared."""

    numbers: Sequence[Number]
    """All that was compared, by measure."""
    not_compared: Sequence[TranslatableText]
    """What could not be, with the reason."""

    @property
    def changes(self) -> Sequence[Number]:
        """The numbers that changed, best first; motors that changed alike are one.

        A motor that alone would change too little is named beside one that changed as it did.
        """
        named = [one for one in self.numbers if one.score]
        named += [
            one
            for one in self.numbers
            if ALIKE <= one.strength < 1 and one.motor and any(map(one.is_like, named))
        ]
        named.sort(key=lambda one: -one.score)
        return of_most_motors(named, Number.is_like, lambda _group: {})


class _Side(NamedTuple):
    """What was counted on one side."""

    name: TranslatableText
    counts: Counts
    events: Events


_Missing = list[TranslatableText]
_Of = tuple[str, int | None, str | None]
"""The port, motor and kind that a number is about."""
_Sides = tuple[_Side, _Side]


def compared(before: Counts, after: Counts) -> Comparison:
    """Compare what was counted on two sides."""
    sides = (
        _Side(TranslatableText("the first side"), before, Events(before)),
        _Side(TranslatableText("the second side"), after, Events(after)),
    )
    if hidden := [one for side in sides for one in side.events.hidden_by]:
        return Comparison([], [hidden_text(hidden)])
    if empty := [side.name for side in sides if not side.events.extent["sum timed"]]:
        form = "{side} has no rows with times"
        return Comparison([], [TranslatableText(form, side=name) for name in empty])
    missing = _Missing()
    ports = _pairs(sides, missing)
    numbers = [
        *(one for pair in ports for one in _of_streams(sides, pair, missing)),
        *_of_answers(sides, missing),
        *(one for pair in ports for one in _of_damage(sides, pair)),
        *_of_motors(sides, missing),
        *_of_values(sides),
        *_of_findings(sides, missing),
    ]
    return Comparison(numbers, list(dict.fromkeys(missing)))


def _only(sides: _Sides, found: Sequence[set[str]], form: str, missing: _Missing) -> None:
    """Name what only one side has."""
    for side, own, other in zip(sides, found, found[::-1], strict=True):
        if names := sorted(own - other):
            missing.append(TranslatableText(form, names=listed(names), side=side.name))


def _pairs(sides: _Sides, missing: _Missing) -> list[tuple[str, str]]:
    """The ports of both sides that belong together: of the same name, or the only ones."""
    first, second = (sorted(side.events.ports) for side in sides)
    if len(first) == len(second) == 1:
        return [(first[0], second[0])]
    _only(sides, [{*first}, {*second}], later("port {names}: only {side} has it"), missing)
    return [(name, name) for name in first if name in second]


class _Histogram(NamedTuple):
    """Durations of one side, as a whole and in parts of its time."""

    whole: Durations
    parts: Sequence[Durations]
    """Within 1.1 %."""

    @classmethod
    def of(cls, counts: Counts, name: str, **keys: object) -> _Histogram:
        """Those with some keys of counts with `window`, `bin` and `sum count`."""
        own = chosen(counts[name], **keys).filter(pl.col("bin") != _NO_PERIOD)
        present, at = np.unique(own["window"].to_numpy(), return_inverse=True)
        bins, of_bin = np.unique(own["bin"].to_numpy(), return_inverse=True)
        parts = np.zeros((PARTS, len(bins)), np.int64)
        part = at * PARTS // max(1, len(present))
        np.add.at(parts, (part, of_bin), own["sum count"].to_numpy())
        inside = (2 * bins + 1) << FINE - COARSE - 1  # the bin in the middle of a coarse one
        return cls(Durations.of(counts, name, **keys), [Durations(inside, one) for one in parts])

    @property
    def is_enough(self) -> bool:
        """Whether half of the parts have enough values."""
        return sum(one.count >= LEAST_VALUES for one in self.parts) >= PARTS // 2

    def up_to(self, ns: float) -> _Histogram:
        """Those that are not longer."""
        return _Histogram(self.whole.up_to(ns), [one.up_to(ns) for one in self.parts])

    def longer_than(self, ns: float) -> _Pair:
        """By part, the number of longer durations, and of all."""
        counts = np.array([one.count for one in self.parts])
        return counts - [one.up_to(ns).count for one in self.parts], counts

    def each(self, percents: tuple[float, float]) -> list[float]:
        """A number of the whole, and of each part with enough values, nanoseconds."""
        large = [one for one in self.parts if one.count >= LEAST_VALUES]
        return [_number(one, percents) for one in (self.whole, *large)]


def _number(own: Durations, percents: tuple[float, float]) -> float:
    """The difference of two percentiles, of which that of 0 is 0; the mean if both are 0."""
    if not any(percents):
        return float((own.lengths_ns * own.counts).sum() / own.count)
    low, high = ((own.percentile_ns(one) or 0.0) if one else 0.0 for one in percents)
    return high - low


def _times(
    sides: Sequence[_Histogram], measures: Iterable[str], what: str, of: _Of
) -> Iterator[Number]:
    """The numbers of durations; a rate that changed with its period is not named again."""
    changed = set[str]()
    for measure in measures:
        time = _TIMES[measure]
        (before, *first), (after, *second) = (side.each(time.percents) for side in sides)
        spread = max(max(one) - min(one) for one in (first, second))
        least = max(spread, time.least_ns, time.least_ratio * min(before, after))
        is_new = measure != "rate" or "period" not in changed
        strength = abs(after - before) / least if is_new else 0.0
        if strength >= 1:
            changed.add(measure)
        size = abs(log2((after + time.least_ns) / (before + time.least_ns)))
        values, shown = (before / 1e9, after / 1e9), (before / 1e6, after / 1e6)
        if measure == "rate":
            values = shown = 1e9 / before, 1e9 / after
        texts = {"before": f"{shown[0]:.3g}", "after": f"{shown[1]:.3g}"}
        text = TranslatableText(time.form, what=what, **texts)
        yield Number(measure, *of, *values, text, strength, size)


def _too_few(measure: str, kinds: Sequence[str], missing: _Missing) -> None:
    if kinds:
        values = {"least": PARTS * LEAST_VALUES, "seconds": round(PARTS * 2**PERIODS / 1e9)}
        text = TranslatableText(
            _TOO_FEW, measure=measure, kinds=listed(dict.fromkeys(kinds)), **values
        )
        missing.append(text)


def _whose(kind: int, motor: int | None) -> str:
    name = KINDS[kind].name
    return name if motor is None else TranslatableText("{kind} {motor}", kind=name, motor=motor)


def _of_streams(sides: _Sides, ports: tuple[str, str], missing: _Missing) -> Iterator[Number]:
    own = [chosen(one.counts["periods"], port=port) for one, port in zip(sides, ports, strict=True)]
    keys = [{*one.select("kind", MOTOR).iter_rows()} for one in own]
    names = [{_whose(*key) for key in one} for one in keys]
    _only(sides, names, later("{names}: only {side} has it"), missing)
    few = list[str]()
    for kind, motor in sorted(keys[0] & keys[1], key=str):
        what, of = _whose(kind, motor), (ports[0], motor, KINDS[kind].name)
        names_ = {"kind": kind, MOTOR: motor}
        whole = [
            _Histogram.of(side.counts, "periods", port=port, **names_)
            for side, port in zip(sides, ports, strict=True)
        ]
        medians = [one.whole.percentile_ns(50) or 0.0 for one in whole]
        active = [one.up_to(PAUSE * ns) for one, ns in zip(whole, medians, strict=True)]
        if not all(one.is_enough for one in active):
            few.append(KINDS[kind].name)
            continue
        yield from _times(active, ("period", "rate", "period_p99"), what, of)
        yield from _times(whole, ("jitter",), what, of)
        if KINDS[kind].direction is Direction.FEEDBACK:
            least_ns = max(5e8, 5 * max(medians))
            yield _share("silence", [one.longer_than(least_ns) for one in whole], what, of)
    _too_few("period", few, missing)


def _of_answers(sides: _Sides, missing: _Missing) -> Iterator[Number]:
    few = list[str]()
    for motor, (code, kind) in product(MOTORS, enumerate(KINDS)):
        delays = [_Histogram.of(one.counts, "delays", motor=motor, kind=code) for one in sides]
        if all(one.is_enough for one in delays):
            of = ("", motor, kind.name)
            yield from _times(delays, ("delay", "delay_p99"), _whose(code, motor), of)
        elif all(one.whole.count for one in delays):
            few.append(kind.name)
    _too_few("delay", few, missing)


def _of_damage(sides: _Sides, ports: tuple[str, str]) -> Iterator[Number]:
    windows = [side.events.ports[port] for side, port in zip(sides, ports, strict=True)]
    for fault in map(str, Fault):
        pairs = [_by_block(one, f"fault {fault}", "rows") for one in windows]
        if any(own.any() for own, _ in pairs):
            yield _share("damage", pairs, fault, (ports[0], None, fault))


_SHARES_OF_MOTOR: Final = (
    ("unanswered", "missed", "asked {}", later("to motor {motor}")),
    ("error_flag", "flagged", "feedback {}", later("of motor {motor}")),
    ("offline", "lacking", "feedback", later("of motor {motor}")),
)
"""Measures, and the columns of their events and rows."""


def _of_motors(sides: _Sides, missing: _Missing) -> Iterator[Number]:
    for motor, (measure, own, rows, form) in product(MOTORS, _SHARES_OF_MOTOR):
        names = (f"{own} {motor}", rows.format(motor))
        pairs = [_by_block(side.events.windows, *names) for side in sides]
        present = [bool(of.any()) for _, of in pairs]
        if all(present):
            what = TranslatableText(form, motor=motor)
            yield _share(measure, pairs, what, ("", motor, None))
        elif any(present) and measure == "unanswered":
            text = "answers of motor {motor}: {side} does not have them"
            name = sides[present[0]].name
            missing.append(TranslatableText(text, motor=motor, side=name))


_Pair = tuple[Ints, Ints]
"""Events and rows of a side, by block."""


def _by_block(windows: Windows, *names: str) -> _Pair:
    """Two columns, added up in blocks."""
    _, at = np.unique(windows.starts_ns >> BLOCK, return_inverse=True)
    own, rows = (np.bincount(at, windows[name].events) for name in names)
    return own, rows


def _share(measure: str, sides: Sequence[_Pair], what: str, of: _Of) -> Number:
    """A share on both sides: events and rows by block."""
    shares, variances, counts = [], [], []
    for events_, rows in sides:
        share = float(events_.sum() / max(1, rows.sum()))
        off, blocks = events_ - share * rows, max(2, len(rows))
        variances.append(float((off**2).sum() / max(1, rows.sum()) ** 2 * blocks / (blocks - 1)))
        shares.append(share)
        counts.append((int(events_.sum()), int(rows.sum())))
    before, after = shares
    difference = abs(after - before)
    error = max(sum(variances) ** 0.5, 1e-12)
    strength = min(
        difference / _LEAST_SHARE,
        log((max(shares) + 1e-12) / (min(shares) + 1e-12)) / log(_LEAST_RATIO),
        surprise(*counts) / LEAST_SCORE,
        difference / (SIGMAS * error),
    )
    texts = {"before": f"{100 * before:.2g}", "after": f"{100 * after:.2g}"}
    text = TranslatableText(_SHARES[measure], what=what, **texts)
    size = abs(log2((after + 0.001) / (before + 0.001)))
    return Number(measure, *of, before, after, text, strength, size)


def _of_values(sides: _Sides) -> Iterator[Number]:
    """The range that a motor reports, where the targets had the same range."""
    for motor, role in product(MOTORS, (Role.SPEED, Role.POSITION)):
        (targets, before), (targets_after, after) = (
            [_range(side.events.windows, f"{of} {role} {motor}") for of in ("target", "present")]
            for side in sides
        )
        if before is None or after is None or _difference(targets, targets_after) > SAME_TARGETS:
            continue
        off, name = _difference(before, after), NAME_OF_ROLE[role]
        text = TranslatableText(
            "motor {motor} reports {name} from {low} to {high}, before from {low_before} to"
            " {high_before}, with the same targets",
            **{"motor": motor, "name": name, "low": after[0], "high": after[1]},
            **{"low_before": before[0], "high_before": before[1]},
        )
        first, second = (float(high - low) for low, high in (before, after))
        yield Number("values", "", motor, name, first, second, text, off / OTHER_RANGE, off)


_Range = tuple[int, int]


def _range(windows: Windows, name: str) -> _Range | None:
    """The range of the values of a column, without windows in which it is unusual; None: none."""
    _, low, high = (one[windows[name].events > 0] for one in windows[name])
    if not len(low):
        return None
    least = np.quantile(low, _OUTLIERS, method="lower")
    return int(least), int(np.quantile(high, 1 - _OUTLIERS, method="higher"))


def _difference(before: _Range | None, after: _Range | None) -> float:
    """How much two ranges differ, as a share of the larger one; infinite without both."""
    if before is None or after is None:
        return inf
    size = max(before[1] - before[0], after[1] - after[0], 1)
    return max(abs(one - other) for one, other in zip(before, after, strict=True)) / size


def _of_findings(sides: _Sides, missing: _Missing) -> Iterator[Number]:
    reports = [find(side.counts) for side in sides]
    causes = [{(one.cause, one.motor): one for one in report.found} for report in reports]
    skipped = {cause for report in reports for cause in report.not_covered}
    forms = later("not any more: {text}"), later("new: {text}")
    for at, (own, others) in enumerate((causes, causes[::-1])):
        for (cause, motor), one in own.items():
            if (cause, motor) not in others and cause not in skipped:
                text = TranslatableText(forms[at], text=one.text)
                numbers = (1.0 - at, float(at))
                of = (one.port, motor, str(cause))
                yield Number("findings", *of, *numbers, text, 1.0, 2.0 + at)
    if len(skipped) < len(Cause):
        first, second = (float(len(report.found)) for report in reports)
        yield Number("findings", "", None, None, first, second, TranslatableText("findings"))
    form = "findings {causes}: {why}"
    for causes_, why in (one for report in reports for one in report.reasons()):
        missing.append(TranslatableText(form, causes=causes_, why=why))
