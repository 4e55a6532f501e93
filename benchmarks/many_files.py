"""`stats` over many recordings: one process, two, and a local Dask cluster; growth of the parent.

    python -m benchmarks.many_files [files] [rows]

Prints rows/s of each way for 200 recordings of 50,000 rows, relative to one process; then the time
and the peak memory of the parent process for a tenth of the files, all, and ten times as many.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, sleep

from tests.support.dask_cluster import cluster

from tests.support.recorded_rows import make_recordings

PROGRAM = [sys.executable, "-P", "-m", "fte_sniff"]


def links(folder: Path, into: Path, files: int) -> Path:
    """A folder with some of the recordings, some of them several times."""
    into.mkdir()
    made = sorted(folder.iterdir())
    for number in range(files):
        os.link(made[number % len(made)], into / f"{number:05}.mcap")
    return into


def run(folder: Path, *options: str) -> tuple[float, int]:
    """Seconds and peak memory of the parent process, in MB, without its workers."""
    begin, peak = perf_counter(), 0
    with subprocess.Popen(
        [*PROGRAM, "stats", str(folder), "--format", "json", *options], stdout=subprocess.DEVNULL
    ) as process:
        while process.poll() is None:
            peak = max(peak, peak_kb(process.pid))
            sleep(0.01)
    assert process.returncode == 0, process.returncode
    return perf_counter() - begin, peak // 1000


def peak_kb(pid: int) -> int:
    """The peak memory of a process so far."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return 0
    found = re.search(r"VmHWM:\s+(\d+) kB", status)
    return int(found[1]) if found else 0


def main(arguments: Sequence[str]) -> None:
    files, rows = (int(one) for one in (*arguments, "200", "50000")[:2])
    with TemporaryDirectory() as name:
        folder, made = Path(name), Path(name) / "made"
        made.mkdir()
        make_recordings(made, files, rows)
        total = files * rows
        one_s, _ = run(made, "--jobs", "1")
        print(f"{'one process':<22} {total / one_s:12,.0f} rows/s   1.00")
        two_s, _ = run(made, "--jobs", "2")
        print(f"{'two processes':<22} {total / two_s:12,.0f} rows/s   {one_s / two_s:.2f}")
        with cluster(2, folder) as address:
            dask_s, _ = run(made, "--cluster", address)
        print(f"{'cluster, two workers':<22} {total / dask_s:12,.0f} rows/s   {one_s / dask_s:.2f}")
        for count in (files // 10, files, files * 10):
            some = links(made, folder / str(count), count)
            for jobs in ("1", "2"):
                seconds, megabytes = run(some, "--jobs", jobs)
                print(f"{count:>6,} files, --jobs {jobs}  {seconds:7.1f} s  {megabytes:5} MB")


if __name__ == "__main__":
    main(sys.argv[1:])
