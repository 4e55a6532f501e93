"""Owns which form of the framer is tested: what was compiled of it, or its source, interpreted.

What was compiled lies beside the source, is loaded first, and does not follow the source's edits.
So tests are refused where it is not of the present source. With `--interpreted` they pass it over,
in their own process; a program that they start loads what is installed.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, ModuleSpec, SourceFileLoader
from pathlib import Path
from types import ModuleType

ROOM = "fte_sniff.protocol.framer"
CHOICE = "FTE_SNIFF_COMPILED"
"""As `setup.py` has it: 1, the framer must be compiled; 0, it need not be. In CI it must."""
INTERPRETED = "FTE_SNIFF_TESTS_INTERPRETED"
"""Set by `--interpreted` for the workers of pytest-xdist."""
SETUP = Path(__file__).parents[1] / "setup.py"
MENDS = "pip install -e . mends it"


class SourceFinder(MetaPathFinder):
    """Finds the framer's modules as source alone."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if path is None or not fullname.startswith(f"{ROOM}."):
            return None
        return FileFinder(path[0], (SourceFileLoader, SOURCE_SUFFIXES)).find_spec(fullname)


def interpret() -> None:
    """Load the framer's source, not what was compiled of it, from now on in this process."""
    if any(isinstance(finder, SourceFinder) for finder in sys.meta_path):
        return
    assert ROOM not in sys.modules, "too late: the framer is already loaded"
    sys.meta_path.insert(0, SourceFinder())


def complaint(environment: Mapping[str, str]) -> str | None:
    """What is wrong with the framer that tests would load; None if it is the present one."""
    __import__(ROOM)
    loaded = {name for name in sys.modules if name.startswith(f"{ROOM}.sources_")}
    if loaded:
        present = runpy.run_path(str(SETUP))["library"]()
        return None if loaded == {present} else f"the compiled framer is of another source: {MENDS}"
    usual = "1" if environment.get("CI") == "true" else "0"
    if environment.get(CHOICE, usual) != "1":
        return None
    return f"the framer is not compiled, and has to be: {MENDS}"
