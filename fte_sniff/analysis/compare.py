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
from dataclasses import dataclass, field, replace
from math import log2
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import polars as pl

from fte_sniff.analysis import events
from fte_sniff.analysis.durations import COARSE, bins_of, chosen, middles
from fte_sniff.analysis.findings import Cause, find, hidden_text
from fte_sniff.analysis.relations import ANSWERABLE, FEEDBACK, AnswerState, values_at
from fte_sniff.analysis.segments import Analysis, Counts, summed
from fte_sniff.analysis.spans import divergence
from fte_sniff.analysis.table import MOTOR, QUANTITIES, Table
from fte_sniff.errors import TranslatableText, listed
from fte_sniff.protocol.rows import Ints, fault_bits
from fte_sniff.protocol.spec import (
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    Direction,
    Fault,
    Role,
    motor_bit,
)

BLOCK: Final = 34
"""A block has 2 to this power of nanoseconds, about 17 s."""

PARTS: Final = 8
"""Parts of a side, between which times vary; a side needs half of them with enough values."""

LEAST_VALUES: Final = 20
"""Values of a part, at least."""

PAUSE: Final = 4.0
SIGMAS: Final = 5.0
LEAST_SCORE: Final = 10.0
"""Minus the logarithm of the probability of a change by chance."""

SAME_TARGETS: Final = 0.1
OTHER_RANGE: Final = 0.25
_OUTLIERS: Final = 0.01
"""Share of values at each end of a range that are left out: flipped bits that were not seen."""

_LEAST_SHARE: Final = 0.002
_LEAST_RATIO: Final = 1.5


class Time(NamedTuple):
    """A number of a distribution of durations, and what matters of it."""

    least_ratio: float
    least_ns: float
    text: str


_TIMES: Final[Mapping[str, Time]] = {
    "period": Time(
        0.03, 100_000, "{what} come every {after} ms (median), before every {before} ms"
    ),
    "period_p99": Time(
        0.25, 2_000_000, "{what} come after up to {after} ms (99 %), before {before} ms"
    ),
    "jitter": Time(0.5, 1_000_000, "the period of {what} varies by {after} ms, before {before} ms"),
    "delay": Time(0.1, 200_000, "answers to {what} take {after} ms (median), before {before} ms"),
    "delay_p99": Time(
        0.25, 1_000_000, "99 % of the answers to {what} within {after} ms, before {before} ms"
    ),
}
"""The measures of times."""

_SHARES: Final[Mapping[str, str]] = {
    "unanswered": "{after} % of the commands {what} have no answer, before {before} %",
    "damage": "{after} % of the rows are {what}, before {before} %",
    "error_flag": "{after} % of the feedback {what} has an ERROR flag, before {before} %",
    "offline": "{after} % of the feedback lacks the bit {what} in ONLINE, before {before} %",
    "silence": "{after} % of the {what} come after a silence, before {before} %",
}
"""The measures of shares."""

MEASURES: Final = ("rate", *_TIMES, *_SHARES, "values", "findings")
"""What is compared."""


# Counting


