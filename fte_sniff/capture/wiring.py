"""Which ports a capture opens, and how: one value, whose fields can go to another process as JSON.

read      each port is opened, and only read
bridge    a host program's pseudo-terminal is connected to the port
attach    the port stays closed; what another program reads and writes is watched
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.lasting_name import LastingPort
from fte_sniff.capture.port_source import connect_port
from fte_sniff.capture.serial_port import DEFAULT_SETTINGS, PortSettings
from fte_sniff.capture.source import HOST, Source
from fte_sniff.errors import UsageError, encodable, printable
from fte_sniff.protocol.items import PortEventKind

Way: TypeAlias = Literal["read", "bridge", "attach"]


@dataclass(frozen=True, slots=True)
class Wiring:
    """The ports of a capture; raises UsageError if one is named twice."""

    ports: Sequence[str]
    """Devices, or URLs that pyserial opens; one for a bridge, or to attach."""
    settings: PortSettings = DEFAULT_SETTINGS
    """How each port is opened; of an attached one, the baud is used for the load of the line."""
    way: Way = "read"
    link: str | None = None
    """The link that a bridge makes for host programs."""
    pid: int | None = None
    """The process to attach to; None for all that have the port open."""
    reconnect: bool = True
    """True to wait for what is lost and can come back: no bridge without a link, as the next one
    has another name, and no process that is named."""

    def __post_init__(self) -> None:
        if len(set(self.ports)) < len(self.ports):
            raise UsageError(
                f"{printable(self.ports[-1])} is named twice: name the port of the other wire "
                "(for simulated ones: 'sim://?wire=control' 'sim://?wire=feedback')"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The wires in chunks, rows and events; first that from the controller."""
        ports = tuple(map(encodable, self.ports))
        return ports if self.way == "read" else (ports[0], HOST)

    def open(self, clock: Clock) -> Source:
        """Open all ports, to be read once the source is entered.

        Raises PortError or FileError, with the fix and with none open, if one fails.
        """
        if self.way == "attach":
            from fte_sniff.capture.attach import LIMITS, connect_strace

            watch = partial(connect_strace, self.ports[0], self.pid, clock)
            source = Source([watch], clock, reconnect=self.reconnect and self.pid is None)
            source.note(PortEventKind.WIRING, LIMITS)
            return source
        lasting = [LastingPort(name, self.settings) for name in self.ports]
        if self.way == "bridge":
            from fte_sniff.capture.bridge import connect_bridge

            bridge = partial(connect_bridge, lasting[0], self.link, clock)
            return Source([bridge], clock, reconnect=self.reconnect and self.link is not None)
        connects = [partial(connect_port, one, clock) for one in lasting]
        return Source(connects, clock, reconnect=self.reconnect)
