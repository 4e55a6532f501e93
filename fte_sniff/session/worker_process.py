"""Processes that the program starts: a function that runs in another Python, and pipes to it.

    this process ──standard input: the function, then lines──► │ function(received, sent)
                 ◄──────────lines──────────── standard output  │

A small module of its own: the new process imports it first, and handles signals before it loads
anything large.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import subprocess
import sys
from base64 import b64decode, b64encode
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fte_sniff.platform import ENDING_SIGNALS, POSIX, signals

_TERMINAL_SIGNALS = signals("SIGINT", "SIGTSTP", "SIGTTIN", "SIGTTOU")
"""Signals that a terminal sends to every process; only the starting process handles them."""

_START = """
import sys
# Only for the package, so that it is this one; its folder may have other modules.
sys.path.insert(0, sys.argv[1])
try:
    import fte_sniff.__main__
except OSError:
    sys.exit(4)
del sys.path[0]
fte_sniff.__main__.worker()
"""


def start_worker(function: Callable[..., None], *arguments: object) -> subprocess.Popen[bytes]:
    """Call `function(*arguments, received, sent)` in a new process; return that process.

    Lines that are written to its standard input can be read from `received`, and what is written to
    `sent` from its standard output. Its import path is that of this process without the working
    folder. It inherits standard error, and ignores Ctrl-C. Raises OSError if it cannot be started.
    """
    # The flags of this Python, for example -E; multiprocessing uses the same function.
    flags = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
    folder = str(Path(__file__).parents[2])
    here = os.path.realpath("")
    path = [*(entry for entry in sys.path if os.path.realpath(entry) != here), folder]
    if POSIX:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        process = subprocess.Popen(
            [sys.executable, *flags, "-P", "-c", _START, folder],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # An empty or relative entry of it would name the working folder.
            env={name: text for name, text in os.environ.items() if name != "PYTHONPATH"},
            # On Windows, Ctrl-C does not reach a group of its own.
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
    finally:
        if POSIX:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with suppress(OSError):  # it has ended already; its standard output shows that
        tell(process, path)
        tell(process, (function, arguments))
    return process


def line_of(value: object) -> bytes:
    """A value as a line, for `value_in`."""
    return b64encode(pickle.dumps(value)) + b"\n"


def value_in(line: bytes) -> Any:
    """The value of a line that another process of this program wrote."""
    return pickle.loads(b64decode(line))


def tell(process: subprocess.Popen[bytes], value: object) -> None:
    """Send a value to a process; raises OSError if it has ended."""
    assert process.stdin is not None
    process.stdin.write(line_of(value))


def run() -> None:
    """Run the function of `start_worker` in the new process."""
    # Ctrl-C and Ctrl-Z reach every process of the terminal. A stopped capture would lose bytes.
    for number in _TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if POSIX:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
    # Unbuffered: a thread that waits for a line holds no lock at the end.
    received, sent = io.FileIO(os.dup(0), "rb"), io.FileIO(os.dup(1), "wb")
    os.dup2(2, 1)
    sys.path[:] = value_in(received.readline())
    function, arguments = value_in(received.readline())
    function(*arguments, received, sent)
