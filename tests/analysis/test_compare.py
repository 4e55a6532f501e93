"""Compare: changes are named, chance is not, and what cannot be compared is said."""

from __future__ import annotations

import pickle
from functools import cache

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.compare_quality import CHANGES, Host, counts_of, halves, is_found
from fte_sniff.analysis import statistics
from fte_sniff.analysis.compare import MEASURES, Comparison, Number, compared, counted
from fte_sniff.analysis.segments import Counts, added, summed
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Item, Row, Rows, fault_bits
from fte_sniff.protocol.spec import Fault
from tests.analysis.captures import captures, segments, table_of
from tests.analysis.test_segments import tables


@cache
def side(seed: int = 1) -> Rows:
    """Ten minutes of one host; another seed is other chance."""
    return Host(np.random.default_rng(1)).recording(np.random.default_rng(seed))


@cache
def before() -> Counts:
    return counts_of(side())


def after(rows: Rows, *first: Item) -> Comparison:
    """Compare with rows, after what comes before them."""
    return compared(before(), summed(map(counted, segments([*first, rows]))))


def test_other_chance_is_no_change() -> None:
    found = after(side(2))
    assert found.changes == []
    assert found.not_compared == []
    assert {one.measure for one in found.numbers} >= {*MEASURES} - {
        "damage",
        "error_flag",
        "offline",
    }


def test_halves_of_an_hour_are_alike() -> None:
    assert halves(np.random.default_rng(11), 1200).changes == []


@cache
def after_change(name: str) -> Comparison:
    """Compare the host with itself after a change."""
    host = Host(np.random.default_rng(1))
    CHANGES[name][0](host)
    return after(host.recording(np.random.default_rng(3)))


@pytest.mark.parametrize("name", CHANGES)
def test_injected_change_is_named(name: str) -> None:
    _, measure, motor = CHANGES[name]
    found = after_change(name)
    assert is_found(found, measure, motor)
    assert found.changes[0].measure == measure


