"""Owns listening to a line: on one port, or on two with a wire each.

It must not know how a port is read, nor what comes from it.
"""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.ports.opening import DEFAULT_SETTINGS, PortSettings
from fte_sniff.capture.sources.items import Source
from fte_sniff.capture.sources.merged import MergedSource
from fte_sniff.capture.sources.source import open_source
from fte_sniff.errors import UsageError, shown


@dataclass(frozen=True, slots=True)
class Tap:
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
            twice = shown(max(self.names, key=lambda name: meant.count(_meant_by(name))))
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
