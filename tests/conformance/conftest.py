"""Recordings of every sort, and the readers that people have, built where they need building."""

import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter
from tests.conformance.python_readers import mcap_lines, rerun_lines
from tests.recording.conftest import START, some_rows
from tests.slow import first
from tests.support.columns import entries

HERE = Path(__file__).parent
BUILD_WITHIN_S = 900
READ_WITHIN_S = 120
BUILDS = "FTE_SNIFF_CONFORMANCE_BUILDS"
"""The environment's word for where readers that were built are kept from run to run."""

Lines = Callable[[Path], list[str]]
Recorded = tuple[Path, list[Row], list[PortEvent]]


def _needs(there: object, what: str) -> None:
    """Leave a reader out where it cannot be had, but never in CI."""
    if not there:
        assert not os.environ.get("CI"), f"{what} is needed here"
        pytest.skip(f"{what} is not installed")


def _run(*command: str | Path, cwd: Path, within_s: int = BUILD_WITHIN_S) -> str:
    done = subprocess.run(
        command, cwd=cwd, timeout=within_s, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def builds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = os.environ.get(BUILDS)
    return Path(kept) if kept else tmp_path_factory.mktemp("readers")


@pytest.fixture(scope="session")
def node_programs(builds: Path) -> Path:
    """The folder of the programs in `node/`."""
    _needs(shutil.which("npm"), "npm")
    folder = builds / "node"
    shutil.copytree(HERE / "node", folder, dirs_exist_ok=True)
    _run("npm", "install", "--no-audit", "--no-fund", "--no-package-lock", cwd=folder)
    return folder


@pytest.fixture(scope="session")
def typescript(node_programs: Path) -> Lines:
    """`@mcap/core`, which Foxglove and Lichtblick read with, and protobufjs."""

    def lines(path: Path) -> list[str]:
        reported = _run("node", "read.mjs", path, cwd=node_programs, within_s=READ_WITHIN_S)
        return reported.splitlines()

    return lines


@pytest.fixture(scope="session")
def rust_programs(builds: Path) -> Path:
    """The folder of the programs in `rust/`."""
    _needs(shutil.which("cargo"), "cargo")
    folder = builds / "rust"
    shutil.copytree(HERE / "rust", folder, dirs_exist_ok=True)
    _run("cargo", "build", "--quiet", cwd=folder)
    return folder / "target" / "debug"


def _lines_of(program: Path) -> Lines:
    return lambda path: _run(program, path, cwd=path.parent, within_s=READ_WITHIN_S).splitlines()


@pytest.fixture(scope="session")
def rust(rust_programs: Path) -> Lines:
    """The `mcap` crate with prost-reflect."""
    return _lines_of(rust_programs / "mcap-lines")


@pytest.fixture(scope="session")
def doctor(rust_programs: Path) -> Lines:
    """A check with the `mcap` crate of all that its project's `mcap doctor` checks, and more."""
    return _lines_of(rust_programs / "doctor")


@pytest.fixture(scope="session")
def python() -> Lines:
    """`mcap` with `mcap-protobuf-support`."""
    return mcap_lines


@pytest.fixture(scope="session")
def rerun() -> Lines:
    """The loader of rerun's viewer."""
    _needs(find_spec("rerun"), "rerun-sdk")
    return rerun_lines


def _record(path: Path, count: int, flush_every: int, ports: tuple[str, ...]) -> Recorded:
    events = [
        PortEvent(START - 5, ports[0], PortEventKind.OPENED, "115200 8N1 串口"),
        PortEvent(START + count * 10**6 + 10**9, ports[0], PortEventKind.CLOSED, ""),
    ]
    rows = [
        replace(row, port=ports[number % len(ports)])
        for number, row in enumerate(some_rows(count, ports[0]))
    ]
    writer = RecordingWriter(path, [PortFacts(port, 115_200) for port in ports], {"host": "bench"})
    with writer:
        writer.write(*entries(events[0]))
        for start in range(0, count, flush_every):
            writer.write(*entries(rows[start : start + flush_every]))
            writer.flush()
        writer.write(*entries(events[1]))
    return path, rows, events


@pytest.fixture(params=first(3, ["empty", "short", "two wires", "many chunks"]))
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> Recorded:
    """A recording, and what went into it."""
    path = tmp_path / "recorded.mcap"
    match request.param:
        case "empty":
            RecordingWriter(path, [PortFacts("/dev/ttyUSB0", 115_200)], {}).close()
            return path, [], []
        case "short":
            return _record(path, 60, 60, ("/dev/ttyUSB0",))
        case "many chunks":
            return _record(path, 20_000, 500, ("/dev/ttyUSB0",))
        case "two wires":
            return _record(path, 2_000, 300, ("/dev/ttyUSB0", "/dev/ttyUSB1"))
    raise AssertionError(request.param)
