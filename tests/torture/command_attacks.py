"""Attacks on every command: its options, hostile names, Ctrl-C, and terminals that vanish.

Commands and options come from click, so that a new one is attacked without a change here.
"""

from __future__ import annotations

import os
import re
import select
import signal
import termios
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from random import Random
from time import monotonic, sleep

import click
import polars as pl

from fte_sniff.cli.main import COMMANDS, fte_sniff
from tests.torture.case import BOUND_S, ROOT, UNSAFE, Case, Run, Started, minute, promise
from tests.torture.damage import VARIANTS, damaged, recording
from tests.torture.file_attacks import (
    check_killed,
    check_read_by_both,
    csv_rows,
    decoded,
    official_rows,
)

ALLOWED: Mapping[str, set[int]] = {
    "live": {0, 1, 2, 3, 4},
    "bridge": {0, 1, 2, 3, 4},
    "check": {0, 1, 2, 4},
    "doctor": {0, 1, 2, 3, 4},
    "simulate": {0, 2, 3, 4},
}
"""Exit codes of a command; of the others 0, 2 and 4."""

VALUES: Mapping[str, Sequence[str]] = {
    "TIME": ("+1s", "-2s", "12:00:05", "2026-01-31T12:00:01Z", "1h", "12:00:05+08:00"),
    "S": ("0.2", "1", "5min"),
    "N": ("1", "7", "100000"),
    "SIZE": ("200kB", "1GB", "none"),
    "SIZE|TIME|auto|none": ("100kB", "1h", "auto", "none"),
    "EXPR": ("motor = 1", "rpm > 500 AND status = 'ok'", "faults IS NULL", "help"),
    "FILE": ("rules.toml", "settings.toml", "missing.toml"),
    "CMD": ("true", "false", "no-such-program -x"),
    "NAME": ("hex pairs, spaces", "/fte/port", "/other"),
    "ZONE": ("+08:00", "Asia/Shanghai", "UTC"),
    "DATE": ("2026-01-31",),
    "REGEX": ("(?P<data>.*)", "(?P<time>[^ ]+) (?P<data>.*)", "(", "(?P<data>(a+)+)$"),
    "RULE": ("count(malformed) == 0", "count(all) >= 1", "no_measure(1) > 2"),
    "SPEED": ("1", "100"),
    "file name": ("x.mcap", "x.csv", "x.html", "rules.toml", "no/x.mcap", ".", "source.mcap"),
    "integer": ("1", "115200", "0", "-1"),
    "integer range": ("1", "115200", "0", "-1"),
    "float": ("0.5", "0"),
    "float range": ("0.5", "0"),
}
"""Valid values, and such as fit sometimes, by what an option's help calls them."""

_FORMS = ("{}", "{}GB", "-{}", "0.{}", "{}h", "{}e{}", "\u202e{}\x9b", "rpm > {}", "", "nan", "inf")
_ENDINGS: Mapping[str, tuple[str, ...]] = {
    "live": ("--duration=0.3",),
    "bridge": ("--duration=0.3",),
    "doctor": ("--duration=0.2",),
}
"""What a drawn command line ends with, so that it ends."""

RULES = '[rules]\nfew = "count(malformed) <= 3"\n'
INPUTS = (
    "source.mcap",
    "cut.mcap",
    "log.hex",
    "log.txt",
    "bytes.raw",
    "missing.mcap",
    ".",
    "*.raw",
)
PORTS = ("sim://?frames=20", "sim://?frames=20&flip=0.2", "loop://", "sim://?seed=x", "no-port")
WORDS = ("AA0000000000000000EE", "AA 01", "zz", "speed", "reset", "--rpm=5", "bash", "1", "")


def _hostile(random: Random) -> str:
    digits = str(random.randrange(10)) * random.choice((1, 20, 400, 5_000))
    return random.choice(_FORMS).replace("{}", digits)


def _option(random: Random, option: click.Option) -> list[str]:
    name = random.choice([*option.opts, *option.secondary_opts])
    if option.is_flag:
        return [name]
    if random.random() < 0.3:
        value = _hostile(random)
    elif isinstance(option.type, click.Choice):
        value = str(random.choice(list(option.type.choices)))
    else:
        value = random.choice(VALUES.get(option.metavar or option.type.name, WORDS))
    return [f"{name}={value}"] if name.startswith("--") else [name, value]


