"""The script of the mutants."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.mutants import chosen, near


def test_mutant_is_a_module_with_one_change() -> None:
    for one in chosen(20, 1, ["protocol/"]):
        assert ast.parse(one.source)
        assert one.before != one.after
        assert str(one).startswith("protocol/")


def test_tests_of_a_module_are_those_of_its_package_and_those_that_import_it() -> None:
    found = [*near(Path("protocol/framer.py"))]
    assert "tests/protocol/test_framer.py" in found
    assert "tests/tui/test_keys.py" not in found
