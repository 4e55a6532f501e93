"""The cost of work, by comparison: twice the input may not cost much more than twice as much.

Processor time is compared within one process, and only with itself: what a machine takes for
anything does not concern a test. The best of some runs counts, because a busy machine only adds.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import process_time

_MEASURABLE_S = 0.02
_ATTEMPTS = 8


def _cost_s(work: Callable[[], object]) -> float:
    """Processor time of a call, repeated until it can be measured."""
    calls = 1
    while True:
        start = process_time()
        for _ in range(calls):
            work()
        taken_s = process_time() - start
        if taken_s >= _MEASURABLE_S:
            return taken_s / calls
        calls *= 4


def grows_linearly(
    half: Callable[[], object], whole: Callable[[], object], most: float = 2.5
) -> bool:
    """Whether work on the whole input costs at most `most` times that on half of it."""
    half_s = whole_s = inf
    for _ in range(_ATTEMPTS):
        half_s, whole_s = min(half_s, _cost_s(half)), min(whole_s, _cost_s(whole))
        if whole_s <= most * half_s:
            return True
    return False
