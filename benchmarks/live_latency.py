"""Time from a frame's last byte on a pseudo-terminal to its row: plain lines, JSON lines, screen.

python -m benchmarks.live_latency [frames]

Each frame has a position of its own, which the output is searched for. As a terminal does, the
benchmark also reads between two frames. Prints the median and the 95th percentile in milliseconds.
"""

from __future__ import annotations

import fcntl
import os
import pty
import random
import select
import struct
import sys
import termios
import time
import tty
from pathlib import Path
from statistics import median, quantiles
from tempfile import TemporaryDirectory

from benchmarks.live_program import SIZE
from fte_sniff.protocol.spec import KIND_BY_NAME, encode

_BOUND_S = 60.0


def read_until(screen: int, wanted: bytes) -> None:
    """Read the output until it has some bytes."""
    found, deadline = b"", time.monotonic() + _BOUND_S
    while wanted not in found:
        if not select.select([screen], [], [], max(0.0, deadline - time.monotonic()))[0]:
            raise RuntimeError(f"no {wanted!r} in {found[-500:]!r}")
        found = found[-1000:] + os.read(screen, 1 << 16)


def read_for(screen: int, seconds: float) -> None:
    """Read the output for some time, so that the program never waits for its terminal."""
    deadline = time.monotonic() + seconds
    while (rest := deadline - time.monotonic()) > 0:
        if select.select([screen], [], [], rest)[0]:
            os.read(screen, 1 << 16)


def delays_ms(options: tuple[str, ...], frames: int, folder: Path) -> list[float]:
    """The delay of each frame in `live` with these options."""
    far, near = os.openpty()
    tty.setraw(near)
    pid, screen = pty.fork()
    if pid == 0:
        words = ["live", os.ttyname(near), *options, "-o", str(folder / "x.mcap"), "--force"]
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", *SIZE, 0, 0))
        root = str(Path(__file__).parents[1])
        environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": root}
        os.execve(sys.executable, [sys.executable, "-m", "fte_sniff", *words], environment)
    found: list[float] = []
    try:
        read_until(screen, b"recording to" if options else b"LIVE")
        read_for(screen, 1)
        for number in range(frames):
            read_for(screen, random.uniform(0.1, 0.3))
            pulses = 1_000_001 + 7 * number
            values = {"motor": 1, "rpm": 1, "pulses": pulses}
            os.write(far, encode(KIND_BY_NAME["position"], values))
            begun = time.perf_counter()
            read_until(screen, str(pulses).encode())
            found.append((time.perf_counter() - begun) * 1000)
    finally:
        os.write(screen, b"\x03" if options else b"Q")
        os.waitpid(pid, 0)
    return found


def main() -> None:
    """Print a line for each kind of output."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    for name, options in {
        "plain": ("--plain",),
        "JSON lines": ("--format", "jsonl"),
        "screen": (),
    }.items():
        with TemporaryDirectory() as folder:
            own = delays_ms(options, frames, Path(folder))
        print(f"{name:<12} median {median(own):5.0f} ms, 95 % {quantiles(own, n=20)[-1]:5.0f} ms")


if __name__ == "__main__":
    main()
