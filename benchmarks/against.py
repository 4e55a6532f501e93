"""Processor time of whole commands in two checkouts, in alternation.

    python -m benchmarks.against CHECKOUT [--frames 200000] [--rounds 5] [--only WORD ...]

Each checkout runs with the Python of its `.venv`, in which its framer is compiled. The figure is
the processor time of all processes of a command, start-up included: least and median of the rounds
of this checkout, and their ratios to those of the other. Both read the same files, which this
checkout wrote; the streams are clean, or 1 % or 20 % of their frames are damaged.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from tests.support.faults import damaged_stream

START = ("--start", "2026-01-31T12:00:00Z")
FRAME = "AA 02 02 03 E8 00 00 27 10 EE"
SHARES = {"clean": 0.0, "1 %": 0.01, "20 %": 0.2}
POOL = 20_000
"""Different frames of a stream, which repeats them."""
OF_A_STREAM: Mapping[str, tuple[str, ...]] = {
    "raw to MCAP": ("decode", "{}.bin", *START, "--force", "-o", "out.mcap"),
    "MCAP to CSV": ("decode", "{}.mcap", "--format", "csv"),
    "MCAP to JSON": ("decode", "{}.mcap", "--format", "jsonl"),
    "MCAP to table": ("decode", "{}.mcap", "--format", "table"),
    "MCAP to hex": ("decode", "{}.mcap", "--format", "hex"),
    "MCAP to MCAP": ("decode", "{}.mcap", "--force", "-o", "out.mcap"),
    "stats": ("stats", "{}.mcap"),
    "check": ("check", "{}.mcap", "--expect", "share(status != 'ok') <= 1"),
}
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "hex (start-up)": ("hex", FRAME),
    "encode (start-up)": ("encode", "speed", "--motor", "1", "--rpm", "1000"),
    "log to CSV": ("decode", "clean.log", "--format", "csv"),
    "log, times end in 0": ("decode", "zeros.log", "--format", "csv"),
    **{
        f"{task}, {name}": tuple(word.replace("{}", name.replace(" %", "")) for word in command)
        for task, command in OF_A_STREAM.items()
        for name in SHARES
    },
}


def python_of(checkout: Path) -> str:
    """The Python of a checkout's environment; this one where it has none."""
    own = checkout / ".venv" / "bin" / "python"
    return str(own.absolute()) if own.exists() else sys.executable


def seconds(python: str, arguments: tuple[str, ...], folder: Path) -> float:
    """Processor time of a command with all its processes."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.Popen(
        [python, "-P", "-m", "fte_sniff", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stderr.close()
    if process.returncode:
        raise SystemExit(f"{' '.join(arguments)}: {said.decode()}")
    return usage.ru_utime + usage.ru_stime


def write_inputs(folder: Path, frames: int) -> None:
    """The streams as raw bytes and recordings, and two logs of the clean one."""
    for name, share in SHARES.items():
        stream, _ = damaged_stream(1, POOL, share, "ordinary")
        path = folder / f"{name.replace(' %', '')}.bin"
        path.write_bytes(stream * max(1, frames // POOL))
        recorded = ("decode", path.name, *START, "-o", f"{path.stem}.mcap")
        seconds(sys.executable, recorded, folder)
    data = (folder / "clean.bin").read_bytes()
    for name, form in {"clean": "{:06}", "zeros": "{:03}000"}.items():
        unit = 10**6 if name == "clean" else 1000
        with (folder / f"{name}.log").open("w") as log:
            for at in range(0, len(data), 10):
                passed = at // 10 * unit // 1000
                clock = f"{passed // unit // 60 % 60:02}:{passed // unit % 60:02}"
                stamp = f"2026-01-31 12:{clock}.{form.format(passed % unit)}"
                log.write(f"[{stamp}] RX: {data[at : at + 10].hex(' ').upper()}\n")


def main() -> None:
    """Print a line for each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--frames", type=int, default=200_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", default=[""], help="commands whose names have a word")
    chosen = parser.parse_args()
    pythons = python_of(Path(__file__).parent.parent), python_of(chosen.checkout)
    with TemporaryDirectory() as name:
        write_inputs(Path(name), chosen.frames)
        print(f"{'command':<24} {'least s':>8} {'ratio':>6} {'median s':>9} {'ratio':>6}")
        for task, command in COMMANDS.items():
            if not any(word in task for word in chosen.only):
                continue
            rounds = [
                [seconds(python, command, Path(name)) for python in pythons]
                for _ in range(chosen.rounds)
            ]
            new, old = zip(*rounds, strict=True)
            print(
                f"{task:<24} {min(new):>8.3f} {min(new) / min(old):>6.2f}"
                f" {median(new):>9.3f} {median(new) / median(old):>6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
