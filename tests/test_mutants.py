"""What the script of the mutants reads from pytest."""

from __future__ import annotations

import pytest

from tests.mutants import failed_tests

KNOWN = ("tests/test_a.py::test_one", "tests/test_a.py::test_one[rpm / (motor - 2) < 0]")


@pytest.mark.parametrize("message", ["", " - assert 1 == 2", " - ValueError: a - b"])
@pytest.mark.parametrize("test", KNOWN)
@pytest.mark.parametrize("outcome", ["FAILED", "ERROR"])
def test_a_failed_test_is_named_also_where_its_name_has_a_dash(
    outcome: str, test: str, message: str
) -> None:
    assert failed_tests(f"...\n{outcome} {test}{message}\n1 failed", KNOWN) == [test]


def test_a_test_that_is_not_known_has_not_failed() -> None:
    assert failed_tests("FAILED tests/test_b.py::test_two - assert 0", KNOWN) == []
