"""Scores of damage are shares of the frames that are damaged."""

from __future__ import annotations

import pytest

from fte_sniff.protocol.framer.likelihood import (
    MOST_INSERTED,
    change_scores,
    insertion_score,
    truncation_scores,
)

LENGTH = 10


def test_each_sort_of_damage_is_equally_likely() -> None:
    """The sum over all places, bits and lengths of a sort."""
    nothing, flipped, *wider = change_scores(LENGTH)
    assert nothing == 0
    flips = flipped * LENGTH * 8
    changes = sum(score * (LENGTH + 1 - width) for width, score in enumerate(wider, 2))
    insertions = insertion_score(LENGTH) * MOST_INSERTED * (LENGTH - 1)
    # Lost bytes begin at any of the offsets that leave this number of bytes.
    losses = sum(score * (left + 1) for left, score in enumerate(truncation_scores(LENGTH)))
    assert [changes, insertions, losses] == pytest.approx([flips] * 3)