def counted(table: Table) -> Counts:
    """The counts of a table: those of `events`, and by block those of each measure."""
    rows, own = table.rows, table.counted
    own = own[rows.timed[own]]
    blocks = rows.t_ns[own] >> BLOCK
    ports = pl.Series(rows.ports, dtype=pl.String)
    periods = table.frame.filter(pl.col("period_ns") > 0, pl.col("kind").is_not_null())
    delays = table.answers.filter(pl.col("cmd").is_in(ANSWERABLE)).drop_nulls("t_ns")
    found = {
        "periods": _binned(periods, ("port", "kind", MOTOR), "period_ns"),
        "delays by block": _binned(delays.drop_nulls("delay_ns"), ("motor", "kind"), "delay_ns"),
        "unanswered": delays.filter(pl.col("state") <= AnswerState.UNANSWERED)
        .group_by("motor", block=pl.col("t_ns") // (1 << BLOCK))
        .agg(
            pl.len().cast(pl.Int64).alias("sum rows"),
            (pl.col("state") == AnswerState.UNANSWERED).sum().cast(pl.Int64).alias("sum events"),
        ),
        "damage": _damage(table, own, blocks),
        "flags": _flags(table, own, blocks),
        "kinds": table.frame.drop_nulls("kind").select("port", "kind", MOTOR).unique(),
        "values": _values(table),
    }
    named = {
        name: one.with_columns(port=ports.gather(one["port"])) if "port" in one.columns else one
        for name, one in found.items()
    }
    return {**events.counted(table), **named}


ANALYSIS: Final = Analysis(counted, summed)


def _binned(frame: pl.DataFrame, keys: Sequence[str], ns: str) -> pl.DataFrame:
    return (
        frame.select(
            *keys,
            block=pl.col("t_ns") // (1 << BLOCK),
            bin=pl.Series(bins_of(frame[ns].to_numpy(), COARSE), dtype=pl.Int64),
            ns=ns,
        )
        .group_by(*keys, "block", "bin")
        .agg(pl.len().cast(pl.Int64).alias("sum count"), pl.col("ns").sum().alias("sum ns"))
    )


def _values(table: Table) -> pl.DataFrame:
    """The quantities of motors by bin: that of the size, with its sign."""
    parts = list[pl.DataFrame]()
    for name in QUANTITIES:
        own = table.frame.filter(pl.col(MOTOR).is_not_null(), pl.col(name).is_not_null())
        values = own[name].to_numpy().astype(np.int64)
        bins = np.sign(values) * bins_of(np.abs(values), COARSE)
        parts.append(
            own.select("port", "kind", MOTOR, name=pl.lit(name), bin=pl.Series(bins))
            .group_by("port", "kind", MOTOR, "name", "bin")
            .agg(pl.len().cast(pl.Int64).alias("sum count"))
        )
    return pl.concat(parts)


def _damage(table: Table, own: Ints, blocks: Ints) -> pl.DataFrame:
    """The rows of each port by block, and those with each fault."""
    frame = pl.DataFrame(
        {"port": table.rows.port[own], "block": blocks, "faults": table.rows.faults[own]}
    )
    rows = frame.group_by("port", "block", "faults").agg(pl.len().cast(pl.Int64).alias("rows"))
    total = pl.col("rows").sum().alias("sum rows")
    sums = [
        pl.col("rows")
        .filter(pl.col("faults") & fault_bits([fault]) != 0)
        .sum()
        .alias(f"sum {fault}")
        for fault in Fault
    ]
    return rows.group_by("port", "block").agg(total, *sums)


def _has(fault: Fault) -> pl.Expr:
    return pl.col("faults") & fault_bits([fault]) != 0


def _flags(table: Table, own: Ints, blocks: Ints) -> pl.DataFrame:
    """By motor and block, its feedback, that with an ERROR flag, any, and that without its bit."""
    rows, is_feedback = table.rows, FEEDBACK[table.rows.kinds[own]]
    at, blocks = own[is_feedback], blocks[is_feedback]
    errors, online = (values_at(rows, NAME_OF_ROLE[one], at) for one in (Role.ERRORS, Role.ONLINE))
    parts = [
        pl.DataFrame(
            {
                "motor": np.full(len(at), motor, np.int64),
                "block": blocks,
                "feedback": rows.nums[at] == motor,
                "error": (rows.nums[at] == motor) & (errors != 0),
                "off": online >> motor_bit(motor) & 1 == 0,
            }
        )
        for motor in MOTORS
    ]
    names = {"feedback": "sum feedback", "error": "sum errors", "off": "sum offline"}
    return (
        pl.concat(parts)
        .group_by("motor", "block")
        .agg(
            pl.len().cast(pl.Int64).alias("sum any"),
            *(pl.col(name).sum().cast(pl.Int64).alias(new) for name, new in names.items()),
        )
    )


# Comparing


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
    score: float = 0.0
    """How much it changed; 0 if that may be chance, or is too little to matter."""
    motors: tuple[int, ...] = ()
    """The motors of which several changed alike."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What changed, and what was compared."""

    numbers: Sequence[Number]
    """All that was compared, by measure."""
    not_compared: Sequence[TranslatableText]
    """What could not be, with the reason."""
    changes: Sequence[Number] = field(init=False)
    """The numbers that changed, best first; motors that changed alike are one."""

    def __post_init__(self) -> None:
        named = [one for one in self.numbers if one.score]
        object.__setattr__(self, "changes", _ranked(named))

    def covers(self, measure: str) -> bool:
        """Whether a measure was compared; empty for any."""
        return any(measure in ("", one.measure) for one in self.numbers)


def compared(before: Counts, after: Counts) -> Comparison:
    """Compare what was counted on two sides."""
    sides = before, after
    hidden = [one for side in sides for one in side["hidden"]["hidden_by"]]
    if hidden:
        return Comparison([], [hidden_text(hidden)])
    empty = [word for word, side in zip(_SIDES, sides, strict=True) if not _timed(side)]
    if empty:
        why = "{side} has no rows with times"
        return Comparison([], [TranslatableText(why, side=TranslatableText(one)) for one in empty])
    missing = list[TranslatableText]()
    ports = _pairs(before, after, missing)
    numbers = [
        *_of_streams(before, after, ports, missing),
        *_of_answers(before, after, missing),
        *_of_damage(before, after, ports),
        *_of_flags(before, after),
        *_of_findings(before, after, missing),
    ]
    return Comparison(numbers, list(dict.fromkeys(missing)))


_SIDES: Final = ("the first side", "the second side")


def _timed(side: Counts) -> int:
    return int(side["extent"]["sum timed"].sum())


def _pairs(before: Counts, after: Counts, missing: list[TranslatableText]) -> dict[str, str]:
    """The ports of the second side by those of the first: of the same name, or the only ones."""
    first, second = (side["damage"]["port"].unique().sort().to_list() for side in (before, after))
    if len(first) == len(second) == 1:
        return {first[0]: second[0]}
    for names, side in ((set(first) - set(second), 0), (set(second) - set(first), 1)):
        if names:
            text = "port {ports}: only {side} has it"
            missing.append(_only(text, side, ports=listed(sorted(names))))
    return {name: name for name in first if name in second}


def _only(text: str, side: int, **values: object) -> TranslatableText:
    return TranslatableText(text, side=TranslatableText(_SIDES[side]), **values)


class _Histogram:
    """Durations of one side, as a whole and in parts of its time."""

    def __init__(self, counts: pl.DataFrame) -> None:
        """`counts` has `block`, `bin`, `sum count` and `sum ns`."""
        blocks = counts["block"].to_numpy()
        present = np.unique(blocks)
        part = np.searchsorted(present, blocks) * PARTS // max(1, len(present))
        self.bins, at = np.unique(counts["bin"].to_numpy(), return_inverse=True)
        self.parts = np.zeros((PARTS, len(self.bins)), np.int64)
        np.add.at(self.parts, (part, at), counts["sum count"].to_numpy())

    @property
    def whole(self) -> Ints:
        """The counts of all parts, by bin."""
        found: Ints = self.parts.sum(axis=0)
        return found

    def without_pauses(self) -> _Histogram:
        """Only durations up to `PAUSE` medians."""
        kept = middles(self.bins, COARSE) <= PAUSE * self.quantile(self.whole, 0.5)
        return self.only(kept)

    def only(self, kept: Any) -> _Histogram:
        """Only some of the bins."""
        found = object.__new__(_Histogram)
        found.bins, found.parts = self.bins[kept], self.parts[:, kept]
        return found

    def quantile(self, counts: Ints, share: float) -> float:
        """A quantile, nanoseconds."""
        at = int(np.searchsorted(np.cumsum(counts), max(1, share * counts.sum())))
        return float(middles(self.bins[at : at + 1], COARSE)[0])

    def mean(self, counts: Ints) -> float:
        """The mean, nanoseconds."""
        return float((middles(self.bins, COARSE) * counts).sum() / counts.sum())

    def each(self, measure: str) -> tuple[float, list[float]]:
        """A number of the whole, and of the parts with enough values."""
        parts = [one for one in self.parts if one.sum() >= LEAST_VALUES]
        return self._of(measure, self.whole), [self._of(measure, one) for one in parts]

    def _of(self, measure: str, counts: Ints) -> float:
        if measure == "rate":
            return self.mean(counts)
        if measure == "jitter":
            return self.quantile(counts, 0.95) - self.quantile(counts, 0.05)
        return self.quantile(counts, 0.99 if measure.endswith("p99") else 0.5)


class _Of(NamedTuple):
    """What a number is about."""

    port: str
    motor: int | None
    kind: str | None


_Pair: TypeAlias = tuple[Ints, Ints]
"""Events and rows of a side, by block."""


def _is_other(before: float, after: float, parts: Sequence[list[float]], time: Time) -> bool:
    """Whether a time changed: by more than between parts of a side, and enough to matter."""
    spread = max(max(one) - min(one) for one in parts)
    least = max(spread, time.least_ns, time.least_ratio * min(before, after))
    return abs(after - before) > least


def _times(
    sides: Sequence[_Histogram], measures: Iterable[str], what: str, of: _Of
) -> Iterator[Number]:
    for measure in measures:
        (before, first), (after, second) = (side.each(measure) for side in sides)
        if min(len(first), len(second)) < PARTS // 2:
            return
        time = _TIMES["period" if measure == "rate" else measure]
        is_other = _is_other(before, after, (first, second), time)
        score = abs(log2(max(after, 1) / max(before, 1))) if is_other else 0.0
        texts = {"before": f"{before / 1e6:.3g}", "after": f"{after / 1e6:.3g}"}
        form, values = time.text, (before / 1e9, after / 1e9)
        if measure == "rate":
            values = 1e9 / before, 1e9 / after
            form = "{what}: {after} in a second, before {before}"
            texts = dict(zip(texts, (f"{one:.3g}" for one in values), strict=True))
        text = TranslatableText(form, what=what, **texts)
        yield Number(measure, *of, *values, text, score)


def _whose(kind: int, motor: int | None) -> str:
    name = KINDS[kind].name
    return name if motor is None else TranslatableText("{kind} {motor}", kind=name, motor=motor)


def _of_streams(
    before: Counts, after: Counts, ports: Mapping[str, str], missing: list[TranslatableText]
) -> Iterator[Number]:
    for port, other in ports.items():
        pairs = (before, port), (after, other)
        keys = [
            {*chosen(side["kinds"], port=name).select("kind", MOTOR).iter_rows()}
            for side, name in pairs
        ]
        for at, own in enumerate((keys[0] - keys[1], keys[1] - keys[0])):
            if own:
                names = sorted(_whose(*key) for key in own)
                missing.append(_only("{kinds}: only {side} has it", at, kinds=listed(names)))
        few = list[str]()
        for kind, motor in sorted(keys[0] & keys[1], key=str):
            yield from _of_stream(before, after, (port, other), kind, motor, few)
        if few:
            text = "periods of {kinds}: too few rows"
            missing.append(TranslatableText(text, kinds=listed(few)))
        yield from _of_values([chosen(side["values"], port=name) for side, name in pairs], port)


def _of_stream(
    before: Counts,
    after: Counts,
    ports: tuple[str, str],
    kind: int,
    motor: int | None,
    few: list[str],
) -> Iterator[Number]:
    whole = [
        _Histogram(chosen(side["periods"], **{"port": port, "kind": kind, MOTOR: motor}))
        for side, port in zip((before, after), ports, strict=True)
    ]
    what = _whose(kind, motor)
    of = _Of(ports[0], motor, KINDS[kind].name)
    if min(one.whole.sum() for one in whole) < LEAST_VALUES * PARTS // 2:
        few.append(what)
        return
    sides = [one.without_pauses() for one in whole]
    found = list(_times(sides, ("period", "rate", "period_p99", "jitter"), what, of))
    if found and found[0].score:  # the rate and the rest follow from the period
        found[1:] = [replace(one, score=0.0) for one in found[1:]]
    yield from found
    if KINDS[kind].direction is Direction.FEEDBACK:
        usual = max(side.quantile(side.whole, 0.5) for side in sides)
        silent = [one.only(middles(one.bins, COARSE) > max(5 * usual, 5e8)) for one in whole]
        pairs = [
            (own.parts.sum(axis=1), one.parts.sum(axis=1))
            for own, one in zip(silent, whole, strict=True)
        ]
        yield _share("silence", pairs, what, of)


def _of_values(sides: Sequence[pl.DataFrame], port: str) -> Iterator[Number]:
    """The range that a motor reports, where the targets had the same range."""
    for motor in MOTORS:
        for name in QUANTITIES:
            for feedback in KINDS:
                if feedback.subject == name and feedback.direction is Direction.FEEDBACK:
                    targets, present = (
                        [_range(side, direction, motor, name) for side in sides]
                        for direction in Direction
                    )
                    yield from _of_range(targets, present, port, motor, name)
                    break


def _range(
    side: pl.DataFrame, direction: Direction, motor: int, name: str
) -> tuple[int, int] | None:
    codes = [
        code
        for code, kind in enumerate(KINDS)
        if kind.direction is direction and kind.names_motor and kind.subject == name
    ]
    own = chosen(side, **{MOTOR: motor, "name": name}).filter(pl.col("kind").is_in(codes))
    if not len(own):
        return None
    own = own.group_by("bin").agg(pl.col("sum count").sum()).sort("bin")
    bins, total = own["bin"].to_numpy(), np.cumsum(own["sum count"].to_numpy())
    at = np.searchsorted(total, total[-1] * np.array([_OUTLIERS, 1 - _OUTLIERS]))
    ends = np.sign(bins[at]) * middles(np.abs(bins[at]), COARSE)
    return int(ends[0]), int(ends[1])


def _of_range(
    targets: Sequence[tuple[int, int] | None],
    present: Sequence[tuple[int, int] | None],
    port: str,
    motor: int,
    name: str,
) -> Iterator[Number]:
    known = [one for one in (*targets, *present) if one is not None]
    if len(known) < len(targets) + len(present):
        return
    (low, high), (other_low, other_high), *_ = known
    size = max(high - low, other_high - other_low, 1)
    if max(abs(low - other_low), abs(high - other_high)) > SAME_TARGETS * size:
        return
    *_, (low, high), (other_low, other_high) = known
    off = max(abs(low - other_low), abs(high - other_high)) / size
    text = TranslatableText(
        "motor {motor} reports {name} from {low} to {high}, before from {low_before} to"
        " {high_before}, with the same targets",
        motor=motor,
        name=name,
        low=other_low,
        high=other_high,
        low_before=low,
        high_before=high,
    )
    score = off if off > OTHER_RANGE else 0.0
    yield Number("values", port, motor, name, high - low, other_high - other_low, text, score)


def _of_answers(before: Counts, after: Counts, missing: list[TranslatableText]) -> Iterator[Number]:
    for motor in MOTORS:
        own = [chosen(side["unanswered"], motor=motor) for side in (before, after)]
        if not all(map(len, own)):
            if any(map(len, own)):
                text = "answers of motor {motor}: {side} does not have them"
                missing.append(_only(text, int(not len(own[1])), motor=motor))
            continue
        what = TranslatableText("to motor {motor}", motor=motor)
        pairs = [(one["sum events"].to_numpy(), one["sum rows"].to_numpy()) for one in own]
        yield _share("unanswered", pairs, what, _Of("", motor, None))
        for code, kind in enumerate(KINDS):
            sides = [
                _Histogram(chosen(side["delays by block"], motor=motor, kind=code))
                for side in (before, after)
            ]
            if min(side.whole.sum() for side in sides) >= LEAST_VALUES * PARTS // 2:
                of = _Of("", motor, kind.name)
                found = list(_times(sides, ("delay", "delay_p99"), _whose(code, motor), of))
                if found and found[0].score:
                    found[1:] = [replace(one, score=0.0) for one in found[1:]]
                yield from found


def _of_damage(before: Counts, after: Counts, ports: Mapping[str, str]) -> Iterator[Number]:
    for port, other in ports.items():
        sides = [
            chosen(side["damage"], port=name) for side, name in ((before, port), (after, other))
        ]
        for fault in Fault:
            pairs = [
                (side[f"sum {fault}"].to_numpy(), side["sum rows"].to_numpy()) for side in sides
            ]
            if any(events_.any() for events_, _ in pairs):
                yield _share("damage", pairs, str(fault), _Of(port, None, str(fault)))


def _of_flags(before: Counts, after: Counts) -> Iterator[Number]:
    for motor in MOTORS:
        own = [chosen(side["flags"], motor=motor) for side in (before, after)]
        for measure, part, whole in (
            ("error_flag", "sum errors", "sum feedback"),
            ("offline", "sum offline", "sum any"),
        ):
            pairs = [(one[part].to_numpy(), one[whole].to_numpy()) for one in own]
            if all(rows.any() for _, rows in pairs) and any(one.any() for one, _ in pairs):
                what = TranslatableText("of motor {motor}", motor=motor)
                yield _share(measure, pairs, what, _Of("", motor, None))


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
    is_large = difference >= _LEAST_SHARE and max(shares) >= _LEAST_RATIO * min(shares)
    error = max(sum(variances) ** 0.5, 1e-12)
    is_sure = _surprise(counts) >= LEAST_SCORE and difference >= SIGMAS * error
    texts = {"before": f"{100 * before:.2g}", "after": f"{100 * after:.2g}"}
    text = TranslatableText(_SHARES[measure], what=what, **texts)
    score = abs(log2((after + 0.001) / (before + 0.001))) if is_large and is_sure else 0.0
    return Number(measure, *of, before, after, text, score)


def _surprise(counts: Sequence[tuple[int, int]]) -> float:
    """Minus the logarithm of the bound on the probability of the events being so divided."""
    (first, rows), (second, other_rows) = counts
    total, expected = first + second, other_rows / max(1, rows + other_rows)
    return total * divergence(second / total, expected) if total and 0 < expected < 1 else 0.0


def _of_findings(
    before: Counts, after: Counts, missing: list[TranslatableText]
) -> Iterator[Number]:
    reports = [find(side) for side in (before, after)]
    causes = [{(one.cause, one.motor): one for one in report.found} for report in reports]
    skipped = {cause for report in reports for cause in report.not_covered}
    for at, (own, others) in enumerate((causes, causes[::-1])):
        for key, one in own.items():
            if key in others or str(one.cause) in skipped:
                continue
            form = ("not any more: {text}", "new: {text}")[at]
            numbers = (1.0, 0.0) if at == 0 else (0.0, 1.0)
            text = TranslatableText(form, text=one.text)
            yield Number("findings", one.port, one.motor, str(one.cause), *numbers, text, 2.0 + at)
    if len(skipped) < len(Cause):
        first, second = (float(len(report.found)) for report in reports)
        yield Number("findings", "", None, None, first, second, TranslatableText("findings"))
    for report in reports:
        for why in dict.fromkeys(report.not_covered.values()):
            names = listed(one for one, reason in report.not_covered.items() if reason == why)
            missing.append(TranslatableText("findings {causes}: {why}", causes=names, why=why))


def _ranked(found: Sequence[Number]) -> list[Number]:
    """The changes, best first; the same change of three or four motors is one."""
    rest, merged = sorted(found, key=lambda one: -one.score), list[Number]()
    while rest:
        first = rest.pop(0)
        same = [
            one
            for one in rest
            if (one.measure, one.kind) == (first.measure, first.kind)
            and None not in (one.motor, first.motor)
            and _rises(one) == _rises(first)
        ]
        motors = sorted({one.motor for one in (first, *same) if one.motor is not None})
        if len(motors) >= len(MOTORS) - 1:
            rest = [one for one in rest if one not in same]
            form = "motors {motors} alike: {text}"
            text = TranslatableText(form, motors=listed(motors), text=first.text)
            first = replace(first, motor=None, text=text, motors=tuple(motors))
        merged.append(first)
    return merged


def _rises(one: Number) -> bool:
    return (one.after or 0.0) > (one.before or 0.0)
