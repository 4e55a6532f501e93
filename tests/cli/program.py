"""The program in a process of its own, and Python code in its place."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

from tests.beside import Process, running
from tests.waiting import BOUND_S

ROOT = Path(__file__).parents[2]
PROGRAM = (sys.executable, "-m", "fte_sniff")
MAIN = "import runpy\nrunpy.run_module('fte_sniff', run_name='__main__', alter_sys=True)"
_DROPPED = ("NO_COLOR", "COLUMNS", "LC_ALL", "LC_MESSAGES", "PYTHONDONTWRITEBYTECODE")


class Ended(NamedTuple):
    """A run that has ended."""

    code: int
    output: bytes
    errors: bytes


def plain_environment() -> dict[str, str]:
    """Ours, without what changes how the program writes."""
    kept = {key: value for key, value in os.environ.items() if key not in _DROPPED}
    return kept | {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "LANG": "C.UTF-8"}


class Program:
    """The program, with Python code that is executed before it."""

    def __init__(self, before: str = "") -> None:
        self._before = before

    def command(self, words: Sequence[str | Path], code: str | None = None) -> list[str]:
        """The command line, with the program's arguments; `code` is executed in its place."""
        arguments = [str(word) for word in words]
        if not self._before and code is None:
            return [*PROGRAM, *arguments]
        return [sys.executable, "-c", f"{self._before}\n{code or MAIN}", *arguments]

    def run(
        self,
        words: Sequence[str | Path],
        given: bytes,
        folder: Path,
        environment: Mapping[str, str],
        code: str | None = None,
    ) -> Ended:
        """Run it to its end, with standard input in a pipe."""
        done = subprocess.run(
            self.command(words, code),
            input=given,
            capture_output=True,
            cwd=folder,
            env=environment,
            timeout=BOUND_S,
            check=False,
        )
        return Ended(done.returncode, done.stdout, done.stderr)

    def start(
        self,
        words: Sequence[str | Path],
        folder: Path,
        environment: Mapping[str, str],
        *,
        streams: Sequence[int] = (subprocess.PIPE,) * 3,
        **options: Any,
    ) -> AbstractContextManager[Process]:
        """Start it; `streams` and `options` are those of `Popen`."""
        stdin, stdout, stderr = streams
        return running(
            self.command(words),
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            cwd=folder,
            env=environment,
            **options,
        )
