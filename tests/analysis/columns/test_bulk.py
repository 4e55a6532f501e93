"""The columns of a damaged stream: the same values as those of the framer's rows."""

from __future__ import annotations

import pytest

from benchmarks.faults import damaged_stream
from fte_sniff.analysis.fields import NO_KIND, field_values, kind_codes
from fte_sniff.protocol import KINDS, VALUE_FIELDS, Chunk, Frame, Framer
from fte_sniff.row_batch import RowBatch


def batch_of(data: bytes) -> RowBatch:
    framer = Framer("p")
    framer.push(Chunk("p", None, data))
    framer.finish()
    return RowBatch.from_span(framer.drain())


@pytest.mark.parametrize(
    ("share", "payload"), [(0.0, "ordinary"), (0.01, "ordinary"), (0.2, "hostile")]
)
def test_columns_are_the_rows(share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 3000, share, payload)
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
    batch = batch_of(stream)
    assert batch.offset.tolist() == [row.offset for row in rows]
    assert batch.length.tolist() == [len(row.raw) for row in rows]
    assert batch.framed.tolist() == [isinstance(row, Frame) for row in rows]
    assert [batch.codebook.faults[code] for code in batch.faults] == [row.faults for row in rows]
    kind_of_row = kind_codes(batch.raw, batch.framed)
    kinds = [row.kind if isinstance(row, Frame) else None for row in rows]
    assert kind_of_row.tolist() == [KINDS.index(k) if k else NO_KIND for k in kinds]
    for field in VALUE_FIELDS:
        values, known = field_values(batch.raw, kind_of_row, field.name)
        expected = [row.values.get(field.name) if isinstance(row, Frame) else None for row in rows]
        got = [int(v) if k else None for v, k in zip(values, known, strict=True)]
        assert got == expected


def test_no_bytes_give_no_rows() -> None:
    assert len(batch_of(b"")) == 0
