"""Owns what is known of rows that are saved, beside the rows: their lines, and what is not there.

It must not know files, nor what becomes of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from fte_sniff.recording.metadata import Selection, Stretch


@dataclass(frozen=True, slots=True)
class Origin:
    """Where rows come from."""

    ports: Sequence[str] = ()
    """The ports that they may come from."""
    bauds: Mapping[str, int] = field(default_factory=dict)
    """Bits per second by port; a port whose baud nobody said is not in it."""
    left_out: Sequence[Stretch] = ()
    """Rows that came and are not there; more may be found while a file is read."""
    selections: Sequence[Selection] = ()
    """The filters that chose the rows."""

    def within(self, first_ns: int | None, last_ns: int | None) -> Origin:
        """The same for the rows between two times alone; None for no bound."""
        cut = [one.within(first_ns, last_ns) for one in self.left_out]
        return replace(self, left_out=[one for one in cut if one is not None])


UNKNOWN = Origin()
"""Nobody said anything."""
