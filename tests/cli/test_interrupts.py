"""Ctrl-C at any moment of a start, once or twice: a quiet end, and nothing half made stays behind.

The signals are real, and so is the program. A hook in its interpreter sends them when it comes to
load a certain module, so that they come at the same moment in every run.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import ROOT, SAMPLES
from tests.cli.processes import BOUND_S, PROGRAM
from tests.cli.terminals import terminal

HOOK = """
import os, signal, sys

MOMENTS = {moments!r}

def once():
    os.kill(os.getpid(), signal.SIGINT)

def twice():
    try:
        once()
    finally:
        # The first was heard already, and is on its way out.
        once()

class Going:
    def __del__(self):
        once()

def unseen():
    # What is raised while an object goes can be caught by nobody.
    Going()

def look(event, arguments):
    if MOMENTS and [event, arguments[0] if arguments else None] == MOMENTS[0][:2]:
        globals()[MOMENTS.pop(0)[2]]()

sys.addaudithook(look)
"""
LEAVING = ("open", os.devnull)
"""What is done last upon a Ctrl-C: what is still to be printed goes nowhere."""

Moments = list[tuple[str, str, str]]
"""Events of the interpreter, what they are about, and how Ctrl-C is pressed then."""
HOW = pytest.mark.parametrize("how", ["once", "twice", "unseen"])
Hooked = Callable[[Moments], dict[str, str]]


@pytest.fixture
def hooked(environment, tmp_path_factory: pytest.TempPathFactory) -> Hooked:
    """The environment in which Ctrl-C is pressed at these moments, one after the other."""

    def hooked(moments: Moments) -> dict[str, str]:
        folder = tmp_path_factory.mktemp("hook")
        text = HOOK.format(moments=[list(moment) for moment in moments])
        (folder / "sitecustomize.py").write_text(text)
        return environment | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}

    return hooked


def assert_quiet_end(environment: dict[str, str], folder: Path, *arguments: str) -> None:
    done = subprocess.run(
        [*PROGRAM, *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=environment,
        cwd=folder,
        timeout=BOUND_S,
        check=False,
    )
    # A shell makes 130 of the one as of the other.
    assert (done.returncode in (130, -signal.SIGINT), done.stderr) == (True, b"")
    assert list(folder.iterdir()) == []


DECODE = ("decode", str(SAMPLES / "damaged.mcap"))


@HOW
@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("fte_sniff.cli", ("encode", "reset")),
        ("click", ("live", "sim://")),
        ("fte_sniff.protocol.codec", ("encode", "reset")),
        ("fte_sniff.cli.capture_command", ("live", "sim://")),
        ("fte_sniff.session.live_session", ("live", "sim://")),
        ("multiprocessing", ("live", "sim://")),
        ("polars", (*DECODE, "--filter", "motor = 1")),
        ("numpy", (*DECODE, "-o", "rows.csv")),
        ("numpy.linalg", (*DECODE, "-o", "rows.mcap")),
        ("fte_sniff.formats.parquet", (*DECODE, "-o", "rows.parquet")),
    ],
)
def test_it_ends_in_silence(
    hooked: Hooked, tmp_path: Path, module: str, arguments: tuple[str, ...], how: str
) -> None:
    assert_quiet_end(hooked([("import", module, how)]), tmp_path, *arguments)


@pytest.mark.parametrize("module", ["polars", "numpy"])
def test_another_one_on_the_way_out_changes_nothing(
    hooked: Hooked, tmp_path: Path, module: str
) -> None:
    environment = hooked([("import", module, "once"), (*LEAVING, "once")])
    assert_quiet_end(environment, tmp_path, *DECODE, "--filter", "motor = 1", "-o", "rows.csv")


@HOW
@pytest.mark.parametrize("module", ["fte_sniff.tui.app", "textual.app", "textual.pilot"])
def test_the_terminal_is_as_it_was(hooked: Hooked, tmp_path: Path, module: str, how: str) -> None:
    with terminal(hooked([("import", module, how)]), tmp_path, "view", DECODE[1]) as screen:
        before = screen.attributes
        assert screen.ended() in (130, -signal.SIGINT)
        assert screen.attributes == before
    assert b"Traceback" not in screen.drawn
    assert b"KeyboardInterrupt" not in screen.drawn
