"""The program in processes of its own that need not load it: forked from one that has.

Each has its own streams, folder, environment and exit code, runs `fte_sniff/__main__.py` from its
first line, and ends as an interpreter does, but for freeing what was loaded. What a start itself
does does not concern this file; tests of that start the program anew, as `processes.py` does.

    test           Program             loaded once        the program
     | --streams, request--> | ------------fork-------------> |
     | <------number-------- |                                |
     | <--exit code, usage-- | <------------end-------------- |
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import pkgutil
import resource
import runpy
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

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


class Program:
    """The program, loaded and waiting to be run again and again, one run at a time."""

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

    def run(
        self,
        arguments: list[str],
        stdin: bytes,
        folder: Path,
        environment: Mapping[str, str],
        code: str | None = None,
    ) -> Ended:
        """Run it to its end, or Python code with the same arguments in its place."""
        with ExitStack() as stack:
            pipes = [os.pipe() for _ in range(3)]
            (given, give), (out, put_out), (err, put_err) = pipes
            theirs = [given, put_out, put_err]
            request = {
                "argv": arguments,
                "folder": str(folder),
                "environment": dict(environment),
                "code": code,
            }
            socket.send_fds(self._near, [json.dumps(request).encode()], theirs)
            for descriptor in theirs:
                os.close(descriptor)
            number = int(self._answer())
            late = threading.Timer(BOUND_S, os.kill, (number, signal.SIGKILL))
            late.start()
            stack.callback(late.cancel)
            written = [b"", b""]
            for thread in (
                Work(_give, give, stdin),
                Work(_take, out, written, 0),
                Work(_take, err, written, 1),
            ):
                thread.ended()
            status, cpu_s, peak_bytes = json.loads(self._answer())
            assert not late.finished.is_set(), f"waited {BOUND_S} s for the end of {arguments}"
        return Ended(status, *written, cpu_s, peak_bytes)

    def _answer(self) -> bytes:
        answer = self._near.recv(MOST)
        assert answer, self._process.communicate(timeout=BOUND_S)[1].decode()
        return answer


def _give(descriptor: int, data: bytes) -> None:
    with suppress(BrokenPipeError), open(descriptor, "wb") as stream:
        stream.write(data)


def _take(descriptor: int, written: list[bytes], which: int) -> None:
    with open(descriptor, "rb") as stream:
        written[which] = stream.read()


def _load() -> None:
    """Load all of the program but the screen, with one thread: a fork has no other."""
    for module in pkgutil.walk_packages(fte_sniff.__path__, "fte_sniff."):
        if not module.name.startswith(("fte_sniff.tui", "fte_sniff.__main__")):
            with suppress(ImportError):
                import_module(module.name)
    import_module("polars")
    threads = {(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()}
    assert len(threads - IDLE_THREADS) == 1, threads
    gc.freeze()


def _next_run(control: socket.socket, fork: Callable[[], int]) -> Request | None:
    """Wait for requests; each returns in a process of its own, and None in this one at the end."""
    while True:
        asked, theirs, _, _ = socket.recv_fds(control, MOST, 3)
        if not asked:
            return None
        number = fork()
        if not number:
            control.close()
            for descriptor, theirs_now in enumerate(theirs):
                os.dup2(theirs_now, descriptor)
                os.close(theirs_now)
            request: Request = json.loads(asked)
            return request
        for descriptor in theirs:
            os.close(descriptor)
        control.send(str(number).encode())
        blocked = sys.modules["resource"]
        sys.modules["resource"] = resource  # wait4 needs it, and `before` may remove it
        _, status, used = os.wait4(number, 0)
        sys.modules["resource"] = blocked
        code, cpu_s = os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime
        control.send(json.dumps([code, cpu_s, 1024 * used.ru_maxrss]).encode())


def _main() -> None:
    fork = os.fork  # `before` may remove it
    exec(sys.argv[2], {})
    _load()
    request = _next_run(socket.socket(fileno=int(sys.argv[1])), fork)
    if request is not None:
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        sys.argv = ["fte-sniff", *request["argv"]]
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


if __name__ == "__main__":
    _main()
