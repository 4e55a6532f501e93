"""Attacks on what works together with others: files of other programs, growing files, jobs.

What each must give is known from elsewhere: from the writer's rows, from one process in the place
of several, from the same page with harmless texts.
"""

from __future__ import annotations

from pathlib import Path
from time import sleep

from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import DEFAULT_BAUD
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from tests.support.columns import entries
from tests.torture.case import Case, Started, promise
from tests.torture.damage import START_NS, numbered_frame
from tests.torture.file_attacks import (
    ReadRow,
    check_read_by_both,
    csv_rows,
)
from tests.torture.process_attacks import check_times, wait_until

_PORTS = [PortFacts("p", DEFAULT_BAUD)]
FAST = "sim://?rate=10000"


def _frames(first: int, count: int) -> list[Row]:
    """Frames of one wire, a millisecond apart."""
    return [
        Row("p", 10 * number, numbered_frame(number), START_NS + number * 10**6)
        for number in range(first, first + count)
    ]


def _as_read(frames: list[Row]) -> list[ReadRow]:
    return [ReadRow(row.port, row.offset, row.raw.hex().upper(), row.t_ns) for row in frames]


def rotate_oldest(case: Case) -> None:
    """Put files of another program on names of a capture that deletes its oldest file.

    None of them is deleted, and the rows that are left are the last ones.
    """
    random, limit = case.random, 300_000
    sizes = ("--rotate", "100kB", "--max-size", f"{limit // 1000}kB")
    program = case.start(*("live", FAST, "--baud=3000000", "--plain", "-o", "x.mcap", *sizes))
    foreign: dict[Path, bytes] = {}
    for _ in range(random.randrange(1, 4)):
        files = _known_files(case, program, len(foreign) + 2)
        if program.has_ended:
            break
        target = random.choice((files[0], files[-1], _next_name(files[-1])))
        content = random.randbytes(random.choice((1, 2_000)))
        case.path("foreign").write_bytes(content)
        case.path("foreign").replace(target)
        foreign[target] = content
    _known_files(case, program, 6)
    program.interrupt()
    run = program.wait()
    for path, content in foreign.items():
        promise(path.exists(), f"{path.name} of another program was deleted\n{run.errors}")
        promise(path.read_bytes() == content, f"{path.name} of another program was changed")
    ours = [path for path in sorted(case.folder.glob("x_*.mcap")) if path not in foreign]
    rows = [row for path in ours for row in check_read_by_both(case, path)]
    check_times(run.output, rows)
    promise(run.code in (0, 4), f"exit code {run.code}\n{run.errors}")
    total = sum(path.stat().st_size for path in ours)
    # The limit is checked after each flush, and the last file is closed with an index.
    promise(total <= limit + 200_000, f"{total:,} bytes are left of at most {limit:,}")
    if not foreign or run.code == 0:
        ends = {row.offset + len(row.raw) // 2 for row in rows}
        gaps = [row.offset for row in rows if row.offset not in ends]
        # Before the first row, and at each file that lost its name.
        promise(len(gaps) <= 1 + len(foreign), f"rows are missing before {gaps}\n{run.errors}")


def _known_files(case: Case, program: Started, number: int) -> list[Path]:
    """The capture's files, once the last has at least this number or the limit ends them."""

    def files() -> list[Path]:
        return sorted(case.folder.glob("x_*.mcap"))

    def is_there() -> bool:
        is_stopped = "recording stopped: its files have reached" in program.errors
        is_begun = bool(files()) and _number_of(files()[-1]) >= number
        return program.has_ended or is_stopped or is_begun

    wait_until(is_there, f"file {number} is not begun\n{program.errors}")
    return files()


def _number_of(path: Path) -> int:
    return int(path.stem.rpartition("_")[2])


def _next_name(path: Path) -> Path:
    return path.with_stem(f"x_{_number_of(path) + 1:05}")


def follow(case: Case) -> None:
    """Follow a recording that grows, and rotates: each row once, with its time."""
    random = case.random
    path, table = case.path("x.mcap"), case.path("rows.csv")
    rotates = RecordingOptions(rotate_bytes=random.choice((None, 20_000)))
    recorder = Recorder(path, _PORTS, options=rotates)
    (first,) = case.folder.glob("x*.mcap")
    program = case.start("decode", "--follow", first.name, "-o", table)
    made = 0
    for _ in range(random.randrange(1, 8)):
        count = random.randrange(1, 300)
        recorder.write(*entries(_frames(made, count)))
        recorder.flush()
        made += count
        sleep(random.choice((0, 0.05, 0.3)))
    wait_until(lambda: program.has_ended or len(_whole_rows(table)) >= made, "rows are missing")
    count = random.randrange(1, 300)
    recorder.write(*entries(_frames(made, count)))
    recorder.close()
    made += count
    run = program.wait()
    promise(run.code == 0, f"exit code {run.code}\n{run.errors}")
    found, wanted = csv_rows(table), _as_read(_frames(0, made))
    promise(found == wanted, f"{len(found)} rows of {made} are followed\n{run.errors}")


def _whole_rows(table: Path) -> list[bytes]:
    """Lines of a table that is being written, without its head."""
    for path in (table, *table.parent.glob(".fte-sniff-*.part")):
        if path.exists():
            return path.read_bytes().split(b"\n")[1:-1]
    return []
