"""Statistics are those of a plain count with polars, whole or in parts."""

from __future__ import annotations

import pickle
from typing import Any

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.check import RuleResult, parse_rule, verdict
from fte_sniff.analysis.check import counted as counted_rules
from fte_sniff.analysis.segments import summed
from fte_sniff.analysis.statistics import counted, statistics
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import _LAYOUTS, Item, Row
from fte_sniff.protocol.spec import KINDS, Direction, Fault, Status
from tests.analysis.captures import MS, START, captures, frame, polled, table_of
from tests.analysis.test_segments import tables
from tests.examples import examples


def stats_of(steps: list[Row | Item]) -> dict[str, Any]:
    """The statistics of one table."""
    return by_port(statistics(summed([counted(table_of(steps))])))


def by_port(found: dict[str, Any]) -> dict[str, Any]:
    """The statistics with the ports in the order of their names."""
    return {**found, "ports": sorted(found["ports"], key=lambda one: one["port"])}


def test_only_errors_and_bytes_of_events_add_up() -> None:
    counts = {
        PortEventKind.OVERRUN: 12,
        PortEventKind.SILENT: 2000,
        PortEventKind.BAUD_CHANGED: 9600,
    }
    row = polled(1)[0]
    events = [PortEvent(START, row.port, kind, "", count) for kind, count in counts.items()]
    (port,) = stats_of([row, *events])["ports"]
    totals = {one["event"]: one["total"] for one in port["events"]}
    assert totals == {"overrun": 12, "silent": None, "baud_changed": None}


@given(captures(), st.integers(1, 12))
def test_parts_add_up_to_the_whole(steps: list[Row | Item], most: int) -> None:
    parts = [pickle.loads(pickle.dumps(counted(one))) for one in tables(steps, most)]
    assert by_port(statistics(summed(parts))) == stats_of(steps)


def oracle(steps: list[Row | Item]) -> pl.DataFrame:
    """The rows of one run after the other, with plain columns."""
    found, run = [], 0
    for step in steps:
        if isinstance(step, Row):
            motor = step.values.get("motor")
            found.append(
                {
                    "run": run, "port": step.port, "t": step.t_ns, "size": len(step.raw),
                    "kind": step.kind and step.kind.name, "motor": motor,
                    "direction": step.direction, "status": step.status,
                    "faults": [*step.faults], "rpm": step.values.get("rpm"),
                    "error": step.values.get("error"), "online": step.values.get("online"),
                }
            )  # fmt: skip
        elif isinstance(step, Gap):
            run += 1
    schema: dict[str, Any] = dict.fromkeys(("t", "motor", "rpm", "error", "online"), pl.Int64)
    schema["faults"] = pl.List(pl.String)
    frame = pl.DataFrame(found, schema_overrides=schema, infer_schema_length=None)
    return frame.with_columns(
        period=pl.col("t") - pl.col("t").shift().over("run", "port", "kind", "motor"),
        step=pl.col("t") - pl.col("t").shift().over("run", "port"),
    )


@examples(100)
@given(captures())
def test_numbers_equal_a_plain_count(steps: list[Row | Item]) -> None:
    found = stats_of(steps)
    if not any(isinstance(step, Row) for step in steps):
        assert (found["rows"], found["first_time"], found["duration_s"]) == (0, None, None)
        return
    plain = oracle(steps)
    first, last = plain["t"].min(), plain["t"].max()
    assert (found["rows"], found["bytes"]) == (len(plain), plain["size"].sum())
    assert found["first_time"] == (None if first is None else iso_time(first))  # type: ignore[arg-type]
    assert found["last_time"] == (None if last is None else iso_time(last))  # type: ignore[arg-type]
    for status in Status:
        assert found["status"][status]["rows"] == len(plain.filter(status=status))
    for port in found["ports"]:
        check_port(port, plain.filter(port=port["port"]))
    for motor in found["motors"]:
        check_flags(motor, plain.filter(direction=Direction.FEEDBACK))


def check_port(port: dict[str, Any], plain: pl.DataFrame) -> None:
    """Compare a port with its rows."""
    assert port["rows"] == len(plain)
    for direction in Direction:
        assert port["frames"][direction] == len(plain.filter(direction=direction))
    steps = plain["step"].drop_nulls()
    expected = len(steps) * 1e9 / steps.sum() if steps.sum() > 0 else None
    assert port["rows_per_s"] == (None if expected is None else pytest.approx(expected))
    noise = len(plain.filter(pl.col("faults").list.contains("noise")))
    assert sum(one["rows"] for one in port["faults"] if one["fault"] == Fault.NOISE) == noise
    kinds = {(one["kind"], one["motor"]): one for one in port["streams"]}
    streams = plain.drop_nulls("kind").partition_by("kind", "motor", as_dict=True)
    assert kinds.keys() == streams.keys()
    for key, own in streams.items():
        one, periods = kinds[key], own["period"].drop_nulls()
        assert one["frames"] == len(own)
        rising = periods.filter(periods >= 0)
        for percent in (50, 95, 99):
            exact = rising.quantile(percent / 100, "equiprobable")
            value = None if exact is None else pytest.approx(exact / 1e9, rel=5e-4)
            assert one["period"][f"p{percent}_s"] == value
        longest = rising.max()
        assert one["period"]["longest_s"] == (None if longest is None else longest / 1e9)  # type: ignore[operator]
        if own["rpm"].count():
            ends = {"least": own["rpm"].min(), "greatest": own["rpm"].max()}
            assert one["values"]["rpm"] == ends


