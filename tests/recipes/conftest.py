"""One copy of the project for all recipes of a process."""

from __future__ import annotations

import compileall
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.recipes.recipe import PACKAGE, ROOT, Recipe, table_rows


@pytest.fixture(scope="session")
def copy_of_project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package with its compiled modules, the tests and the documentation."""
    root = tmp_path_factory.mktemp("project")
    for name in (PACKAGE, "tests", "docs"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("golden"))
    for file in (ROOT / "pyproject.toml", *ROOT.glob("*.md")):
        shutil.copy2(file, root)
    for name in ("samples", "benchmarks"):
        (root / name).symlink_to(ROOT / name)
    compileall.compile_dir(root / PACKAGE, quiet=1)
    return root


@pytest.fixture
def recipe(
    request: pytest.FixtureRequest, copy_of_project: Path, tmp_path: Path
) -> Iterator[Recipe]:
    """The recipe of the row that has the name of the test."""
    row = next(row for row in table_rows() if row.test == request.function.__name__)
    recipe = Recipe(copy_of_project, tmp_path, row)
    yield recipe
    recipe.undo()
