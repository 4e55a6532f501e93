"""Owns what a source of bytes is: what it yields, how it is stopped, and how it ends.

It must not know any kind of source. Whoever frames and records takes any `Source`, and a capture
can be started with any `Wiring`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Protocol, Self, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.ports.opening import PortSettings
from fte_sniff.protocol import Chunk, PortEvent

Item: TypeAlias = Chunk | PortEvent


class SourceEnd(StrEnum):
    """How a source ended."""

    STOPPED = "stopped"
    LOST = "lost"


class Source(Protocol):
    """Open ports as one iterable of chunks and events, in order of their times; iterate once.

    Each port's first item is the event `opened`. No port is silent for long: an empty chunk tells
    some times a second that time has passed. An event `lost` or `overrun` means that the bytes
    before it and those behind it do not join.
    """

    @property
    def end(self) -> SourceEnd | None:
        """How the reading ended, though items may still wait to be taken; None while it goes on."""
        ...

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """By port: how much earlier than the times say bytes may have been on the wire."""
        ...

    @property
    def granted(self) -> Mapping[str, str]:
        """By port: what its driver granted when it was opened, for people."""
        ...

    def __iter__(self) -> Iterator[Item]: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_error: object) -> None: ...

    def stop(self) -> None:
        """Ask for the end: what has arrived until now is still yielded, then the source ends.

        Returns at once; may be called from any thread and from signal handlers, and repeatedly.
        """
        ...

    def stop_at(self, t_ns: float) -> None:
        """Ask for the end at a time of the chunks' clock, whether or not chunks are taken then."""
        ...

    @property
    def waiting(self) -> int:
        """How many bytes were read and wait to be taken."""
        ...

    def drop(self) -> None:
        """Once the reading has ended: yield no more bytes, but an `overrun` that counts them.

        Returns at once; may be called from any thread.
        """
        ...

    def close(self) -> None:
        """Stop, and close the ports. Items left can be read on."""
        ...


class Wiring(Protocol):
    """How the program gets at a line: which ports, and how they are opened. Can be pickled."""

    @property
    def names(self) -> tuple[str, ...]:
        """What chunks, rows and events call the ports."""
        ...

    @property
    def settings(self) -> PortSettings:
        """How each of the ports is opened."""
        ...

    def open(self, clock: Clock) -> Source:
        """Open the ports and begin to read them.

        Raises:
            PortError: one of them cannot be opened; none is left open then.
        """
        ...