def changed(**columns: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> Comparison:
    return after(side(2).replace(**columns))


def test_damage_is_named_with_its_fault() -> None:
    rows, rng = side(2), np.random.default_rng(5)
    faults, framed = rows.faults.copy(), rows.framed.copy()
    hit = rng.random(len(rows)) < 0.01
    faults[hit], framed[hit] = fault_bits([Fault.TRUNCATED]), False
    (found, *_) = changed(faults=faults, framed=framed).changes
    assert (found.measure, found.kind, found.before) == ("damage", "truncated", 0)
    assert found.after == pytest.approx(0.01, abs=0.001)
    assert found.text.endswith(" % of the rows are truncated, before 0 %")


def test_flag_of_a_motor_is_named() -> None:
    rows = side(2)
    raw = rows.raw.copy()
    own = (raw[:, 0] == 0x55) & (raw[:, 2] == 2)
    raw[own & (np.random.default_rng(5).random(len(rows)) < 0.02), 7] = 4
    found = changed(raw=raw).changes
    assert ("error_flag", 2) in {(one.measure, one.motor) for one in found}


def test_range_of_values_is_named_where_the_targets_are_the_same() -> None:
    rows = side(2)
    raw = rows.raw.copy()
    own = (raw[:, 0] == 0x55) & (raw[:, 2] == 2)
    raw[own, 3:5] = 0
    (found, *_) = changed(raw=raw).changes
    assert (found.measure, found.motor, found.kind) == ("values", 2, "rpm")
    every = raw.copy()
    every[:, 3:5] = 0
    assert "values" not in {one.measure for one in changed(raw=every).changes}


def test_host_that_rests_is_no_change() -> None:
    rows = side(2)
    t_ns = rows.t_ns.copy()
    t_ns[len(t_ns) // 3 :] += 100 * 10**9
    t_ns[len(t_ns) // 2 :] += 60 * 10**9
    assert [one.measure for one in after(rows.replace(t_ns=t_ns)).changes] == []


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        (side(2).select(side(2).nums != 3), "only the first side has it"),
        (side(2).select(side(2).raw[:, 0] == 0xAA), "speed_feedback 1, speed_feedback 2"),
        (side(2)[:400], "period of speed, speed_feedback: too few"),
        (side(2)[:400], "too few rows; each side needs 160 of each, over 34 s"),
        (side(2).replace(t_ns=np.full(len(side(2)), -(2**63))), "the second side has no rows"),
    ],
)
def test_what_cannot_be_compared_is_named(rows: Rows, text: str) -> None:
    assert any(text in one for one in after(rows).not_compared)


def test_ports_of_other_names_are_compared_if_they_are_the_only_ones() -> None:
    assert after(Rows(side(2).columns, ("other",))).not_compared == []
    two = Rows.concat([side(2), Rows(side(2).columns, ("third",))[:5]])
    found = after(two.select(np.argsort(two.t_ns, kind="stable"))).not_compared
    assert "port third: only the second side has it" in found


def test_selected_rows_are_not_compared() -> None:
    found = after(side(2), Gap(GapKind.SELECTED, reason="motor = 1"))
    assert found.numbers == []
    assert found.not_compared == [
        "the recording has only the rows for which this held: motor = 1",
    ]


@given(captures(), st.integers(1, 12))
def test_counts_of_parts_add_up_to_the_whole(steps: list[Row | Item], most: int) -> None:
    parts = [pickle.loads(pickle.dumps(counted(one))) for one in tables(steps, most)]
    whole = counted(table_of(steps))
    assert counts_by_key(summed(parts)) == counts_by_key(whole)


def counts_by_key(counts: Counts) -> object:
    """Counts in an order of their own, but those of events that later frames decide."""
    later = pl.col("name").str.contains("raised|offline|jump|irregular").not_()
    found = {}
    for name, own in counts.items():
        own = added([own.filter(later) if name == "windows" else own])
        keys = [one for one in own.columns if " " not in one]
        found[name] = (own.sort(keys) if keys else own).select(sorted(own.columns)).to_dicts()
    return found


@given(captures(), captures())
def test_anything_can_be_compared(one: list[Row | Item], other: list[Row | Item]) -> None:
    found = compared(counted(table_of(one)), counted(table_of(other)))
    assert {change.measure for change in found.changes} <= {"findings"}
    assert all(number.text.isprintable() for number in found.numbers)


def test_jitter_is_that_of_the_statistics() -> None:
    counts = summed(map(statistics.counted, segments([side()])))
    (port,) = statistics.statistics(counts)["ports"]
    figures = {(one["kind"], one["motor"]): one["jitter_s"] for one in port["streams"]}
    found = {(one.kind, one.motor): one for one in after(side()).numbers if one.measure == "jitter"}
    assert found.keys() == figures.keys()
    for key, one in found.items():
        assert one.before == one.after == figures[key]


@pytest.mark.parametrize(("last", "others"), [(0.004, "1, 3, 4"), (0.0005, "1, 3")])
def test_motor_that_alone_changes_enough_is_not_named_alone(last: float, others: str) -> None:
    strengths = {0.0041: 0.9, 0.0045: 1.1, 0.0038: 0.8, last: last * 200}
    numbers = [
        Number("unanswered", "", motor, None, 0.0003, share, f"motor {motor} ...", strength, 1.0)
        for motor, (share, strength) in enumerate(strengths.items(), 1)
    ]
    assert [one.motor for one in numbers if one.score] == [2]
    (change,) = Comparison(numbers, []).changes
    assert (change.motor, change.text) == (None, f"motor 2 ...; likewise motors {others}")


def test_three_motors_that_change_alike_are_one_change() -> None:
    delays = [one for one in after_change("answers 20 % slower").changes if one.measure == "delay"]
    assert [one.motor for one in delays] == [None]
    named, _, others = delays[0].text.partition("; likewise motors ")
    assert named.startswith("answers to speed "), "its motor is named"
    assert len(others.split(", ")) == 3
