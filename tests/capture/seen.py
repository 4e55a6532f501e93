"""What a source gives, taken by a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Self

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.capture.source import Received, Source
from fte_sniff.capture.wiring import Wiring
from fte_sniff.protocol.items import Chunk, PortEvent
from tests.beside import Work
from tests.pseudo_terminals import Pty
from tests.waiting import wait_until

CLOCK = Clock.tied()


class Seen:
    """The items of a source; it is stopped at the end of a block."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.items: list[Received] = []
        self._work = Work(self._take)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.end()

    def _take(self) -> None:
        for batch in self.source:
            self.items += batch

    def chunks(self, wire: str | None = None) -> list[Chunk]:
        """The chunks with bytes, of one wire or of all."""
        chunks = [one for one in list(self.items) if isinstance(one, Chunk) and one.data]
        return [one for one in chunks if wire in (None, one.port)]

    def data(self, wire: str | None = None) -> bytes:
        return b"".join(chunk.data for chunk in self.chunks(wire))

    def events(self, wire: str | None = None) -> list[PortEvent]:
        events = [one for one in list(self.items) if isinstance(one, PortEvent)]
        return [one for one in events if wire in (None, one.port)]

    def kinds(self, wire: str | None = None) -> list[str]:
        return [event.kind.value for event in self.events(wire)]

    def times(self, wire: str) -> list[int]:
        return [one.t_ns or 0 for one in self.items if one.port == wire]

    def wait_for(self, kind: str, count: int = 1, wire: str | None = None) -> PortEvent:
        """Wait for the event of a kind that is the `count`th; returns it."""
        wait_until(lambda: self.kinds(wire).count(kind) >= count)
        return [event for event in self.events(wire) if event.kind == kind][count - 1]

    def wait(self, holds: Callable[[Seen], object]) -> None:
        wait_until(lambda: holds(self))

    def ended(self) -> None:
        """Wait for the end of the source."""
        self._work.ended()

    def end(self) -> None:
        self.source.stop()
        self.ended()


class Adapter:
    """A link such as udev keeps, and one for host programs."""

    def __init__(self, folder: Path) -> None:
        self._fresh, self.link = folder / "new", folder / "motors"
        self.name = str(folder / "usb-FTDI-if00-port0")

    def plug(self, pty: Pty) -> None:
        self._fresh.symlink_to(pty.device)
        self._fresh.rename(self.name)

    def pull(self, pty: Pty) -> None:
        Path(self.name).unlink()
        pty.unplug()


def opened(*names: str, reconnect: bool = False, **settings: object) -> Source:
    """A source of ports."""
    return Wiring(names, PortSettings(**settings), reconnect=reconnect).open(CLOCK)  # type: ignore[arg-type]
