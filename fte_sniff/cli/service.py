"""What a service needs: messages to systemd, and a command for each finished file.

The protocol of `sd_notify(3)` is a datagram with lines such as `READY=1`; the packages for it are
not maintained, or need the library of systemd.
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import socket
import subprocess
from collections.abc import MutableMapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from fte_sniff.cli.capture_loop import Observer
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import UsageError, quoted, reason_of
from fte_sniff.platform import ENDING_SIGNALS, POSIX, signals

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import FeedUpdate
    from fte_sniff.session.live_session import LiveSession

PATIENCE_S: Final = 1.0
"""How long a command may run after the end of the capture until this is reported."""


class ServiceManager:
    """systemd, or nobody if the environment has no NOTIFY_SOCKET."""

    def __init__(self, environment: MutableMapping[str, str]) -> None:
        """Read the variables and remove them, so that commands do not inherit them."""
        address = environment.pop("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        usec = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        is_watched = usec.isdecimal() and pid in ("", str(os.getpid()))
        self._every_s = int(usec) / 2e6 if is_watched else None
        self._alive_s: float | None = None
        self._sent: set[str] = set()

    def notify(self, state: str) -> None:
        """Send a state such as `READY=1` once."""
        if state not in self._sent:
            self._sent.add(state)
            self._send(state)

    def alive(self, at_s: float) -> None:
        """Tell the watchdog that the capture made progress at a monotonic time, in seconds."""
        if self._every_s is None:
            return
        if self._alive_s is None or at_s >= self._alive_s + min(self._every_s, 1.0):
            self._alive_s = at_s
            self._send("WATCHDOG=1")

    def _send(self, state: str) -> None:
        if not (self._address and POSIX):
            return
        # A manager that is gone or busy does not stop a capture.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.setblocking(False)
            channel.sendto(state.encode(), self._address)


class Service(Observer):
    """A capture as a service: messages to the service manager, SIGUSR1, commands for files.

    It is the first observer: the manager hears READY once all others have printed that the capture
    began, and the wait for commands is the last thing at the end.
    """

    def __init__(self, command: FileCommand) -> None:
        self._manager = ServiceManager(os.environ)
        self._command = command
        self._rotating = signals("SIGUSR1")
        for number in self._rotating:
            signal.signal(number, signal.SIG_IGN)  # by default it ends the program

    def begun(self, session: LiveSession) -> None:
        """Begin the next file at each SIGUSR1."""
        for number in self._rotating:
            signal.signal(number, lambda *_: session.rotate())

    def update(self, update: FeedUpdate, session: LiveSession) -> None:
        """Report that the capture runs, or stops; run the command for files that are finished."""
        self._command.update(session.state.recordings, session.state.recording)
        self._manager.notify("READY=1")
        self._manager.alive(session.received_at_s)
        if session.stopping:
            self._manager.notify("STOPPING=1")

    def ended(self, session: LiveSession) -> None:
        """Run the command for the last file, and wait for all, also if the recording failed."""
        self._command.update(session.state.recordings, None)
        self._command.wait()


def _leave(*_: object) -> None:
    raise KeyboardInterrupt


class FileCommand:
    """A command that runs for each finished file, while the capture goes on."""

    def __init__(self, command: str | None) -> None:
        """Split the command as a shell does; None runs nothing.

        Raises UsageError if it is not a command.
        """
        try:
            # On Windows, a backslash separates folders.
            words = shlex.split(command or "", posix=POSIX)
        except ValueError as error:
            raise UsageError(f"--on-file: {quoted(command or '')}: {error}") from error
        self._words = words if POSIX else [word.strip('"') for word in words]
        if command is not None and not (self._words and shutil.which(self._words[0])):
            name = quoted(self._words[0] if self._words else "")
            raise UsageError(f"--on-file: {name} is not a command; name a program, no shell line")
        self._finished: set[Path] = set()
        self._running: dict[Path, subprocess.Popen[bytes]] = {}

    def update(self, recordings: Sequence[Path], current: Path | None) -> None:
        """Report commands that failed; run it for files that are finished since the last call."""
        for path, process in list(self._running.items()):
            if process.poll() is not None:
                self._report(path)
        for path in recordings if self._words else ():
            if path != current and path not in self._finished:
                self._finished.add(path)
                if path.exists():
                    self._start(path)

    def wait(self) -> None:
        """Wait for the commands that still run, up to the next signal that ends a capture."""
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
                signal.signal(number, _leave)
        try:
            for path, process in list(self._running.items()):
                try:
                    process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    name = f"{self._words[0]} for {path}"
                    print_err(f"--on-file: waiting for {name}; Ctrl-C ends, and leaves it running")
                    process.wait()
                self._report(path)
        except KeyboardInterrupt:
            print_err("--on-file: not waiting any longer")

    def _start(self, path: Path) -> None:
        try:
            # In a session of its own, Ctrl-C does not reach it; its output goes to the log.
            self._running[path] = subprocess.Popen(
                # A name that begins with a hyphen is not an option of the command.
                [*self._words, f"./{path}" if str(path).startswith("-") else str(path)],
                stdin=subprocess.DEVNULL,
                stdout=2,
                start_new_session=True,
            )
        except OSError as error:
            print_err(f"--on-file: {self._words[0]} did not start for {path}: {reason_of(error)}")

    def _report(self, path: Path) -> None:
        code = self._running.pop(path).returncode
        if code:
            how = f"exit code {code}" if code > 0 else f"signal {-code}"
            print_err(f"--on-file: {self._words[0]} failed for {path}: {how}")
