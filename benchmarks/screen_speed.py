"""Benchmark of the screen: frame rate, CPU, memory and delay over millions of rows.

python -m benchmarks.screen_speed [--rows 1 5 10] [--seconds 5]
python -m benchmarks.screen_speed --idle samples/damaged.mcap [--seconds 30]
python -m benchmarks.screen_speed --play [--rows 1 5] [--seconds 5]
python -m benchmarks.screen_speed --live [--seconds 30]

The screen runs in another process on a pseudo-terminal of 80 by 24, and is measured at its other
end: a frame ends with the end of synchronized output, and the delay is the age of the newest time
of day in it. 2,300 rows a second, twice the rate of a wire, are added to the given millions of
rows, without and with a filter. At the end the whole program runs on a simulated wire.

With `--play`, `view` plays a recording of two full wires at several speeds, and at speeds that
change, without a pane and with the motors. With `--live`, `live` shows a full simulated wire; the
last figure is the CPU against that without a pane. With `--idle`, `view` shows a file, and the CPU
is measured while nothing happens, without a pane and with each.
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

PER_SECOND = 2_300
BATCH = 65_536
MILLION = 1_000_000
FILTER = "motor = 1 AND rpm > -2000"
ASKS_FOR_SYNC = b"\x1b[?2026$p"
HAS_SYNC = b"\x1b[?2026;2$y"
FRAME_END = b"\x1b[?2026l"
PANE_KEYS = {"detail": b"i", "bytes": b"b", "motors": b"M", "statistics": b"S", "top": b"T"}
"""By name of a pane or view, the key that opens it."""
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

    def wait_for(self, holds: Callable[[bytes], bool], seconds: float) -> float:
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
        """CPU seconds so far, and resident megabytes."""
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
    """Print a line for each size, without and with a filter."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, nargs="+", default=[1, 5, 10], help="millions")
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--idle", type=Path, metavar="FILE")
    parser.add_argument("--play", action="store_true")
    parser.add_argument("--live", action="store_true")
    parser.add_argument("--screen", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.screen:
        _screen(int(options.screen[0]), options.screen[1])
        return
    if options.play:
        for millions in options.rows:
            _print_playback(millions * MILLION, options.seconds)
        return
    if options.live:
        _print_live(options.seconds)
        return
    if options.idle:
        _print_idle(options.idle, options.seconds)
        return
    print(f"80x24, {PER_SECOND} rows/s, {options.seconds:g} s each")
    print("rows        filter  frames/s   CPU  delay p50/p99 ms    MB  bytes/row  jump ms")
    base = _empty_memory()
    for millions in options.rows:
        for text in ("", FILTER):
            print(_line(millions * MILLION, text, options.seconds, base), flush=True)
    print(_live_line(options.seconds))


def _line(rows: int, text: str, seconds: float, base: float) -> str:
    terminal = _started(rows, text)
    frames, cpu, ages = _measured(terminal, seconds)
    held = terminal.usage()[1]
    jumps = [_jump(terminal, key) for key in (b"g", b"G", b"g", b"G", b"g")]
    terminal.end()
    bytes_a_row = (held - base) * 2**20 / rows
    return (
        f"{rows:>10,}  {'on' if text else 'off':>6}  {frames:>8.1f} {cpu:>5.0%}"
        f"  {_percentile(ages, 50):>6.0f} / {_percentile(ages, 99):>6.0f}    {held:>5.0f}"
        f"  {bytes_a_row:>9.1f}  {statistics.median(jumps) * 1e3:>7.0f}"
    )


def _started(rows: int, text: str) -> Terminal:
    command = [sys.executable, "-m", "benchmarks.screen_speed", "--screen", f"{rows}", text]
    terminal = Terminal(command)
    terminal.wait_for(lambda drawn: b"READY" in drawn, 300)
    terminal.read(2)
    return terminal


def _empty_memory() -> float:
    """Megabytes of a screen without rows."""
    terminal = _started(0, "")
    held = terminal.usage()[1]
    terminal.end()
    return held


def _measured(terminal: Terminal, seconds: float) -> tuple[float, float, list[float]]:
    terminal.frames, terminal.ages_ms = 0, []
    before, start = terminal.usage()[0], time.monotonic()
    terminal.read(seconds)
    took = time.monotonic() - start
    return terminal.frames / took, (terminal.usage()[0] - before) / took, [*terminal.ages_ms]


def _jump(terminal: Terminal, key: bytes) -> float:
    """Seconds from a key to the frame after the jump."""
    terminal.read(0.3)
    terminal.press(key)
    sign = b"SCROLLED" if key == b"g" else b"LIVE"
    return terminal.wait_for(lambda drawn: sign in drawn, 20)


def _percentile(values: list[float], percent: int) -> float:
    if not values:
        return float("nan")
    return sorted(values)[min(len(values) - 1, len(values) * percent // 100)]


def _print_idle(file: Path, seconds: float) -> None:
    """Print the CPU seconds of a screen at rest, with each pane of `PANES`."""
    terminals = {}
    for name, keys in {"no pane": b"", **PANE_KEYS}.items():
        terminal = Terminal([sys.executable, "-m", "fte_sniff", "view", f"{file}"])
        terminal.wait_for(lambda drawn: b"FILE" in drawn, 60)
        terminal.read(1)
        terminal.press(keys)
        terminal.read(4)
        terminals[name] = terminal, terminal.usage()[0], time.monotonic()
    for name, (terminal, cpu, start) in terminals.items():
        while (left := start + seconds - time.monotonic()) > 0:
            time.sleep(left)
        took = (terminal.usage()[0] - cpu) / (time.monotonic() - start) * 30
        print(f"{name:<12}{took:>6.2f} s of CPU in 30 s", flush=True)
    for terminal, *_ in terminals.values():
        terminal.end()


SPEEDS = (0.1, 1, 10, 100)
"""Speeds of playback that are measured."""

SPEED_STEPS = 9
"""Steps from the lowest to the highest speed."""


def _print_playback(rows: int, seconds: float) -> None:
    """Print frames per second and CPU of playback at several speeds."""
    from fte_sniff.protocol.rows import Rows
    from fte_sniff.recording.metadata import PortFacts
    from tests.support.recorded_rows import PORTS, rows_a_second, rows_of, write_recording

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "played.mcap")
        frames = range(0, rows // len(PORTS), BATCH)
        batches = (Rows.of(rows_of(first, BATCH)) for first in frames)
        write_recording(file, [PortFacts(port) for port in PORTS], batches)
        span_s = rows / len(PORTS) / rows_a_second()
        print(f"{rows:,} rows, 80x24, {seconds:g} s each")
        for pane in ("", "motors"):
            for speed in SPEEDS:
                # At the highest speed, a short recording ends before.
                print(_played(file, speed, pane, min(seconds, span_s / speed / 2)), flush=True)
            print(_sped_up(file, pane, seconds), flush=True)


def _playing(file: Path, speed: float, pane: str) -> tuple[Terminal, float]:
    """A screen that plays a file, and the seconds after which it did."""
    command = [sys.executable, "-m", "fte_sniff", "view", "--play", f"{speed:g}", f"{file}"]
    terminal = Terminal(command)
    first = terminal.wait_for(lambda drawn: b"PLAYING" in drawn, 120)
    terminal.press(PANE_KEYS.get(pane, b""))
    return terminal, first


def _played(file: Path, speed: float, pane: str, seconds: float) -> str:
    terminal, first = _playing(file, speed, pane)
    terminal.read(seconds / 4)
    frames, cpu, _ages = _measured(terminal, seconds)
    terminal.press(b" ")
    pause = terminal.wait_for(lambda drawn: b"PAUSED AT" in drawn, 60)
    held = terminal.usage()[1]
    terminal.end()
    return (
        f"{speed:>6g}x  {pane or 'no pane':<8} {frames:>5.1f} frames/s {cpu:>5.0%}  {held:>4.0f} MB"
        f"  plays after {first:.2f} s, pauses after {pause * 1e3:.0f} ms"
    )


def _sped_up(file: Path, pane: str, seconds: float) -> str:
    """The speed rises from the lowest to the highest in `seconds`, and falls again."""
    terminal, _first = _playing(file, SPEEDS[0], pane)
    terminal.read(1)
    terminal.frames, changes = 0, []
    before, start = terminal.usage()[0], time.monotonic()
    for key in [b">"] * SPEED_STEPS + [b"<"] * SPEED_STEPS:
        terminal.press(key)
        changes.append(terminal.wait_for(lambda drawn: b"PLAYING" in drawn, 20))
        terminal.read(seconds / SPEED_STEPS / 2)
    took = time.monotonic() - start
    cpu = (terminal.usage()[0] - before) / took
    terminal.end()
    return (
        f"changing  {pane or 'no pane':<8} {terminal.frames / took:>5.1f} frames/s {cpu:>5.0%}"
        f"           the speed changes after {statistics.median(changes) * 1e3:.0f} ms (median),"
        f" {max(changes) * 1e3:.0f} ms (longest)"
    )


def _print_live(seconds: float) -> None:
    """Print the CPU of a full wire without a pane and with each."""
    table = 0.0
    for name, keys in {"no pane": b"", **PANE_KEYS}.items():
        wire = "sim://?seed=1&rate=1100"
        terminal = Terminal([sys.executable, "-m", "fte_sniff", "live", "--no-record", wire])
        terminal.wait_for(lambda drawn: b"LIVE" in drawn, 60)
        terminal.press(keys)
        terminal.read(3)
        frames, cpu, _ages = _measured(terminal, seconds)
        terminal.end()
        table = table or cpu
        print(
            f"{name:<12}{frames:>6.1f} frames/s  {cpu * seconds:>5.2f} s of CPU in {seconds:g} s"
            f"  {cpu / table:.2f}",
            flush=True,
        )


def _live_line(seconds: float) -> str:
    terminal = Terminal([sys.executable, "-m", "fte_sniff", "live", "--no-record", "sim://?seed=1"])
    terminal.wait_for(lambda drawn: bool(_CLOCK.search(drawn)), 60)
    terminal.read(2)
    frames, cpu, ages = _measured(terminal, seconds)
    terminal.end()
    return (
        f"live sim://: {frames:.1f} frames/s, screen {cpu:.0%} of a core, wire to screen"
        f" {_percentile(ages, 50):.0f} ms (p50), {_percentile(ages, 99):.0f} ms (p99)"
    )


def _screen(rows: int, text: str) -> None:
    """Run the screen over a feed of old and new rows."""
    from fte_sniff.analysis.feed import FeedState, FeedUpdate
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.protocol import KIND_BY_NAME, Row, encode
    from fte_sniff.tui.app import run_screen
    from fte_sniff.tui.options import StartOptions

    raws = [
        encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 4, "rpm": number % 2000 - 1000})
        for number in range(4000)
    ]

    from fte_sniff.protocol.rows import Rows

    def made(first: int, count: int, t_ns: int) -> list[Row]:
        return [Row("p", 10 * n, raws[n % 4000], t_ns) for n in range(first, first + count)]

    def updates() -> Iterator[FeedUpdate]:
        came, old = 0, made(0, BATCH, time.time_ns())
        while came < rows:
            count = min(BATCH, rows - came)
            came += count
            yield FeedUpdate(FeedState("loading", rows=came), Rows.of(old[:count]))
        start = time.monotonic()
        while True:
            due = rows + int((time.monotonic() - start) * PER_SECOND)
            new = made(came, due - came, time.time_ns())
            came = due
            yield FeedUpdate(FeedState("READY", rows=came), Rows.of(new))

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
