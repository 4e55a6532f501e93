"""The labels of values in the table of the screen."""

from __future__ import annotations

import pytest

from fte_sniff.protocol import KINDS, FrameKind
from fte_sniff.tui.cells import value_heads


@pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])
def test_labels_of_values_differ_also_where_they_are_as_short_as_possible(kind: FrameKind) -> None:
    *forms, short, _ = value_heads(kind)
    assert all(len({*labels}) == len(kind.fields) for labels in (*forms, short))
    names = [field.option for field in kind.fields]
    for field, label in zip(kind.fields, short, strict=True):
        if field.unit:
            prefix = label.removesuffix("=")
            assert [name for name in names if name.startswith(prefix)] == [field.option]
            assert sum(name.startswith(prefix[:-1]) for name in names) > 1
