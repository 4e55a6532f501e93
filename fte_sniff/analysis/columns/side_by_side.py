"""Owns what rows that lie side by side are: arrays, one for each thing that a row tells.

It must not know polars, which takes long to load: who only counts such rows does without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from fte_sniff.analysis.columns.fields import Array
from fte_sniff.protocol import Fault


class Words(Protocol):
    """What the numbers in columns stand for."""

    @property
    def ports(self) -> Sequence[str]:
        """Port names, by number."""
        ...

    @property
    def faults(self) -> Sequence[tuple[Fault, ...]]:
        """Combinations of faults, by number."""
        ...


class SideBySide(Protocol):
    """Rows as arrays, all equally long: what each row tells that cannot be derived."""

    @property
    def words(self) -> Words:
        """What the numbers of `port` and `faults` stand for."""
        ...

    @property
    def t_ns(self) -> Array:
        """Nanoseconds since 1970 UTC, int64; it means something where `timed`."""
        ...

    @property
    def timed(self) -> Array:
        """Whether the row has a time, bool."""
        ...

    @property
    def offset(self) -> Array:
        """Of the first byte, int64."""
        ...

    @property
    def length(self) -> Array:
        """Bytes of the row, uint32."""
        ...

    @property
    def port(self) -> Array:
        """Number of the port."""
        ...

    @property
    def faults(self) -> Array:
        """Number of the faults."""
        ...

    @property
    def framed(self) -> Array:
        """Whether the row is a Frame, bool."""
        ...

    @property
    def raw(self) -> Array:
        """The first ten bytes, zeros behind them; uint8, ten for each row."""
        ...

    @property
    def long(self) -> Mapping[int, bytes]:
        """All bytes of the rows longer than ten, by place."""
        ...
