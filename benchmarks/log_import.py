"""Measures reading of logs: a log with times against the same bytes as raw, and plain hex.

    python -m benchmarks.log_import [--lines 2000000] [--rounds 3] [--shapes LINES]

Each figure is rows in a second of processor time to a recording, from the difference between all
lines and an eighth of them, so that start-up does not count; the median of the rounds. Also the
time to find the evidence, the time for 1 MB of a repeated token, and the memory for one line of
250 MB. `benchmarks.against` compares two checkouts. `--shapes LINES`
measures logs of different lines: the processor time of the whole process against that of the same
bytes as raw, in turn, the least of the rounds; and the rows that are read and framed in a second.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from base64 import b64encode
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.decode_speed import cost
from benchmarks.recording_speed import frame_pool
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.log import Log
from fte_sniff.protocol.spec import FRAME_LENGTH
from fte_sniff.session.framing import rows_of_chunks

PART = 8
TOKENS = (
    *("a", "A", "0", "1", "AA", "aa", "AA01", "0x", "0xAA", "AA ", "A ", "1 ", "12 ", "0b", "b'"),
    *("\\", "\\x", "\\xaa", "<", "<AA>", "[", "[1]", "(", "{", "'", '"', "'a'", ":", "-", ",", ";"),
    *("12:", "AA:", "AA-", "$", "h", "AAh ", "%", "=", "AB=", "RX ", "->", "é", "收"),
)
"""What a form of bytes may begin with, or be confused with."""
BYTE_US = 86.8
WORK = {
    "log": ("rows.log", "-o", "out.mcap"),
    "raw": ("rows.bin", "--start", "2026-01-31T12:00:00Z", "-o", "out.mcap"),
    "hex": ("rows.hex", "-o", "out.raw"),
}


def write_inputs(folder: Path, lines: int) -> Path:
    """Write the same frames as a log with times, raw bytes and plain hex."""
    folder.mkdir()
    pool = frame_pool()
    rows = pool[np.random.default_rng(2).integers(0, len(pool), lines)]
    data = rows.tobytes()
    (folder / "rows.bin").write_bytes(data)
    texts = [data[at : at + FRAME_LENGTH].hex(" ").upper() for at in range(0, len(data), 10)]
    (folder / "rows.hex").write_text("".join(f"{text}\n" for text in texts))
    with (folder / "rows.log").open("w") as log:
        for at, text in enumerate(texts):
            seconds, us = divmod(int(at * FRAME_LENGTH * BYTE_US), 1_000_000)
            clock = f"{12 + seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}"
            log.write(f"[2026-01-31 {clock}.{us:06}] RX: {text}\n")
    return folder


def _names() -> list[str]:
    letters = np.random.default_rng(3).integers(97, 123, (3000, 9), np.uint8)
    return [bytes(row[: 3 + at % 7]).decode() for at, row in enumerate(letters)]


NAMES = _names()
SHAPES: dict[str, Callable[[int, str, bytes], str]] = {
    "hex": lambda at, t, data: f"[{t}] RX: {data.hex(' ')}",
    "times that end in 0": lambda at, t, data: f"[{t[:-1]}0] RX: {data.hex(' ')}",
    "decimals": lambda at, t, data: f"{t} [{', '.join(map(str, data))}]",
    "decimals, no times": lambda at, t, data: ", ".join(map(str, data)),
    "JSON": lambda at, t, data: f'{{"t":{1_700_000_000_000 + at},"data":{[*data]}}}',
    "Python repr": lambda at, t, data: f"{t} {'TX' if data[0] == 0xAA else 'RX'} {data!r}",
    "unpadded": lambda at, t, data: f"{at}: {' '.join(f'{byte:X}' for byte in data)}",
    "base64": lambda at, t, data: f'{{"n":{at},"data":"{b64encode(data).decode()}"}}',
    "names and foreign lines": lambda at, t, data: (
        f"{t} [{NAMES[at * 7 % 3000]}] RX: {data.hex(' ')}\n"
        f"{t} [{NAMES[at * 11 % 3000]}] {NAMES[at % 3000]} took {at * 13 % 977} us"
    ),
}
"""Lines of a frame by its number, time and bytes."""


def print_ratios(folder: Path, lines: int, rounds: int) -> None:
    """Print the processor time of logs with such lines, and its ratio to that of raw bytes."""
    data = (write_inputs(folder / "shapes", lines) / "rows.bin").read_bytes()
    frames = [data[at : at + FRAME_LENGTH] for at in range(0, len(data), FRAME_LENGTH)]
    start = np.datetime64("2026-01-31T12:00:00.000000")
    steps = (np.arange(lines) * FRAME_LENGTH * BYTE_US).astype("timedelta64[us]")
    times = [str(time).replace("T", " ") for time in start + steps]
    raw = (sys.executable, "-m", "fte_sniff", "decode", *WORK["raw"])
    log = tuple("rows.log" if word == "rows.bin" else word for word in raw)
    for name, form in SHAPES.items():
        rows = zip(range(lines), times, frames, strict=True)
        text = "".join(f"{form(*row)}\n" for row in rows)
        (folder / "shapes" / "rows.log").write_text(text)
        used = [
            [cost((*one, "--force"), folder / "shapes") for one in (raw, log)]
            for _ in range(rounds)
        ]
        least = [min(own) for own in zip(*used, strict=True)]
        rate = max(rows_per_second(folder / "shapes" / "rows.log") for _ in range(rounds))
        print(
            f"{name:24} {least[1]:6.2f} s  {least[1] / least[0]:5.1f} times raw"
            f"  {rate:9,.0f} rows/s read and framed"
        )


def rows_per_second(log: Path) -> float:
    """Rows of a log in a second of processor time, read and framed in this process."""
    began = time.process_time()
    rows = sum(map(len, rows_of_chunks(Log(str(log)).chunks(), lambda _note: None)))
    return rows / (time.process_time() - began)


def speed(work: str, whole: Path, part: Path, lines: int) -> float:
    """Rows in a second of processor time."""
    command = (sys.executable, "-m", "fte_sniff", "decode", *WORK[work], "--force")
    used = [cost(command, folder) for folder in (whole, part)]
    return lines * (1 - 1 / PART) / max(used[0] - used[1], 1e-3)


def evidence_seconds(log: Path) -> float:
    """Processor time to find the layout of a log."""
    began = time.process_time()
    Log(str(log))
    return time.process_time() - began


def slowest_token(folder: Path) -> tuple[float, str]:
    """Most processor time to answer 1 MB of a token that is repeated, in one line or in many."""
    found = []
    for token in TOKENS:
        for end in ("", "\n"):
            path = folder / "token.txt"
            path.write_text((token + end) * (1_000_000 // len(token + end)))
            began = time.process_time()
            with suppress(FteSniffError):
                for _ in rows_of_chunks(Log(str(path)).chunks(), lambda _note: None):
                    pass
            found.append((time.process_time() - began, token + end))
    return max(found)


def memory_mb(folder: Path) -> float:
    """Most memory while a line of 250 MB is read."""
    frame = "AA 01 01 03 E8 00 00 00 00 EE " * 100_000
    with (folder / "long.hex").open("w") as file:
        for _ in range(84):
            file.write(frame)
    command = [sys.executable, "-m", "fte_sniff", "decode", "long.hex", "-o", "long.raw"]
    process = subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL)
    _, _, usage = os.wait4(process.pid, 0)
    return usage.ru_maxrss / 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, default=2_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--shapes", type=int, metavar="LINES")
    chosen = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        if chosen.shapes:
            print_ratios(folder, chosen.shapes, chosen.rounds)
            return
        # First: a new process begins with the peak memory of the one that starts it.
        print(f"a line of 250 MB: {memory_mb(folder):.0f} MB")
        whole = write_inputs(folder / "whole", chosen.lines)
        part = write_inputs(folder / "part", chosen.lines // PART)
        speeds = {
            work: median(speed(work, whole, part, chosen.lines) for _ in range(chosen.rounds))
            for work in WORK
        }
        for work, rows in speeds.items():
            print(f"{work:6}{rows:14,.0f} rows/s  {rows / speeds['raw']:5.2f}x raw")
        print(f"evidence {evidence_seconds(whole / 'rows.log'):.2f} s")
        seconds, token = slowest_token(folder)
        print(f"1 MB of a repeated token: at most {seconds:.2f} s, of {token!r}")


if __name__ == "__main__":
    main()
