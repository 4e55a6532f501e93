"""The self-attack notices sabotage: a program that breaks a promise makes an attack fail.

`pytest -m sabotage`. A sabotage is code that is appended to a module of a copy of the package: it
replaces a function by name, so that edits around the function do not break it, as they would a
patch, and every process that the attack starts runs it, also those that ignore the environment.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import BOUND_S

ROOT = Path(__file__).parents[1]
FOLDER = Path(__file__).parent / "torture" / "sabotages"
SEEDS = range(1, 13)
"""Not every case of an attack can notice every sabotage: one of these has to."""

TORTURE = (sys.executable, "-m", "tests.torture")
NOTICED = (
    ("no_sync", "power-cut"),
    ("half_lost_at_close", "noisy-line"),
    ("half_lost_at_close", "follow"),
    ("truncation_ignored", "taken-away"),
    ("one_row_lost", "kill-recorder"),
    ("late_after_rotation", "kill-recorder"),
    ("foreign_files_deleted", "rotate-oldest"),
)

pytestmark = pytest.mark.sabotage


def _sabotaged(folder: Path, name: str) -> None:
    """Make a copy of the tree whose package has a sabotage."""
    code = (FOLDER / f"{name}.py").read_text()
    target = re.match(r"# Appended to (\S+):", code)
    assert target is not None
    shutil.copytree(ROOT / "fte_sniff", folder / "fte_sniff", symlinks=True)
    for other in ("tests", "benchmarks", "samples"):
        (folder / other).symlink_to(ROOT / other)
    with (folder / "fte_sniff" / target[1]).open("a") as module:
        module.write(f"\n\n{code}")


@pytest.mark.parametrize(("name", "attack"), NOTICED)
def test_the_attack_notices(tmp_path: Path, name: str, attack: str) -> None:
    _sabotaged(tmp_path, name)
    said = ""
    for seed in SEEDS:
        done = subprocess.run(
            [*TORTURE, "--case", f"{attack}:{seed}", "--keep", str(tmp_path / "failures")],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=3 * BOUND_S,
            check=False,
        )
        said += f"{seed}: {done.stdout}{done.stderr}\n"
        assert "the attack itself failed" not in said, said
        if done.returncode:
            break
    assert re.search(r"^\d+: broken ", said, re.M), said


def test_each_sabotage_is_tried() -> None:
    assert {name for name, _ in NOTICED} == {path.stem for path in FOLDER.glob("*.py")}
