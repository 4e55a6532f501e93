"""Modules that take part in a task: those in which a function is called, without imports; depth.

python -m benchmarks.call_paths [--list]

Each task runs once to load what it imports, and once under a profiler of all threads. `--list`
names the modules.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import Any

import fte_sniff

PACKAGE = Path(fte_sniff.__file__).parent
SAMPLES = PACKAGE.parent / "samples"
PASTE = "[12:00:01.345] RX: 55 01 01 03 E8 00 00 00 0F EE"


class CallRecorder:
    """Collects the modules of the package in which functions are called."""

    def __init__(self) -> None:
        """Nothing is recorded before `recording` is entered."""
        self._files: set[str] = set()
        self.depth = 0
        """Frames of the package on the stack at the first decoding of messages; 0 without."""

    @property
    def modules(self) -> list[str]:
        """Dotted names below the package, without package `__init__` modules."""
        paths = (Path(name).relative_to(PACKAGE).with_suffix("") for name in self._files)
        return sorted(".".join(path.parts) for path in paths if path.name != "__init__")

    @contextmanager
    def recording(self) -> Iterator[None]:
        """Record the calls of all threads that run meanwhile."""
        threading.setprofile(self._on_event)
        sys.setprofile(self._on_event)
        try:
            yield
        finally:
            sys.setprofile(None)
            threading.setprofile(None)

    def _on_event(self, frame: FrameType, event: str, _argument: object) -> None:
        code = frame.f_code
        if event == "call" and _is_inside(frame) and code.co_name != "<module>":
            self._files.add(code.co_filename)
            if code.co_name == "decode_columns" and not self.depth:
                self.depth = sum(map(_is_inside, _stack(frame)))


def _is_inside(frame: FrameType) -> bool:
    return frame.f_code.co_filename.startswith(f"{PACKAGE}{os.sep}")


def _stack(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def command(*arguments: str) -> CallRecorder:
    """A command line, with its output discarded."""
    from fte_sniff.cli.main import main

    def run() -> None:
        with suppress(SystemExit):
            main(arguments)

    with silent():
        run()
        recorder = CallRecorder()
        with recorder.recording():
            run()
    return recorder


@contextmanager
def silent() -> Iterator[None]:
    """Send standard output and standard error to /dev/null."""
    kept = [os.dup(descriptor) for descriptor in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    try:
        yield
    finally:
        sys.stdout.flush()
        for descriptor, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(nowhere)


def capture() -> CallRecorder:
    """The capture loop, from chunks of a damaged stream to a closed recording."""
    from fte_sniff.capture.clock import Clock
    from fte_sniff.capture.port_source import PortGroup
    from fte_sniff.capture.source import SourceEnd
    from fte_sniff.protocol import Chunk, PortEvent, PortEventKind
    from fte_sniff.recording.metadata import PortFacts
    from fte_sniff.recording.recorder import Recorder
    from fte_sniff.session.capture_process import CaptureLoop, CapturePlan, Outbox

    start_ns, data = 10**18, (SAMPLES / "damaged.raw").read_bytes()
    chunks = [
        Chunk("p", start_ns + at * 100_000, data[at : at + 10]) for at in range(0, len(data), 10)
    ]

    class KnownSource:
        """A source of these chunks."""

        waiting, end = 0, SourceEnd.STOPPED
        uncertainty_ns: Mapping[str, int] = {"p": 0}

        def __iter__(self) -> Iterator[PortEvent | Chunk]:
            yield PortEvent(start_ns, "p", PortEventKind.OPENED, "")
            yield from chunks

    def drain(connection: Connection) -> None:
        with suppress(EOFError, OSError):
            while True:
                connection.recv()

    recorder = CallRecorder()
    with TemporaryDirectory() as folder:
        for name in ("first.mcap", "second.mcap"):
            ours, theirs = Pipe()
            threading.Thread(target=drain, args=(theirs,), daemon=True).start()
            path = Path(folder, name)
            plan, clock = CapturePlan(PortGroup(("p",)), path), Clock.tied()
            files = Recorder(path, (PortFacts("p", 115_200),), {})
            outbox = Outbox(ours, lambda: None)
            loop = CaptureLoop(plan, clock, KnownSource(), files, outbox)  # type: ignore[arg-type]
            if name.startswith("first"):
                loop.run()
                continue
            with recorder.recording():
                loop.run()
    return recorder


def screen() -> CallRecorder:
    """The screen, from rows of a feed to drawn lines.

    Its clock stands still meanwhile: what it does once a second, the health of the motors, would be
    counted on a busy machine only.
    """
    from tests.tui.conftest import ListFeed, _speed_rows, play, settle

    feed, recorder = ListFeed(), CallRecorder()

    async def scenario(app: Any, pilot: object) -> None:
        feed.give(_speed_rows(30))
        await settle(app, pilot)  # type: ignore[arg-type]
        rows, now_ns = _speed_rows(5, 30), app.now_ns()
        app.now_ns = lambda: now_ns
        with recorder.recording():
            feed.give(rows)
            await settle(app, pilot)  # type: ignore[arg-type]

    with silent():
        play(feed, scenario, size=(120, 32))
        asyncio.set_event_loop(None)
    return recorder


TASKS: Mapping[str, Callable[[], CallRecorder]] = {
    "pasted line to frames": lambda: command("hex", PASTE),
    "MCAP to CSV": lambda: command("decode", str(SAMPLES / "clean.mcap"), "--format", "csv"),
    "raw to CSV": lambda: command("decode", str(SAMPLES / "clean.raw"), "--format", "csv"),
    "chunk to MCAP": capture,
    "row to screen": screen,
}


def main() -> None:
    """Measure each task in a process of its own."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--list", action="store_true", help="name the modules")
    parser.add_argument("--task", choices=TASKS, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.task is None:
        more = ["--list"] if asked.list else []
        for task in TASKS:
            words = [sys.executable, "-m", "benchmarks.call_paths", "--task", task, *more]
            subprocess.run(words, check=True)
        return
    recorder = TASKS[asked.task]()
    modules = recorder.modules
    deep = f"  {recorder.depth} frames deep" if recorder.depth else ""
    print(f"{asked.task:<24} {len(modules):>3}{deep}")
    for module in modules if asked.list else ():
        print(f"  {module}")


if __name__ == "__main__":
    main()
