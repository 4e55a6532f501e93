"""Owns the last few of many numbers, and what they say together.

It must not know what the numbers are.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

MOST: Final = 256
"""Numbers kept where nobody says otherwise."""

RATE_OVER_NS: Final = 2_000_000_000
"""How far back a rate looks, nanoseconds."""


class Recent:
    """The latest `most` of the numbers added, in the order in which they came."""

    def __init__(self, most: int = MOST) -> None:
        """`most` is at least 1."""
        self._most = most
        self.values: npt.NDArray[np.int64] = np.empty(0, np.int64)
        """The numbers kept, the latest last; never written in place, so copies may share it."""

    def add(self, values: npt.NDArray[np.int64]) -> None:
        """These came."""
        if len(values):
            kept = np.concatenate((self.values, values[-self._most :]))
            self.values = kept[-self._most :]

    def percentile(self, percent: float) -> int | None:
        """The least number kept that so many percent (0 to 100) do not exceed; None without any."""
        if not len(self.values):
            return None
        return int(np.percentile(self.values, percent, method="inverted_cdf"))

    def per_second(self, now_ns: int) -> float | None:
        """Where the numbers are times: how many a second came lately; None where none ever came.

        It looks back two seconds from `now_ns`, or as far as the numbers kept reach; 0 says that
        what came before has stopped.
        """
        times = self.values
        if not len(times):
            return None
        late = times[times > now_ns - RATE_OVER_NS]
        if len(late) == len(times):
            # The window begins before the first of them: they alone say how far apart they come.
            span = int(late[-1] - late[0])
            return (len(late) - 1) * 1e9 / span if span > 0 else None
        return len(late) * 1e9 / RATE_OVER_NS
