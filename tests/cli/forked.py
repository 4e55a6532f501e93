"""The program in processes of its own that need not load it: forked from one that has.

Each has its own streams, folder, environment and exit code, runs `fte_sniff/__main__.py` from its
first line, and ends as an interpreter does, but for freeing what was loaded. It may have a session
and a controlling terminal of its own, and any number run at the same time. Its capture process is
forked from it too, if it has one thread. What a start itself does does not concern this file; tests
of that start the program anew, as `subprocess` does.

    test           Program             loaded once        the program        its capture
     | --channel, streams, request-> | --------fork-----------> | -----fork------> |
     | <--number, by the channel---- |                          |                  |
     | <--exit code, usage---------- | <---------end----------- | <------end------ |
"""

from __future__ import annotations

import atexit
import fcntl
import gc
import json
import os
import pkgutil
import resource
import runpy
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from multiprocessing.connection import Pipe
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple, NoReturn, Self

import fte_sniff
from tests.beside import Work
from tests.waiting import BOUND_S

MOST = 1 << 17
"""Bytes of a request at most."""
ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "_RJEM_MALLOC_CONF": "background_thread:false",  # of polars
}
"""Variables with which the libraries start no threads: only one thread of a process is forked."""
IDLE_THREADS = {"polars-ooc-clea"}
"""What polars starts all the same. It waits until rows are written to the disk, which none are."""
ROOT = Path(__file__).parents[2]
Request = dict[str, Any]


class Ended(NamedTuple):
    """A run that has ended."""

    code: int
    output: bytes
    errors: bytes
    cpu_s: float
    """Processor time of the run, without loading the program."""
    peak_bytes: int
    """Most memory that it had, with that of the loaded program."""


