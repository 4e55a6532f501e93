"""Owns the bridge as a source: an exchange, and another one when a lost port has come back.

It must not know of frames, nor how bytes are passed on.

    opened -> exchange -> stopped: closed
                       -> lost:    the pseudo-terminal is hung up; wait, and begin again
"""

from __future__ import annotations

import fcntl
import termios
import threading
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

import serial

from fte_sniff.capture.bridge.exchange import Exchange
from fte_sniff.capture.bridge.host_end import HostEnd
from fte_sniff.capture.bridge.wires import HOST, Wires
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.holders import sharing_note
from fte_sniff.capture.items import Item, SourceEnd
from fte_sniff.capture.latency import ask_low_latency
from fte_sniff.capture.lateness import lateness_ns
from fte_sniff.capture.ports import PortSettings, device_of, open_port
from fte_sniff.capture.refusal import one_line
from fte_sniff.capture.returning import Opened, Reopen, Return, way_back
from fte_sniff.errors import FileError
from fte_sniff.protocol import PortEventKind
from fte_sniff.said import Said

_BEAT_S = 0.05
"""Seconds between two signs of life while a port is waited for."""


class BridgeSource:
    """The chunks and events of both directions, in order of their times; iterate once.

    `opened` comes for the port at once, and for the host's wire whenever a host program comes. The
    last item is the port's `lost` or `closed`; then the port is closed, and the pseudo-terminal is
    hung up, as an adapter's device is that was unplugged.
    """

    end: SourceEnd | None = None
    """How the passing on ended, though items may still wait to be taken; None while it goes on."""

    def __init__(
        self,
        port: serial.Serial,
        host: HostEnd,
        wires: Wires,
        *,
        detail: str = "",
        reopen: Reopen | None = None,
    ) -> None:
        """Take over an open port and a host's end; both are closed when the source ends.

        Args:
            port: as `open_port` gives it; no other program can open it from now on.
            host: where host programs come.
            wires: what is told of both.
            detail: how the port was opened, for the event.
            reopen: how to open the port again when it is lost; None to end then.
        """
        self.device = host.name
        """What a host program is to open."""
        self._port = port
        self._host = host
        self._wires = wires
        self._reopen = reopen
        self._stopping = False
        self._low_latency = ask_low_latency(port)
        self._lateness_ns = lateness_ns(port)
        _refuse_others(port, termios.TIOCEXCL)
        self._exchange = Exchange(port, host, wires)
        self._tell(PortEventKind.OPENED, detail)
        self._thread = threading.Thread(target=self._run, name="port to host", daemon=True)
        self._thread.start()

    @property
    def uncertainty_ns(self) -> Mapping[str, int]:
        """By wire: how much earlier than the times say bytes may have been on it."""
        return {self._wires.port: self._lateness_ns, HOST: 0}

    @property
    def granted(self) -> Mapping[str, str]:
        """By port: what its driver granted when it was opened. Line errors are not asked for.

        The marks that they need would be taken away whenever a host program sets its baud.
        """
        return {self._wires.port: str(self._low_latency), HOST: "a pseudo-terminal"}

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from self._wires
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
        self._exchange.end()

    def stop_at(self, t_ns: float) -> None:
        """Ask for the end at a time of the clock, as `stop` would then; returns at once."""
        self._wires.end_ns = t_ns

    @property
    def waiting(self) -> int:
        """How many bytes of both wires wait to be taken."""
        return self._wires.waiting

    def drop(self) -> None:
        """Once it has ended: yield no more bytes, but an overrun a wire that counts them."""
        self._wires.drop()

    def close(self) -> None:
        """Stop, wait for the threads (some 10 ms), and close both ends."""
        self.stop()
        self._thread.join()
        self._close_port()

    def _run(self) -> None:
        try:
            self._exchange_until_the_end()
        finally:
            self._wires.end()

    def _exchange_until_the_end(self) -> None:
        while (error := self._exchange.run()) is not None:
            self._host.close()
            lost = one_line(error)
            if self._reopen is None:
                self._finish(SourceEnd.LOST, lost)
                return
            self._tell(PortEventKind.LOST, Said("{lost}; waiting for it to come back", lost=lost))
            opened, away_s = self._wait_for_return(self._reopen)
            if opened is None:
                break
            try:
                self._take_over(opened, away_s)
            except FileError as refused:
                self._finish(SourceEnd.LOST, refused.said)
                return
        else:
            self._host.close()
        self._finish(SourceEnd.STOPPED, Said("as asked"))

    def _wait_for_return(self, reopen: Reopen) -> tuple[Opened | None, float]:
        """The port once it is open again, None if the end is asked for; and how long, seconds.

        Both lines are told to be silent meanwhile, so that nothing waits for them.
        """
        lost_ns = self._wires.now_ns()
        self._close_port()
        returning = Return(reopen)
        while not (self._stopping or self._wires.due):
            opened = returning.wait(_BEAT_S)
            away_s = (self._wires.now_ns() - lost_ns) / 1e9
            if opened is not None:
                return opened, away_s
            if refusal := returning.refusal():
                self._tell(PortEventKind.NOT_OPENED, refusal)
            self._wires.read(self._wires.now_ns(), b"")
            self._wires.written(b"")
        returning.give_up()
        return None, 0

    def _take_over(self, opened: Opened, away_s: float) -> None:
        self._port = opened.port
        ask_low_latency(self._port)
        _refuse_others(self._port, termios.TIOCEXCL)
        self._host = self._host.again(self._port.baudrate)
        named = "" if opened.name == self._wires.port else Said(" as {port}", port=opened.name)
        self._tell(
            PortEventKind.FOUND_AGAIN,
            Said("after {seconds:.1f} s{named}", seconds=away_s, named=named),
        )
        self._wires.start_again(self._port.baudrate)
        self._exchange = Exchange(self._port, self._host, self._wires)
        if self._stopping:
            self._exchange.end()

    def _finish(self, end: SourceEnd, detail: str) -> None:
        self.end = end
        kind = PortEventKind.LOST if end is SourceEnd.LOST else PortEventKind.CLOSED
        self._tell(kind, detail)

    def _tell(self, kind: PortEventKind, detail: str) -> None:
        self._wires.tell(self._wires.port, kind, detail)

    def _close_port(self) -> None:
        _refuse_others(self._port, termios.TIOCNXCL)
        with suppress(OSError):  # a driver may complain of what is gone
            self._port.close()


def _refuse_others(port: serial.Serial, request: int) -> None:
    """Let a host program that is told the wrong name be refused, rather than take bytes away."""
    with suppress(OSError):  # no terminal, or closed already
        fcntl.ioctl(port.fileno(), request)


def open_bridge(
    name: str,
    settings: PortSettings,
    clock: Clock,
    link: Path | None = None,
    *,
    reconnect: bool = False,
) -> BridgeSource:
    """Open a port for the bridge alone, and a pseudo-terminal in front of it.

    Args:
        name: as `open_port` takes it.
        settings: how to open it.
        clock: what chunks and events are stamped with.
        link: a link to make to the pseudo-terminal.
        reconnect: wait for the port when it is lost, if it is one that can return and there is a
            link: a pseudo-terminal's own name would be another one then.

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
    return BridgeSource(
        port,
        host,
        Wires(name, settings.baud, clock),
        detail=Said(
            "a host program can open {name}; {settings}{shared}",
            name=host.name,
            settings=str(settings),
            shared=sharing_note(device_of(port)),
        ),
        reopen=way_back(name, settings, port) if reconnect and link is not None else None,
    )
