"""Source interface, thread base class, items of a source.

opened -> read -> stopped: closed
               -> lost:    wait, and read again where it came back
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Protocol, Self, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.reconnect import FIRST_WAIT_S, OpenedPort, Reconnector, Reopen
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

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


_BEAT_S = 0.05
"""Seconds between two signs of life while a port is waited for."""


class Waiting(Protocol):
    """What was read, until the consumer takes it."""

    def __iter__(self) -> Iterator[Item]: ...

    @property
    def waiting(self) -> int:
        """How many bytes wait."""
        ...

    def drop(self) -> None:
        """Let the consumer have no more bytes, but overruns that count them."""
        ...

    def end(self) -> None:
        """Nothing comes after what waits now."""
        ...


class ThreadedSource(ABC):
    """A source that a thread reads, but for how it reads; a `Source` once that is said."""

    end: SourceEnd | None = None
    """How the reading ended, though items may still wait to be taken; None while it goes on."""

    def __init__(self, items: Waiting, clock: Clock, reopen: Reopen | None) -> None:
        """Not begun.

        Args:
            items: where what is read waits for the consumer.
            clock: what it is stamped with.
            reopen: how to open the port again when it is lost; None to end then.
        """
        self._items = items
        self._clock = clock
        self._reopen = reopen
        self._stopping = False

    def _begin(self, name: str, detail: str) -> None:
        """Tell that the port is open, and begin to read it in a thread of that name."""
        self._tell(PortEventKind.OPENED, detail)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from self._items
        finally:
            self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def stop(self) -> None:
        """Ask for the end: what has arrived until now is still yielded, then the source ends.

        Returns at once; may be called from any thread and from signal handlers, and repeatedly.
        """
        self._stopping = True

    @property
    def waiting(self) -> int:
        """How many bytes were read and wait to be taken."""
        return self._items.waiting

    def drop(self) -> None:
        """Once it has ended: yield no more bytes, but overruns that count them."""
        self._items.drop()

    def close(self) -> None:
        """Stop, wait for the reader (some 10 ms), and close the port. Items left can be read on."""
        self.stop()
        self._thread.join()
        self._close_port()

    def _run(self) -> None:
        try:
            self._read_until_the_end()
        finally:
            self._items.end()

    def _read_until_the_end(self) -> None:
        while (error := self._read_on()) is not None:
            lost = one_line(error)
            if self._reopen is None:
                self._finish(SourceEnd.LOST, PortEventKind.LOST, lost)
                return
            self._tell(
                PortEventKind.LOST,
                TranslatableText("{error}; waiting for it to come back", error=lost),
            )
            opened, away_s = self._wait_for_return(self._reopen)
            if opened is None:
                break
            try:
                self._take_over(opened, away_s)
            except FileError as refused:
                self._finish(SourceEnd.LOST, PortEventKind.LOST, refused.message)
                return
        self._finish(SourceEnd.STOPPED, PortEventKind.CLOSED, TranslatableText("as asked"))

    def _wait_for_return(self, reopen: Reopen) -> tuple[OpenedPort | None, float]:
        """The port once it is open again, None if the end is asked for; and how long, seconds."""
        lost_ns = self._clock.now_ns()
        self._close_port()
        returning = Reconnector(reopen, self._first_wait_s())
        while not self._is_to_end():
            opened = returning.wait(_BEAT_S)
            if opened is not None:
                return opened, (self._clock.now_ns() - lost_ns) / 1e9
            if refusal := returning.refusal():
                self._tell(PortEventKind.NOT_OPENED, refusal)
            self._tell_of_silence()
        returning.give_up()
        return None, 0

    def _first_wait_s(self) -> float:
        """Seconds before a lost port is looked for at first."""
        return FIRST_WAIT_S

    def _finish(self, end: SourceEnd, kind: PortEventKind, detail: str) -> None:
        self.end = end
        self._tell(kind, detail)

    @abstractmethod
    def _read_on(self) -> OSError | None:
        """Read until asked to stop, or until the port is lost by the error that is returned."""

    @abstractmethod
    def _is_to_end(self) -> bool:
        """Whether the end was asked for, and is due."""

    @abstractmethod
    def _take_over(self, opened: OpenedPort, away_s: float) -> None:
        """Tell that the port was found again, and be ready to read it on.

        Raises:
            FileError: that cannot be done, so that it stays lost.
        """

    @abstractmethod
    def _tell(self, kind: PortEventKind, detail: str) -> None:
        """Tell of what happened to the port just now."""

    @abstractmethod
    def _tell_of_silence(self) -> None:
        """Tell that time has passed, so that nothing waits for a port that is away."""

    @abstractmethod
    def _close_port(self) -> None:
        """Close the port, also where it is closed already, or gone."""
