"""Owns being between a host program and the controller as a wiring for a capture.

It must not know how bytes are passed on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fte_sniff.capture.bridge.source import BridgeSource, open_bridge
from fte_sniff.capture.bridge.wires import HOST
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.ports.opening import DEFAULT_SETTINGS, PortSettings


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
