"""Owns the rows that the user marked, and the way from one to the next.

It must not know what a row is: rows are their indices in a store, which never change.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator


class Marks:
    """Indices of marked rows."""

    def __init__(self) -> None:
        self._rising: list[int] = []
        self._latest: list[int] = []

    def __contains__(self, index: int) -> bool:
        at = bisect_left(self._rising, index)
        return at < len(self._rising) and self._rising[at] == index

    def __len__(self) -> int:
        return len(self._rising)

    @property
    def latest(self) -> int | None:
        """The mark that was set last, of those that are left."""
        return self._latest[-1] if self._latest else None

    def toggle(self, index: int) -> bool:
        """Set a mark, or take it away; whether it is set now."""
        if index in self:
            self._rising.remove(index)
            self._latest.remove(index)
            return False
        insort(self._rising, index)
        self._latest.append(index)
        return True

    def forget_before(self, first: int) -> None:
        """Rows before that index have left, and their marks with them."""
        if self._rising and self._rising[0] < first:
            self._rising = self._rising[bisect_left(self._rising, first) :]
            self._latest = [index for index in self._latest if index >= first]

    def beyond(self, index: int, by: int) -> Iterator[int]:
        """The marks behind an index, the nearest first; those before it where `by` is below 0."""
        if by > 0:
            yield from self._rising[bisect_right(self._rising, index) :]
        else:
            yield from reversed(self._rising[: bisect_left(self._rising, index)])
