"""Owns the bridge as a source: two threads pass every byte on at once, and hand it to the capture.

It must not know of frames: it yields chunks of two wires, and port events where they happened.

    feedback thread:  port read -> stamp -> host program  -> backlog ->  consumer
    control thread:   host read -> port write -> stamp    -> backlog ->  consumer

The chunks of the host's wire hold what was put onto the line. Their time is when their last byte
will have left at the line's pace, so that they are dated back like any others.
"""

from __future__ import annotations

import fcntl
import heapq
import termios
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import serial

from fte_sniff.capture.backlog import CAPACITY, Backlog
from fte_sniff.capture.bridge.host_end import HostEnd
from fte_sniff.capture.bridge.outlet import outlet_of
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.items import Item, SourceEnd
from fte_sniff.capture.ports import BAUD_RANGE, PortSettings, open_port
from fte_sniff.capture.reading import reader_of
from fte_sniff.capture.refusal import one_line
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind, byte_time_ns

HOST = "host"
"""What the wire from the host program is called; the other is called as the port is."""

MOST_AHEAD = 4096
"""Bytes that a driver holds before it lets a writer wait, about: none is timed later than these."""


class Departures:
    """When bytes that are passed on leave at the line's pace, one after the other."""

    def __init__(self, baud: int) -> None:
        self.pace(baud)
        self.free_ns = 0
        """When the latest of them leaves."""

    def pace(self, baud: int) -> None:
        """From now on the line has this speed, bits per second."""
        self._byte_ns = byte_time_ns(baud)

    def last_of(self, count: int, now_ns: int) -> int:
        """When the last of `count` bytes that are put onto the line now has left it."""
        taken_ns = count * self._byte_ns
        latest_ns = now_ns + max(taken_ns, MOST_AHEAD * self._byte_ns)
        self.free_ns = min(max(self.free_ns, now_ns) + taken_ns, latest_ns)
        return self.free_ns


