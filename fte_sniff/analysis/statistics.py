"""Statistics of ports, streams, faults and motors, as the object of docs/stats.md.

port     one wire: counts, utilization, silences, events
stream   the frames of one kind, to or from one motor, on one port: rate, period, jitter, ranges
fault    count, and first and last time
motor    commands, answers, flags

`counted` counts a table, `statistics` makes the numbers from the sum of such counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
import polars as pl

from fte_sniff.analysis.dataframe import known_only
from fte_sniff.analysis.durations import Durations, binned, chosen
from fte_sniff.analysis.relations import FEEDBACK, AnswerState
from fte_sniff.analysis.segments import Analysis, Counts, extent_of
from fte_sniff.analysis.table import MOTOR, QUANTITIES, Table, times
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.rows import fault_bits, faults_in
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    KINDS,
    MOTORS,
    NAME_OF_ROLE,
    Direction,
    Role,
    Status,
    motor_bit,
    status_of,
)

Json = dict[str, Any]

_SUMMED: Final = (PortEventKind.LINE_ERROR, PortEventKind.OVERRUN, PortEventKind.NOT_PASSED_ON)
"""Port events whose counts add up: errors, or bytes."""


def counted(table: Table) -> Counts:
    """The counts of a table."""
    bauds = {one: table.bauds.get(one) for one in (*table.bauds, *table.rows.used_ports)}
    frame, answers = table.frame, table.answers
    by_stream = ("port", "kind", MOTOR)
    streams = frame.filter(pl.col("kind").is_not_null())
    return {
        "rows": frame.group_by("source", "port", "faults", "direction").agg(
            pl.len().cast(pl.Int64).alias("sum rows"),
            pl.col("length").sum().alias("sum bytes"),
            pl.col("t_ns").min().alias("least t"),
            pl.col("t_ns").max().alias("greatest t"),
        ),
        "ports": frame.group_by("port").agg(
            pl.col("step_ns").count().cast(pl.Int64).alias("sum steps"),
            pl.col("step_ns").sum().alias("sum step_ns"),
            (pl.col("end_ns") - pl.col("t_ns")).sum().alias("sum busy_ns"),
            pl.col("used_ns").sum().alias("sum used_ns"),
        ),
        "streams": streams.group_by(by_stream).agg(
            pl.len().cast(pl.Int64).alias("sum frames"),
            pl.col("period_ns").count().cast(pl.Int64).alias("sum periods"),
            pl.col("period_ns").sum().alias("sum period_ns"),
            *(pl.col(name).min().cast(pl.Int64).alias(f"least {name}") for name in QUANTITIES),
            *(pl.col(name).max().cast(pl.Int64).alias(f"greatest {name}") for name in QUANTITIES),
        ),
        **binned("silences", frame.filter(pl.col("idle_ns") > 0), ["port"], "idle_ns", "t_ns"),
        **binned("periods", streams, by_stream, "period_ns", "t_ns"),
        "answers": answers.group_by("motor", "state").agg(
            pl.len().cast(pl.Int64).alias("sum commands")
        ),
        **binned("delays", answers, ["motor", "kind"], "delay_ns", "end_ns"),
        "flags": _flags(table),
        "events": _events(table),
        "bauds": pl.DataFrame(
            [*bauds.items()], {"port": pl.String, "last baud": pl.Int64}, orient="row"
        ),
        "sources": pl.DataFrame({"source": [*filter(None, table.sources)]}, {"source": pl.String}),
        **extent_of(table),
    }


_FLAGS: Final = {"error": NAME_OF_ROLE[Role.ERRORS], "online": NAME_OF_ROLE[Role.ONLINE]}


def _flags(table: Table) -> pl.DataFrame:
    """Feedback by motor, ERROR, ONLINE, and the bits of ONLINE that only the one before it had.

    A flag is null in kinds that do not have it.
    """
    rows, at = table.rows, np.flatnonzero(FEEDBACK[table.rows.kinds[: table.stop]])
    if table.selected is not None:
        at = at[table.selected[at]]
    feedback, online = rows.select(at), pl.col("online")
    flags = {name: known_only(*feedback.field(own)) for name, own in _FLAGS.items()}
    return (
        pl.DataFrame({"motor": feedback.nums, **flags, "t_ns": times(feedback.t_ns)})
        .with_columns(lost=online.forward_fill().shift() & ~online)
        .filter(pl.Series(at >= table.start))
        .group_by("motor", *flags, "lost")
        .agg(
            pl.len().cast(pl.Int64).alias("sum frames"),
            pl.col("t_ns").min().alias("least t"),
            pl.col("t_ns").max().alias("greatest t"),
        )
    )


def _events(table: Table) -> pl.DataFrame:
    names = ("sum count", "sum total", "least t", "greatest t")
    found = [(one.port, str(one.kind), 1, one.count, one.t_ns, one.t_ns) for one in table.events]
    schema = {"port": pl.String, "event": pl.String, **dict.fromkeys(names, pl.Int64)}
    return pl.DataFrame(found, schema, orient="row")


ANALYSIS: Final = Analysis(counted)


# The numbers


def statistics(counts: Counts, baud: int = DEFAULT_BAUD) -> Json:
    """The numbers of counts that were summed; `baud` is that of ports for which none was named.

    The keys of the object that depend on the inputs (`version`, `notes`, ...) are not in it.
    """
    rows, names, is_hidden = counts["rows"], counts["sources"]["source"], len(counts["hidden"]) > 0
    files = [{"name": name, **_extent(chosen(rows, source=name))} for name in names]
    ends = [one[name] for one in files if one["rows"] for name in ("first_time", "last_time")]
    in_order = len(ends) <= 2 or (None not in ends and ends == sorted(ends))
    first_ns, last_ns = counts["extent"].select("least t", "greatest t").row(0)
    return {
        **_extent(rows),
        "duration_s": None if first_ns is None else (last_ns - first_ns) / 1e9,
        "status": _statuses(rows),
        "files": files,
        "ports": [
            _port(counts, port, baud if own is None else own)
            for port, own in counts["bauds"].iter_rows()
        ],
        "motors": [_motor(counts, motor, known=in_order and not is_hidden) for motor in MOTORS],
    }


def _extent(rows: pl.DataFrame) -> Json:
    size = {"rows": int(rows["sum rows"].sum()), "bytes": int(rows["sum bytes"].sum())}
    return {**size, **_times(rows)}


def _times(counts: pl.DataFrame) -> Json:
    return {
        "first_time": _time(counts["least t"].min()),
        "last_time": _time(counts["greatest t"].max()),
    }


def _time(t_ns: Any) -> str | None:
    return None if t_ns is None else iso_time(int(t_ns))


def _seconds(ns: float | None) -> float | None:
    return None if ns is None else ns / 1e9


def _having(counts: pl.DataFrame, name: str, bits: int) -> pl.DataFrame:
    """The counts with one of some bits in a column."""
    return counts.filter(pl.col(name) & bits != 0)


def _statuses(rows: pl.DataFrame) -> Json:
    found = {str(status): {"rows": 0, "bytes": 0} for status in Status}
    for bits, count, size in rows.select("faults", "sum rows", "sum bytes").iter_rows():
        own = found[str(status_of(faults_in(bits)))]
        own["rows"] += count
        own["bytes"] += size
    return found


def _port(counts: Counts, port: str, baud: int) -> Json:
    rows, used = (chosen(counts[name], port=port) for name in ("rows", "ports"))
    sums = {name: int(used[name].sum()) for name in used.columns if name != "port"}
    rate = sums["sum steps"] * 1e9 / sums["sum step_ns"] if sums["sum step_ns"] > 0 else None
    silences = Durations.of(counts, "silences", port=port)
    frames = dict(rows.group_by("direction").agg(pl.col("sum rows").sum()).iter_rows())
    return {
        "port": port,
        "baud": baud,
        **_extent(rows),
        "rows_per_s": rate,
        "line_use": None if rate is None else sums["sum busy_ns"] / sums["sum used_ns"],
        "status": _statuses(rows),
        "frames": {str(one): frames.get(code, 0) for code, one in enumerate(Direction)},
        "faults": list(_faults(rows)),
        "silences": {"count": silences.count, **_durations(silences)},
        "events": [_event(one) for one in chosen(counts["events"], port=port).to_dicts()],
        "streams": list(_streams(counts, port)),
    }


def _faults(rows: pl.DataFrame) -> Iterator[Json]:
    """The faults that occurred; a row counts for each of its own."""
    total = _extent(rows)
    for fault in faults_in(int(np.bitwise_or.reduce(rows["faults"].to_numpy()))):
        extent = _extent(_having(rows, "faults", fault_bits([fault])))
        yield {
            "fault": str(fault),
            "status": str(status_of((fault,))),
            **extent,
            "rows_share": extent["rows"] / total["rows"],
            "bytes_share": extent["bytes"] / total["bytes"] if total["bytes"] else 0.0,
        }


def _durations(found: Durations) -> Json:
    return {
        **{f"p{percent}_s": _seconds(found.percentile_ns(percent)) for percent in (50, 95, 99)},
        "longest_s": _seconds(found.longest_ns),
        "longest_until": _time(found.longest_until_ns),
    }


def _event(one: Mapping[str, Any]) -> Json:
    return {
        "event": one["event"],
        "count": one["sum count"],
        "total": one["sum total"] if one["event"] in _SUMMED else None,
        "first_time": _time(one["least t"]),
        "last_time": _time(one["greatest t"]),
    }


def _streams(counts: Counts, port: str) -> Iterator[Json]:
    for one in chosen(counts["streams"], port=port).sort("kind", MOTOR).iter_rows(named=True):
        keys = {"port": port, "kind": one["kind"], MOTOR: one[MOTOR]}
        periods = Durations.of(counts, "periods", **keys)
        is_timed = one["sum period_ns"] > 0
        yield {
            "kind": KINDS[one["kind"]].name,
            MOTOR: one[MOTOR],
            "frames": one["sum frames"],
            "frames_per_s": one["sum periods"] * 1e9 / one["sum period_ns"] if is_timed else None,
            "period": _durations(periods),
            "jitter_s": _seconds(periods.jitter_ns),
            "values": {
                name: {"least": one[f"least {name}"], "greatest": one[f"greatest {name}"]}
                for name in QUANTITIES
                if one[f"least {name}"] is not None
            },
        }


def _motor(counts: Counts, motor: int, *, known: bool) -> Json:
    """The numbers of a motor; what its answers are is null unless it is `known`."""
    own = chosen(counts["answers"], motor=motor)
    states = dict(own.select("state", "sum commands").iter_rows())
    total, answered = sum(states.values()), states.get(AnswerState.ANSWERED, 0)
    unanswered = states.get(AnswerState.UNANSWERED, 0)
    is_covered = answered or unanswered or AnswerState.UNCOVERED not in states
    delays = Durations.of(counts, "delays", motor=motor if known else None)
    flags, bit = counts["flags"], 1 << motor_bit(motor)
    own, offline = chosen(flags, motor=motor), flags.filter(pl.col("online") & bit == 0)
    return {
        MOTOR: motor,
        "commands": total,
        "feedback": int(own["sum frames"].sum()),
        "answered": answered if known else None,
        "unanswered": unanswered if known and is_covered else None,
        "neither": total - answered - unanswered if known else None,
        "delay": _durations(delays),
        "error_bits": [
            {"bit": number, "frames": int(raised["sum frames"].sum()), **_times(raised)}
            for number in range(8)
            if len(raised := _having(own, "error", 1 << number))
        ],
        "offline": {
            "frames": int(offline["sum frames"].sum()),
            "times_lost": int(_having(flags, "lost", bit)["sum frames"].sum()) if known else None,
            **_times(offline),
        },
    }
