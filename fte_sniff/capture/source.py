"""Owns a port as an iterable: a thread reads, stamps and hands on; nothing is lost in silence.

It must not know of frames: it yields chunks as they came, and port events where they happened. A
port that was lost and can return is waited for, in the same thread and the same stream.

    reader thread:  read -> stamp -> bounded queue ->  consumer: for item in source
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from math import inf

import serial

from fte_sniff.capture.backlog import CAPACITY, Backlog
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.granted import Granted, ask
from fte_sniff.capture.holders import sharing_note
from fte_sniff.capture.items import Item, SourceEnd
from fte_sniff.capture.lateness import lateness_ns
from fte_sniff.capture.line_errors import BlindWatch, LineWatch
from fte_sniff.capture.ports import PortSettings, device_of, open_port
from fte_sniff.capture.reading import reader_of
from fte_sniff.capture.refusal import one_line
from fte_sniff.capture.returning import (
    FIRST_WAIT_S,
    LONGEST_WAIT_S,
    Opened,
    Reopen,
    Return,
    way_back,
)
from fte_sniff.protocol import Chunk, LineErrorCounts, PortEvent, PortEventKind
from fte_sniff.said import Said

_BEAT_S = 0.05
"""Seconds between two signs of life while a port is waited for."""


class PortSource:
    """The chunks and events of one open port, in order; iterate once.

    The first item is the event `opened`. In silence an empty chunk tells every 10 ms or so that
    time has passed, every 50 ms while the port is lost and waited for. The last item is the event
    `lost` or `closed`; then the port is closed.
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
        granted: Granted | None = None,
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
        self.name = name
        self._port = port
        self._clock = clock
        self._granted = granted or ask(port)
        self._line: LineWatch = self._granted.line
        self._read = reader_of(port)
        self._uncertainty_ns = uncertainty_ns
        self._reopen = reopen
        self._lost_at_bytes = -1
        self._backlog = Backlog(name, capacity)
        self._stop_at_ns = inf
        self._stopping = False
        self._tell(PortEventKind.OPENED, detail)
        self._thread = threading.Thread(target=self._run, name=f"reads {name}", daemon=True)
        self._thread.start()

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """How much earlier than the times say bytes may have been on the wire."""
        return {self.name: self._uncertainty_ns}

    @property
    def granted(self) -> Mapping[str, str]:
        """What the port's driver granted when it was opened, for people."""
        return {self.name: str(self._granted)}

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from self._backlog
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

    def stop_at(self, t_ns: float) -> None:
        """Ask for the end at a time of the clock, as `stop` would then; returns at once."""
        self._stop_at_ns = t_ns

    @property
    def waiting(self) -> int:
        """How many bytes were read and wait to be taken."""
        return self._backlog.waiting

    def drop(self) -> None:
        """Once it has ended: yield no more bytes, but an overrun that counts them."""
        self._backlog.drop()

    def close(self) -> None:
        """Stop, wait for the reader (some 10 ms), and close the port. Items left can be read on."""
        self.stop()
        self._thread.join()
        self._port.close()

    def _run(self) -> None:
        try:
            while (error := self._read_on()) is not None:
                self._tell_of_line_errors(self._clock.now_ns(), self._line.rest())
                if self._reopen is None:
                    self._finish(SourceEnd.LOST, PortEventKind.LOST, one_line(error))
                    return
                self._tell(
                    PortEventKind.LOST,
                    Said("{error}; waiting for it to come back", error=one_line(error)),
                )
                self._come_back(self._reopen)
            self._tell_of_line_errors(self._clock.now_ns(), self._line.rest())
            self._finish(SourceEnd.STOPPED, PortEventKind.CLOSED, Said("as asked"))
        finally:
            self._backlog.end()

    def _is_to_end(self) -> bool:
        return self._stopping or self._clock.now_ns() >= self._stop_at_ns

    def _read_on(self) -> OSError | None:
        """Read until asked to stop, or until the port is lost by the error that is returned."""
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

    def _come_back(self, reopen: Reopen) -> None:
        """Wait until the port is open again, or the end is asked for."""
        lost_ns = self._clock.now_ns()
        with suppress(OSError):  # a driver may complain of what is gone
            self._port.close()
        self._read, self._line = _nothing, BlindWatch()
        # A port that came back and brought nothing is likely to go again: then slowly.
        fruitless = self.bytes_read == self._lost_at_bytes
        self._lost_at_bytes = self.bytes_read
        returning = Return(reopen, LONGEST_WAIT_S if fruitless else FIRST_WAIT_S)
        while not self._is_to_end():
            opened = returning.wait(_BEAT_S)
            if opened is not None:
                self._take_over(opened, (self._clock.now_ns() - lost_ns) / 1e9)
                return
            if refusal := returning.refusal():
                self._tell(PortEventKind.NOT_OPENED, refusal)
            self._backlog.put(Chunk(self.name, self._clock.now_ns(), b""))
        returning.give_up()

    def _take_over(self, opened: Opened, away_s: float) -> None:
        self._port, self._line = opened.port, ask(opened.port).line
        self._read = reader_of(opened.port)
        named = "" if opened.name == self.name else Said(" as {port}", port=opened.name)
        shared = sharing_note(device_of(opened.port))
        self._tell(
            PortEventKind.FOUND_AGAIN,
            Said(
                "after {seconds:.1f} s{named}{shared}", seconds=away_s, named=named, shared=shared
            ),
        )

    def _finish(self, end: SourceEnd, kind: PortEventKind, detail: str) -> None:
        self.end = end
        self._tell(kind, detail)

    def _tell_of_line_errors(self, now_ns: int, counts: LineErrorCounts | None) -> None:
        if counts:
            kind = PortEventKind.LINE_ERROR
            self._backlog.tell(PortEvent(now_ns, self.name, kind, str(counts), counts.total))

    def _tell(self, kind: PortEventKind, detail: str) -> None:
        self._backlog.tell(PortEvent(self._clock.now_ns(), self.name, kind, detail))


def _nothing() -> bytes:
    """What a port that is away has to read."""
    return b""


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
        detail=Said(
            "{settings}; {granted}{shared}",
            settings=str(settings),
            granted=str(granted),
            shared=sharing_note(device_of(port)),
        ),
        granted=granted,
        uncertainty_ns=lateness_ns(port),
        reopen=way_back(name, settings, port) if reconnect else None,
    )
