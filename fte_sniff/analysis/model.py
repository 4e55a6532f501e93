"""Models of rows: they observe the next rows, merge with those of later rows, and are copied."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar

from fte_sniff.protocol import Gap, PortEvent, Rows

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import BaudChange, StreamChange

_End = TypeVar("_End")


class Model:
    """A state that is copied; other objects than containers, arrays and models never change."""

    def copy(self) -> Self:
        """An independent copy."""
        other = copy(self)
        for name, value in vars(self).items():
            setattr(other, name, _copied(value))
        return other


def _copied(value: Any) -> Any:
    match value:
        case dict():
            return {key: _copied(one) for key, one in value.items()}
        case list():
            return [_copied(one) for one in value]
        case set() | Model():
            return value.copy()
    return value.copy() if hasattr(value, "dtype") else value  # numpy is not loaded for this


class Ends(Model, Generic[_End]):
    """Facts of the first and the last row, by which later rows continue those before a cut."""

    def __init__(self, *, interrupted: bool = False) -> None:
        """`interrupted` is whether rows are missing before the first one."""
        self.interrupted = interrupted
        """Whether rows are missing somewhere."""
        self._first: _End | None = None
        """Of the first row, unless a gap is before it."""
        self._last: _End | None = None
        """Of the last row, unless a gap is after it."""

    def append(self, first: _End, last: _End) -> _End | None:
        """Add rows; returns the last one before them, None without one or after a gap."""
        before, self._last = self._last, last
        if self._first is None and not self.interrupted:
            self._first = first
        return before

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._last, self.interrupted = None, True

    def merge(self, later: Ends[_End]) -> tuple[_End, _End] | None:
        """Add the rows that follow; returns the last one here and the first there, if adjacent."""
        before = None if later._first is None else self.append(later._first, later._first)
        if later.interrupted:
            self.interrupt()
        if later._last is not None:
            self._last = later._last
        return None if later._first is None or before is None else (before, later._first)


class RowModel(Model, ABC):
    """A model of consecutive rows, with the port events, gaps and baud changes among them."""

    def begin(self, name: str) -> None:
        """Start the next input."""

    def observe(
        self,
        rows: Rows,
        events: Sequence[PortEvent] = (),
        changes: Sequence[StreamChange] = (),
    ) -> None:
        """Add the next rows, and the port events and changes among them."""
        start = 0
        for change in changes:
            if change.index > start:
                self._observe(rows[start : change.index])
            self.observe_change(change.what)
            start = change.index
        if len(rows) > start:
            self._observe(rows[start:])
        self.observe_events(events)

    @abstractmethod
    def _observe(self, rows: Rows) -> None:
        """Add rows, at least one."""

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""

    @abstractmethod
    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""

    @abstractmethod
    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""
