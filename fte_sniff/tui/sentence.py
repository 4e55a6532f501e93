"""Owns how a sentence stands in few lines: wrapped, and where it is too long, short of its middle.

It must not know what is said. What it is about stands at a sentence's start, and the way out at its
end; both are kept.
"""

from __future__ import annotations

import re

from rich.text import Text
from textual.geometry import Size
from textual.widget import Widget

from fte_sniff.tui.fitting import ELLIPSIS, fit_path, wrap

_PATH = re.compile(r"[!-~]*/[!-~]+")
_LONG_WORD = 12
"""Characters of a word that may be cut apart."""

_SHORTEST_PATH = 16
"""Cells that a path is left with."""


def in_lines(text: str, width: int, most: int) -> list[str]:
    """The text in at most `most` lines of `width` cells: paths give way first, then its middle."""
    text = text.strip()
    lines = wrap(text, width)
    if len(lines) <= 1:
        return lines
    for room in (width, max(_SHORTEST_PATH, width * most // 3)):
        text = _with_short_paths(text, room)
        if len(lines := wrap(text, width)) <= most:
            return lines
    kept = len(text)
    while len(lines := wrap(_without_middle(text, kept), width)) > most and kept > 2:
        kept -= 1
    return lines[:most]


def _with_short_paths(text: str, room: int) -> str:
    return _PATH.sub(lambda path: fit_path(path[0], room), text)


def _without_middle(text: str, kept: int) -> str:
    """The text short of its middle, so many characters of it; between words, where they are short.

    The way out needs more words than what it is about.
    """
    if kept >= len(text):
        return text
    end = max(1, kept * 3 // 5)
    head, tail = text[: max(1, kept - end)], text[len(text) - end :]
    if len(head) - _LONG_WORD < head.rfind(" "):
        head = head[: head.rfind(" ")]
    if -1 < tail.find(" ") < _LONG_WORD:
        tail = tail[tail.find(" ") :]
    return f"{head.rstrip()} {ELLIPSIS} {tail.lstrip()}"


class Sentence(Widget):
    """A sign and a sentence behind it, in as many lines as there are."""

    def __init__(self, most: int = 0, classes: str | None = None) -> None:
        """`most` is how many lines it takes where its height is left to it."""
        super().__init__(classes=classes)
        self.most = most
        self._sign, self._words = "", ""

    def say(self, sign: str, words: str) -> None:
        """Show this from now on; `words` have no control characters."""
        if (sign, words) != (self._sign, self._words):
            self._sign, self._words = sign, words
            self.refresh(layout=True)

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """As many lines as the sentence needs, up to the most."""
        return max(1, len(self._lines(width, self.most)))

    def _lines(self, width: int, most: int) -> list[str]:
        return in_lines(self._words, max(1, width - len(self._sign) - 1), max(1, most))

    def render(self) -> Text:
        """The lines, all behind the sign."""
        indent = "\n" + " " * (len(self._sign) + 1)
        lines = self._lines(self.size.width, self.size.height)
        return Text(f"{self._sign} {indent.join(lines)}", no_wrap=True, overflow="crop")