class BridgeSource:
    """The chunks and events of both directions, in order; iterate once.

    `opened` comes for the port at once, and for the host's wire whenever a host program comes. The
    last item is the port's `lost` or `closed`; then the port is closed, and the pseudo-terminal is
    hung up, as an adapter's device is that was unplugged.
    """

    end: SourceEnd | None = None
    """How the passing on ended, though items may still wait to be taken; None while it goes on."""

    def __init__(
        self,
        port: serial.Serial,
        name: str,
        host: HostEnd,
        clock: Clock,
        *,
        detail: str = "",
        capacity: int = CAPACITY,
    ) -> None:
        """Take over an open port and a host's end; both are closed when the source ends.

        Args:
            port: as `open_port` gives it.
            name: what chunks and events call the port; the host's wire is called HOST.
            host: where host programs come.
            clock: what chunks and events are stamped with.
            detail: how the port was opened, for the event.
            capacity: how many bytes of each wire may wait for the consumer.
        """
        self.names = (name, HOST)
        self._port = port
        self._host = host
        self._clock = clock
        self._read = reader_of(port)
        self._put = outlet_of(port)
        self._baud = port.baudrate
        self._lines = port.dtr, port.rts
        self._departures = Departures(self._baud)
        self._backlogs = {wire: Backlog(wire, capacity) for wire in self.names}
        self._stopping = False
        self._lost: OSError | None = None
        self._not_given = 0
        self._not_taken = 0
        self._tell(name, PortEventKind.OPENED, detail)
        self._control = threading.Thread(
            target=self._pass_on_control, name="host to port", daemon=True
        )
        self._feedback = threading.Thread(target=self._run, name="port to host", daemon=True)
        self._control.start()
        self._feedback.start()

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """By wire: how much earlier than the times say bytes may have been on it."""
        return dict.fromkeys(self.names, 0)

    @property
    def device(self) -> str:
        """What a host program is to open."""
        return self._host.name

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from heapq.merge(*self._backlogs.values(), key=_time_of)
        finally:
            self.close()

    def __enter__(self) -> BridgeSource:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def stop(self) -> None:
        """Ask for the end: what has arrived until now is still passed on and yielded.

        Returns at once; may be called from any thread and from signal handlers, and repeatedly.
        """
        self._stopping = True

    def close(self) -> None:
        """Stop, wait for the threads (some 10 ms), and close both ends."""
        self.stop()
        self._feedback.join()
        _refuse_others(self._port, termios.TIOCNXCL)
        self._port.close()

    def _run(self) -> None:
        try:
            self._pass_on_feedback()
        except OSError as error:
            self._lost = self._lost or error
        self._stopping = True
        self._control.join()
        self._tell_of_drops()
        if self._not_taken:
            detail = f"{self._not_taken} bytes of the host program: the port did not take them"
            self._tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_taken)
        self._host.close()
        port = self.names[0]
        if self._lost is None:
            self.end = SourceEnd.STOPPED
            self._tell(port, PortEventKind.CLOSED, "as asked")
        else:
            self.end = SourceEnd.LOST
            self._tell(port, PortEventKind.LOST, one_line(self._lost))
        for backlog in self._backlogs.values():
            backlog.end()

    def _pass_on_feedback(self) -> None:
        while True:
            # Looked at before the read: what has arrived when `stop` is called is read yet.
            last = self._stopping
            data = self._read()
            now_ns = self._clock.now_ns()
            dropped = self._host.write(data)
            self._hand_on(self.names[0], now_ns, data)
            if dropped:
                self._drop(dropped)
            elif not self._host.behind:
                self._tell_of_drops()
            if last:
                return

    def _pass_on_control(self) -> None:
        while True:
            last = self._stopping
            present = self._host.present
            data = self._host.read()
            try:
                if self._host.present != present:
                    self._tell_of_presence(not present)
                if self._host.present:
                    self._follow_baud()
                self._pass_on(data)
            except (OSError, termios.error) as error:
                self._lost = self._lost or OSError(*error.args)
                self._stopping = True
                return
            if last:
                return

    def _pass_on(self, data: bytes) -> None:
        """Put the host's bytes onto the line, all of them; an empty chunk tells of silence."""
        if not data:
            self._hand_on(HOST, self._now_ns(HOST), b"")
        while data:
            count = self._put(data)
            t_ns = self._departures.last_of(count, self._clock.now_ns())
            self._hand_on(HOST, t_ns, data[:count])
            data = data[count:]
            if self._stopping and not count:
                self._not_taken += len(data)
                return

    def _tell_of_presence(self, present: bool) -> None:
        kind = PortEventKind.OPENED if present else PortEventKind.CLOSED
        self._tell(HOST, kind, f"a host program {'has' if present else 'left'} {self._host.name}")

    def _follow_baud(self) -> None:
        baud = self._host.baud()
        if baud == self._baud:
            return
        before, self._baud = self._baud, baud
        if not baud:
            self._set_lines(False, False)
            detail = "the host program hung up (0 baud): DTR and RTS are off"
            self._tell(HOST, PortEventKind.BAUD_CHANGED, detail)
            return
        if not before:
            self._set_lines(*self._lines)
        try:
            if not BAUD_RANGE[0] <= baud <= BAUD_RANGE[1]:
                raise ValueError(f"{baud} baud is out of range")
            self._port.baudrate = baud
        except (ValueError, OSError, termios.error) as error:
            detail = f"{baud} baud is refused by the port: {one_line(error)}"
            self._tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
            return
        self._departures.pace(baud)
        kind = PortEventKind.BAUD_CHANGED
        self._tell(HOST, kind, f"the host program asks for {baud} baud", baud)
        self._tell(self.names[0], kind, f"it has {baud} baud now", baud)

    def _set_lines(self, dtr: bool, rts: bool) -> None:
        # A port without such lines refuses; one that is lost is met by the next read.
        with suppress(OSError):
            self._port.dtr = dtr
        with suppress(OSError):
            self._port.rts = rts

    def _drop(self, count: int) -> None:
        if not self._not_given:
            detail = "the host program does not read: what comes for it is dropped, but kept here"
            self._tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
        self._not_given += count

    def _tell_of_drops(self) -> None:
        if self._not_given:
            detail = f"{self._not_given} bytes were kept here, but not given to the host program"
            self._tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_given)
            self._not_given = 0

    def _hand_on(self, wire: str, t_ns: int, data: bytes) -> None:
        self._backlogs[wire].put(Chunk(wire, t_ns, data))

    def _tell(self, wire: str, kind: PortEventKind, detail: str, count: int = 0) -> None:
        self._backlogs[wire].tell(PortEvent(self._now_ns(wire), wire, kind, detail, count))

    def _now_ns(self, wire: str) -> int:
        """The time now, but behind all that was put onto the host's wire."""
        now_ns = self._clock.now_ns()
        return max(now_ns, self._departures.free_ns) if wire == HOST else now_ns


def _time_of(item: Item) -> int:
    return item.t_ns or 0


def _refuse_others(port: serial.Serial, request: int) -> None:
    """Let a host program that is told the wrong name be refused, rather than take bytes away."""
    with suppress(OSError):  # no terminal, or closed already
        fcntl.ioctl(port.fileno(), request)


def open_bridge(
    name: str, settings: PortSettings, clock: Clock, link: Path | None = None
) -> BridgeSource:
    """Open a port for the bridge alone, and a pseudo-terminal in front of it.

    Raises:
        PortError: as `open_port` does.
        FileError: something is in the way of `link`, or it cannot be made.
    """
    port = open_port(name, settings)
    try:
        host = HostEnd(settings.baud, link)
    except BaseException:
        port.close()
        raise
    _refuse_others(port, termios.TIOCEXCL)
    detail = f"{settings}; a host program can open {host.name}"
    return BridgeSource(port, name, host, clock, detail=detail)
