"""What a fixture needs of the machine: a mark of each test that uses it, directly or not.

    @pytest.fixture
    @needs("port")
    def pty(): ...

README's test command leaves out the marked tests, `.ci/run` runs them; `pyproject.toml` explains
the marks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import pytest

_Function = TypeVar("_Function", bound=Callable[..., object])
_ATTRIBUTE = "needs_of_fixture"


def needs(*marks: str) -> Callable[[_Function], _Function]:
    """Give these marks to each test that uses the fixture below."""

    def decorate(function: _Function) -> _Function:
        setattr(function, _ATTRIBUTE, marks)
        return function

    return decorate


def needs_of(item: pytest.Item) -> Iterator[str]:
    """The marks of all fixtures that a test uses."""
    if not isinstance(item, pytest.Function):
        return
    for definitions in item._fixtureinfo.name2fixturedefs.values():
        for definition in definitions:
            yield from getattr(definition.func, _ATTRIBUTE, ())
