"""Statistics of ports, streams, faults and motors.

port     one wire: counts, utilization, silences, events
stream   the frames of one kind, to or from one motor, on one port: rate, period, jitter, ranges
fault    count, and count over time
motor    commands, answers, flags
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import polars as pl

from fte_sniff.analysis.whole.relations import AnswerState
from fte_sniff.analysis.whole.table import Table
from fte_sniff.protocol import MOTORS, VALUE_FIELDS, Direction
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit

Numbers = dict[str, Any]
"""Numbers by name: the JSON object of docs/stats.md, with times as nanoseconds."""

_MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]
_ONLINE: Final = NAME_OF_ROLE[Role.ONLINE]
_ERRORS: Final = NAME_OF_ROLE[Role.ERRORS]
_QUANTITIES: Final = [field.name for field in VALUE_FIELDS if field.unit]
_EXTENT: Final = {
    "rows": pl.len(),
    "bytes": pl.col("length").sum(),
    "first_ns": pl.col("t_ns").min(),
    "last_ns": pl.col("t_ns").max(),
}


def durations(ns: pl.Expr, until: pl.Expr) -> dict[str, pl.Expr]:
    """Percentiles and the longest of some durations, in seconds, and when the longest ended."""
    percentiles = {p: ns.quantile(p / 100, "equiprobable") for p in (5, 50, 95, 99)}
    return {
        "count": ns.count(),
        **{f"p{p}_s": value / 1e9 for p, value in percentiles.items()},
        "longest_s": ns.max() / 1e9,
        "longest_until": until.get(ns.arg_max()),
    }


def _rate(ns: pl.Expr) -> pl.Expr:
    """The rate of events between which these times are."""
    return pl.when(ns.sum() > 0).then(ns.count() * 1e9 / ns.sum())


def whole(table: Table) -> Numbers:
    """All statistics."""
    frame = table.frame
    return {
        **frame.select(**_EXTENT).row(0, named=True),
        "status": _statuses(frame),
        "files": [
            {"name": name, **frame.filter(pl.col("source") == at).select(**_EXTENT).row(0, named=True)}
            for at, name in enumerate(table.sources)
        ],
        "ports": [_port(table, port) for port in frame["port"].unique(maintain_order=True)],
        "motors": [_motor(table, motor) for motor in MOTORS],
    }


def _statuses(frame: pl.DataFrame) -> list[Numbers]:
    return frame.group_by("status").agg(**_EXTENT).to_dicts()


def _port(table: Table, name: str) -> Numbers:
    frame = table.frame
    if frame["port"].n_unique() > 1:
        frame = frame.filter(pl.col("port") == name)
    silence = pl.col("idle_ns").filter(pl.col("idle_ns") > 0)
    until = pl.col("t_ns").filter(pl.col("idle_ns") > 0)
    busy = pl.col("end_ns") - pl.col("t_ns")
    used = frame.group_by("run").agg(
        busy=busy.sum(),
        span=pl.col("end_ns").drop_nulls().last() - pl.col("t_ns").drop_nulls().first(),
    )
    numbers = frame.select(
        **_EXTENT,
        rows_per_s=_rate(pl.col("step_ns")),
        frames=pl.struct(
            **{str(one): (pl.col("direction") == str(one)).sum() for one in Direction}
        ),
        silences=pl.struct(**durations(silence, until)),
    ).row(0, named=True)
    span = used["span"].sum()
    line_use = used["busy"].sum() / span if numbers["rows_per_s"] is not None else None
    return {
        "port": name,
        "baud": table.bauds[name],
        **numbers,
        "line_use": line_use,
        "status": _statuses(frame),
        "faults": list(faults(frame)),
        "events": _events(table, name),
        "streams": list(streams(frame)),
    }


def faults(frame: pl.DataFrame) -> Iterator[Numbers]:
    """The faults that occurred; a row counts for each of its own."""
    own = frame.select("faults", "length", "t_ns").explode("faults").drop_nulls("faults")
    found = own.group_by("faults", maintain_order=True).agg(**_EXTENT)
    total = frame.select(**_EXTENT).row(0, named=True)
    for one in found.iter_rows(named=True):
        yield {
            "fault": one.pop("faults"),
            **one,
            "rows_share": one["rows"] / total["rows"],
            "bytes_share": one["bytes"] / total["bytes"] if total["bytes"] else 0.0,
        }


def streams(frame: pl.DataFrame) -> Iterator[Numbers]:
    """The streams of a port, by kind and motor."""
    period = pl.col("period_ns").filter(pl.col("period_ns") >= 0)
    until = pl.col("t_ns").filter(pl.col("period_ns") >= 0)
    found = (
        frame.group_by("kind", _MOTOR)
        .agg(
            frames=pl.len(),
            frames_per_s=_rate(pl.col("period_ns")),
            period=pl.struct(**durations(period, until)),
            **{f"least {name}": pl.col(name).min() for name in _QUANTITIES},
            **{f"greatest {name}": pl.col(name).max() for name in _QUANTITIES},
        )
        .drop_nulls("kind")
        .sort("kind", _MOTOR)
    )
    for one in found.iter_rows(named=True):
        ranges = {name: (one.pop(f"least {name}"), one.pop(f"greatest {name}")) for name in _QUANTITIES}
        period_ = one["period"]
        known = period_["count"] > 1
        yield {
            **one,
            "jitter_s": period_["p95_s"] - period_["p5_s"] if known else None,
            "values": {name: own for name, own in ranges.items() if own[0] is not None},
        }


def _events(table: Table, port: str) -> list[Numbers]:
    own = [one for one in table.rows.events if one.port == port]
    found: dict[str, Numbers] = {}
    for one in own:
        event = found.setdefault(
            str(one.kind), {"event": str(one.kind), "count": 0, "total": 0, "first_ns": one.t_ns}
        )
        event["count"] += 1
        event["total"] += one.count
        event["last_ns"] = one.t_ns
    return [*found.values()]


def _motor(table: Table, motor: int) -> Numbers:
    answers = table.answers.filter(pl.col("motor") == motor)
    feedback = table.frame.filter(pl.col("direction") == Direction.FEEDBACK, pl.col("kind").is_not_null())
    own = feedback.filter(pl.col(_MOTOR) == motor)
    states = dict(answers.group_by("state").len().iter_rows())
    answered, unanswered = (
        states.get(one, 0) for one in (AnswerState.ANSWERED, AnswerState.UNANSWERED)
    )
    is_covered = bool(answered or unanswered or not states.get(AnswerState.UNCOVERED, 0))
    delays = durations(pl.col("delay_ns"), pl.col("end_ns"))
    return {
        _MOTOR: motor,
        "commands": len(answers),
        "feedback": len(own),
        "answered": answered,
        "unanswered": unanswered if is_covered else None,
        "neither": len(answers) - answered - unanswered,
        "delay": answers.select(**delays).row(0, named=True),
        "error_bits": list(_error_bits(own)),
        "offline": _offline(feedback, motor),
    }


def _error_bits(feedback: pl.DataFrame) -> Iterator[Numbers]:
    for bit in range(8):
        raised = feedback.filter(pl.col(_ERRORS) & (1 << bit) != 0)
        if len(raised):
            yield {"bit": bit, "frames": len(raised), **_span(raised)}


def _offline(feedback: pl.DataFrame, motor: int) -> Numbers:
    """Feedback of any motor that lacks a motor's bit, and how often the bit was lost."""
    mask = 1 << motor_bit(motor)
    online = feedback.select("t_ns", on=pl.col(_ONLINE) & mask != 0)
    lost = online.select((~pl.col("on") & pl.col("on").shift(1)).sum()).item()
    missing = online.filter(~pl.col("on"))
    return {"frames": len(missing), "times_lost": lost, **_span(missing)}


def _span(frame: pl.DataFrame) -> Mapping[str, int | None]:
    return {"first_ns": frame["t_ns"].min(), "last_ns": frame["t_ns"].max()}  # type: ignore[dict-item]
