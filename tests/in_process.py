"""The command line in this process, with the streams, folder and environment of a user.

Standard output and standard error are pipes, as in a shell; a terminal needs a process of its own.
"""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import copy_context
from pathlib import Path
from tempfile import TemporaryFile
from typing import NamedTuple

from fte_sniff.cli.main import main
from tests.beside import Work

_HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)


class Done(NamedTuple):
    """A command that has ended."""

    code: int
    output: bytes
    errors: bytes


def user_environment(home: Path) -> dict[str, str]:
    """The variables of a session: the same zone, language and settings on every machine.

    Args:
        home: the home folder, in which there are no settings yet.
    """
    return {
        "PATH": os.environ.get("PATH", os.defpath),
        "HOME": str(home),
        "LANG": "C.UTF-8",
        "TZ": "UTC",
        "TERM": "xterm-256color",
        "FTE_SNIFF_CONFIG": str(home / "config.toml"),
        "XDG_STATE_HOME": str(home / "state"),
        "XDG_RUNTIME_DIR": str(home / "runtime"),
        "XDG_CACHE_HOME": str(home / "cache"),
    }


def call(words: Sequence[str], given: bytes, folder: Path, environment: Mapping[str, str]) -> Done:
    """Run a command to its end.

    Args:
        words: the arguments of `fte-sniff`.
        given: standard input.
        folder: the working folder.
        environment: all variables.
    """
    with ExitStack() as stack:
        file = stack.enter_context(TemporaryFile())
        file.write(given)
        file.seek(0)
        outputs = [_Output(), _Output()]
        with streams([file.fileno(), *(one.near for one in outputs)]), place(folder, environment):
            code = exit_code(words)
        written = [one.end() for one in outputs]
    return Done(code, *written)


def exit_code(words: Sequence[str]) -> int:
    """Run a command with the streams and in the folder of this process; returns its exit code."""
    handlers = {number: signal.getsignal(number) for number in _HANDLED}
    try:
        with warnings.catch_warnings():
            copy_context().run(main, [*words])  # the language is that of one command
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        # A process that ends has no alarm either: the next command would take it for Ctrl-C.
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return 0


@contextmanager
def streams(descriptors: Sequence[int]) -> Iterator[None]:
    """Standard streams at these descriptors, in Python and below it."""
    kept, ours = [os.dup(number) for number in range(3)], (sys.stdin, sys.stdout, sys.stderr)
    try:
        for number, descriptor in enumerate(descriptors):
            os.dup2(descriptor, number)
        sys.stdin, sys.stdout, sys.stderr = (
            open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115
            for number, mode in enumerate("rww")
        )
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        sys.stdin, sys.stdout, sys.stderr = ours
        for number, descriptor in enumerate(kept):
            os.dup2(descriptor, number)
            os.close(descriptor)


@contextmanager
def place(folder: Path, environment: Mapping[str, str]) -> Iterator[None]:
    """A working folder and variables."""
    here, variables = Path.cwd(), dict(os.environ)
    try:
        os.chdir(folder)
        _set_variables(environment)
        yield
    finally:
        os.chdir(here)
        _set_variables(variables)


def _set_variables(variables: Mapping[str, str]) -> None:
    os.environ.clear()
    os.environ.update(variables)
    time.tzset()


class _Output:
    """A pipe that is read beside the command: a file would be another kind of output."""

    def __init__(self) -> None:
        far, self.near = os.pipe()
        self._data = b""
        self._reading = Work(self._read, far)

    def _read(self, far: int) -> None:
        with open(far, "rb") as stream:
            self._data = stream.read()

    def end(self) -> bytes:
        """All that was written."""
        os.close(self.near)
        self._reading.ended()
        return self._data
