"""Processes that the program starts: a function that runs in another Python, and a pipe to it.

Messages are pickled objects. A small module of its own: the new process imports it first, and
handles signals before it loads anything large.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Client, Connection, Listener, Pipe
from pathlib import Path
from typing import Any

from fte_sniff.platform import ENDING_SIGNALS, POSIX, signals

_TERMINAL_SIGNALS = signals("SIGINT", "SIGTSTP", "SIGTTIN", "SIGTTOU")
"""Signals that a terminal sends to every process; only the starting process handles them."""

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

_Worker = tuple[subprocess.Popen[bytes], Connection]


def start_worker(function: Callable[..., None], *arguments: object) -> _Worker:
    """Call `function(*arguments, connection)` in a new process; return it and the other end.

    Its import path is that of this process without the working folder. It inherits standard output
    and standard error, and ignores Ctrl-C. Raises OSError if it cannot be started.
    """
    # The flags of this Python, for example -E; multiprocessing uses the same function.
    flags = subprocess._args_from_interpreter_flags()  # type: ignore[attr-defined]
    program = [sys.executable, *flags, "-P", "-c", _START]
    folder = str(Path(__file__).parents[2])
    here = os.path.realpath("")
    path = [*(entry for entry in sys.path if os.path.realpath(entry) != here), folder]
    # An empty or relative entry of it would name the working folder.
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONPATH"}
    process, ours = _start(program, folder, environment)
    with suppress(OSError):  # it has ended already; the caller notices at its first `recv`
        ours.send(path)
        ours.send((function, arguments))
    return process, ours


_BY_ADDRESS = "-"
"""In place of a descriptor: address and key come through standard input."""

if POSIX:

    def _start(program: Sequence[str], folder: str, environment: Mapping[str, str]) -> _Worker:
        """A process that inherits the other end of a pipe."""
        ours, theirs = Pipe()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            with theirs:
                process = subprocess.Popen(
                    [*program, str(theirs.fileno()), folder],
                    stdin=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    env=environment,
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return process, ours

else:

    def _start(program: Sequence[str], folder: str, environment: Mapping[str, str]) -> _Worker:
        """A process that connects to this one, where none inherits a pipe by its number."""
        key, connected = os.urandom(32), threading.Event()
        with Listener(authkey=key) as listener:
            process = subprocess.Popen(
                [*program, _BY_ADDRESS, folder],
                stdin=subprocess.PIPE,
                env=environment,
                # Ctrl-C does not reach a group of its own, not even before it is ignored.
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )

            def end_waiting() -> None:
                process.wait()
                if not connected.is_set():
                    with suppress(OSError):
                        Client(listener.address, authkey=key).close()

            threading.Thread(target=end_waiting, name="waits for a process", daemon=True).start()
            assert process.stdin is not None
            with suppress(OSError), process.stdin:
                process.stdin.write(pickle.dumps((listener.address, key)))
            ours: Any = listener.accept()
            connected.set()
        return process, ours


def run(descriptor: str) -> None:
    """Run the function of `start_worker` in the new process."""
    # Ctrl-C and Ctrl-Z reach every process of the terminal. A stopped capture would lose bytes.
    for number in _TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    if POSIX:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING_SIGNALS)
        connection = Connection(int(descriptor))
    else:
        address, key = pickle.load(sys.stdin.buffer)
        connection = Client(address, authkey=key)
    sys.path[:] = connection.recv()
    function, arguments = connection.recv()
    function(*arguments, connection)
