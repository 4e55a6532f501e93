"""Rows as columns are the rows one by one."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol.rows import (
    MOST_BYTES,
    NO_KIND,
    Row,
    Rows,
    fault_bits,
    faults_in,
)
from fte_sniff.protocol.spec import KINDS, MOTORS, VALUE_FIELDS, Direction, Fault, Status, encode
from tests.support.columns import rows_from

SPEED = encode(KINDS[1], {"motor": 1, "rpm": -1000})

known = st.none() | st.integers(0, 2**31 - 1)
frames = st.sampled_from(KINDS).flatmap(
    lambda kind: st.fixed_dictionaries(
        {field.name: st.integers(field.low, field.high) for field in kind.fields}
    ).map(lambda values: encode(kind, values))
)
faults = st.sets(st.sampled_from(Fault)).map(lambda found: faults_in(fault_bits(found)))


def rows_of(raw: st.SearchStrategy[bytes], *, framed: bool) -> st.SearchStrategy[Row]:
    return st.builds(
        Row,
        port=st.sampled_from(["a", "b", "電機"]),
        offset=st.integers(0, 2**62),
        raw=raw,
        t_ns=known,
        faults=faults,
        framed=st.just(framed),
        delay_ns=known,
        unordered=st.booleans(),
        answer_ns=known,
        unanswered=st.none() | st.booleans(),
        motor_hint=st.none() | st.sampled_from(MOTORS),
        previous=known,
    )


single_rows = rows_of(frames, framed=True) | rows_of(
    st.binary(min_size=1, max_size=MOST_BYTES), framed=False
)
many_rows = st.lists(single_rows, max_size=20)


def facts(row: Row) -> tuple[object, ...]:
    """What `==` of rows does not compare."""
    return (
        row.delay_ns, row.unordered, row.answer_ns, row.unanswered, row.motor_hint, row.previous
    )  # fmt: skip


def same(found: Rows, expected: list[Row]) -> bool:
    return list(found) == expected and [*map(facts, found)] == [*map(facts, expected)]


@given(many_rows)
def test_columns_and_single_rows_are_the_same(rows: list[Row]) -> None:
    assert same(rows_from(rows), rows)
    assert same(pickle.loads(pickle.dumps(rows_from(rows))), rows)


@given(st.lists(many_rows, max_size=4))
def test_concatenated_rows_keep_order_and_ports(parts: list[list[Row]]) -> None:
    every = [row for part in parts for row in part]
    found = Rows.concat([rows_from(part) for part in parts])
    assert same(found, every)
    assert set(found.used_ports) == {row.port for row in every}
    assert found.tobytes() == b"".join(row.raw for row in every)


@given(many_rows, st.slices(20), st.data())
def test_chosen_rows_are_those_of_a_list(rows: list[Row], part: slice, data: st.DataObject) -> None:
    columns = rows_from(rows)
    assert same(columns[part], rows[part])
    mask = data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows)))
    chosen = columns.select(np.array(mask, np.bool_))
    assert same(chosen, [row for row, kept in zip(rows, mask, strict=True) if kept])
    if rows:
        at = data.draw(st.integers(-len(rows), len(rows) - 1))
        assert columns[at] == rows[at]


@given(many_rows)
def test_columns_of_meaning_follow_the_single_rows(rows: list[Row]) -> None:
    columns = rows_from(rows)
    kinds = [NO_KIND if row.kind is None else KINDS.index(row.kind) for row in rows]
    words = [*Direction, None]
    assert columns.kinds.tolist() == kinds
    assert [words[code] for code in columns.directions.tolist()] == [row.direction for row in rows]
    assert [[*Status][code] for code in columns.statuses.tolist()] == [row.status for row in rows]
    assert columns.is_malformed.tolist() == [row.status is Status.MALFORMED for row in rows]
    raised = [row.kind is not None and row.kind.raised(row.raw) for row in rows]
    assert columns.raised().tolist() == raised
    for field in VALUE_FIELDS:
        values, has = columns.field(field.name)
        found = [int(value) if own else None for value, own in zip(values, has, strict=True)]
        assert found == [row.values.get(field.name) for row in rows]


@given(st.lists(rows_of(frames, framed=True), min_size=1, max_size=10))
def test_previous_field_is_read_from_the_payload_before(rows: list[Row]) -> None:
    columns = rows_from(rows)
    before = columns.replace(previous=columns.payloads)
    for field in VALUE_FIELDS:
        if field.name != "motor":
            values, has = before.previous_field(field.name)
            own, own_has = columns.field(field.name)
            assert (has == own_has).all()
            assert (values == own).all()
    assert not columns.replace(previous=np.full(len(rows), -1)).previous_field("rpm")[1].any()


def test_blank_rows_check_their_columns() -> None:
    assert Rows.blank(2, t_ns=[1, 2])[1].t_ns == 2
    with pytest.raises(KeyError):
        Rows.blank(1, colour=[1])
    with pytest.raises(ValueError, match="offset has the shape"):
        Rows.blank(2, offset=[1])
    with pytest.raises(ValueError, match="not in"):
        rows_from([Row("a", 0, b"1", None)]).with_ports(("b",))