class Running:
    """A run of the program, with what tests use of `subprocess.Popen`; killed after BOUND_S."""

    def __init__(
        self,
        pid: int,
        channel: socket.socket,
        words: Sequence[str],
        streams: Sequence[BinaryIO | None],
    ) -> None:
        self.pid, self.args = pid, words
        self.stdin, self.stdout, self.stderr = streams
        self.cpu_s, self.peak_bytes = 0.0, 0
        self._channel = channel
        self.returncode: int | None = None
        self._late = threading.Timer(BOUND_S, self.kill)
        self._late.daemon = True
        self._late.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.kill()
        self.wait(BOUND_S)
        for stream in filter(None, (self.stdin, self.stdout, self.stderr)):
            with suppress(BrokenPipeError):
                stream.close()

    def poll(self) -> int | None:
        """The exit code, or the negative number of a signal; None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; returns the exit code, or raises `TimeoutExpired`."""
        if self.returncode is None:
            if not select.select([self._channel], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
            self._late.cancel()
            answer = self._channel.recv(MOST)
            self._channel.close()
            self.returncode, self.cpu_s, self.peak_bytes = json.loads(answer)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def communicate(
        self, given: bytes = b"", timeout: float = BOUND_S
    ) -> tuple[bytes | None, bytes | None]:
        """Write the input, and read both outputs to their ends."""
        written = dict[str, bytes]()
        works = [] if self.stdin is None else [Work(_give, self.stdin, given)]
        for name, stream in (("stdout", self.stdout), ("stderr", self.stderr)):
            if stream is not None:
                works.append(Work(_take, stream, written, name))
        for work in works:
            work.ended()
        self.wait(timeout)
        return written.get("stdout"), written.get("stderr")


class Program:
    """The program, loaded and waiting to be run again and again."""

    def __init__(self, environment: Mapping[str, str], root: Path, before: str = "") -> None:
        """Load it.

        Args:
            environment: what an interpreter begins with.
            root: where `tests` lies.
            before: Python source that is executed before it is loaded.
        """
        # Its streams are pipes as those of its runs are: what a stream is, it learns only once.
        self._near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with far:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.cli.forked", str(far.fileno()), before],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                cwd=root,
                env={**environment, **ONE_THREAD},
                pass_fds=[far.fileno()],
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._near.close()
        self._process.communicate(timeout=BOUND_S)

    def start(
        self,
        arguments: Sequence[str],
        folder: Path,
        environment: Mapping[str, str],
        *,
        streams: Sequence[int] = (subprocess.PIPE,) * 3,
        code: str | None = None,
        leads_session: bool = False,
        controlled: bool = False,
    ) -> Running:
        """Start it, or Python code with the same arguments in its place.

        Args:
            arguments: those of the program.
            folder: the working folder.
            environment: all variables.
            streams: descriptors, PIPE or DEVNULL, as those of `Popen`.
            code: Python code.
            leads_session: whether it has a session of its own.
            controlled: whether standard input is the controlling terminal of that session.
        """
        request = {
            "argv": [*map(str, arguments)],
            "folder": str(folder),
            "environment": dict(environment),
            "code": code,
            "leads_session": leads_session,
            "controlled": controlled,
            "ignores_hang_up": signal.getsignal(signal.SIGHUP) is signal.SIG_IGN,  # inherited
        }
        channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        passed, own, given = [theirs.detach()], list[BinaryIO | None](), list[int]()
        for number, stream in enumerate(streams):
            side = None
            if stream == subprocess.DEVNULL:
                given.append(os.open(os.devnull, os.O_RDWR))
            elif stream == subprocess.PIPE:
                read, write = os.pipe()
                given.append(write if number else read)
                side = os.fdopen(read, "rb") if number else os.fdopen(write, "wb")
            passed.append(given[-1] if stream < 0 else stream)
            own.append(side)
        socket.send_fds(self._near, [json.dumps(request).encode()], passed)
        for descriptor in (passed[0], *given):
            os.close(descriptor)
        answer = channel.recv(MOST)
        assert answer, self._process.communicate(timeout=BOUND_S)[1].decode()
        return Running(int(answer), channel, request["argv"], own)

    def run(
        self,
        arguments: list[str],
        stdin: bytes,
        folder: Path,
        environment: Mapping[str, str],
        code: str | None = None,
    ) -> Ended:
        """Run it to its end, or Python code with the same arguments in its place."""
        with self.start(arguments, folder, environment, code=code) as process:
            output, errors = process.communicate(stdin)
            assert output is not None
            assert errors is not None
            return Ended(process.wait(), output, errors, process.cpu_s, process.peak_bytes)


def plain_environment() -> dict[str, str]:
    """Ours, without what changes how the program writes."""
    # What is compiled is kept, so that not every start compiles the program anew.
    dropped = ("NO_COLOR", "COLUMNS", "LC_ALL", "LC_MESSAGES", "PYTHONDONTWRITEBYTECODE")
    kept = {key: value for key, value in os.environ.items() if key not in dropped}
    return kept | {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "LANG": "C.UTF-8"}


def needs_start(environment: Mapping[str, str]) -> bool:
    """Whether it has other variables that are read when an interpreter, or Textual, is loaded."""

    def read_once(variables: Mapping[str, str]) -> dict[str, str]:
        return {one: variables[one] for one in variables if one.startswith(("PYTHON", "TEXTUAL"))}

    return read_once(environment) != read_once(plain_environment())


@cache
def loaded_program() -> Program:
    """The program, loaded once for all tests of this process."""
    program = Program(plain_environment(), ROOT)
    atexit.register(program.__exit__, None, None, None)
    return program


def _take(stream: BinaryIO, written: dict[str, bytes], name: str) -> None:
    written[name] = stream.read()


def _give(stream: BinaryIO, data: bytes) -> None:
    with suppress(BrokenPipeError), stream:
        stream.write(data)


def _load() -> None:
    """Load all of the program, with one thread: a fork has no other."""
    for module in pkgutil.walk_packages(fte_sniff.__path__, "fte_sniff."):
        if module.name != "fte_sniff.__main__":
            with suppress(ImportError):
                import_module(module.name)
    import_module("polars")
    assert _has_one_thread()
    gc.freeze()


def _has_one_thread() -> bool:
    names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    return len([name for name in names if name not in IDLE_THREADS]) == 1


def _next_run(control: socket.socket, fork: Callable[[], int]) -> Request | None:
    """Wait for requests; each returns in a process of its own, and None in this one at the end."""
    running = dict[int, tuple[int, socket.socket]]()
    """Number and channel of each run, by the descriptor that becomes readable at its end."""
    while True:
        for ready in select.select([control, *running], [], [])[0]:
            if ready is not control:
                _report_end(*running.pop(ready))
                os.close(ready)
                continue
            asked, descriptors, _, _ = socket.recv_fds(control, MOST, 4)
            if not asked:
                return None
            channel, theirs = socket.socket(fileno=descriptors[0]), descriptors[1:]
            number = fork()
            if not number:
                for one in (control, channel, *(kept for _, kept in running.values())):
                    one.close()
                for descriptor in running:
                    os.close(descriptor)
                request: Request = json.loads(asked)
                _take_streams(theirs, request)
                return request
            for descriptor in theirs:
                os.close(descriptor)
            channel.send(str(number).encode())
            running[os.pidfd_open(number)] = number, channel


def _take_streams(theirs: Sequence[int], request: Request) -> None:
    if request["leads_session"]:
        os.setsid()
    for descriptor, passed in enumerate(theirs):
        os.dup2(passed, descriptor)
    for passed in theirs:
        os.close(passed)
    if request["ignores_hang_up"]:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if request["controlled"]:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    if os.isatty(1):
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]


