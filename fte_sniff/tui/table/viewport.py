"""Visible range, cursor, marks."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator


class Viewport:
    """A window of `height` rows onto `count` of them, that follows the end until told otherwise.

    Rows are named by their position among those shown; `refit` tells when positions change.
    """

    def __init__(self) -> None:
        self.count = 0
        """Rows that can be looked at."""
        self.height = 0
        """Rows that fit into the window."""
        self.top = 0
        """The first row in the window."""
        self.cursor = 0
        """The row under the cursor; 0 where there is none."""
        self.following = True
        """Whether the window stays at the end as rows come."""
        self.paused = False
        """Whether rows that come stay out of the window."""
        self.waiting = 0
        """Rows that came since the pause began."""

    @property
    def last_top(self) -> int:
        """The greatest `top`: the window then ends with the last row."""
        return max(0, self.count - max(1, self.height))

    @property
    def below(self) -> int:
        """Rows behind the end of the window."""
        return max(0, self.count - self.top - self.height)

    def refit(self, count: int, cursor: int, waiting: int) -> None:
        """Rows came, left, or were filtered; the cursor's row has the position `cursor` now.

        The window moves along with that row, unless it follows the end.
        """
        self.top += cursor - self.cursor
        self.count, self.cursor, self.waiting = count, cursor, waiting
        self._settle()

    def resize(self, height: int) -> None:
        """The window has another height now; the cursor stays in it."""
        self.height = max(0, height)
        self._settle()
        self._reveal()

    def move(self, by: int) -> None:
        """Move the cursor; up leaves the end, down onto the last row follows it again."""
        target = self.cursor + by
        self.following = by > 0 and target >= self.count - 1 and not self.paused
        self._put(target)

    def jump(self, row: int) -> None:
        """Put the cursor on a row, in the middle of the window where it was out of sight."""
        self.following = False
        self._put(row)

    def scroll(self, top: int) -> None:
        """The window was moved by hand; the cursor comes along only as far as it must."""
        self.top = min(max(0, top), self.last_top)
        self.following = self.top >= self.last_top and not self.paused
        self.cursor = min(max(self.cursor, self.top), max(self.top, self.top + self.height - 1))
        self._settle()

    def follow(self) -> None:
        """Go to the end and stay there; ends a pause."""
        self.paused = False
        self.following = True
        self._settle()

    def _put(self, cursor: int) -> None:
        outside = not self.top <= cursor < self.top + self.height
        far = abs(cursor - self.cursor) > self.height
        self.cursor = cursor
        if outside and far:
            self.top = cursor - self.height // 2
        self._settle()
        self._reveal()

    def _settle(self) -> None:
        last = max(0, self.count - 1)
        if self.following and not self.paused:
            self.cursor, self.top = last, self.last_top
        self.cursor = min(max(0, self.cursor), last)
        self.top = min(max(0, self.top), self.last_top)

    def _reveal(self) -> None:
        lowest = self.cursor - max(1, self.height) + 1
        self.top = min(max(self.top, lowest, 0), self.cursor)


class RowMarks:
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
