"""The window onto the shown rows: its place, the cursor, and whether the end is followed."""

from __future__ import annotations


class Viewport:
    """A window of `height` rows onto `count` rows, which follows the end at first.

    Rows are positions among those shown.
    """

    def __init__(self) -> None:
        self.count = 0
        """Rows that can be shown."""
        self.height = 0
        self.top = 0
        self.cursor = 0
        """The row under the cursor; 0 without rows."""
        self.following = True
        """Whether the window stays at the end when rows come."""

    @property
    def last_top(self) -> int:
        """The greatest `top`, at which the window ends with the last row."""
        return max(0, self.count - max(1, self.height))

    @property
    def below(self) -> int:
        """Rows below the window."""
        return max(0, self.count - self.top - self.height)

    def refit(self, count: int, cursor: int) -> None:
        """Update to the number of rows now, and the cursor's new position.

        The window moves with the cursor's row, unless it follows the end.
        """
        self.top += cursor - self.cursor
        self.count, self.cursor = count, cursor
        self._clamp()

    def resize(self, height: int) -> None:
        """Change the height; the cursor stays in the window."""
        self.height = max(0, height)
        self._clamp()
        self._reveal()

    def move(self, by: int) -> None:
        """Move the cursor; up stops following the end, down onto the last row follows it again."""
        target = self.cursor + by
        self.following = by > 0 and target >= self.count - 1
        self._put(target)

    def jump(self, row: int) -> None:
        """Put the cursor on a row; a far one is shown in the middle of the window."""
        self.following = False
        self._put(row)

    def scroll(self, top: int) -> None:
        """Scroll the window; the cursor moves only as far as it has to."""
        self.top = min(max(0, top), self.last_top)
        self.following = self.top >= self.last_top
        self.cursor = min(max(self.cursor, self.top), max(self.top, self.top + self.height - 1))
        self._clamp()

    def follow(self) -> None:
        """Follow the end."""
        self.following = True
        self._clamp()

    def _put(self, cursor: int) -> None:
        outside = not self.top <= cursor < self.top + self.height
        far = abs(cursor - self.cursor) > self.height
        self.cursor = cursor
        if outside and far:
            self.top = cursor - self.height // 2
        self._clamp()
        self._reveal()

    def _clamp(self) -> None:
        last = max(0, self.count - 1)
        if self.following:
            self.cursor, self.top = last, self.last_top
        self.cursor = min(max(0, self.cursor), last)
        self.top = min(max(0, self.top), self.last_top)

    def _reveal(self) -> None:
        lowest = self.cursor - max(1, self.height) + 1
        self.top = min(max(self.top, lowest, 0), self.cursor)
