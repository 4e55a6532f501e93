"""Owns the bottom line of numbers: rows, rate, malformed share, and the place in the rows.

It must not know where the numbers come from. Numbers have widths of their own, so that the line
stands still while they run.
"""

from __future__ import annotations

from dataclasses import dataclass

from rich.cells import cell_len
from rich.text import Text
from textual.widget import Widget

from fte_sniff.tui.fitting import fit
from fte_sniff.tui.language import _

ROOMY = 72
"""Cells from which on there is room for whole words."""


@dataclass(frozen=True, slots=True)
class Numbers:
    """What the bottom line tells."""

    rows: int
    """All rows that came."""
    frames_per_s: float | None
    """None where there are no times to count by."""
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
    line_errors: int = 0
    """Errors that UARTs reported."""
    hits: str = ""
    """How many rows have what is looked for; empty where nothing is."""


def status_text(numbers: Numbers, width: int) -> str:
    """The line in exactly `width` cells; where it is narrow, the last parts are left out first."""
    parts = _parts(numbers) if width >= ROOMY else _short_parts(numbers)
    if numbers.hits:
        parts.insert(1, numbers.hits)
    if numbers.line_errors:
        parts.append(_("{count:,} line errors").format(count=numbers.line_errors))
    if numbers.not_shown:
        parts.append(_("{count:,} too fast to show").format(count=numbers.not_shown))
    place = _("row {number:,}").format(number=numbers.place)
    parts.append(place if numbers.place else _("no row shown"))
    if not numbers.following:
        parts.append(_("{count:,} below").format(count=numbers.below))
    line = parts[0]
    for part in parts[1:]:
        if cell_len(line) + cell_len(part) + 2 > width:
            break
        line += "  " + part
    return fit(line, width)


def _parts(numbers: Numbers) -> list[str]:
    per_s = numbers.frames_per_s
    rate = [] if per_s is None else [_("{rate:>6,.0f} frames/s").format(rate=per_s)]
    malformed = _("{count:>6,} malformed {share:>6}").format(
        count=numbers.malformed, share=_share(numbers, 2)
    )
    return [_("{count:>9,} rows").format(count=numbers.rows), *rate, malformed]


def _short_parts(numbers: Numbers) -> list[str]:
    """The same in few cells, the rate last."""
    rate = [] if numbers.frames_per_s is None else [f"{numbers.frames_per_s:>5,.0f}/s"]
    malformed = _("{count:>5,} bad {share:>5}").format(
        count=numbers.malformed, share=_share(numbers, 1)
    )
    return [_("{count:>9,} rows").format(count=numbers.rows), malformed, *rate]


def _share(numbers: Numbers, digits: int) -> str:
    share, least = numbers.malformed_share, 10.0 ** -(digits + 2)
    if 0 < share < least:
        return f"<{least:.{digits}%}"
    return f"{share:.{digits}%}" if share < 1 else "100%"


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
