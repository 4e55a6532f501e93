"""The command line as its users have it: in this process, or in one of its own."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.program import plain_environment as plain_environment
from tests.in_process import call
from tests.needs import needs

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "samples"
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def settings_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the program looks for its settings; there is no such file yet."""
    return tmp_path_factory.mktemp("settings") / "config.toml"


@pytest.fixture
@needs("program")
def environment(variables: dict[str, str]) -> dict[str, str]:
    """The variables of a program that a test starts, and of `run`; a test may change them."""
    return variables


@pytest.fixture
def variables(settings_file: Path) -> dict[str, str]:
    """Our variables, without what changes the output of the program."""
    state = str(settings_file.parent / "state")
    return plain_environment() | {"FTE_SNIFF_CONFIG": str(settings_file), "XDG_STATE_HOME": state}


@pytest.fixture
def run(tmp_path: Path, variables: dict[str, str]) -> Run:
    """Run a command in this process in an empty folder; gives what it wrote and its exit code."""

    def run(*arguments: str | Path, stdin: str | bytes = "") -> subprocess.CompletedProcess[str]:
        data = stdin.encode() if isinstance(stdin, str) else stdin
        words = [str(argument) for argument in arguments]
        ended = call(words, data, tmp_path, variables)
        output, errors = ended.output.decode(), ended.errors.decode()
        return subprocess.CompletedProcess(words, ended.code, output, errors)

    return run


def decoded(run: Run, name: str) -> list[dict[str, Any]]:
    """The rows of a file, which `decode` writes as JSON lines."""
    done = run("decode", name, "--format", "jsonl")
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@pytest.fixture
def samples() -> Path:
    return SAMPLES
