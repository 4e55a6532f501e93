"""CONTRIBUTING's "Where do I put ..." and the recipes are about the same things."""

from __future__ import annotations

import inspect

from tests.recipes import test_recipes
from tests.recipes.recipe import TableRow, table_rows


def test_each_row_has_a_recipe_and_each_recipe_a_row() -> None:
    recipes = [name for name, _ in inspect.getmembers(test_recipes, inspect.isfunction)]
    rows = [row.test for row in table_rows()]
    assert sorted(rows) == [name for name in recipes if name.startswith("test_")]


def test_row_names_only_its_files() -> None:
    row = TableRow("a form", ["a row in `formats/logs/evidence.py`; in `times.py`", "`cli/`"])
    assert row.test == "test_form"
    named = ("fte_sniff/formats/logs/evidence.py", "fte_sniff/formats/logs/times.py", "cli/a.py")
    assert all(map(row.names, named))
    assert not any(map(row.names, ("fte_sniff/formats/logs/layout.py", "tests/cli.py")))
