"""Make the sample files with the simulator; fixed seeds make them reproducible.

    python samples/make.py            make every sample and its expected output again
    python samples/make.py --check    report samples that are not current; exit 1 if any

Each sample but `motor3.mcap` exists as a recording, as raw bytes and as hex text.
`expected/NAME.txt` is the output of `fte-sniff decode samples/NAME`. Recordings are compared by
content, because another release of the compressor may produce other bytes. `layouts/` is that of
`samples/layouts.py`.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import layouts

from fte_sniff.capture.simulation import Simulation, parse_parameters
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    KIND_BY_NAME,
    MOTORS,
    Chunk,
    FrameKind,
    Framer,
    PortEvent,
    PortEventKind,
    encode,
    iso_time,
    record,
    spaced_hex,
)
from fte_sniff.protocol.rows import NO_ROWS
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import Existing, RecordingWriter

FOLDER = Path(__file__).parent
START_NS = 1_769_860_800_000_000_000  # 2026-01-31T12:00:00Z
EXTRA_FORMATS = {"damaged.mcap": ("jsonl", "csv")}


@dataclass(frozen=True, slots=True)
class Sample:
    """One session on a simulated wire."""

    name: str
    story: str
    query: str
    """The parameters of sim://."""
    skip: int = 0
    """Bytes before the first one that is captured."""

    @property
    def port(self) -> str:
        """The port's name in the recording."""
        return f"sim://?{self.query}"

    def chunks(self) -> list[Chunk]:
        """The reads, with their times."""
        found, skip = [], self.skip
        for timed in Simulation(parse_parameters(self.query)):
            data = timed.data[skip:]
            skip -= len(timed.data) - len(data)
            if data:
                found.append(Chunk(self.port, START_NS + timed.t_ns, data))
        return found


SAMPLES = (
    Sample("clean", "a host drives a robot, nothing goes wrong", "seed=1&rate=30&frames=1200"),
    Sample(
        "damaged",
        "the same wire with a bad connector: lost bytes, flipped bits, noise",
        "seed=2&rate=30&drop=0.05&flip=0.05&noise=0.05&frames=500",
    ),
    Sample("idle", "almost silence: a frame now and then", "seed=3&rate=1&frames=12"),
    Sample(
        "midstream",
        "somebody plugged in while frames went by, in the middle of one",
        "seed=4&rate=200&frames=60",
        skip=117,
    ),
)


@dataclass(frozen=True, slots=True)
class PolledSample(Sample):
    """A host that polls four motors, of which one loses answers and answers late for a while."""

    seconds: int = 80
    polls_per_s: int = 6
    trouble_s: tuple[int, int] = (30, 60)
    motor: int = 3

    @property
    def port(self) -> str:
        """The port's name in the recording."""
        return "/dev/ttyUSB0"

    def chunks(self) -> list[Chunk]:
        """The reads, with their times."""
        rng, found = random.Random(self.query), list[Chunk]()
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


POLLED = PolledSample("motor3", "motor 3 loses answers and answers late for half a minute", "5")


def make(folder: Path) -> None:
    """Make every sample and its expected output in `folder`."""
    (folder / "expected").mkdir(parents=True, exist_ok=True)
    layouts.write(folder / "layouts")
    _write_recording(folder / f"{POLLED.name}.mcap", POLLED, POLLED.chunks(), flush_s=20)
    for sample in SAMPLES:
        chunks = sample.chunks()
        _write_recording(folder / f"{sample.name}.mcap", sample, chunks)
        (folder / f"{sample.name}.raw").write_bytes(b"".join(chunk.data for chunk in chunks))
        (folder / f"{sample.name}.hex").write_text("".join(_hex_lines(sample, chunks)))
        for ending in ("mcap", "raw", "hex"):
            _expect(folder, f"{sample.name}.{ending}")


def _write_recording(path: Path, sample: Sample, chunks: list[Chunk], flush_s: int = 1) -> None:
    framer = Framer(sample.port, DEFAULT_BAUD)
    facts = {"start": iso_time(START_NS), "story": sample.story}
    ports = (PortFacts(sample.port, DEFAULT_BAUD),)
    opened = PortEvent(START_NS, sample.port, PortEventKind.OPENED, f"{DEFAULT_BAUD} baud 8N1")
    with RecordingWriter(path, ports, facts, existing=Existing.REPLACE) as recording:
        recording.write(NO_ROWS.replace([opened]))
        flush_ns = START_NS
        for chunk in chunks:
            framer.push(chunk)
            recording.write(framer.drain())
            # As a live recording does, so that a copy cut short still has its beginning.
            if (now_ns := chunk.t_ns or 0) >= flush_ns:
                recording.flush()
                flush_ns = now_ns + flush_s * 1_000_000_000
        framer.finish()
        recording.write(framer.drain())


def _hex_lines(sample: Sample, chunks: list[Chunk]) -> Iterator[str]:
    yield f"# {sample.story}\n"
    for chunk in chunks:
        yield f"{spaced_hex(chunk.data)}\n"


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
    facts = {key: value for key, value in reader.metadata["fte-sniff"].items() if key != "library"}
    batches = list(reader.batches())
    rows = [record(row) for batch in batches for row in batch]
    events = [event for batch in batches for event in batch.events]
    return rows, events, facts, reader.ending, reader.losses


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
