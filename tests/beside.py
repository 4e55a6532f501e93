"""Programs, threads and servers beside a test: each ends with its block, and in BOUND_S at most.

A test that fails half way leaves nothing that runs, and nothing waits for a program that has
stopped to answer: it is killed, so that a read of its output ends too.
"""

from __future__ import annotations

import socket
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.waiting import BOUND_S

Process = subprocess.Popen[bytes]


@contextmanager
def running(words: Sequence[str | Path], **options: Any) -> Iterator[Process]:
    """A program, with the options of `Popen`; killed at the end of the block if it still runs."""
    with subprocess.Popen(words, **options) as process:
        late = threading.Timer(BOUND_S, process.kill)
        late.daemon = True
        late.start()
        try:
            yield process
        finally:
            late.cancel()
            process.kill()


def state_of(pid: int) -> str:
    """The state of a process in /proc: `T` if it is stopped, `Z` or `X` if it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "X"


@contextmanager
def held(near: int, *words: str) -> Iterator[Process]:
    """A process of another program that has a terminal open.

    It must not read: once a port has its settings, a read without bytes is an end of file.
    """
    with running(words or ("sleep", "infinity"), stdin=near, stdout=subprocess.DEVNULL) as process:
        yield process


class Work(threading.Thread):
    """A function in a thread of its own, begun at once."""

    def __init__(self, function: Callable[..., object], *arguments: object) -> None:
        super().__init__(target=function, args=arguments, daemon=True)
        self.start()

    def ended(self) -> None:
        """Wait for its end. What it raised fails the test, as pytest sees to."""
        self.join(BOUND_S)
        assert not self.is_alive(), f"waited {BOUND_S:.0f} s for the end of a thread"


def server_socket() -> socket.socket:
    """A server of this machine that listens, on a TCP port of its own."""
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(BOUND_S)
    return server
