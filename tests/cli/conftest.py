"""Runs the real program, as its users do: in a process, with files, pipes and terminals."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.processes import PROGRAM

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "samples"

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def settings_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the program looks for its settings; there is no such file yet."""
    return tmp_path_factory.mktemp("settings") / "config.toml"


@pytest.fixture
def environment(settings_file: Path) -> dict[str, str]:
    """Ours, with nothing in it that changes how the program writes."""
    dropped = ("NO_COLOR", "COLUMNS", "LC_ALL", "LC_MESSAGES")
    kept = {key: value for key, value in os.environ.items() if key not in dropped}
    own = {"PYTHONPATH": str(ROOT), "TERM": "xterm-256color", "LANG": "C.UTF-8"}
    return kept | own | {"FTE_SNIFF_CONFIG": str(settings_file)}


@pytest.fixture
def run(tmp_path: Path, environment: dict[str, str]) -> Run:
    """Run the program in an empty folder to its end, and give what it wrote and its exit code."""

    def run(*arguments: str | Path, stdin: str | bytes = "") -> subprocess.CompletedProcess[str]:
        data = stdin.encode() if isinstance(stdin, str) else stdin
        done = subprocess.run(
            [*PROGRAM, *map(str, arguments)],
            input=data,
            capture_output=True,
            timeout=60,
            check=False,
            cwd=tmp_path,
            env=environment,
        )
        return subprocess.CompletedProcess(
            done.args, done.returncode, done.stdout.decode(), done.stderr.decode()
        )

    return run


@pytest.fixture
def samples() -> Path:
    return SAMPLES
