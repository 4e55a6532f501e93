"""Delay that the bridge adds, compared with a bare pseudo-terminal.

A frame is written at one end and timed until its last byte is at the other, in both directions. The
real program bridges, frames, records and prints; the bare terminal shows the delay of the system.

    python -m benchmarks.bridge_delay [--frames N]
"""

from __future__ import annotations

import argparse
import os
import select
import subprocess
import sys
import tempfile
import time
import tty
from contextlib import suppress
from pathlib import Path

import numpy as np

from benchmarks.paced_line import frames_of

GAP_S = 0.002
"""Time between two frames, seconds: a host program that sends 500 commands a second."""

_BOUND_S = 30.0


def delays_ms(there: int, back: int, frames: int) -> np.ndarray:
    """Time from writing a frame to `there` until all of it was read from `back`, milliseconds."""
    poll = select.poll()
    poll.register(back, select.POLLIN)
    found = np.empty(frames)
    cycle = frames_of("position")
    for at in range(frames):
        frame, received = cycle[at % len(cycle)], b""
        start_ns = time.perf_counter_ns()
        os.write(there, frame)
        while len(received) < len(frame):
            if not poll.poll(_BOUND_S * 1000):
                raise RuntimeError("a frame did not arrive")
            received += os.read(back, 4096)
        found[at] = (time.perf_counter_ns() - start_ns) / 1e6
        if received != frame:
            raise RuntimeError("a frame arrived damaged")
        time.sleep(GAP_S)
    return found


def bare(frames: int) -> dict[str, np.ndarray]:
    """The delays of one pseudo-terminal alone."""
    far, near = os.openpty()
    tty.setraw(near)
    found = {"bare terminal": delays_ms(far, near, frames)}
    os.close(far)
    os.close(near)
    return found


def bridged(frames: int) -> dict[str, np.ndarray]:
    """The delays of the bridge, in both directions."""
    with tempfile.TemporaryDirectory() as name:
        far, near = os.openpty()
        tty.setraw(near)
        link = Path(name) / "host"
        command = [sys.executable, "-m", "fte_sniff", "bridge", os.ttyname(near)]
        options = ["--link", str(link), "-o", str(Path(name) / "x.mcap"), "--plain"]
        quiet = subprocess.DEVNULL
        with subprocess.Popen([*command, *options], stdout=quiet, stderr=quiet) as bridge:
            host = _opened(link, bridge)
            # The bridge may not have noticed the host program at the first frame.
            delays_ms(host, far, 1)
            found = {
                "host to port": delays_ms(host, far, frames),
                "port to host": delays_ms(far, host, frames),
            }
            os.close(host)
            bridge.terminate()
        os.close(far)
        os.close(near)
        return found


def _opened(link: Path, bridge: subprocess.Popen[bytes]) -> int:
    deadline = time.monotonic() + _BOUND_S
    while time.monotonic() < deadline and bridge.poll() is None:
        with suppress(FileNotFoundError):
            return os.open(link, os.O_RDWR | os.O_NOCTTY)
        time.sleep(0.01)
    raise RuntimeError("the bridge does not start")


def main() -> None:
    """Measure in one run, and print the percentiles."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=3000)
    frames = parser.parse_args().frames
    measured = bare(frames) | bridged(frames)
    base = float(np.median(next(iter(measured.values()))))
    heads = " ".join(f"{head:>7}" for head in ("p50", "p90", "p99", "max"))
    print(f"{'way, ms':<14} {heads}  added p50  added p99")
    for name, found in measured.items():
        middle, high, higher, most = np.percentile(found, (50, 90, 99, 100))
        print(
            f"{name:<14} {middle:7.3f} {high:7.3f} {higher:7.3f} {most:7.3f} "
            f"{middle - base:10.3f} {higher - base:10.3f}"
        )


if __name__ == "__main__":
    main()
