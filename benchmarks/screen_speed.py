"""Benchmark of the screen: first rows, filters, frames, processor time and memory.

python -m benchmarks.screen_speed [--rows 1 10]         a recording of millions of rows is viewed
python -m benchmarks.screen_speed --grow [--rows 1 10]  2,300 rows a second are added to millions
python -m benchmarks.screen_speed --play [--rows 1]     two full wires are played
python -m benchmarks.screen_speed --live                a full wire, without a pane and with each

The screen runs in another process on a pseudo-terminal of 80 by 24, and is measured at its other
end: a frame ends with the end of synchronized output, and the delay is the age of the newest time
of day in it. Recordings are made in a temporary folder.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import select
import signal
import statistics
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.recording_speed import PORTS, batches
from tests.support.recorded_rows import write_recording

PER_SECOND = 2_300
"""Twice the rate of a wire."""
BATCH = 65_536
MILLION = 1_000_000
FILTER = "motor = 1 AND rpm > -2000"
ASKS_FOR_SYNC = b"\x1b[?2026$p"
HAS_SYNC = b"\x1b[?2026;2$y"
FRAME_END = b"\x1b[?2026l"
PANE_KEYS = {"no pane": b"", "detail": b"i", "motors": b"M", "streams": b"T", "findings": b"!"}
"""By name of a page, the key that opens it."""
SPEEDS = (0.1, 1, 10, 100)
"""Speeds of playback that are measured."""
LONGEST_S = 600.0
_CLOCK = re.compile(rb"([0-9]{2}):([0-9]{2}):([0-9]{2})\.([0-9]{3})")
_DAY_MS = 86_400_000


@dataclass
class Terminal:
    """A process on a pseudo-terminal, and its frames."""

    command: list[str]
    _frame: bytes = b""
    frames: int = 0
    ages_ms: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (24, 80))
        environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
        # Some containers disable byte code files; an installed program has them.
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        self.began_s = time.monotonic()
        self.process = subprocess.Popen(
            self.command,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment,
            start_new_session=True,
        )
        os.close(slave)

    def read(self, seconds: float) -> bytes:
        """Read the output of this many seconds; counts frames and their ages."""
        until, found = time.monotonic() + seconds, b""
        while (left := until - time.monotonic()) > 0:
            if not select.select([self._master], [], [], left)[0]:
                break
            chunk = os.read(self._master, 1 << 16)
            if ASKS_FOR_SYNC in chunk:
                os.write(self._master, HAS_SYNC)
            found += chunk
            *whole, self._frame = (self._frame + chunk).split(FRAME_END)
            self.frames += len(whole)
            for frame in whole:
                self._note_age(frame)
        return found

    def _note_age(self, frame: bytes) -> None:
        now_ms = time.time() * 1000 % _DAY_MS
        times = [
            ((int(h) * 60 + int(m)) * 60 + int(s)) * 1000 + int(ms)
            for h, m, s, ms in _CLOCK.findall(frame)
        ]
        if times:
            self.ages_ms.append(now_ms - max(times))

    def wait_for(self, holds: Callable[[bytes], bool], seconds: float = LONGEST_S) -> float:
        """Seconds until the output since the call satisfies `holds`; fails after `seconds`."""
        start, found = time.monotonic(), b""
        while not holds(found):
            if time.monotonic() - start > seconds:
                raise TimeoutError(found[-2000:])
            found += self.read(0.01)
        return time.monotonic() - start

    def press(self, keys: bytes) -> None:
        """Type keys."""
        os.write(self._master, keys)

    def usage(self) -> tuple[float, float]:
        """Processor seconds so far, and resident megabytes."""
        folder = Path(f"/proc/{self.process.pid}")
        ticks = (folder / "stat").read_text().rpartition(")")[2].split()
        lines = (folder / "status").read_text().splitlines()
        held = next(line for line in lines if line.startswith("VmRSS")).split()[1]
        cpu = (int(ticks[11]) + int(ticks[12])) / os.sysconf("SC_CLK_TCK")
        return cpu, int(held) / 1024

    def end(self) -> None:
        """Quit; kill the process where that fails."""
        self.press(b"Q")
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        os.close(self._master)


def main() -> None:
    """Print a line for each measurement."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, nargs="+", default=[1, 10], help="millions")
    parser.add_argument("--seconds", type=float, default=5)
    for name in ("grow", "play", "live"):
        parser.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--folder", type=Path, help="where the recordings are for the while")
    parser.add_argument("--screen", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    counts = [millions * MILLION for millions in options.rows]
    if options.screen:
        _screen(int(options.screen[0]), options.screen[1])
    elif options.grow:
        _print_growing(counts, options.seconds)
    elif options.live:
        _print_live(options.seconds)
    else:
        measured = _print_played if options.play else _print_viewed
        for rows in counts:
            with tempfile.TemporaryDirectory(dir=options.folder) as folder:
                path = Path(folder, f"{rows}.mcap")
                write_recording(path, PORTS, batches(rows))
                measured(path, rows, options.seconds)


def _program(*arguments: object) -> Terminal:
    return Terminal([sys.executable, "-m", "fte_sniff", *map(str, arguments)])


def _measured(terminal: Terminal, seconds: float) -> tuple[float, float, list[float]]:
    """Frames a second, share of a core, and the ages of the newest rows."""
    terminal.frames, terminal.ages_ms = 0, []
    before, start = terminal.usage()[0], time.monotonic()
    terminal.read(seconds)
    took = time.monotonic() - start
    return terminal.frames / took, (terminal.usage()[0] - before) / took, [*terminal.ages_ms]


# A recording


def _print_viewed(path: Path, rows: int, _seconds: float) -> None:
    """Print first rows, loading, a filter, jumps and memory."""
    terminal = _program("view", path)
    terminal.wait_for(lambda drawn: bool(_CLOCK.search(drawn)))
    first_s = time.monotonic() - terminal.began_s
    loading_s = terminal.wait_for(lambda drawn: b" FILE " in drawn)
    terminal.read(1)
    _wait_until_idle(terminal)
    loaded = terminal.usage()
    terminal.press(f"f{FILTER}\r".encode())
    filter_s = terminal.wait_for(lambda drawn: b"rows" in drawn)
    _wait_until_idle(terminal)
    filtered = terminal.usage()
    jumps = [_jump(terminal, key, b"%") for key in (b"G", b"g", b"G")]
    terminal.end()
    print(
        f"{rows:,} rows: first rows after {first_s:.2f} s, loaded {loading_s:.1f} s later and"
        f" examined with {loaded[0]:.1f} s of processor time; {loaded[1]:.0f} MB\n"
        f"  filter: answered after {filter_s:.2f} s, complete with"
        f" {filtered[0] - loaded[0]:.1f} s of processor time; {filtered[1]:.0f} MB; jumps"
        f" {statistics.median(jumps) * 1e3:.0f} ms",
        flush=True,
    )


def _wait_until_idle(terminal: Terminal) -> None:
    """Wait until the program takes less than a tenth of a core for two seconds."""
    while _measured(terminal, 1)[1] > 0.1 or _measured(terminal, 1)[1] > 0.1:
        pass


def _jump(terminal: Terminal, key: bytes, sign: bytes) -> float:
    """Seconds from a key to the frame that has a sign."""
    terminal.read(0.3)
    terminal.press(key)
    return terminal.wait_for(lambda drawn: sign in drawn or bool(_CLOCK.search(drawn)), 20)


def _print_played(path: Path, _rows: int, seconds: float) -> None:
    """Print frames and processor time of playing at several speeds."""
    for pane in ("no pane", "motors"):
        for speed in SPEEDS:
            terminal = _program("view", "--play", f"{speed:g}", path)
            terminal.wait_for(lambda drawn: bool(_CLOCK.search(drawn)))
            terminal.press(PANE_KEYS[pane])
            terminal.read(seconds / 4)
            frames, cpu, _ages = _measured(terminal, seconds)
            held = terminal.usage()[1]
            terminal.press(b" ")
            pause_s = terminal.wait_for(lambda drawn: b"SCROLLED" in drawn, 60)
            terminal.end()
            print(
                f"{speed:>6g}x  {pane:<8} {frames:>5.1f} frames/s {cpu:>5.0%}  {held:>4.0f} MB"
                f"  pauses after {pause_s * 1e3:.0f} ms",
                flush=True,
            )


# Rows that come


def _print_growing(counts: list[int], seconds: float) -> None:
    print(f"80x24, {PER_SECOND} rows/s, {seconds:g} s each")
    print("      rows  filter  frames/s   CPU  delay p50/p99 ms    MB  bytes/row  jump ms")
    terminal = _started(0, "")
    base = terminal.usage()[1]
    terminal.end()
    for rows in counts:
        for text in ("", FILTER):
            terminal = _started(rows, text)
            frames, cpu, ages = _measured(terminal, seconds)
            held = terminal.usage()[1]
            jumps = [_jump(terminal, key, sign) for key, sign in _ENDS * 2]
            terminal.end()
            print(
                f"{rows:>10,}  {'on' if text else 'off':>6}  {frames:>8.1f} {cpu:>5.0%}"
                f"  {_percentile(ages, 50):>6.0f} / {_percentile(ages, 99):>6.0f}    {held:>5.0f}"
                f"  {(held - base) * 2**20 / rows:>9.1f}  {statistics.median(jumps) * 1e3:>7.0f}",
                flush=True,
            )


_ENDS = [(b"g", b"SCROLLED"), (b"G", b"LIVE")]


def _started(rows: int, text: str) -> Terminal:
    terminal = Terminal(
        [sys.executable, "-m", "benchmarks.screen_speed", "--screen", f"{rows}", text]
    )
    terminal.wait_for(lambda drawn: b"READY" in drawn)
    terminal.read(2)
    return terminal


def _percentile(values: list[float], percent: int) -> float:
    if not values:
        return float("nan")
    return sorted(values)[min(len(values) - 1, len(values) * percent // 100)]


def _print_live(seconds: float) -> None:
    """Print frames, processor time and delay of a full wire, for each page."""
    for name, keys in PANE_KEYS.items():
        terminal = _program("live", "--no-record", "sim://?seed=1&rate=1100")
        terminal.wait_for(lambda drawn: bool(_CLOCK.search(drawn)), 60)
        terminal.press(keys)
        terminal.read(3)
        frames, cpu, ages = _measured(terminal, seconds)
        terminal.end()
        print(
            f"{name:<9} {frames:>5.1f} frames/s {cpu:>5.0%}  wire to screen"
            f" {_percentile(ages, 50):.0f} ms (p50), {_percentile(ages, 99):.0f} ms (p99)",
            flush=True,
        )


def _screen(rows: int, text: str) -> None:
    """Run the screen over a feed of old and new rows."""
    import numpy as np

    from fte_sniff.analysis.feed import FeedState, FeedUpdate
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.protocol.rows import Row, Rows
    from fte_sniff.protocol.spec import KIND_BY_NAME, encode
    from fte_sniff.tui.app import run_screen
    from fte_sniff.tui.options import StartOptions
    from tests.support.columns import rows_from

    raws = [
        encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 4, "rpm": number % 2000 - 1000})
        for number in range(4000)
    ]

    def made(first: int, count: int, t_ns: int) -> list[Row]:
        return [Row("p", 10 * n, raws[n % 4000], t_ns) for n in range(first, first + count)]

    def updates() -> Iterator[FeedUpdate]:
        came, old = 0, rows_from(made(0, BATCH, 0))
        step_ns = 10**9 // PER_SECOND
        start_ns = time.time_ns() - rows * step_ns
        while came < rows:
            times = {"t_ns": start_ns + (came + np.arange(BATCH)) * step_ns}
            count = min(BATCH, rows - came)
            came += count
            timed = Rows({**old.columns, **times}, old.ports)
            yield FeedUpdate(FeedState("loading"), timed[:count])
        start = time.monotonic()
        while True:
            due = rows + int((time.monotonic() - start) * PER_SECOND)
            new = made(came, due - came, time.time_ns())
            came = due
            yield FeedUpdate(FeedState("READY"), rows_from(new))

    class GrowingFeed:
        def __init__(self) -> None:
            self._updates = updates()

        def poll(self) -> FeedUpdate:
            return next(self._updates)

        def stop(self) -> None:
            return

    wanted = RowFilter.parse(text) if text else None
    run_screen(GrowingFeed(), StartOptions(row_filter=wanted))


if __name__ == "__main__":
    main()