def _report_end(number: int, channel: socket.socket) -> None:
    blocked = sys.modules["resource"]
    sys.modules["resource"] = resource  # wait4 needs it, and `before` may remove it
    _, status, used = os.wait4(number, 0)
    sys.modules["resource"] = blocked
    code, cpu_s = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
    with channel, suppress(OSError):  # of a test that has ended
        channel.send(json.dumps([code, cpu_s, 1024 * used.ru_maxrss]).encode())


def _main() -> None:
    fork = os.fork  # `before` may remove it
    exec(sys.argv[2], {})
    _load()
    request = _next_run(socket.socket(fileno=int(sys.argv[1])), fork)
    if request is not None:
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        time.tzset()
        sys.argv = ["fte-sniff", *request["argv"]]
        if hasattr(os, "fork"):
            _fork_workers()
        if request["code"] is not None:
            exec(request["code"], {"__name__": "__main__"})
        else:
            _run_program()


def _run_program() -> None:
    codes: list[object] = []
    atexit.register(_end_at_once, codes)
    try:
        runpy.run_module("fte_sniff", run_name="__main__", alter_sys=True)
        codes.append(0)
    except SystemExit as end:
        codes.append(end.code)
        raise


def _end_at_once(codes: list[object]) -> None:
    """End where the exit code is a number, after all that the program does at its end.

    What this leaves out, freeing all modules, takes as long as a short command.
    """
    # The interpreter reports what cannot be written.
    with suppress(AttributeError, OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
        if codes and isinstance(codes[0], int):
            os._exit(codes[0] & 0xFF)


class _Worker:
    """A process that the program has forked, with what it uses of `subprocess.Popen`."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._end = os.pidfd_open(pid)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; returns the exit code, or raises `TimeoutExpired`."""
        if self.returncode is None:
            if not select.select([self._end], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired("a forked process", timeout or 0)
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode

    def kill(self) -> None:
        """Send SIGKILL."""
        self._send(signal.SIGKILL)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self._send(signal.SIGTERM)

    def _send(self, number: int) -> None:
        if self.returncode is None:
            signal.pidfd_send_signal(self._end, number)


def _fork_workers() -> None:
    """Fork the processes that `session.worker_process` starts."""
    # What `before` removes must be removed before they are imported.
    from fte_sniff.platform import ENDING_SIGNALS
    from fte_sniff.session import worker_process

    start_anew = worker_process._start

    def start(program: Sequence[str], folder: str, environment: Mapping[str, str]) -> Any:
        # A fork has one thread, and the libraries of its parent.
        if not _has_one_thread() or "LD_PRELOAD" in environment:
            return start_anew(program, folder, environment)
        ours, theirs = Pipe()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        number = os.fork()
        if not number:
            _run_worker(theirs.fileno(), folder, environment)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        return _Worker(number), ours

    worker_process._start = start


def _run_worker(connection: int, folder: str, environment: Mapping[str, str]) -> NoReturn:
    """What a new interpreter does in a worker process; nothing of the program's end."""
    code: object = 1
    try:
        atexit._clear()
        for one in signal.valid_signals():
            if callable(signal.getsignal(one)):
                by_python = signal.default_int_handler if one == signal.SIGINT else signal.SIG_DFL
                signal.signal(one, by_python)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.closerange(3, connection)
        os.closerange(connection + 1, os.sysconf("SC_OPEN_MAX"))
        # What the program has not flushed yet is its own.
        sys.stdout, sys.stderr = (open(one, "w", closefd=False) for one in (1, 2))  # noqa: SIM115
        os.environ.clear()
        os.environ.update(environment)
        sys.argv = ["-c", str(connection), folder]
        gc.enable()
        import_module("fte_sniff.__main__").worker()
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    finally:
        _end_at_once([code])
        os._exit(1)


if __name__ == "__main__":
    _main()
