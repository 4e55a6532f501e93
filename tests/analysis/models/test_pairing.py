"""Which feedback answers which command, against the rule done by hand."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.fields import NO_TIME
from fte_sniff.analysis.motors import Pairing, PendingCommands

COMMAND, FEEDBACK = True, False
EVENTS = st.lists(
    st.tuples(st.sampled_from([COMMAND, FEEDBACK]), st.sampled_from([0, 1, 1, 2, 3, 9])),
    max_size=40,
)


def add(pairing: Pairing, events: list[tuple[bool, int]], begin: int = 0) -> None:
    """Events one time unit apart."""

    def moments(side: bool) -> PendingCommands:
        places = [place for place, (kind, _) in enumerate(events) if kind is side]
        cmds = [events[place][1] for place in places]
        times = [begin + place for place in places]
        return PendingCommands(*(np.array(part, np.int64) for part in (places, cmds, times)))

    pairing.add(moments(COMMAND), moments(FEEDBACK))


def by_hand(events: list[tuple[bool, int]]) -> tuple[list[int], int, bool]:
    """The delays of what is answered, how many are not, and whether the last one waits."""
    delays: list[int] = []
    unanswered = 0
    asked: tuple[int, int] | None = None
    for at, (side, cmd) in enumerate(events):
        if side is COMMAND:
            unanswered += asked is not None
            asked = (cmd, at) if cmd in (1, 2, 3) else None
        elif asked is not None and asked[0] == cmd:
            delays.append(at - asked[1])
            asked = None
    return delays, unanswered, asked is not None


@given(EVENTS, st.lists(st.integers(0, 40), max_size=4))
def test_batches_of_any_size_give_what_the_rule_says(
    events: list[tuple[bool, int]], cuts: list[int]
) -> None:
    pairing = Pairing()
    edges = [0, *sorted(min(cut, len(events)) for cut in cuts), len(events)]
    for start, end in pairwise(edges):
        add(pairing, events[start:end], begin=start)
    delays, unanswered, waits = by_hand(events)
    assert pairing.delays.values.tolist() == delays
    assert (pairing.answered, pairing.unanswered) == (len(delays), unanswered)
    assert pairing.waiting is waits
    asked = sum(side is COMMAND and cmd in (1, 2, 3) for side, cmd in events)
    assert pairing.answered + pairing.unanswered + pairing.waiting == asked


def test_pairs_without_times_are_counted_and_not_measured() -> None:
    pairing = Pairing()
    one = np.array([0]), np.array([1]), np.array([NO_TIME])
    other = np.array([1]), np.array([1]), np.array([NO_TIME])
    pairing.add(PendingCommands(*one), PendingCommands(*other))
    assert pairing.answered == 1
    assert pairing.delays.percentile(50) is None
    pairing.add(PendingCommands(*one), PendingCommands(*(part[:0] for part in other)))
    assert pairing.waiting
    assert pairing.waiting_since_ns is None