def drawn_command(random: Random, name: str) -> list[str]:
    """A command line of a command, with up to six of its options."""
    command = fte_sniff.get_command(click.Context(fte_sniff), name)
    assert command is not None
    known = [each for each in command.params if isinstance(each, click.Option)]
    # A cluster is waited for; its address is tested in tests/cli.
    known = [each for each in known if each.name != "cluster"]
    chosen = random.sample(known, min(len(known), random.choice((0, 1, 2, 3, 6))))
    words = [word for option in chosen for word in _option(random, option)]
    pool = {"live": PORTS, "bridge": PORTS, "doctor": PORTS}.get(name, INPUTS)
    if name in ("hex", "encode", "completion"):
        pool = WORDS
    arguments = [each for each in command.params if isinstance(each, click.Argument)]
    if name == "encode":  # without arguments it prints its help
        words += random.choices(pool, k=2)
    elif arguments:
        words += random.choices(pool, k=random.choice((1, 1, 1, 2, 0)))
    return [name, *words, *_ENDINGS.get(name, ())]


def _write_inputs(case: Case) -> None:
    random = case.random
    data = recording(random.randrange(VARIANTS))
    case.path("source.mcap").write_bytes(data)
    case.path("cut.mcap").write_bytes(data[: random.randrange(len(data))])
    log = (ROOT / "samples" / "clean.hex").read_bytes()[:20_000]
    case.path("log.hex").write_bytes(log)
    case.path("log.txt").write_bytes(damaged(random, log))
    case.path("bytes.raw").write_bytes(random.randbytes(2_000))
    case.path("rules.toml").write_text(RULES)
    case.path("settings.toml").write_text('[screen]\nlanguage = "zh"\n')


def _ended(case: Case, name: str, program: Started) -> Run:
    """The end of a drawn command; `simulate` is interrupted."""
    end = monotonic() + 2
    while name == "simulate" and not program.has_ended and monotonic() < end:
        if program.output:
            program.interrupt()
            break
        sleep(0.01)
    return program.wait()


def options(case: Case) -> None:
    """Start a command with drawn options, valid and hostile: a clear end, unchanged inputs."""
    _write_inputs(case)
    before = {name: case.path(name).read_bytes() for name in INPUTS if case.path(name).is_file()}
    name = case.random.choice(COMMANDS)
    words = drawn_command(case.random, name)
    run = case.check_limits(_ended(case, name, case.start(*words)), " ".join(words)[:200])
    promise(
        run.code in ALLOWED.get(name, {0, 2, 4}), f"{words}: exit code {run.code}\n{run.errors}"
    )
    if not (name in ("live", "bridge") and "--force" in words):
        for path, data in before.items():
            promise(case.path(path).read_bytes() == data, f"{words} changed {path}")
    promise(not list(case.folder.glob("*.part")), f"{words} left a partial file")


_EVIL = (
    *("\x1b[31m", "\x1b]0;title\x07", "\x9b", "\x85", "\u2028", "\u202e", "\u2066", "\r\n", "\t"),
    *("<script>alert(1)</script>", "[red]", "&quot;\"'", "\udcff\udcfe", "\ufeff", "%s{x}", ",;"),
)


