"""Processes that the program starts: a function that runs in another Python, and a pipe to it.

Messages are pickled objects. A small module of its own: the new process imports it first, and
handles signals before it loads anything large.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

_TERMINAL_SIGNALS = (signal.SIGINT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
"""Signals that a terminal sends to every process; only the starting process handles them."""

_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_START = """
import sys
# Only for the package, so that it is this one; its folder may have other modules.
sys.path.insert(0, sys.argv[2])
try:
    import fte_sniff.__main__
except OSError:
    sys.exit(4)
del sys.path[0]
fte_sniff.__main__.worker()
"""


def start_worker(
    function: Callable[..., None], *arguments: object
) -> tuple[subprocess.Popen[bytes], Connection]:
    """Call `function(*arguments, connection)` in a new process; return it and the other end.

    Its import path is that of this process without the working folder. It inherits standard output
    and standard error, and ignores Ctrl-C. Raises OSError if it cannot be started.
    """
    ours, theirs = Pipe()
    # The flags of this Python, for example -E; multiprocessing uses the same function.
    flags = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
    folder = str(Path(__file__).parents[2])
    program = [sys.executable, *flags, "-P", "-c", _START, str(theirs.fileno()), folder]
    here = os.path.realpath("")
    path = [*(entry for entry in sys.path if os.path.realpath(entry) != here), folder]
    # An empty or relative entry of it would name the working folder.
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
    try:
        with theirs:
            process = subprocess.Popen(
                program, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()], env=environment
            )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with suppress(OSError):  # it has ended already; the caller notices at its first `recv`
        ours.send(path)
        ours.send((function, arguments))
    return process, ours


def run(descriptor: int) -> None:
    """Run the function of `start_worker` in the new process."""
    # Ctrl-C and Ctrl-Z reach every process of the terminal. A stopped capture would lose bytes.
    for number in _TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING_SIGNALS)
    connection = Connection(descriptor)
    sys.path[:] = connection.recv()
    function, arguments = connection.recv()
    function(*arguments, connection)
