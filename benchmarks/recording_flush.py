"""Live recording: the time to write one second of two full wires to the disk.

python -m benchmarks.recording_flush [--seconds 200] [--folder FOLDER]

`write` accepts the rows; `flush` packs, writes and syncs them; `disk` is the share of the flush in
system calls. `message by message` uses the mcap package's writer, with one flush and fdatasync, and
without summary and message index.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from fte_sniff.recording.metadata import PortFacts, host_facts
from fte_sniff.recording.schema import TOPICS, encode, schema_data, schema_name, topic_of
from fte_sniff.recording.writer import RecordingWriter
from tests.support.columns import entries
from tests.support.recorded_rows import PORTS, START_NS, rows_a_second, rows_of

_CALLS = ("pwrite", "fdatasync", "ftruncate")


@contextmanager
def _timed_calls() -> Iterator[list[float]]:
    """Seconds in the system calls that write, within this context."""
    spent: list[float] = []

    def timed(call: Callable[..., Any]) -> Callable[..., Any]:
        def timing(*given: Any) -> Any:
            start = time.perf_counter()
            try:
                return call(*given)
            finally:
                spent.append(time.perf_counter() - start)

        return timing

    before = {name: getattr(os, name) for name in _CALLS}
    for name, call in before.items():
        setattr(os, name, timed(call))
    try:
        yield spent
    finally:
        for name, call in before.items():
            setattr(os, name, call)


def ours(folder: Path, seconds: int) -> dict[str, list[float]]:
    """Milliseconds of each step, for each recorded second."""
    found: dict[str, list[float]] = {"write": [], "flush": [], "disk": [], "rows to disk": []}
    a_second = rows_a_second()
    ports = [PortFacts(port, 115_200) for port in PORTS]
    path = folder / "flush.mcap"
    with RecordingWriter(path, ports, host_facts(START_NS)) as writer, _timed_calls() as spent:
        for second in range(seconds):
            rows = rows_of(second * a_second, a_second)
            spent.clear()
            start = time.perf_counter()
            writer.write(*entries(rows))
            written = time.perf_counter()
            writer.flush()
            end = time.perf_counter()
            found["write"].append((written - start) * 1e3)
            found["flush"].append((end - written) * 1e3)
            found["disk"].append(sum(spent) * 1e3)
            found["rows to disk"].append((end - start) * 1e3)
    path.unlink()
    return found


def others(folder: Path, seconds: int) -> list[float]:
    """Milliseconds for each recorded second with the mcap package's writer."""
    found = []
    a_second = rows_a_second()
    with (folder / "others.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic in TOPICS:
            schema = writer.register_schema(
                schema_name(topic), "protobuf", schema_data(topic.schema)
            )
            for port in PORTS:
                channels[port, topic.name] = writer.register_channel(topic.name, "protobuf", schema)
        for second in range(seconds):
            rows = rows_of(second * a_second, a_second)
            start = time.perf_counter()
            for row in rows:
                time_ns = row.t_ns or 0
                channel, data = channels[row.port, topic_of(row).name], encode(row, time_ns)
                writer.add_message(channel, time_ns, data, time_ns)
            file.flush()
            os.fdatasync(file.fileno())
            found.append((time.perf_counter() - start) * 1e3)
        writer.finish()
    return found


def main() -> None:
    """Record second after second; print the median and the 99th percentile."""
    parser = argparse.ArgumentParser(description="How long a second of rows takes to the disk.")
    parser.add_argument("--seconds", type=int, default=200)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        steps = ours(Path(name), options.seconds)
        steps["message by message"] = others(Path(name), max(5, options.seconds // 10))
    print(f"{2 * rows_a_second()} rows a second, {options.seconds} seconds; milliseconds")
    print(f"{'':<20} {'median':>8} {'p99':>8}")
    for step, times in steps.items():
        worst = statistics.quantiles(times, n=100)[-1]
        print(f"{step:<20} {statistics.median(times):8.2f} {worst:8.2f}")


if __name__ == "__main__":
    main()
