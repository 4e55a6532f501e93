"""How a status looks: signs and colours, of plain text and pages."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Status


class Look(NamedTuple):
    """How a status is shown."""

    mark: str
    """Sign in front of a row; colour must never be the only difference."""
    color: str = "green"
    """Colour on a terminal whose ground is unknown, by its ANSI name."""
    bold: bool = False
    plot: str = "#3a7bd5"
    """Colour in plots, with a contrast of about 3, at least 2.9, on light and dark ground."""

    @property
    def style(self) -> str:
        """Style on a terminal whose ground is unknown, as rich writes it."""
        return f"bold {self.color}" if self.bold else self.color


LOOKS: Mapping[Status, Look] = MappingProxyType(
    {
        Status.OK: Look(" "),
        Status.SUSPECT: Look("?", "yellow", plot="#d9822b"),
        Status.MALFORMED: Look("!", "red", bold=True, plot="#d03b3b"),
    }
)
"""The look of each status; `tui.painter` has the colours of the screen."""


ORDER_MARK = "~"
"""The mark of an `ok` row whose order with rows of another port is uncertain."""


def mark_of(row: Row) -> str:
    """One character for the status of a row, or an uncertain order."""
    if row.unordered and row.status is Status.OK:
        return ORDER_MARK
    return LOOKS[row.status].mark
