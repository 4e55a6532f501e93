"""Names of Textual that are private, so that another version may change them without notice."""

from __future__ import annotations

import ast
import inspect
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

from textual.app import App
from textual.screen import Screen
from textual.widget import Widget

from fte_sniff import tui

PRIVATE = {
    "app": {"_display", "_handle_exception"},
    "terminal": {
        *("_app", "_debug", "_exit", "_file", "_key_thread", "_loop", "_writer_thread"),
        "_xterm_parser",
    },
}
"""What the modules of the screen use; so only the version that was tested is allowed."""

FOLDER = Path(tui.__file__).parent


@cache
def private_names(kind: type) -> frozenset[str]:
    """Private attributes and methods of a class and its parents, as far as they are Textual's."""
    parents = [one for one in kind.__mro__ if one.__module__.startswith("textual.")]
    code = "".join(class_sources(one.__module__)[one.__name__] for one in parents)
    return frozenset(re.findall(r"(?:def |self\.)(_[a-z]\w*)", code))


@cache
def class_sources(module: str) -> dict[str, str]:
    """Sources of the classes of a module; `inspect.getsource` parses the module for each class."""
    source = inspect.getsource(import_module(module))
    lines = source.splitlines(keepends=True)
    return {
        node.name: "".join(lines[node.lineno - 1 : node.end_lineno])
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.ClassDef)
    }


def used_names(tree: ast.Module, name: str) -> Iterator[str]:
    """Private names that a module takes from Textual, or that it hides in a class of Textual."""
    module = import_module(name)
    on_self = set()
    for owner in (node for node in tree.body if isinstance(node, ast.ClassDef)):
        private = private_names(getattr(module, owner.name))
        for node in ast.walk(owner):
            match node:
                case ast.Attribute(value=ast.Name(id="self"), attr=attribute):
                    on_self.add(node)
                    yield from {attribute} & private
                case ast.FunctionDef(name=method) | ast.AsyncFunctionDef(name=method):
                    yield from {method} & private
    others = private_names(App) | private_names(Screen) | private_names(Widget)
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=attribute) if node not in on_self:
                yield from {attribute} & others
            case ast.ImportFrom(module=str(source)) if source.startswith("textual."):
                yield from (part for part in source.split(".") if part.startswith("_"))


def test_private_names_of_textual_are_these_and_no_more() -> None:
    found: dict[str, set[str]] = {}
    for path in sorted(FOLDER.rglob("*.py")):
        name = ".".join(path.relative_to(FOLDER).with_suffix("").parts)
        names = set(used_names(ast.parse(path.read_text("utf-8")), f"fte_sniff.tui.{name}"))
        if names:
            found[name] = names
    assert found == PRIVATE


def test_only_the_tested_minor_version_is_allowed() -> None:
    project = tomllib.loads((FOLDER.parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
    (wanted,) = [one for one in project["dependencies"] if one.startswith("textual")]
    major, minor = version("textual").split(".")[:2]
    assert wanted == f"textual>={major}.{minor},<{major}.{int(minor) + 1}"
