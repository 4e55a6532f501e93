"""Owns the lines that were given to a field before, and the way through them.

It must not know what they mean.
"""

from __future__ import annotations


class History:
    """Lines, the newest last; going up starts from the line that is being typed."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._at = 0
        self._typed = ""

    def add(self, line: str) -> None:
        """Keep a line that was given; the same line again moves to the end."""
        if line in self._lines:
            self._lines.remove(line)
        if line:
            self._lines.append(line)
        self._at = len(self._lines)

    def go(self, by: int, typed: str) -> str:
        """The line `by` steps newer (or older, below 0) than the one that stands there now."""
        if self._at == len(self._lines):
            self._typed = typed
        self._at = min(max(0, self._at + by), len(self._lines))
        return self._typed if self._at == len(self._lines) else self._lines[self._at]
