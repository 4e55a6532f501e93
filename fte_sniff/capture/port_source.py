"""The source that reads one port.

reader thread:  read -> stamp -> bounded queue ->  consumer: for item in source
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from math import inf

import serial

from fte_sniff.capture.chunk_queue import CAPACITY, ChunkQueue
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import sharing_note
from fte_sniff.capture.reconnect import FIRST_WAIT_S, LONGEST_WAIT_S, OpenedPort, Reopen, way_back
from fte_sniff.capture.serial_port import (
    PortCapabilities,
    PortSettings,
    ask,
    device_of,
    max_latency_ns,
    open_port,
    reader_of,
)
from fte_sniff.capture.source import ThreadedSource
from fte_sniff.capture.uart_errors import LineWatch
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Chunk, LineErrorCounts, PortEvent, PortEventKind


class PortSource(ThreadedSource):
    """The chunks and events of one open port, in order; iterate once.

    The first item is the event `opened`. In silence an empty chunk tells every 10 ms or so that
    time has passed, every 50 ms while the port is lost and waited for. The last item is the event
    `lost` or `closed`; then the port is closed.
    """

    bytes_read = 0
    """Bytes read from the port since it was opened, also those that an overrun lost."""

    def __init__(
        self,
        port: serial.Serial,
        name: str,
        clock: Clock,
        *,
        detail: str = "",
        granted: PortCapabilities | None = None,
        capacity: int = CAPACITY,
        uncertainty_ns: int = 0,
        reopen: Reopen | None = None,
    ) -> None:
        """Take over an open port.

        Args:
            port: as `open_port` gives it; closed when the source ends.
            name: what chunks and events call the port.
            clock: what they are stamped with.
            detail: how the port was opened, for the event.
            granted: what the port was asked for and granted; None to ask it here.
            capacity: how many bytes may wait for the consumer.
            uncertainty_ns: how much earlier than they are stamped bytes may have come.
            reopen: how to open the port again when it is lost; None to end then.
        """
        self._backlog = ChunkQueue(name, capacity)
        super().__init__(self._backlog, clock, reopen)
        self.name = name
        self._port = port
        self._granted = granted or ask(port)
        self._line: LineWatch = self._granted.line
        self._read = reader_of(port)
        self._uncertainty_ns = uncertainty_ns
        self._lost_at_bytes = -1
        self._stop_at_ns = inf
        self._begin(f"reads {name}", detail)

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """How much earlier than the times say bytes may have been on the wire."""
        return {self.name: self._uncertainty_ns}

    @property
    def granted(self) -> Mapping[str, str]:
        """What the port's driver granted when it was opened, for people."""
        return {self.name: str(self._granted)}

    def stop_at(self, t_ns: float) -> None:
        """Ask for the end at a time of the clock, as `stop` would then; returns at once."""
        self._stop_at_ns = t_ns

    def _is_to_end(self) -> bool:
        return self._stopping or self._clock.now_ns() >= self._stop_at_ns

    def _read_on(self) -> OSError | None:
        error = self._read_while_it_is_there()
        self._tell_of_line_errors(self._clock.now_ns(), self._line.rest())
        return error

    def _read_while_it_is_there(self) -> OSError | None:
        while True:
            # Looked at before the read: what has arrived when `stop` is called is read yet.
            last = self._is_to_end()
            try:
                data = self._read()
            except OSError as error:
                return error
            now_ns = self._clock.now_ns()
            data, line_errors = self._line.take(data)
            self._tell_of_line_errors(now_ns, self._line.news(now_ns))
            self._backlog.put(Chunk(self.name, now_ns, data, line_errors))
            self.bytes_read += len(data)
            if last:
                return None

    def _first_wait_s(self) -> float:
        # A port that came back and brought nothing is likely to go again: then slowly.
        fruitless = self.bytes_read == self._lost_at_bytes
        self._lost_at_bytes = self.bytes_read
        return LONGEST_WAIT_S if fruitless else FIRST_WAIT_S

    def _take_over(self, opened: OpenedPort, away_s: float) -> None:
        self._port, self._line = opened.port, ask(opened.port).line
        self._read = reader_of(opened.port)
        named = "" if opened.name == self.name else TranslatableText(" as {port}", port=opened.name)
        shared = sharing_note(device_of(opened.port))
        self._tell(
            PortEventKind.FOUND_AGAIN,
            TranslatableText(
                "after {seconds:.1f} s{named}{shared}", seconds=away_s, named=named, shared=shared
            ),
        )

    def _tell_of_line_errors(self, now_ns: int, counts: LineErrorCounts | None) -> None:
        if counts:
            kind = PortEventKind.LINE_ERROR
            self._backlog.tell(PortEvent(now_ns, self.name, kind, str(counts), counts.total))

    def _tell(self, kind: PortEventKind, detail: str) -> None:
        self._backlog.tell(PortEvent(self._clock.now_ns(), self.name, kind, detail))

    def _tell_of_silence(self) -> None:
        self._backlog.put(Chunk(self.name, self._clock.now_ns(), b""))

    def _close_port(self) -> None:
        with suppress(OSError):  # a driver may complain of what is gone
            self._port.close()


def open_source(
    name: str, settings: PortSettings, clock: Clock, *, reconnect: bool = False
) -> PortSource:
    """Open a port and start to read it; raises PortError as `open_port` does.

    Args:
        name: as `open_port` takes it.
        settings: how to open it.
        clock: what its chunks are stamped with.
        reconnect: wait for the port when it is lost, if it is one that can return.
    """
    port = open_port(name, settings)
    granted = ask(port)
    return PortSource(
        port,
        name,
        clock,
        detail=TranslatableText(
            "{settings}; {granted}{shared}",
            settings=str(settings),
            granted=str(granted),
            shared=sharing_note(device_of(port)),
        ),
        granted=granted,
        uncertainty_ns=max_latency_ns(port),
        reopen=way_back(name, settings, port) if reconnect else None,
    )
