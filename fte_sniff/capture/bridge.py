"""Bridge command's source and set-up.

opened -> exchange -> stopped: closed
                   -> lost:    the pseudo-terminal is hung up; wait, and begin again
"""

from __future__ import annotations

import fcntl
import termios
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import serial

from fte_sniff.capture.bridge_io import HOST, Exchange, WireEvents
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import sharing_note
from fte_sniff.capture.pty import HostEnd
from fte_sniff.capture.reconnect import OpenedPort, Reopen, way_back
from fte_sniff.capture.serial_port import (
    DEFAULT_SETTINGS,
    PortSettings,
    ask_low_latency,
    device_of,
    max_latency_ns,
    open_port,
)
from fte_sniff.capture.source import Item, ThreadedSource
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import PortEventKind


class BridgeSource(ThreadedSource):
    """The chunks and events of both directions, in order of their times; iterate once.

    Nothing is passed on until it is entered as a context, or iterated: so whoever is to record it
    can be ready before. It has to be closed then.

    `opened` comes for the port at once, and for the host's wire whenever a host program comes. The
    last item is the port's `lost` or `closed`; then the port is closed, and the pseudo-terminal is
    hung up, as an adapter's device is that was unplugged.
    """

    def __init__(
        self,
        port: serial.Serial,
        host: HostEnd,
        wires: WireEvents,
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
        super().__init__(wires, wires.clock, reopen)
        self.device = host.name
        """What a host program is to open."""
        self._port = port
        self._host = host
        self._wires = wires
        self._low_latency = ask_low_latency(port)
        self._lateness_ns = max_latency_ns(port)
        _refuse_others(port, termios.TIOCEXCL)
        self._exchange = Exchange(port, host, wires)
        self._detail = detail
        self._begun = False

    def __enter__(self) -> Self:
        """Begin to pass on, if that has not begun."""
        if not self._begun:
            self._begun = True
            self._begin("port to host", self._detail)
        return self

    def __iter__(self) -> Iterator[Item]:
        return super(BridgeSource, self.__enter__()).__iter__()

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

    def stop(self) -> None:
        """Ask for the end: what has arrived until now is still passed on and yielded.

        Returns at once; may be called from any thread and from signal handlers, and repeatedly.
        """
        super().stop()
        self._exchange.end()

    def stop_at(self, t_ns: float) -> None:
        """Ask for the end at a time of the clock, as `stop` would then; returns at once."""
        self._wires.end_ns = t_ns

    def _read_on(self) -> OSError | None:
        error = self._exchange.run()
        self._host.close()
        return error

    def _is_to_end(self) -> bool:
        return self._stopping or self._wires.due

    def _take_over(self, opened: OpenedPort, away_s: float) -> None:
        self._port = opened.port
        ask_low_latency(self._port)
        _refuse_others(self._port, termios.TIOCEXCL)
        self._host = self._host.again(self._port.baudrate)
        named = (
            ""
            if opened.name == self._wires.port
            else TranslatableText(" as {port}", port=opened.name)
        )
        self._tell(
            PortEventKind.FOUND_AGAIN,
            TranslatableText("after {seconds:.1f} s{named}", seconds=away_s, named=named),
        )
        self._wires.start_again(self._port.baudrate)
        self._exchange = Exchange(self._port, self._host, self._wires)
        if self._stopping:
            self._exchange.end()

    def _tell(self, kind: PortEventKind, detail: str) -> None:
        self._wires.tell(self._wires.port, kind, detail)

    def _tell_of_silence(self) -> None:
        self._wires.read(self._wires.now_ns(), b"")
        self._wires.written(b"")

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
        WireEvents(name, settings.baud, clock),
        detail=TranslatableText(
            "a host program can open {name}; {settings}{shared}",
            name=host.name,
            settings=str(settings),
            shared=sharing_note(device_of(port)),
        ),
        reopen=way_back(name, settings, port) if reconnect and link is not None else None,
    )


@dataclass(frozen=True, slots=True)
class Bridge:
    """A port, and a pseudo-terminal that a host program opens instead of it."""

    port: str
    """A device, or a URL that pyserial opens."""
    settings: PortSettings = DEFAULT_SETTINGS
    """How it is opened; the baud is the host program's to change."""
    link: Path | None = None
    """A link to make to the pseudo-terminal; None for none."""
    reconnect: bool = True
    """Whether a port that is lost is waited for, if it can return and there is a link."""

    @property
    def names(self) -> tuple[str, ...]:
        """The wire from the controller, and that from the host program."""
        return (self.port, HOST)

    def open(self, clock: Clock) -> BridgeSource:
        """Open the port; what is passed on waits until the source is entered.

        Raises:
            PortError: it cannot be opened.
            FileError: something is in the way of the link, or it cannot be made.
        """
        return open_bridge(self.port, self.settings, clock, self.link, reconnect=self.reconnect)
