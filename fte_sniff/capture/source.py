"""Owns a port as an iterable: a thread reads, stamps and hands on; nothing is lost in silence.

It must not know of frames: it yields chunks as they came, and port events where they happened.

    reader thread:  read -> stamp -> bounded queue ->  consumer: for item in source
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator, Mapping

import serial

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.holders import holders_of
from fte_sniff.capture.items import Item, SourceEnd
from fte_sniff.capture.ports import PortSettings, device_of, open_port
from fte_sniff.capture.reading import reader_of
from fte_sniff.capture.refusal import one_line
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

CAPACITY = 32 * 2**20
"""Bytes that may wait for the consumer, its bookkeeping included, before reads are dropped."""

_ITEM_COST = 256
"""What one waiting item takes besides its bytes, roughly."""


class PortSource:
    """The chunks and events of one open port, in order; iterate once.

    The first item is the event `opened`. In silence an empty chunk tells every 10 ms or so that
    time has passed. The last item is the event `lost` or `closed`; then the port is closed.
    """

    bytes_read = 0
    """Bytes read from the port since it was opened, also those that an overrun lost."""
    end: SourceEnd | None = None
    """How the reading ended, though items may still wait to be taken; None while it goes on."""

    def __init__(
        self,
        port: serial.Serial,
        name: str,
        clock: Clock,
        *,
        detail: str = "",
        capacity: int = CAPACITY,
    ) -> None:
        """Take over an open port.

        Args:
            port: as `open_port` gives it; closed when the source ends.
            name: what chunks and events call the port.
            clock: what they are stamped with.
            detail: how the port was opened, for the event.
            capacity: how many bytes may wait for the consumer.
        """
        self.name = name
        self._port = port
        self._clock = clock
        self._read = reader_of(port)
        self._capacity = capacity
        self._queue: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        # Each is written by one thread alone: what was put less what was taken is what waits.
        self._put_cost = 0
        self._taken_cost = 0
        self._dropped = 0
        self._dropped_at_ns = 0
        self._stopping = False
        self._tell(PortEventKind.OPENED, detail)
        self._thread = threading.Thread(target=self._run, name=f"reads {name}", daemon=True)
        self._thread.start()

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """How much earlier than the times say bytes may have been on the wire."""
        return {self.name: 0}

    def __iter__(self) -> Iterator[Item]:
        try:
            while (item := self._queue.get()) is not None:
                self._taken_cost += _cost(item)
                yield item
            # The end stays the end for whoever iterates again.
            self._queue.put(None)
        finally:
            self.close()

    def __enter__(self) -> PortSource:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def stop(self) -> None:
        """Ask for the end: what has arrived until now is still yielded, then the source ends.

        Returns at once; may be called from any thread and from signal handlers, and repeatedly.
        """
        self._stopping = True

    def close(self) -> None:
        """Stop, wait for the reader (some 10 ms), and close the port. Items left can be read on."""
        self.stop()
        self._thread.join()
        self._port.close()

    def _run(self) -> None:
        try:
            self._read_until_stopped()
            self._finish(SourceEnd.STOPPED, PortEventKind.CLOSED, "as asked")
        except OSError as error:
            self._finish(SourceEnd.LOST, PortEventKind.LOST, one_line(error))
        finally:
            self._queue.put(None)

    def _read_until_stopped(self) -> None:
        while True:
            # Looked at before the read: what has arrived when `stop` is called is read yet.
            last = self._stopping
            data = self._read()
            self._hand_on(Chunk(self.name, self._clock.now_ns(), data))
            self.bytes_read += len(data)
            if last:
                return

    def _hand_on(self, chunk: Chunk) -> None:
        waiting = self._put_cost - self._taken_cost
        if waiting and not chunk.data:
            return
        if waiting + _cost(chunk) > self._capacity:
            if not self._dropped:
                self._dropped_at_ns = chunk.t_ns or 0
            self._dropped += len(chunk.data)
            return
        self._tell_of_overrun()
        self._put(chunk)

    def _finish(self, end: SourceEnd, kind: PortEventKind, detail: str) -> None:
        self._tell_of_overrun()
        self.end = end
        self._tell(kind, detail)

    def _tell_of_overrun(self) -> None:
        if self._dropped:
            detail = f"{self._dropped} bytes were not kept: they came faster than they were taken"
            self._put(
                PortEvent(self._dropped_at_ns, self.name, PortEventKind.OVERRUN, detail),
            )
            self._dropped = 0

    def _tell(self, kind: PortEventKind, detail: str) -> None:
        self._put(PortEvent(self._clock.now_ns(), self.name, kind, detail))

    def _put(self, item: Item) -> None:
        self._put_cost += _cost(item)
        self._queue.put(item)


def _cost(item: Item) -> int:
    return _ITEM_COST + (len(item.data) if isinstance(item, Chunk) else 0)


def open_source(name: str, settings: PortSettings, clock: Clock) -> PortSource:
    """Open a port and start to read it; raises PortError as `open_port` does."""
    port = open_port(name, settings)
    device = device_of(port)
    holders = holders_of(device) if device else []
    shared = "".join(f"; {holder} has it open too, and may take bytes away" for holder in holders)
    return PortSource(port, name, clock, detail=f"{settings}{shared}")
