"""Make the sample files that follow from others, and one recording of a simulated host.

    python samples/make.py            make them again
    python samples/make.py --check    report samples that are not current; exit 1 if any

The recordings `clean`, `damaged`, `idle` and `midstream` are data, as they were captured from
`sim://`; each exists as hex text, a read a line, and as raw bytes too. `expected/NAME.txt` is the
output of `fte-sniff decode samples/NAME`. `motor3.mcap` is made here, and is compared by content,
because another release of the compressor may produce other bytes. `layouts/` is that of
`samples/layouts.py`.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import layouts

from fte_sniff.protocol.columns import iso_time, record
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    KIND_BY_NAME,
    MOTORS,
    NAME_OF_ROLE,
    FrameKind,
    Role,
    encode,
)
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import Existing, RecordingWriter

FOLDER = Path(__file__).parent
START_NS = 1_769_860_800_000_000_000  # 2026-01-31T12:00:00Z
FLUSH_NS = 20 * 10**9
EXTRA_FORMATS = {"damaged.mcap": ("jsonl", "csv")}


SAMPLES = ("clean", "damaged", "idle", "midstream")
"""Recordings that are data."""


@dataclass(frozen=True, slots=True)
class PolledSample:
    """A host that polls four motors, of which one loses answers and answers late for a while."""

    name: str = "motor3"
    story: str = "motor 3 loses answers and answers late for half a minute"
    seed: str = "5"
    port: str = "/dev/ttyUSB0"
    """The port's name in the recording."""
    seconds: int = 80
    polls_per_s: int = 6
    trouble_s: tuple[int, int] = (30, 60)
    motor: int = 3

    def chunks(self) -> list[Chunk]:
        """The reads, with their times."""
        rng, found = random.Random(self.seed), list[Chunk]()
        for poll in range(self.seconds * self.polls_per_s):
            for motor in MOTORS:
                at_s = poll / self.polls_per_s + motor * 0.03 + rng.uniform(0, 0.001)
                rpm = 60 * motor + 20 * (poll // 50 % 5)
                troubled = self.trouble_s[0] <= at_s < self.trouble_s[1] and motor == self.motor
                found.append(self._chunk(at_s, KIND_BY_NAME["speed"], motor, rpm))
                delay_s = rng.uniform(0.002, 0.004)
                if troubled and rng.random() < 0.4:
                    continue
                if troubled and rng.random() < 0.4:
                    delay_s += rng.uniform(0.01, 0.02)
                shown = rpm + rng.randint(-2, 2)
                kind = KIND_BY_NAME["speed_feedback"]
                found.append(self._chunk(at_s + delay_s, kind, motor, shown))
        return sorted(found, key=lambda chunk: chunk.t_ns or 0)

    def _chunk(self, at_s: float, kind: FrameKind, motor: int, rpm: int) -> Chunk:
        t_ns = START_NS + round(at_s * 1e9)
        values = {NAME_OF_ROLE[Role.MOTOR]: motor, NAME_OF_ROLE[Role.SPEED]: rpm}
        return Chunk(self.port, t_ns, encode(kind, values))


def make(folder: Path) -> None:
    """Make every sample and its expected output in `folder`."""
    (folder / "expected").mkdir(parents=True, exist_ok=True)
    layouts.write(folder / "layouts")
    _write_recording(folder, PolledSample())
    for name in SAMPLES:
        for ending in ("mcap", "hex"):
            (folder / f"{name}.{ending}").write_bytes((FOLDER / f"{name}.{ending}").read_bytes())
        reads = (FOLDER / f"{name}.hex").read_text().splitlines()[1:]
        (folder / f"{name}.raw").write_bytes(bytes.fromhex("".join(reads)))
        for ending in ("mcap", "raw", "hex"):
            _expect(folder, f"{name}.{ending}")


def _write_recording(folder: Path, sample: PolledSample) -> None:
    framer = Framer(sample.port, DEFAULT_BAUD)
    facts = {"start": iso_time(START_NS), "story": sample.story}
    ports = (PortFacts(sample.port, DEFAULT_BAUD),)
    opened = PortEvent(START_NS, sample.port, PortEventKind.OPENED, f"{DEFAULT_BAUD} baud 8N1")
    path = folder / f"{sample.name}.mcap"
    with RecordingWriter(path, ports, facts, existing=Existing.REPLACE) as recording:
        recording.write(opened)
        flush_ns = START_NS
        for chunk in sample.chunks():
            framer.push(chunk)
            recording.write(framer.drain())
            # As a live recording does, so that a copy cut short still has its beginning.
            if (now_ns := chunk.t_ns or 0) >= flush_ns:
                recording.flush()
                flush_ns = now_ns + FLUSH_NS
        recording.write(framer.finish())


def _expect(folder: Path, name: str) -> None:
    _decode(folder, name, "table", f"{name}.txt")
    for form in EXTRA_FORMATS.get(name, ()):
        _decode(folder, name, form, f"{name}.{form}")


def _decode(folder: Path, name: str, form: str, expected: str) -> None:
    # Run beside the sample's folder, so that names in the output are the same everywhere.
    command = [sys.executable, "-m", "fte_sniff", "decode", f"samples/{name}", "--format", form]
    with (folder / "expected" / expected).open("wb") as output:
        subprocess.run(
            command, cwd=folder.parent, stdout=output, stderr=subprocess.DEVNULL, check=True
        )


def stale() -> list[str]:
    """The files here that differ from what `make` makes."""
    with tempfile.TemporaryDirectory() as scratch:
        fresh = Path(scratch) / FOLDER.name
        make(fresh)
        made = {path.relative_to(fresh) for path in fresh.rglob("*") if path.is_file()}
        kept = {
            path.relative_to(FOLDER)
            for path in FOLDER.rglob("*")
            if path.is_file() and path.suffix not in (".py", ".pyc", ".md")
        }
        differing = {
            name for name in made & kept if _content(fresh / name) != _content(FOLDER / name)
        }
        return sorted(map(os.fspath, made ^ kept | differing))


def _content(path: Path) -> object:
    if path.suffix != ".mcap":
        return path.read_bytes()
    reader = Recording(path)
    facts = dict(reader.facts)
    for name in ("library", "library.marks"):  # of the release that wrote it
        facts.pop(name, None)
    items = list(reader.items())
    rows = [record(row) for item in items if isinstance(item, Rows) for row in item]
    events = [item for item in items if isinstance(item, PortEvent)]
    return rows, events, facts, reader.losses


def main() -> int:
    """Make or check the samples; returns the exit code."""
    if sys.argv[1:] not in ([], ["--check"]):
        print(__doc__, file=sys.stderr)
        return 2
    if sys.argv[1:] == ["--check"]:
        for name in (old := stale()):
            print(f"not current: samples/{name}; run python samples/make.py", file=sys.stderr)
        return 1 if old else 0
    make(FOLDER)
    return 0


if __name__ == "__main__":
    sys.exit(main())
