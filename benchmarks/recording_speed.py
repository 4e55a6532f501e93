"""Speed of reading and writing recordings in batches, compared with other readers and writers.

    python -m benchmarks.recording_speed [--frames 5000000] [--rounds 3] [--flush 115]
        [--memory 20000000]

All work is done in turn in each round, and each number is the median of the rounds. The `mcap`
package gets the first rows only; all costs are by row. While other programs use the cores, the time
of all cores is the better measure. One recording is flushed every `--flush` rows, as a capture with
a view does: 115 rows are 50 ms of two wires, and its ten minutes are 1,380,000 rows. `--memory`
writes recordings of a twentieth of that number of rows and of all, and prints how much memory it
takes to read all columns, and to decode to CSV.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from zstandard import ZstdDecompressor

from fte_sniff.analysis.dataframe import table_frame
from fte_sniff.analysis.segments import summed
from fte_sniff.analysis.statistics import counted, statistics
from fte_sniff.protocol.rows import Rows, fault_bits
from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, Fault, encode
from fte_sniff.recording.chunks import HEAD, unpack
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import RecordingWriter
from tests.analysis.captures import segments
from tests.support.recorded_rows import write_recording

BATCH = 1 << 18
POOL = 1 << 16
"""Different frames; a recording holds each many times, at other times and offsets."""
TEN_MINUTES = 1_380_000
"""Rows that are flushed as a capture does."""
SLOW_PART = 200_000
"""Rows that the mcap package reads and writes."""
PORTS = [PortFacts("/dev/ttyUSB0", 115_200), PortFacts("/dev/ttyUSB1", 115_200)]
START_NS = 1_770_000_000 * 10**9
FRAME_NS = 868_056


def frame_pool() -> np.ndarray:
    """Sound frames of every kind, feedback more often than control, as on two full wires."""
    random = Random(1)
    weights = [10 if kind.direction == "feedback" else 3 for kind in KINDS]
    given = {"motor": (1, 4), "error": (0, 0), "online": (15, 15)}
    frames = []
    for kind in random.choices(KINDS, weights, k=POOL):
        limits = {field.name: given.get(field.name, (-2000, 2000)) for field in kind.fields}
        frames.append(encode(kind, {name: random.randint(*ends) for name, ends in limits.items()}))
    return np.frombuffer(b"".join(frames), np.uint8).reshape(-1, FRAME_LENGTH)


DAMAGE = {Fault.NOISE: 3, Fault.TRUNCATED: 7, Fault.OVERLONG: 12, Fault.BAD_TAIL: 10}
"""Faults and the bytes of their rows."""


def damaged(rows: Rows, share: float) -> Rows:
    """The rows, a share of them damaged; offsets no longer tile the stream."""
    random = np.random.default_rng(3)
    codes = random.integers(0, len(DAMAGE), len(rows))
    codes[random.random(len(rows)) >= share] = -1
    for code, (fault, length) in enumerate(DAMAGE.items()):
        own = codes == code
        rows.faults[own], rows.length[own], rows.framed[own] = fault_bits([fault]), length, False
        rows.raw[own, :length] = random.integers(0, 256, (int(own.sum()), length))
        rows.raw[own, length:] = 0
    return rows


def batches(frames: int) -> Iterator[Rows]:
    """So many rows of two ports, at line rate, read every few milliseconds."""
    pool, random = frame_pool(), np.random.default_rng(2)
    ports = tuple(port.name for port in PORTS)
    for start in range(0, frames, BATCH):
        count = min(BATCH, frames - start)
        at = np.arange(start, start + count)
        rows = Rows.blank(count, ports)
        rows.t_ns[:] = START_NS + at // 2 * FRAME_NS + at % 2 * 400_000
        rows.offset[:] = at // 2 * FRAME_LENGTH
        rows.delay_ns[:] = random.integers(0, 16_000_000, count)
        rows.port[:] = at % 2
        rows.raw[:, :FRAME_LENGTH] = pool[random.integers(0, POOL, count)]
        yield rows


Cost = tuple[float, float]
"""Seconds on the wall, and seconds of all cores together."""


def cost(work: Callable[[], object], rows: int) -> Cost:
    """What a row costs."""
    began, used = perf_counter(), process_time()
    work()
    return (perf_counter() - began) / rows, (process_time() - used) / rows


def read_columns(path: Path) -> None:
    """All rows as batches, all checksums checked."""
    for _ in Recording(path).items():
        pass


def read_frames(path: Path) -> None:
    """All columns of the row contract as polars frames, the bytes as hex text."""
    for item in Recording(path).items():
        if isinstance(item, Rows):
            table_frame(item)


def survey(path: Path) -> None:
    """All numbers of `stats`."""
    rows = (item for item in Recording(path).items() if isinstance(item, Rows))
    statistics(summed(map(counted, segments(rows))))


def read_messages(path: Path) -> None:
    """The mcap package's message loop, which decodes nothing."""
    with path.open("rb") as file:
        for _ in make_reader(file, validate_crcs=True).iter_messages():
            pass


def chunk_bodies(path: Path) -> list[bytes]:
    content = path.read_bytes()
    return [content[one.start + HEAD.size : one.stop] for one in Recording(path).contents.chunks]


def unpack_all(bodies: list[bytes], threads: int) -> None:
    """Only unpacking, with the checksums, from memory."""
    with ThreadPoolExecutor(threads) as pool:
        for body in pool.map(lambda body: unpack(body, ZstdDecompressor()), bodies):
            del body


def write_columns(rows: list[Rows], path: Path) -> None:
    path.unlink(missing_ok=True)
    write_recording(path, PORTS, rows)


