"""Memory of a capture process while many rows go through it.

The real capture process frames, orders and records two wires that deliver frames as fast as they
are read, so that the result does not depend on a pace or a busy machine; a view receives the rows
and discards them. Flat means: no more at the end than after the first tenth.

    python -m benchmarks.capture_memory [--rows N]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path

from benchmarks.live_program import taken
from benchmarks.paced_line import frames_of
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.capture.source import Item
from fte_sniff.capture.wiring import Wiring
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from fte_sniff.session import control
from fte_sniff.session.control import CapturePlan
from fte_sniff.session.live_session import LiveSession

WIRES = {"control": "position", "feedback": "position_feedback"}
A_CHUNK = 30
"""Frames in one read: one millisecond at 3,000,000 baud."""

_CHUNK_NS = 1_000_000


class FlatOut:
    """A source of both wires that always has the next frames ready."""

    is_over = False
    lost = None
    device = None
    uncertainty_ns: Mapping[str, int] = dict.fromkeys(WIRES, 1_000_000)

    def __init__(self, rows: int, start_ns: int) -> None:
        self._rows = rows
        self._start_ns = start_ns
        self._stopping = False

    def __iter__(self) -> Iterator[Item]:
        t_ns = self._start_ns
        for wire in WIRES:
            yield PortEvent(t_ns, wire, PortEventKind.OPENED, "")
        cycles = {wire: frames_of(kind) for wire, kind in WIRES.items()}
        for at in range(0, self._rows // len(WIRES), A_CHUNK):
            t_ns += _CHUNK_NS
            for wire, cycle in cycles.items():
                start = at % (len(cycle) - A_CHUNK)
                yield Chunk(wire, t_ns, b"".join(cycle[start : start + A_CHUNK]))
            if self._stopping:
                break
        self.is_over = True
        for wire in WIRES:
            yield PortEvent(t_ns, wire, PortEventKind.CLOSED, "")

    def __enter__(self) -> FlatOut:
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Request the end."""
        self._stopping = True

    def stop_at(self, t_ns: float) -> None:
        """Do nothing: it ends after its rows."""

    @property
    def waiting(self) -> int:
        """Always 0."""
        return 0

    def drop(self) -> None:
        """Do nothing: nothing waits."""

    def close(self) -> None:
        """Request the end: there is nothing to close."""
        self.stop()


_PATH_ENDS = "del sys.path[0]"
START = control._START.replace(
    _PATH_ENDS, f"import benchmarks.capture_memory as m; m.replace_source()\n{_PATH_ENDS}"
)
"""How the capture process starts, with `FlatOut` as its source."""


def replace_source() -> None:
    """Let every wiring open `FlatOut`; the number of rows is that of the plan's port."""
    Wiring.names = property(lambda _: tuple(WIRES))
    Wiring.open = lambda self, clock: FlatOut(int(self.ports[0]), clock.now_ns())


def main() -> None:
    """Capture the rows, and print the memory after each twentieth of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    rows = parser.parse_args().rows
    print(f"{'rows':>12} {'MB':>7} {'CPU us/row':>10}")
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "x.mcap"
        start = time.monotonic()
        wiring = Wiring([str(rows)], PortSettings(3_000_000))
        control._START = START
        with closing(LiveSession(CapturePlan(wiring, path))) as session:
            session.begin()
            shown, running = 1, True
            while running:
                state = session.wait(0.1).state
                running = state.running
                if running and state.rows >= shown * rows / 20:
                    now = taken(session.capture_pid)
                    each = now.cpu_s / state.rows * 1e6
                    print(f"{state.rows:>12,} {now.rss_mb:7.1f} {each:10.2f}")
                    shown += 1
        passed = time.monotonic() - start
        print(f"{session.capture.rows:,} rows, {path.stat().st_size / 1e6:,.0f} MB, {passed:.0f} s")


if __name__ == "__main__":
    main()
