"""The program as a background process on a pseudo-terminal, for tests of signals and files."""

from __future__ import annotations

import os
import select
import subprocess
import tty
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.reader import Recording
from tests.beside import Process as Process
from tests.cli.program import PROGRAM as PROGRAM
from tests.cli.program import Program
from tests.waiting import BOUND_S, while_waiting
from tests.waiting import wait_until as wait_until

FRAME = bytes.fromhex("AA0000000000000000EE")


@contextmanager
def wire() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal: the descriptor of the controller's side, and the device to capture."""
    far, near = os.openpty()
    tty.setraw(near)
    try:
        yield far, os.ttyname(near)
    finally:
        for descriptor in (far, near):
            with suppress(OSError):
                os.close(descriptor)


@contextmanager
def started(
    environment: Mapping[str, str],
    folder: Path,
    *arguments: str,
    stdin: int = subprocess.DEVNULL,
    stdout: int = subprocess.PIPE,
    stderr: int = subprocess.PIPE,
) -> Iterator[Process]:
    """The running program in `folder`, with its streams; killed at the end if it runs."""
    streams = (stdin, stdout, stderr)
    with Program().start(arguments, folder, environment, streams=streams) as process:
        yield process


def children_of(pid: int) -> list[int]:
    """The processes that any thread of a process started; none if it has ended."""
    found: list[int] = []
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            found += map(int, (task / "children").read_text().split())
    return found


def first_output(process: Process, far: int) -> bytes:
    """Send frames until the program prints; returns its first output."""
    assert process.stdout is not None
    for _ in while_waiting(lambda: "the first output"):
        os.write(far, FRAME)
        if select.select([process.stdout], [], [], 0.05)[0]:
            break
    return os.read(process.stdout.fileno(), 1 << 16)


def ended(process: Process) -> tuple[int, str, str]:
    """Wait for the end; returns the exit code, and the unread rest of stdout and stderr."""
    output, errors = process.communicate(timeout=BOUND_S)
    return process.returncode, (output or b"").decode(), (errors or b"").decode()


def until(process: Process, wanted: bytes) -> bytes:
    """Standard output up to `wanted`."""
    assert process.stdout is not None
    found = b""
    awaited = while_waiting(lambda: f"{wanted!r} after {found!r}")
    while wanted not in found:
        next(awaited)
        if select.select([process.stdout], [], [], 1.0)[0]:
            more = os.read(process.stdout.fileno(), 1 << 16)
            assert more, f"the output ended before {wanted!r}: {found!r}"
            found += more
    return found


def holding(file: Path) -> list[int]:
    """Ids of the processes that have the file open, also under a former name."""
    found, sought = [], file.stat()
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.path.samestat(descriptor.stat(), sought):
                found.append(int(descriptor.parts[2]))
        except OSError:
            continue
    return found


def stderr_until(process: Process, *wanted: str) -> str:
    """Standard error up to the line with one of `wanted`; an open standard output is drained.

    The next call, or `ended`, reads the lines after it.
    """
    assert process.stderr is not None
    streams = [one for one in (process.stdout, process.stderr) if one is not None]
    found = b""
    awaited = while_waiting(lambda: f"{wanted!r} after {found!r}")
    while not (any(one.encode() in found for one in wanted) and found.endswith(b"\n")):
        next(awaited)
        for stream in select.select(streams, [], [], 1.0)[0]:
            if stream is process.stderr:
                more = os.read(stream.fileno(), 1)
                assert more, f"it ended before {wanted!r}: {found!r}"
                found += more
            else:
                os.read(stream.fileno(), 1 << 16)
    return found.decode()


def rows_in(file: Path) -> int:
    """Rows of a recording."""
    return sum(len(item) for item in Recording(file).items() if isinstance(item, Rows))
