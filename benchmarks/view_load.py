"""Benchmark of `view` on very large recordings: first rows, loading, models, memory.

    python -m benchmarks.view_load [--rows 1000000 10000000]

`fte-sniff view` runs in another process on a pseudo-terminal of 80 by 24 and is measured at its
other end. Times are also given as a ratio to reading the same file by columns, or to `python -c
'import textual.app'` (in alternation, the best of some rounds), in the same run. Loading ends when
the title says so; the models are complete when the statistics report no rows to go.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.recording_speed import PORTS, batches
from benchmarks.screen_speed import Terminal
from fte_sniff.recording.reader import Recording
from tests.support.recorded_rows import write_recording

FEW = 1_000
_ROW = re.compile(rb"[0-9]{2}:[0-9]{2}:[0-9]{2}\.[0-9]{3}")
_LOADED = b" FILE "
_TO_GO = b"rows to go"
_LONGEST_S = 600
ROUNDS = 7
"""Starts that are timed; the best counts, since other programs slow most of them down."""


def main() -> None:
    """Print a line for each size."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, nargs="+", default=[1_000_000, 10_000_000])
    parser.add_argument("--keep", type=int, help="rows that the screen keeps", default=None)
    parser.add_argument("--folder", type=Path, help="where the recordings go for the while")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        base_mb = _viewed(_recording(Path(folder), FEW), options.keep)[2]
        print(f"a view of {FEW:,} rows: {base_mb:.0f} MB")
        print(
            "      rows  first rows s  to bare   rows/s loading  to reading   models s"
            "     MB  bytes/row  G, g ms"
        )
        for rows in options.rows:
            print(_line(_recording(Path(folder), rows), rows, options.keep, base_mb), flush=True)


def _line(path: Path, rows: int, keep: int | None, base_mb: float) -> str:
    first_s, bare_s = _first_rows(path, keep)
    began = time.perf_counter()
    for _ in Recording(path).batches():
        pass
    reading_s = time.perf_counter() - began
    loading_s, models_s, held_mb, jumps_ms = _viewed(path, keep)
    return (
        f"{rows:>10,} {first_s:>13.2f} {first_s / bare_s:>8.2f} {rows / loading_s:>16,.0f}"
        f" {loading_s / reading_s:>11.2f} {models_s:>10.2f} {held_mb:>6.0f}"
        f" {(held_mb - base_mb) * 2**20 / rows:>10.1f}  {jumps_ms[0]:.0f}, {jumps_ms[1]:.0f}"
    )


def _recording(folder: Path, rows: int) -> Path:
    path = folder / f"{rows}.mcap"
    write_recording(path, PORTS, batches(rows))
    return path


def _first_rows(path: Path, keep: int | None) -> tuple[float, float]:
    """Seconds to the first rows, and of the bare import; the best of each."""
    firsts, bares = [], []
    for _ in range(ROUNDS):
        began = time.monotonic()
        subprocess.run([sys.executable, "-c", "import textual.app"], check=True)
        bares.append(time.monotonic() - began)
        began = time.monotonic()
        terminal = Terminal(_command(path, keep))
        terminal.wait_for(lambda drawn: bool(_ROW.search(drawn)), _LONGEST_S)
        firsts.append(time.monotonic() - began)
        terminal.end()
    return min(firsts), min(bares)


def _command(path: Path, keep: int | None) -> list[str]:
    kept = [] if keep is None else ["--keep-rows", f"{keep}"]
    return [sys.executable, "-m", "fte_sniff", "view", *kept, str(path)]


def _viewed(path: Path, keep: int | None) -> tuple[float, float, float, list[float]]:
    """Seconds of loading and of the models after it, megabytes, and milliseconds of jumps."""
    began = time.monotonic()
    terminal = Terminal(_command(path, keep))
    drawn = bytearray()

    def see(seconds: float) -> bytes:
        drawn.extend(terminal.read(seconds))
        return bytes(drawn)

    while not _ROW.search(see(0.01)):
        _check(began)
    first = time.monotonic()
    while _LOADED not in see(0.02):
        _check(began)
        drawn[: -len(_LOADED)] = b""
    loaded = time.monotonic()
    terminal.press(b"S")
    _wait_for_models(terminal)
    counted = time.monotonic()
    held = terminal.usage()[1]
    terminal.press(b"S")
    jumps = []
    for key in (b"G", b"g"):
        terminal.read(0.5)
        terminal.press(key)
        jumps.append(1000 * terminal.wait_for(lambda seen: bool(_ROW.search(seen)), 30))
    terminal.end()
    return loaded - first, counted - loaded, held, jumps


def _wait_for_models(terminal: Terminal) -> None:
    """Wait until the statistics report no rows to go."""
    began = time.monotonic()
    terminal.read(0.5)
    terminal.press(b"SS")
    while _TO_GO in terminal.read(0.5):
        _check(began)
        terminal.press(b"SS")


def _check(began: float) -> None:
    if time.monotonic() - began > _LONGEST_S:
        raise TimeoutError("the screen does not get there in time")


if __name__ == "__main__":
    main()
