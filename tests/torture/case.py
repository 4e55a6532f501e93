"""One case of an attack: its random numbers, its folder, the program's runs, and their promises.

Every run of the program must end in time with an exit code of the contract, without a
traceback, and with a line that names the problem if the code is not 0. What it starts ends with it.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import resource
import signal
import subprocess
import sys
import termios
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from time import monotonic, sleep

from fte_sniff.protocol.spec import DEFAULT_BAUD
from fte_sniff.recording.metadata import PortFacts
from tests.support.columns import rows_from
from tests.support.recorded_rows import PORTS, recorded_row, write_recording
from tests.waiting import BOUND_S

ROOT = Path(__file__).parents[2]
EXIT_CODES = frozenset({0, 2, 3, 4, 130})
"""Done, wrong usage, port, file, interrupted; verdicts also end with 1."""

OUT_OF_MEMORY = 70
"""The exit code where the system has too little memory, which only a limit of it may cause."""

MOST_RSS_MB = 300
MOST_UNITS = 15
"""Limits of a run on a file below 1 MB; a unit is what `decode` takes for a minute of a wire."""

_SUBREAPER = 36
_VERDICTS = re.compile(r"\s(check|doctor|--check)\b")
"""Commands that end with 1 if their verdict is bad."""
_TRACEBACK = re.compile(r"Traceback \(most recent call last\)|^\w*(Error|Exception): ", re.M)
UNSAFE = re.compile(r"[^\n\x20-\U0010ffff]|[\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


class PromiseError(Exception):
    """A promise that was not kept."""


class SkippedError(Exception):
    """An attack that this machine cannot make."""


def promise(kept: object, text: str) -> None:
    """Raise PromiseError with the text if a promise is not kept."""
    if not kept:
        raise PromiseError(text)


def adopt_orphans() -> None:
    """Become the parent of processes whose own parent is killed, so that they can be awaited."""
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


@dataclass(frozen=True)
class Run:
    """A run of the program that has ended."""

    code: int
    """Exit code; a negative signal number where it was killed."""
    output: bytes
    errors: str
    rss_mb: float
    """Largest resident set of the run and the processes that it started."""
    cpu_s: float


class Started:
    """A running program: the leader of its own session, with its output in files."""

    def __init__(
        self,
        arguments: tuple[str, ...],
        folder: Path,
        streams: Path,
        environment: Mapping[str, str],
        terminal: int | None,
    ) -> None:
        self._command = " ".join(arguments)
        self._terminal = terminal
        self._streams = [streams.with_suffix(suffix) for suffix in (".stdout", ".stderr")]
        stdout, stderr = (path.open("wb") for path in self._streams)
        with stdout, stderr:
            self._process = subprocess.Popen(
                [sys.executable, "-P", *arguments],
                stdin=subprocess.DEVNULL if terminal is None else terminal,
                stdout=stdout if terminal is None else terminal,
                stderr=stderr if terminal is None else terminal,
                cwd=folder,
                env=environment,
                start_new_session=True,
                preexec_fn=None if terminal is None else _rule_session,
            )

    @property
    def output(self) -> bytes:
        """What it has written to stdout so far."""
        return self._streams[0].read_bytes()

    @property
    def errors(self) -> str:
        """What it has written to stderr so far."""
        return self._streams[1].read_text("utf-8", "replace")

    @property
    def has_ended(self) -> bool:
        """Whether it has ended; `wait` has its exit code."""
        state = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return state[0] == "Z"

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        os.killpg(self._process.pid, signal.SIGINT)

    def kill(self) -> None:
        """Kill it with all processes of its group, and wait until all are gone."""
        self._kill_group()
        self._end(monotonic() + BOUND_S)

    def wait(self, killed_by: signal.Signals | None = None) -> Run:
        """Wait for its end, and check what holds for every run; a signal may have killed it."""
        run = self._end(monotonic() + BOUND_S)
        about = f"`{self._command}` (exit code {run.code})"
        is_verdict = run.code == 1 and bool(_VERDICTS.search(self._command))
        is_killed = killed_by is not None and run.code == -killed_by
        is_limited = run.code == OUT_OF_MEMORY and "fte-sniff: out of memory" in run.errors
        promise(
            run.code in EXIT_CODES or is_verdict or is_killed or is_limited,
            f"{about}: no exit code of the contract\n{run.errors}",
        )
        promise(not _TRACEBACK.search(run.errors), f"{about}: a traceback\n{run.errors}")
        promise(not UNSAFE.search(run.errors), f"{about}: control characters\n{run.errors!r}")
        silent = run.code in (0, 130) or is_verdict or is_killed or self._terminal is not None
        named = silent or "fte-sniff: " in run.errors
        promise(named, f"{about}: no line that names the problem\n{run.errors}")
        return run

    def _end(self, until: float) -> Run:
        pid, status, usage = self._reap(until)
        self._process.returncode = os.waitstatus_to_exitcode(status)
        self._await_group(until, pid)
        cpu_s = usage.ru_utime + usage.ru_stime
        errors = self.errors
        return Run(self._process.returncode, self.output, errors, usage.ru_maxrss / 1024, cpu_s)

    def _reap(self, until: float) -> tuple[int, int, resource.struct_rusage]:
        while True:
            found = os.wait4(self._process.pid, os.WNOHANG)
            if found[0]:
                return found
            if monotonic() > until:
                self._kill_group()
                os.waitpid(self._process.pid, 0)
                raise PromiseError(
                    f"`{self._command}` did not end within {BOUND_S:.0f} s\n{self.errors}"
                )
            sleep(0.005)

    def _await_group(self, until: float, group: int) -> None:
        """Wait for the processes that it started; they may end a little later."""
        while True:
            try:
                if not os.waitpid(-group, os.WNOHANG)[0]:
                    sleep(0.005)
            except ChildProcessError:
                return
            if monotonic() > until:
                self._kill_group()
                raise PromiseError(f"`{self._command}` left a process behind")

    def _kill_group(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)


def _rule_session() -> None:
    """Make the terminal that of the session, which its end hangs up; also under nohup."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@cache
