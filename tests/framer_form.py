"""Choice of the framer under test: the compiled one, or its interpreted source.

The compiled modules are in the folder of the source, are loaded first, and do not follow edits. So
tests are refused if the compiled framer is of another source. With `--interpreted` they load the
source, in their own process; a program that a test starts loads what is installed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, ModuleSpec, SourceFileLoader
from pathlib import Path
from types import ModuleType

PACKAGE = "fte_sniff.protocol.framer"
CHOICE = "FTE_SNIFF_COMPILED"
"""As in `setup.py`: 1, the framer must be compiled; 0, it need not be. In CI it must."""
INTERPRETED = "FTE_SNIFF_TESTS_INTERPRETED"
"""Set by `--interpreted` for the workers of pytest-xdist."""
FIX = "run: pip install -e ."


class SourceFinder(MetaPathFinder):
    """Finds only the sources of the framer's modules."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if path is None or not fullname.startswith(f"{PACKAGE}."):
            return None
        return FileFinder(path[0], (SourceFileLoader, SOURCE_SUFFIXES)).find_spec(fullname)


def interpret() -> None:
    """Load the interpreted source of the framer in this process."""
    if any(isinstance(finder, SourceFinder) for finder in sys.meta_path):
        return
    assert PACKAGE not in sys.modules, "too late: the framer is already loaded"
    sys.meta_path.insert(0, SourceFinder())


def form_error(environment: Mapping[str, str]) -> str | None:
    """Why the tests cannot use the framer they would load; None if they can."""
    from fte_sniff.protocol import framer
    from fte_sniff.session.framer_hash import library_name

    loaded = {name for name in sys.modules if name.startswith(f"{PACKAGE}.sources_")}
    if loaded:
        present = f"{PACKAGE}.{library_name(Path(framer.__file__).parent)}"
        return None if loaded == {present} else f"the compiled framer is of another source: {FIX}"
    usual = "1" if environment.get("CI") == "true" else "0"
    if environment.get(CHOICE, usual) != "1":
        return None
    return f"the framer is not compiled, but has to be: {FIX}"
