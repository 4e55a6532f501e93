"""The bulk path: the same rows as the framer gives, as columns."""

from __future__ import annotations

import pytest

from benchmarks.bulk import bulk_columns
from benchmarks.faults import damaged_stream
from fte_sniff.analysis.fields import NO_KIND
from fte_sniff.protocol import KINDS, VALUE_FIELDS, Chunk, Frame, Framer


@pytest.mark.parametrize(
    ("share", "payload"), [(0.0, "ordinary"), (0.01, "ordinary"), (0.2, "hostile")]
)
def test_columns_are_the_rows(share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 3000, share, payload)
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
    columns = bulk_columns("p", stream)
    assert columns.offset.tolist() == [row.offset for row in rows]
    assert columns.length.tolist() == [len(row.raw) for row in rows]
    assert columns.framed.tolist() == [isinstance(row, Frame) for row in rows]
    assert [columns.fault_sets[code] for code in columns.faults] == [row.faults for row in rows]
    kinds = [row.kind if isinstance(row, Frame) else None for row in rows]
    assert columns.kind.tolist() == [KINDS.index(k) if k else NO_KIND for k in kinds]
    for field in VALUE_FIELDS:
        known, values = columns.known(field.name), columns.values[field.name]
        expected = [row.values.get(field.name) if isinstance(row, Frame) else None for row in rows]
        got = [int(v) if k else None for v, k in zip(values, known, strict=True)]
        assert got == expected


def test_no_bytes_give_no_rows() -> None:
    columns = bulk_columns("p", b"")
    assert len(columns.kind) == len(columns.offset) == 0