def check_flags(motor: dict[str, Any], feedback: pl.DataFrame) -> None:
    """Compare what a motor reports with its feedback."""
    own, bit = feedback.filter(motor=motor["motor"]), 1 << (motor["motor"] - 1)
    assert motor["feedback"] == len(own)
    raised = {at: len(own.filter(pl.col("error") & (1 << at) != 0)) for at in range(8)}
    assert {one["bit"]: one["frames"] for one in motor["error_bits"]} == {
        at: frames for at, frames in raised.items() if frames
    }
    off = feedback["online"] & bit == 0 if len(feedback) else pl.Series([], dtype=pl.Boolean)
    assert motor["offline"]["frames"] == off.sum()
    assert motor["offline"]["times_lost"] == (off & ~off.shift(1)).sum()


def test_numbers_of_a_healthy_line() -> None:
    found = stats_of([*polled(100)])
    (port,) = found["ports"]
    stream = next(one for one in port["streams"] if one["motor"] == 2)
    assert stream["frames_per_s"] == pytest.approx(20)
    assert stream["period"]["p50_s"] == pytest.approx(0.05, rel=5e-4)
    assert stream["jitter_s"] == pytest.approx(0, abs=1e-9)
    assert stream["values"] == {"rpm": {"least": 100, "greatest": 100}}
    assert port["line_use"] == pytest.approx(800 * 10 / 11520 / 5, rel=0.01)
    motor = found["motors"][1]
    assert [motor[name] for name in ("commands", "answered", "unanswered", "neither")] == [
        *(100, 100, 0, 0)
    ]
    assert motor["delay"]["p50_s"] == pytest.approx(0.003, rel=5e-4)
    assert motor["delay"]["longest_until"] == iso_time(START + int(15.5 * MS))


def test_silence_begins_at_the_end_of_a_row() -> None:
    found = stats_of([frame("speed", 0), frame("speed", 10)])["ports"][0]["silences"]
    assert found["count"] == 1
    assert found["longest_s"] == pytest.approx(0.01 - 10 * 10 / 115_200)
    assert found["longest_until"] == iso_time(START + 10 * MS)


def test_answers_that_cannot_be_known_are_null() -> None:
    only_commands = [row for row in polled(10) if row.direction is Direction.CONTROL]
    motor = stats_of([*only_commands])["motors"][0]
    assert (motor["answered"], motor["unanswered"], motor["neither"]) == (0, None, 10)
    motor = stats_of([Gap(GapKind.SELECTED, reason="x"), *polled(10)])["motors"][0]
    names = ("answered", "unanswered", "neither")
    assert [motor[name] for name in names] == [None] * 3
    assert set(motor["delay"].values()) == {None}


def test_inputs_that_overlap_in_time_have_no_answers() -> None:
    parts = [counted(table_of([*polled(10)])) for _ in range(2)]
    other = {
        name: own.with_columns(source=pl.col("source") + "2")
        for name, own in parts[1].items()
        if "source" in own.columns
    }
    found = statistics(summed([parts[0], {**parts[1], **other}]))
    assert [one["rows"] for one in found["files"] if one["name"] != "2"] == [80, 80]
    assert found["motors"][0]["answered"] is None
    assert found["motors"][0]["commands"] == 20


@pytest.fixture
def _one_kind_without_online(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let feedback of positions have no ONLINE."""
    code = [kind.name for kind in KINDS].index("position_feedback")
    layouts = [(*one, having.copy()) for *one, having in _LAYOUTS["online"]]
    for *_, having in layouts:
        having[code] = False
    monkeypatch.setitem(_LAYOUTS, "online", layouts)


@pytest.mark.usefixtures("_one_kind_without_online")
def test_feedback_without_online_is_not_offline() -> None:
    rows = [frame("speed_feedback", 0), frame("position_feedback", 10)]
    motor = stats_of([*rows, frame("speed_feedback", 20, online=0x0E)])["motors"][0]
    assert motor["feedback"] == 3
    assert (motor["offline"]["frames"], motor["offline"]["times_lost"]) == (1, 1)
    table = table_of([*rows])
    found = verdict(ONLINE, counted_rules(table, [ONLINE]))
    assert (found.result, found.value) == (RuleResult.PASS, 1.0)


ONLINE = parse_rule("online(1) == 1")
