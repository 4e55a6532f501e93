"""Attacks on what works together with others: files of other programs, growing files, jobs.

What each must give is known from elsewhere: from the writer's rows, from one process in the place
of several, from the same page with harmless texts.
"""

from __future__ import annotations

import json
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from time import sleep

from fte_sniff.protocol import DEFAULT_BAUD, Frame, PortEvent, PortEventKind
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.retention import RecordingOptions
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.notes import Note, Notes, RowKey
from tests.support.columns import in_columns
from tests.torture.case import OUT_OF_MEMORY, Case, Started, promise
from tests.torture.damage import START_NS, VARIANTS, damaged, numbered_frame, recording
from tests.torture.file_attacks import (
    ReadRow,
    check_read_by_both,
    csv_rows,
)
from tests.torture.process_attacks import check_times, wait_until

_PORTS = [PortFacts("p", DEFAULT_BAUD)]
FAST = "sim://?rate=10000"


def _frames(first: int, count: int) -> list[Frame]:
    """Frames of one wire, a millisecond apart."""
    return [
        Frame("p", 10 * number, numbered_frame(number), START_NS + number * 10**6)
        for number in range(first, first + count)
    ]


def _as_read(frames: list[Frame]) -> list[ReadRow]:
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


_RULES = """\
[rules]
few = "count(malformed) <= 3"
speed = "max(rpm) < 30000"
gap = "max_gap(motor = 1) < 1000"
"""


def rules(case: Case) -> None:
    """Check by rules that are whole, damaged or nested: 1 is a verdict and nothing else."""
    random = case.random
    case.path("source.mcap").write_bytes(recording(random.randrange(VARIANTS)))
    deep = random.randrange(1, 60_000)
    text = random.choice(
        (
            _RULES.encode(),
            damaged(random, _RULES.encode()),
            _RULES.encode() + b"a = " + b"[" * deep + b"]" * deep,
            b"a = " + b"{a=" * deep,
            b'[rules]\na = "' + b"(" * deep + b'"\n',
            b'[rules]\na = "' + b"not " * deep + b'count(all) > 1"\n',
            b"a." * deep + b"a = 1\n",
            random.randbytes(random.randrange(2_000)),
        )
    )
    case.path("rules.toml").write_bytes(text)
    words = ("check", "source.mcap", "--rules", "rules.toml", "--format", "json")
    memory = random.choice((None, None, 300, 600, 1_000))
    run = (
        case.start_python("-c", _LITTLE_MEMORY, str(memory << 20), *words)
        if memory
        else case.start(*words)
    ).wait()
    promise(run.code in (0, 1, 2, 4, OUT_OF_MEMORY), f"exit code {run.code}\n{run.errors}")
    if run.code > 1:
        return
    promise(run.output, f"exit code {run.code} without a verdict\n{run.errors}")
    verdicts = {rule["verdict"] for rule in json.loads(run.output)["rules"]}
    promise(verdicts, "a verdict without a rule")
    promise((run.code == 0) == (verdicts == {"pass"}), f"exit code {run.code} for {verdicts}")


_LITTLE_MEMORY = """
import resource, runpy, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
del sys.argv[1]
runpy.run_module("fte_sniff", run_name="__main__", alter_sys=True)
"""


def follow(case: Case) -> None:
    """Follow a recording that grows, and rotates: each row once, with its time."""
    random = case.random
    path, table = case.path("x.mcap"), case.path("rows.csv")
    rotates = RecordingOptions(max_index_bytes=random.choice((None, 2_000)))
    recorder = Recorder(path, _PORTS, options=rotates)
    program = case.start("decode", "--follow", path.name, "-o", table)
    made = 0
    for _ in range(random.randrange(1, 8)):
        count = random.randrange(1, 300)
        recorder.write(in_columns(_frames(made, count)))
        recorder.flush()
        made += count
        sleep(random.choice((0, 0.05, 0.3)))
    wait_until(lambda: program.has_ended or len(_whole_rows(table)) >= made, "rows are missing")
    count = random.randrange(1, 300)
    recorder.write(in_columns(_frames(made, count)))
    recorder.close()
    made += count
    run = program.wait()
    promise(run.code == 0, f"exit code {run.code}\n{run.errors}")
    found, wanted = csv_rows(table), _as_read(_frames(0, made))
    promise(found == wanted, f"{len(found)} rows of {made} are followed\n{run.errors}")


def _whole_rows(table: Path) -> list[bytes]:
    """Lines of a table that is being written, without its head."""
    for path in (table, *table.parent.glob(f"*{table.name}*.part")):
        if path.exists():
            return path.read_bytes().split(b"\n")[1:-1]
    return []


def jobs(case: Case) -> None:
    """Read damaged files with several processes: what one process prints, and its exit code."""
    random = case.random
    for number in range(random.randrange(2, 6)):
        data = recording(random.randrange(VARIANTS))
        case.path(f"{number}.mcap").write_bytes(random.choice((data, damaged(random, data))))
    words: tuple[str, ...] = random.choice(
        (
            ("stats", "--format", "json"),
            ("stats",),
            ("check", "--format", "json", "--expect", "count(malformed) <= 3"),
            ("check", "--expect", "max_gap(motor = 1) < 0.1", "--expect", "count(all) > 1"),
        )
    )
    files = sorted(path.name for path in case.folder.glob("*.mcap"))
    one, several = (case.run(*words, *files, "--jobs", count) for count in ("1", "3"))
    promise(one.code == several.code, f"{words}: exit codes {one.code} and {several.code}")
    promise(one.output == several.output, f"{words}: other output with three jobs")
    lines = (Counter(run.errors.splitlines()) for run in (one, several))
    promise(next(lines) == next(lines), f"{words}: other messages\n{one.errors}\n{several.errors}")


_TEXTS = (
    *("<script>alert(1)</script>", "</script><img src=x onerror=alert(1)>", "<!--", "]]>", "&lt;"),
    *("'\"><b>", "\u202e", "\x1b[31m", "{{7*7}}", "${1}", "</title>", "\u2028", "javascript:1"),
)


class _Tags(HTMLParser):
    """The elements and attributes of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[tuple[str, tuple[str, ...]]] = Counter()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found[tag, tuple(name for name, _ in attrs)] += 1


def report_texts(case: Case) -> None:
    """Report on ports, hosts and events with hostile texts: the page has no other element."""
    random = case.random
    hostile = "".join(random.sample(_TEXTS, 4))
    pages = []
    for name, text in (("hostile", hostile), ("harmless", "x" * len(hostile))):
        path = case.path(f"{name}.mcap")
        events = [
            PortEvent(START_NS + 10**8, text, PortEventKind.LOST, text),
            PortEvent(START_NS + 2 * 10**8, text, PortEventKind.FOUND_AGAIN, text),
        ]
        with RecordingWriter(path, [PortFacts(text, DEFAULT_BAUD)], {"host": text}) as writer:
            writer.write(
                in_columns([Frame(text, row.offset, row.raw, row.t_ns) for row in _frames(0, 300)])
            )
            writer.write(in_columns(events))
        saved = Notes({path: None})
        saved.set(Note(RowKey(text, 0, START_NS), text))
        saved.save()
        run = case.run("report", path, "-o", case.path(f"{name}.html"))
        promise(run.code == 0, f"{name}: exit code {run.code}\n{run.errors}")
        pages.append(case.path(f"{name}.html").read_text())
    first, second = (_Tags(), _Tags())
    for tags, page in zip((first, second), pages, strict=True):
        tags.feed(page)
    other = (first.found - second.found) + (second.found - first.found)
    promise(not other, f"elements that texts made: {dict(other)}")
