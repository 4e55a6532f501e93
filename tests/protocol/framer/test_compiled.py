"""What was compiled of the framer is of the present source, and both do the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.framer_form import ROOM, SETUP, complaint
from tests.protocol.framer.told_rows import told_rows

ROOT = SETUP.parent
BOUND_S = 300


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=BOUND_S, check=False,
    )  # fmt: skip


def test_the_interpreted_source_gives_the_same_rows() -> None:
    done = run("tests.protocol.framer.told_rows", "--interpreted")
    assert not done.returncode, done.stderr
    form, *rows = done.stdout.splitlines()
    assert form == "interpreted"
    assert rows == told_rows()


def test_what_only_the_source_allows_is_tested_with_it() -> None:
    folder = str(Path(__file__).parent)
    own = ("-n", "0", "-p", "no:cacheprovider", "--no-header")
    done = run("pytest", "-q", "--interpreted", "-m", "interpreted", *own, folder)
    assert not done.returncode, done.stdout + done.stderr
    assert "skipped" not in done.stdout


def test_a_compiled_framer_of_another_source_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(f"{ROOM}.sources_")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, f"{ROOM}.sources_0__mypyc", sys)
    told = complaint({})
    assert told == "the compiled framer is of another source: pip install -e . mends it"


@pytest.mark.parametrize(
    ("environment", "refused"),
    [
        ({}, False),
        ({"CI": "true"}, True),
        ({"CI": "true", "FTE_SNIFF_COMPILED": "0"}, False),
        ({"FTE_SNIFF_COMPILED": "1"}, True),
    ],
)
def test_a_framer_that_is_not_compiled_is_refused_where_it_has_to_be(
    environment: dict[str, str], refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith(f"{ROOM}.sources_")]:
        monkeypatch.delitem(sys.modules, name)
    assert (complaint(environment) is not None) is refused