def names(case: Case) -> None:
    """Give files, ports and logs names with control characters: no output contains one."""
    random = case.random
    evil = "a".join(random.sample(_EVIL, 4))
    name = evil.replace("/", "_")
    source = case.path(f"{name}.{random.choice(('mcap', 'mcap', 'log'))}")
    port = evil.encode(errors="replace").decode()
    data = recording(random.randrange(VARIANTS), port)
    if source.suffix == ".log":
        text = evil.encode(errors="surrogateescape")
        source.write_bytes(b"12:00:00.1 %s TX: AA0000000000000000EE\n" % text * 40)
    else:
        source.write_bytes(data if random.random() < 0.5 else data[: len(data) * 2 // 3])
    words = random.choice(
        (
            *(("decode", "--format", form) for form in ("table", "csv", "jsonl", "hex")),
            ("decode", "-o", f"x{name}.csv"),
            ("decode", "-o", f"x{name}.mcap"),
            ("decode", "--filter", f"port = '{evil}'"),
            *(("stats", "--format", form) for form in ("table", "json")),
            *(
                ("check", "--expect", "count(malformed) == 0", "--format", form)
                for form in ("table", "json")
            ),
            ("check", "--expect", evil),
            ("report", "-o", "x.html"),
            ("repair", "-o", f"x{name}.mcap"),
        )
    )
    run = case.run_limited(*words, source.name)
    texts = [run.output, *(path.read_bytes() for path in case.folder.glob("x*.html"))]
    if words[-1].endswith(".csv"):
        texts += [path.read_bytes() for path in case.folder.glob("x*.csv")]
    for text in texts:
        # What is no UTF-8 would become a surrogate here, which is unsafe too.
        found = UNSAFE.search(text.decode(errors="surrogateescape").replace("\r\n", "\n"))
        promise(not found, f"{words}: {found and found[0]!r} is in the output")
        promise(b"<script>alert" not in text or b"<html" not in text, "a script of a name runs")
    for path in case.folder.glob("x*.mcap"):
        official_rows(path)


_INTERRUPTED: Sequence[tuple[str, ...]] = (
    *(("decode", "source.mcap", "-o", f"x.{kind}") for kind in ("csv", "jsonl", "mcap", "parquet")),
    ("decode", "source.mcap", "-o", "old.csv", "--force"),
    ("decode", "--follow", "source.mcap", "-o", "x.csv"),
    ("stats", "source.mcap", "copy.mcap", "--jobs", "2"),
    ("stats", "source.mcap"),
    ("check", "source.mcap", "--expect", "count(malformed) >= 0"),
    ("report", "source.mcap", "-o", "x.html"),
    ("repair", "cut.mcap", "-o", "x.mcap"),
    ("live", "sim://?rate=1000", "--plain", "-o", "x.mcap"),
    ("live", "sim://?rate=1000", "--headless", "-o", "x.mcap"),
    ("bridge", "sim://?rate=1000", "--plain", "-o", "x.mcap"),
    ("doctor", "sim://"),
    ("simulate",),
)
_NORMAL_ENDS = frozenset({"live", "bridge", "simulate", "--follow"})
_RECORDED = re.compile(r"^([\d,]+) rows", re.M)


LOADING = """
import pathlib, runpy, signal
signal.signal(signal.SIGINT, signal.SIG_DFL)
pathlib.Path("loading").touch()
runpy.run_module("fte_sniff", run_name="__main__", alter_sys=True)
"""
"""Before it, Ctrl-C is Python's own, which prints a traceback."""


def interrupt(case: Case) -> None:
    """Press Ctrl-C at any moment of any command: the exit code and what it reports are true."""
    words = case.random.choice(_INTERRUPTED)
    data = minute()
    for name in ("source.mcap", "copy.mcap"):
        case.path(name).write_bytes(data)
    case.path("cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    case.path("old.csv").write_text("old")
    _, rows = decoded(case, case.path("source.mcap"), limited=False)
    program = case.start_python("-c", LOADING, *words)
    while not case.path("loading").exists():
        sleep(0.002)
    sleep(case.random.uniform(0, 1.5))
    with suppress(ProcessLookupError):
        program.interrupt()
    run = program.wait(killed_by=signal.SIGINT)
    has_begun = "recording to" in run.errors or run.output
    is_normal = _NORMAL_ENDS.intersection(words) and has_begun
    codes = {0} if is_normal else {0, 130, -signal.SIGINT}
    promise(run.code in codes, f"{words}: exit code {run.code}\n{run.errors}")
    promise(not list(case.folder.glob(".*.part")), f"{words} left a partial file\n{run.errors}")
    if words[0] in ("live", "bridge"):
        _check_capture(case, run)
    elif words[0] == "decode":
        _check_conversion(case, words, run, len(rows))


def _check_capture(case: Case, run: Run) -> None:
    shown = [int(number.replace(",", "")) for number in _RECORDED.findall(run.errors)]
    path = case.path("x.mcap")
    rows = len(check_killed(case, path)) if path.exists() and path.stat().st_size else 0
    if run.code == 0:
        promise(rows == max(shown, default=0), f"{rows} rows in the file\n{run.errors}")


def _rows_in(case: Case, path: Path) -> int:
    """The rows of a converted file; all, if the signal came after the last of them."""
    if path.suffix == ".parquet":
        return pl.read_parquet(path).height
    if path.suffix == ".mcap":
        return len(check_killed(case, path))
    return len(csv_rows(path) if path.suffix == ".csv" else path.read_bytes().splitlines())


def _check_conversion(case: Case, words: Sequence[str], run: Run, total: int) -> None:
    """A converted file is complete, or it is announced as a part, or it is as before."""
    path = case.path(words[words.index("-o") + 1])
    announced = "holds the rows up to there" in run.errors
    if run.code == 0:
        promise(path.exists(), f"{words}: exit code 0 without a file\n{run.errors}")
    elif not announced:
        whole = path.exists() and _rows_in(case, path) == total
        before = path.name == "old.csv" and path.read_text() == "old"
        promise(whole or before or not path.exists(), f"{words}: a file is left\n{run.errors}")
    if run.code == 0 and path.suffix == ".csv" and "--follow" not in words:
        promise(len(csv_rows(path)) == total, f"{words}: exit code 0, and not all rows")


class Screen:
    """A pseudo-terminal for a program, and what was drawn on it."""

    def __init__(self) -> None:
        self.far, self.near = os.openpty()
        termios.tcsetwinsize(self.near, (24, 80))
        self.drawn = b""

    def read(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        """Read what is drawn for some time, or until something holds."""
        end = monotonic() + seconds
        while not until() and (left := end - monotonic()) > 0:
            if select.select([self.far], [], [], min(left, 0.1))[0]:
                try:
                    self.drawn += os.read(self.far, 1 << 16)
                except OSError:  # the program has ended
                    return

    def type(self, keys: bytes) -> None:
        """Press keys."""
        with suppress(OSError):
            os.write(self.far, keys)

    def close(self) -> None:
        """Take the terminal away."""
        os.close(self.far)


_SCREENS: Sequence[tuple[str, ...]] = (
    ("live", "sim://?rate=500", "-o", "x.mcap"),
    ("live", "sim://?rate=500", "-o", "x.mcap", "--plain"),
    ("live", "sim://?rate=500", "-o", "x.mcap", "--headless"),
    ("view", "source.mcap"),
    ("view", "--follow", "source.mcap"),
    ("decode", "source.mcap", "-o", "x.csv"),
    ("decode", "source.mcap"),
    ("stats", "source.mcap"),
    ("report", "source.mcap", "-o", "x.html"),
    ("repair", "cut.mcap", "-o", "x.mcap"),
)
_KEYS = (b"q", b"q", b"?", b"/rpm > 5\r", b"\x1b", b"e", b"p", b"\x03", b" ", b"\x1b[A", b"n")


def terminal(case: Case) -> None:
    """Take the terminal away at any moment: everything ends, and the files are valid."""
    random = case.random
    words = random.choice(_SCREENS)
    data = minute()
    case.path("source.mcap").write_bytes(data)
    case.path("cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    screen = Screen()
    program = case.start(*words, terminal=screen.near, TERM="xterm-256color")
    os.close(screen.near)
    if random.random() < 0.7:
        # Without a screen, a capture prints one short line.
        least = 1 if "--headless" in words else 200
        screen.read(BOUND_S, lambda: len(screen.drawn) >= least or program.has_ended)
        for _ in range(random.randrange(4)):
            screen.type(random.choice(_KEYS))
            screen.read(random.uniform(0, 0.6))
    screen.read(random.uniform(0, 1.5))
    screen.close()
    run = program.wait(killed_by=signal.SIGHUP)
    promise(b"Traceback" not in screen.drawn, f"{words}: a traceback\n{screen.drawn[-3000:]!r}")
    codes = {0, 4, 130, -signal.SIGHUP}
    promise(run.code in codes, f"{words}: exit code {run.code}\n{screen.drawn[-1000:]!r}")
    promise(not list(case.folder.glob(".*.part")), f"{words} left a partial file")
    for path in case.folder.glob("x*.mcap"):
        if path.stat().st_size:
            check_read_by_both(case, path)
