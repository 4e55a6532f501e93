"""Owns a stretch of a recording whose rows were read once and can be read again.

It must not know how it is read, nor who asks for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mcap.records import Channel, Schema

from fte_sniff.recording.reading.span import Span

Range = tuple[int, int]
"""Where records begin in a file, and where the last of them ends."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """What a pass knew of the channels before it came to a stretch."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]


@dataclass(frozen=True, slots=True)
class Passage:
    """Some rows of a recording, by where they stand in the file."""

    known: Definitions
    ranges: tuple[Range, ...]
    """Of the records that hold the rows, rising."""
    span: Span
    """Rows outside it were left out."""
    skipped: int
    """Rows that these records hold before them."""
    count: int
    """How many rows they are."""
    after_loss: bool = False
    """Whether something could not be read between the rows before and these."""


def ranges_of(records: Iterable[Range]) -> tuple[Range, ...]:
    """The same, with those that follow each other without a gap as one."""
    found: list[Range] = []
    for start, end in records:
        if found and found[-1][1] == start:
            start = found.pop()[0]
        found.append((start, end))
    return tuple(found)
