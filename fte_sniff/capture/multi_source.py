"""Several sources as one stream; one or two ports as one line."""

from __future__ import annotations

import heapq
import os
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import open_source
from fte_sniff.capture.serial_port import DEFAULT_SETTINGS, PortSettings
from fte_sniff.capture.source import Item, Source, SourceEnd
from fte_sniff.errors import UsageError, printable
from fte_sniff.protocol import PortEvent, PortEventKind


class MergedSource:
    """The items of several sources, in order of their times; when one is lost for good, all end."""

    def __init__(self, sources: Sequence[Source]) -> None:
        """Take over open sources; they are closed when this one is."""
        self._sources = tuple(sources)

    @property
    def end(self) -> SourceEnd | None:
        """How the reading ended: lost where one was lost; None while one goes on."""
        ends = {source.end for source in self._sources}
        if None in ends:
            return None
        return SourceEnd.LOST if SourceEnd.LOST in ends else SourceEnd.STOPPED

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """By port: how much earlier than the times say bytes may have been on the wire."""
        return ChainMap(*(dict(source.uncertainty_ns) for source in self._sources))

    @property
    def granted(self) -> Mapping[str, str]:
        """By port: what its driver granted when it was opened, for people."""
        return ChainMap(*(dict(source.granted) for source in self._sources))

    def __iter__(self) -> Iterator[Item]:
        try:
            for item in heapq.merge(*self._sources, key=_time_of):
                yield item
                if _is_lost(item) and any(s.end is SourceEnd.LOST for s in self._sources):
                    self.stop()
        finally:
            self.close()

    def __enter__(self) -> MergedSource:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def stop(self) -> None:
        """Ask all for the end; returns at once, and may be called from signal handlers."""
        for source in self._sources:
            source.stop()

    def stop_at(self, t_ns: float) -> None:
        """Ask all for the end at a time of the chunks' clock."""
        for source in self._sources:
            source.stop_at(t_ns)

    @property
    def waiting(self) -> int:
        """How many bytes were read and wait to be taken, of all."""
        return sum(source.waiting for source in self._sources)

    def drop(self) -> None:
        """Once all have ended: yield no more bytes, but for each an overrun that counts them."""
        for source in self._sources:
            source.drop()

    def close(self) -> None:
        """Stop all, wait for their readers, and close their ports."""
        self.stop()
        for source in self._sources:
            source.close()


def _time_of(item: Item) -> int:
    return item.t_ns or 0


def _is_lost(item: Item) -> bool:
    return isinstance(item, PortEvent) and item.kind is PortEventKind.LOST


@dataclass(frozen=True, slots=True)
class PortGroup:
    """Ports that are only listened to; nothing is ever written to them."""

    names: tuple[str, ...]
    """Devices, or URLs that pyserial opens; all different, or UsageError is raised."""
    settings: PortSettings = DEFAULT_SETTINGS
    """How each of them is opened."""
    reconnect: bool = True
    """Whether a port that is lost is waited for, if it is one that can return."""

    def __post_init__(self) -> None:
        meant = [_meant_by(name) for name in self.names]
        if len(set(meant)) < len(meant):
            twice = printable(max(self.names, key=lambda name: meant.count(_meant_by(name))))
            raise UsageError(
                f"{twice} is named twice: name the port of the other wire "
                "(for simulated ones: 'sim://?wire=control' 'sim://?wire=feedback')"
            )

    def open(self, clock: Clock) -> Source:
        """Open the ports and begin to read them.

        Raises:
            PortError: one of them cannot be opened; none is left open then.
        """
        with ExitStack() as opened:
            sources = [
                opened.enter_context(
                    open_source(name, self.settings, clock, reconnect=self.reconnect)
                )
                for name in self.names
            ]
            opened.pop_all()
        return sources[0] if len(sources) == 1 else MergedSource(sources)


def _meant_by(name: str) -> str:
    """What a name leads to: a device has many spellings, and links."""
    return name if "://" in name or "\0" in name else os.path.realpath(name)
