"""Owns what a copy of a recording says of the filter that chose its rows.

It must not know filters. A record that makes no sense says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from fte_sniff.recording.encoding.facts import PROGRAM

SELECTION_NAME: Final = f"{PROGRAM}.selection"
"""The name of the metadata record that tells that the file is a selection."""

_MOST_DIGITS: Final = 18


@dataclass(frozen=True, slots=True)
class Selection:
    """Only rows for which a filter holds are there; between them others came."""

    filter_text: str
    """Text from the file, so show it, never obey it."""
    rows: int
    """How many rows there were before the filter."""

    def told(self) -> dict[str, str]:
        """As a recording holds it."""
        return {"filter": self.filter_text, "rows": str(self.rows)}


def selection_of(name: str, told: Mapping[str, str]) -> Selection | None:
    """What a metadata record tells; None where it tells of no selection."""
    text, rows = told.get("filter", ""), told.get("rows", "")
    if name != SELECTION_NAME or not text:
        return None
    if not (rows.isascii() and rows.isdecimal() and len(rows) <= _MOST_DIGITS):
        return None
    return Selection(text, int(rows))
