"""Each room's docstring is its map: it names every module and package that stands in it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import fte_sniff

ROOT = Path(fte_sniff.__file__).parent
ROOMS = sorted(path.parent for path in ROOT.rglob("__init__.py"))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: str(room.relative_to(ROOT.parent)))
def test_a_room_names_all_that_is_in_it(room: Path) -> None:
    said = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
    inside = {path.stem for path in room.glob("*.py")}
    inside |= {path.name for path in room.iterdir() if (path / "__init__.py").exists()}
    inside -= {"__init__", "__main__"}
    assert inside <= set(re.findall(r"\w+", said)), "not on the map"
