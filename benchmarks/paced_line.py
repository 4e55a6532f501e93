"""A line that carries frames at the pace of a baud: a pseudo-terminal and a writing process.

The process never writes faster than the line carries the frames. Bytes that the terminal does not
accept at once are lost, as with a full receiver, and counted.

    python -m benchmarks.paced_line DESCRIPTOR BAUD SECONDS KIND TIMES    (started by `PacedLine`)
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
import tty
from array import array
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fte_sniff.protocol.spec import FRAME_LENGTH, KIND_BY_NAME, byte_time_ns, encode

CLOCK = time.CLOCK_BOOTTIME
"""The clock of a capture."""

TICK_NS = 1_000_000
"""Interval of writes, nanoseconds; faster frames are combined into one write."""

_CYCLE = 4096
"""Frames after which the line repeats."""


@dataclass(frozen=True, slots=True)
class Sent:
    """What was written to a line."""

    frames: int
    refused: int
    """Bytes that the terminal had no room for."""
    times: array[int]
    """When each write began, by CLOCK; empty unless requested."""


class PacedLine:
    """A pseudo-terminal, opened by `device`, that delivers frames of one kind."""

    def __init__(self, kind: str) -> None:
        """Create the line; nothing is sent yet."""
        self._kind = kind
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        os.set_blocking(self.far, False)
        self.device = os.ttyname(self.near)

    def begin(self, baud: int, seconds: float, times: Path | None = None) -> None:
        """Send at the pace of `baud` for some seconds; store write times in a file if given."""
        self._times = times
        arguments = map(str, (self.far, baud, seconds, self._kind, times or ""))
        self._sender = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.paced_line", *arguments],
            pass_fds=[self.far],
            stdout=subprocess.PIPE,
            text=True,
        )

    @property
    def pid(self) -> int:
        """The sending process."""
        return self._sender.pid

    def sent(self) -> Sent:
        """Wait until all is sent; return what was written."""
        output, _ = self._sender.communicate()
        frames, refused = map(int, output.split())
        times = array("q")
        if self._times is not None:
            times.frombytes(self._times.read_bytes())
        return Sent(frames, refused, times)

    def close(self) -> None:
        """Unplug the line."""
        for descriptor in (self.far, self.near):
            with suppress(OSError):
                os.close(descriptor)


def frames_of(kind: str) -> list[bytes]:
    """Frames of a kind, all different, with a changing position."""
    values = {"motor": 1, "rpm": 300, "error": 0, "online": 15}
    entry = KIND_BY_NAME[kind]
    names = {field.name for field in entry.fields}
    own = {name: value for name, value in values.items() if name in names}
    return [encode(entry, {**own, "pulses": at * 37}) for at in range(_CYCLE)]


def _send(descriptor: int, baud: int, seconds: float, kind: str, times: str) -> None:
    frame_ns = FRAME_LENGTH * byte_time_ns(baud)
    a_write = max(1, TICK_NS // frame_ns)
    cycle = frames_of(kind)
    writes = [b"".join((cycle + cycle)[at : at + a_write]) for at in range(_CYCLE)]
    begun: array[int] = array("q")
    frames = refused = 0
    start_ns = due_ns = time.clock_gettime_ns(CLOCK)
    while due_ns < start_ns + seconds * 1e9:
        now_ns = time.clock_gettime_ns(CLOCK)
        if now_ns < due_ns:
            time.sleep((due_ns - now_ns) / 1e9)
            now_ns = time.clock_gettime_ns(CLOCK)
        data = writes[frames % _CYCLE]
        try:
            refused += len(data) - os.write(descriptor, data)
        except BlockingIOError:
            refused += len(data)
        frames += a_write
        if times:
            begun.append(now_ns)
            # A line that is late does not hurry.
            due_ns = max(due_ns, now_ns)
        due_ns += a_write * frame_ns
    if times:
        Path(times).write_bytes(begun.tobytes())
    print(frames, refused)


if __name__ == "__main__":
    _send(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4], sys.argv[5])
