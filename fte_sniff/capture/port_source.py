"""Sources of serial ports that are only read: one port, or several with one queue."""

from __future__ import annotations

import os
from collections import ChainMap
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import serial

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import sharing_note
from fte_sniff.capture.reconnect import FIRST_WAIT_S, LONGEST_WAIT_S, OpenedPort, Reopen, reopener
from fte_sniff.capture.serial_port import (
    DEFAULT_SETTINGS,
    PortCapabilities,
    PortSettings,
    device_of,
    max_latency_ns,
    open_port,
    reader_of,
    request_capabilities,
)
from fte_sniff.capture.source import ChunkQueue, Item, Source, SourceEnd, ThreadedSource
from fte_sniff.capture.uart_errors import LineWatch
from fte_sniff.errors import TranslatableText, UsageError, printable
from fte_sniff.protocol import Chunk, LineErrorCounts, PortEvent, PortEventKind


@dataclass(frozen=True, slots=True)
class PortGroup:
    """The ports of a live capture; raises UsageError if one is named twice."""

    names: tuple[str, ...]
    """Devices, or URLs that pyserial opens; all different."""
    settings: PortSettings = DEFAULT_SETTINGS
    reconnect: bool = True
    """True to wait for a lost port, if it can come back."""

    def __post_init__(self) -> None:
        targets = [_target_of(name) for name in self.names]
        if len(set(targets)) < len(targets):
            twice = printable(max(self.names, key=lambda name: targets.count(_target_of(name))))
            raise UsageError(
                f"{twice} is named twice: name the port of the other wire "
                "(for simulated ones: 'sim://?wire=control' 'sim://?wire=feedback')"
            )

    def open(self, clock: Clock) -> Source:
        """Open all ports and start to read; raises PortError, with none open, if one fails."""
        queue = ChunkQueue(*self.names, readers=len(self.names))
        with ExitStack() as opened:
            sources = [
                opened.enter_context(
                    open_source(name, self.settings, clock, queue, reconnect=self.reconnect)
                )
                for name in self.names
            ]
            opened.pop_all()
        return sources[0] if len(sources) == 1 else SourceGroup(sources, queue)


def _target_of(name: str) -> str:
    """The device that a name leads to; one device has many spellings and links."""
    return name if "://" in name or "\0" in name else os.path.realpath(name)


def open_source(
    name: str,
    settings: PortSettings,
    clock: Clock,
    queue: ChunkQueue | None = None,
    *,
    reconnect: bool = False,
) -> PortSource:
    """Open a port and start to read it into a queue; with `reconnect`, wait for it when it is lost.

    Raises PortError if it cannot be opened.
    """
    port = open_port(name, settings)
    capabilities = request_capabilities(port)
    return PortSource(
        port,
        name,
        clock,
        detail=TranslatableText(
            "{settings}; {granted}{shared}",
            settings=str(settings),
            granted=str(capabilities),
            shared=sharing_note(device_of(port)),
        ),
        capabilities=capabilities,
        queue=queue,
        uncertainty_ns=max_latency_ns(port),
        reopen=reopener(name, settings, port) if reconnect else None,
    )


class PortSource(ThreadedSource):
    """The chunks and events of one open port, in order; iterate once.

    The first item is the event `opened`, the last `lost` or `closed`. In silence an empty chunk
    comes about every 10 ms, every 50 ms while a lost port is awaited.
    """

    bytes_read = 0
    """Bytes read from the port since it was opened, dropped ones included."""

    def __init__(
        self,
        port: serial.Serial,
        name: str,
        clock: Clock,
        *,
        detail: str = "",
        capabilities: PortCapabilities | None = None,
        queue: ChunkQueue | None = None,
        uncertainty_ns: int = 0,
        reopen: Reopen | None = None,
    ) -> None:
        """Take over an open port, and start to read it; the source closes it at its end.

        Args:
            detail: text of the event `opened`.
            capabilities: None to request them here.
            queue: receives the items; None for a queue of this port alone.
            uncertainty_ns: how much earlier than their time stamp bytes may have arrived.
            reopen: opens the port again when it is lost; None to end then.
        """
        super().__init__(port, name, queue or ChunkQueue(name), clock, reopen)
        capabilities = capabilities or request_capabilities(port)
        self.uncertainty_ns = {name: uncertainty_ns}
        self.capabilities = {name: str(capabilities)}
        self._line: LineWatch = capabilities.line
        self._read = reader_of(port)
        self._bytes_at_loss = -1
        self._start(f"reads {name}", detail)

    def _read_until_lost(self) -> OSError | None:
        error = self._read_chunks()
        self._put_line_errors(self._clock.now_ns(), self._line.flush())
        return error

    def _read_chunks(self) -> OSError | None:
        while True:
            # Checked before the read, so that bytes that arrived before `stop` are still read.
            last = self._stopping
            try:
                data = self._read()
            except OSError as error:
                return error
            now_ns = self._clock.now_ns()
            data, line_errors = self._line.feed(data)
            self._put_line_errors(now_ns, self._line.report(now_ns))
            self._items.put(Chunk(self.name, now_ns, data, line_errors))
            self.bytes_read += len(data)
            if last or now_ns >= self._stop_at_ns:
                return None

    def _first_wait_s(self) -> float:
        # A port that came back without any byte is likely to go again: back off.
        silent = self.bytes_read == self._bytes_at_loss
        self._bytes_at_loss = self.bytes_read
        return LONGEST_WAIT_S if silent else FIRST_WAIT_S

    def _resume(self, opened: OpenedPort, away_s: float) -> None:
        self._port, self._line = opened.port, request_capabilities(opened.port).line
        self._read = reader_of(opened.port)
        self._put_found_again(opened, away_s, sharing_note(device_of(opened.port)))

    def _put_line_errors(self, now_ns: int, counts: LineErrorCounts | None) -> None:
        if counts:
            kind = PortEventKind.LINE_ERROR
            self._items.put_event(PortEvent(now_ns, self.name, kind, str(counts), counts.total))


class SourceGroup(Source):
    """Several sources with one queue; when one is lost for good, all end."""

    def __init__(self, sources: Sequence[Source], queue: ChunkQueue) -> None:
        self._sources, self._queue = tuple(sources), queue
        self.uncertainty_ns = ChainMap(*(dict(source.uncertainty_ns) for source in sources))
        self.capabilities = ChainMap(*(dict(source.capabilities) for source in sources))

    @property
    def end(self) -> SourceEnd | None:
        """LOST if a source was lost; None while one is still read."""
        ends = {source.end for source in self._sources}
        if None in ends:
            return None
        return SourceEnd.LOST if SourceEnd.LOST in ends else SourceEnd.STOPPED

    def __iter__(self) -> Iterator[Item]:
        try:
            for item in self._queue:
                yield item
                lost = isinstance(item, PortEvent) and item.kind is PortEventKind.LOST
                if lost and any(source.end is SourceEnd.LOST for source in self._sources):
                    self.stop()
        finally:
            self.close()

    def stop(self) -> None:
        """Request the end of all sources, as `Source.stop`."""
        for source in self._sources:
            source.stop()

    def stop_at(self, t_ns: float) -> None:
        """Request the end of all sources at a time of the chunks' clock."""
        for source in self._sources:
            source.stop_at(t_ns)

    @property
    def waiting(self) -> int:
        """Number of bytes that were read and not yet yielded, of all sources."""
        return self._queue.waiting

    def close(self) -> None:
        """Stop all sources, wait for their reader threads, and close their ports."""
        self.stop()
        for source in self._sources:
            source.close()
