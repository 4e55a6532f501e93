"""Owns the bottom line of numbers: rows, rate, malformed share, and the place in the rows.

It must not know where the numbers come from. Numbers have widths of their own, so that the line
stands still while they run.
"""

from __future__ import annotations

from dataclasses import dataclass

from rich.text import Text
from textual.widget import Widget

from fte_sniff.tui.fitting import fit


@dataclass(frozen=True, slots=True)
class Numbers:
    """What the bottom line tells."""

    rows: int
    """All rows that came."""
    frames_per_s: float
    malformed: int
    """Malformed rows among those that reached the view."""
    malformed_share: float
    """Their share, 0 to 1."""
    not_shown: int
    """Rows that came too fast for the view."""
    place: int
    """The cursor's row among those shown, from 1; 0 where there is none."""
    following: bool
    below: int
    """Rows behind the end of the window."""


def status_text(numbers: Numbers, width: int) -> str:
    """The line in exactly `width` cells; where it is narrow, the last parts are left out first."""
    behind = "" if numbers.following else f", {numbers.below:,} below"
    place = f"row {numbers.place:,}{behind}" if numbers.place else "no row shown"
    parts = [
        f"{numbers.rows:>9,} rows",
        f"{numbers.frames_per_s:>6,.0f} frames/s",
        f"{numbers.malformed:>6,} malformed {_share(numbers):>6}",
        place,
    ]
    if numbers.not_shown:
        parts.insert(3, f"{numbers.not_shown:,} too fast to show")
    line = parts[0]
    for part in parts[1:]:
        if len(line) + len(part) + 2 > width:
            break
        line += "  " + part
    return fit(line, width)


def _share(numbers: Numbers) -> str:
    share = numbers.malformed_share
    return "<0.01%" if 0 < share < 0.0001 else f"{share:.2%}" if share < 1 else "100%"


class StatusLine(Widget):
    """The bottom line."""

    def __init__(self) -> None:
        super().__init__()
        self._numbers: Numbers | None = None

    def show(self, numbers: Numbers) -> None:
        """Draw these, if they are not what is drawn."""
        if numbers != self._numbers:
            self._numbers = numbers
            self.refresh()

    def render(self) -> Text:
        """The line."""
        if self._numbers is None:
            return Text()
        return Text(status_text(self._numbers, self.size.width), no_wrap=True, overflow="crop")
