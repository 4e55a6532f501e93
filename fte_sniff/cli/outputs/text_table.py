"""Owns small tables of text: a name, and cells at the right of it under their heads.

It must not know what is in the cells. Columns are as wide as what is in them; where a table is
wider than it may be, names are shortened first, down to a bound, then the last columns left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.cells import cell_len
from rich.text import Text

from fte_sniff.tui.fitting import fit_path, fit_right, padded

HEAD_STYLE = "dim"
LEAST_NAME = 21
"""Cells that a name is shortened to at most."""


class TextTable:
    """One table."""

    def __init__(self, heads: Sequence[str]) -> None:
        """No lines yet; the first head is that of the names."""
        self._lines = [("", list(heads), "")]

    def add(self, cells: Sequence[str], style: str = "", mark: str = "") -> None:
        """One more line: the name, and as many cells as there are heads for.

        Args:
            cells: the name first.
            style: of mark and name.
            mark: stands left of the name, in a column of its own.
        """
        self._lines.append((mark, list(cells), style))

    def lines(self, width: int | None) -> Iterator[Text]:
        """All lines, in at most so many cells if they can be; None for as many as they take."""
        marks = max(cell_len(mark) for mark, _, _ in self._lines)
        names, *widths = (
            max(map(cell_len, column))
            for column in zip(*(cells for _, cells, _ in self._lines), strict=True)
        )
        if width is not None:
            room = width - marks
            names = max(min(names, LEAST_NAME), min(names, room - sum(widths) - 2 * len(widths)))
            while len(widths) > 1 and names + sum(widths) + 2 * len(widths) > room:
                widths.pop()
        for number, (mark, (name, *cells), style) in enumerate(self._lines):
            told = "".join(
                f"  {fit_right(cell, room)}" for cell, room in zip(cells, widths, strict=False)
            )
            lead = f"{padded(mark, marks)}{padded(fit_path(name, names), names)}"
            line = Text.assemble((lead, style), told, style="" if number else HEAD_STYLE)
            line.rstrip()
            yield line