def write_flushed(rows: list[Rows], path: Path, count: int) -> None:
    """Write as a capture with a view does, with a chunk for some rows each."""
    with RecordingWriter(path, PORTS) as writer:
        for one in rows:
            for start in range(0, len(one), count):
                writer.write(one[start : start + count])
                writer.flush(waits=False)


def write_messages(messages: list[tuple[int, int, int, bytes]], path: Path) -> None:
    """The mcap package's writer, given messages that are encoded already."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("bench", "protobuf", b"")
        channels = {
            channel: writer.register_channel(f"/bench/{channel}", "protobuf", schema)
            for channel in {channel for channel, *_ in messages}
        }
        for channel, sequence, time, data in messages:
            writer.add_message(channels[channel], time, data, time, sequence)
        writer.finish()


def first_messages(path: Path, count: int) -> list[tuple[int, int, int, bytes]]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages()
        return [
            (channel.id, message.sequence, message.log_time, message.data)
            for _, (_, channel, message) in zip(range(count), found, strict=False)
        ]


def compare(frames: int, rounds: int, flush: int, folder: Path) -> None:
    names = ("bench.mcap", "hurt.mcap", "out.mcap", "few.mcap", "few-hurt.mcap", "live.mcap")
    path, hurt, out, few, few_hurt, live = (folder / name for name in names)
    rows, part = list(batches(frames)), min(frames, SLOW_PART)
    flushed = min(frames, TEN_MINUTES)
    write_flushed(list(batches(flushed)), live, flush)
    write_columns(rows, path)
    write_columns([damaged(one, 0.2) for one in batches(frames)], hurt)
    write_columns(list(batches(part)), few)
    write_columns([damaged(one, 0.2) for one in batches(part)], few_hurt)
    bodies, messages = chunk_bodies(path), first_messages(few, part)
    cores = len(os.sched_getaffinity(0))
    work: dict[str, Callable[[], Cost]] = {
        "read columns": lambda: cost(lambda: read_columns(path), frames),
        "read live file": lambda: cost(lambda: read_columns(live), flushed),
        "walk live file": lambda: cost(lambda: Recording(live, is_growing=True), flushed),
        "iter_messages": lambda: cost(lambda: read_messages(few), part),
        "read damaged": lambda: cost(lambda: read_columns(hurt), frames),
        "iter damaged": lambda: cost(lambda: read_messages(few_hurt), part),
        "write columns": lambda: cost(lambda: write_columns(rows, out), frames),
        "mcap.writer.Writer": lambda: cost(lambda: write_messages(messages, out), part),
        "read frames": lambda: cost(lambda: read_frames(path), frames),
        "numbers of stats": lambda: cost(lambda: survey(path), frames),
        "unpack, all cores": lambda: cost(lambda: unpack_all(bodies, cores), frames),
        "unpack, one core": lambda: cost(lambda: unpack_all(bodies, 1), frames),
    }
    found = _in_turn(work, rounds)
    print(f"{frames:,} frames, {path.stat().st_size / frames:.1f} bytes each; {cores} cores")
    print(f"{rounds} rounds, median; ns a row  wall  all cores")
    for name, (wall, used) in found.items():
        print(f"  {name:<18} {wall * 1e9:14.0f} {used * 1e9:10.0f}")
    print("times faster" + " " * 33 + "wall  all cores")
    claims = [
        ("read columns", "iter_messages", "50"),
        ("read damaged", "iter damaged", "35"),
        ("write columns", "mcap.writer.Writer", "8"),
        ("read live file", "read columns", "0.5"),
        ("read columns", "unpack, all cores", "0.5"),
        ("read frames", "iter_messages", ""),
        ("numbers of stats", "iter_messages", ""),
    ]
    for fast, slow, wanted in claims:
        wall, used = (old / new for old, new in zip(found[slow], found[fast], strict=True))
        goal = wanted and f"   (wanted: {wanted})"
        print(f"{fast:>16} against {slow:<20} {wall:8.2f} {used:10.2f}{goal}")


def _in_turn(work: dict[str, Callable[[], Cost]], rounds: int) -> dict[str, Cost]:
    """The median cost of each."""
    costs: dict[str, list[Cost]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, measure in work.items():
            costs[name].append(measure())
    return {
        name: (median(wall for wall, _ in own), median(used for _, used in own))
        for name, own in costs.items()
    }


READ = """
import sys
from pathlib import Path
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.reader import Recording
print(sum(len(one) for one in Recording(Path(sys.argv[1])).items() if isinstance(one, Rows)))
"""


def memory(rows: int, folder: Path) -> None:
    """The most memory that reading and decoding took, for a twentieth of the rows and for all."""
    path = folder / "memory.mcap"
    decode = ["-m", "fte_sniff", "decode", str(path), "--format=csv"]
    for count in (rows // 20, rows):
        path.unlink(missing_ok=True)
        write_recording(path, PORTS, batches(count))
        print(f"{count:,} rows ({path.stat().st_size / 1e6:,.0f} MB)")
        for name, words in (("all columns", ["-c", READ, str(path)]), ("to CSV", decode)):
            process = subprocess.Popen(
                [sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            _, code, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(code)
            most = usage.ru_maxrss / 1024
            print(f"  {name:<12} exit {process.returncode}, {most:.0f} MiB of memory at most")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=5_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--flush", type=int, default=115)
    parser.add_argument("--memory", type=int, default=0)
    chosen = parser.parse_args()
    with TemporaryDirectory() as folder:
        if chosen.frames:
            compare(chosen.frames, chosen.rounds, chosen.flush, Path(folder))
        if chosen.memory:
            memory(chosen.memory, Path(folder))


if __name__ == "__main__":
    main()