def start_s() -> float:
    """Processor time of a run that does nothing else than start: a unit is more."""
    with TemporaryDirectory(prefix="fte-sniff-torture-") as name:
        return Case("start", 0, Path(name)).run("--version").cpu_s


@cache
def unit_s() -> float:
    """Processor time of `decode` for a minute of a full wire, on this machine as it is now."""
    with TemporaryDirectory(prefix="fte-sniff-torture-") as name:
        case = Case("unit", 0, Path(name))
        case.path("minute.mcap").write_bytes(minute())
        return case.run("decode", "minute.mcap", "-o", "x.csv").cpu_s


@cache
def minute() -> bytes:
    """A recording of a minute of a full wire."""
    count, copies = 3_456, 20
    part = rows_from([recorded_row(PORTS[0], number) for number in range(count)])
    span_ns = int(part.t_ns[1] - part.t_ns[0]) * count
    batches = [
        part.replace(
            t_ns=part.t_ns + copy * span_ns, offset=part.offset + copy * int(part.length.sum())
        )
        for copy in range(copies)
    ]
    with TemporaryDirectory() as name:
        path = Path(name) / "x.mcap"
        write_recording(path, [PortFacts(PORTS[0], DEFAULT_BAUD)], batches)
        return path.read_bytes()


class Case:
    """A case of an attack; the same seed makes the same choices."""

    def __init__(self, attack: str, seed: int, folder: Path) -> None:
        self.folder = folder / "files"
        """Where the program runs, with the files of the case."""
        self.streams = folder / "runs"
        """What the program wrote to stdout and stderr."""
        self.random = Random(f"{attack}:{seed}")
        self._runs = 0
        self._started: list[Started] = []
        settings = folder / "settings"
        for each in (self.folder, self.streams, settings):
            each.mkdir(parents=True)
        kept = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}
        self.environment = kept | {
            "PYTHONPATH": str(ROOT),
            "LANG": "C.UTF-8",
            "FTE_SNIFF_CONFIG": str(settings / "config.toml"),
            "XDG_CACHE_HOME": str(settings),
        }

    def path(self, name: str) -> Path:
        """A file of the case."""
        return self.folder / name

    def start(
        self, *arguments: str | Path, terminal: int | None = None, **environment: str
    ) -> Started:
        """Start the program with these arguments, on a terminal if one is given."""
        words = ("-m", "fte_sniff", *arguments)
        return self.start_python(*words, terminal=terminal, **environment)

    def start_python(
        self, *arguments: str | Path, terminal: int | None = None, **environment: str
    ) -> Started:
        """Start Python; `environment` is in addition to the case's own."""
        self._runs += 1
        words = tuple(map(str, arguments))
        streams = self.streams / str(self._runs)
        started = Started(words, self.folder, streams, self.environment | environment, terminal)
        self._started.append(started)
        return started

    def run(self, *arguments: str | Path, **environment: str) -> Run:
        """Run the program to its end."""
        return self.start(*arguments, **environment).wait()

    def run_limited(self, *arguments: str | Path) -> Run:
        """Run the program on a file below 1 MB, within the limits for memory and time."""
        return self.check_limits(self.run(*arguments), " ".join(map(str, arguments)))

    def check_limits(self, run: Run, about: str) -> Run:
        """Check the limits of a run on a file below 1 MB."""
        promise(run.rss_mb <= MOST_RSS_MB, f"`{about}` used {run.rss_mb:.0f} MB of memory")
        if run.cpu_s > MOST_UNITS * start_s() and run.cpu_s > MOST_UNITS * unit_s():
            unit_s.cache_clear()  # the machine may be slower now
            used = f"{run.cpu_s:.1f} s of processor time, a minute of a wire {unit_s():.1f} s"
            promise(run.cpu_s <= MOST_UNITS * unit_s(), f"`{about}` used {used}")
        return run

    def close(self) -> None:
        """Kill what still runs."""
        for started in self._started:
            started._kill_group()
