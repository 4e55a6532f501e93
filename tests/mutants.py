"""Mutants of the program: small faults that the tests should notice.

    python -m tests.mutants [--count 100] [--seed 1] [--of PATH ...]

Each mutant is one changed expression or statement in a copy of the project. For each, the tests of
its module and package run, and those that import it, then all tests. A mutant that no test notices
has survived; one whose tests do not end is undecided. Exit code 1 if one survived.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = "fte_sniff"
MARKS = "not (browser or cluster or conformance or sabotage or slow)"
"""The tests that have to notice: those of README's command and of the gate."""
OPPOSITES: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult,
}
LINKED = ("samples", "benchmarks", "pyproject.toml", ".ci")
"""What tests use and no mutant changes."""
LIMIT_S = 1800.0
"""Duration of the tests of a mutant, at most."""


class Mutant(NamedTuple):
    """One change of a module."""

    module: Path
    """Its path in the package."""
    line: int
    before: str
    after: str
    source: str
    """The changed module."""

    def __str__(self) -> str:
        return f"{self.module}:{self.line}: {self.before} -> {self.after}"


def changes_of(node: ast.AST) -> Iterator[ast.AST]:
    """Changed copies of a node."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in OPPOSITES:
            yield ast.Compare(node.left, [OPPOSITES[type(operator)]()], node.comparators)
        case ast.BoolOp(op=operator):
            yield ast.BoolOp(OPPOSITES[type(operator)](), node.values)
        case ast.BinOp(op=operator) if type(operator) in OPPOSITES:
            yield ast.BinOp(node.left, OPPOSITES[type(operator)](), node.right)
        case ast.UnaryOp(op=ast.Not()):
            yield node.operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.If():
            yield ast.If(ast.UnaryOp(ast.Not(), node.test), node.body, node.orelse)
        case ast.Expr(value=ast.Call()) | ast.AugAssign():
            yield ast.Pass()
        case ast.Return(value=ast.expr() as value) if ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))


class _Replaced(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self._old, self._new = old, new

    def visit(self, node: ast.AST) -> Any:
        self.generic_visit(node)
        return self._new if node is self._old else node


def changes(tree: ast.Module) -> list[tuple[ast.AST, ast.AST]]:
    """Nodes of a module, each with a changed copy."""
    return [(node, new) for node in ast.walk(tree) for new in changes_of(node)]


def mutant(module: Path, number: int) -> Mutant:
    """The change of a module with this number."""
    tree = ast.parse((ROOT / PACKAGE / module).read_text("utf-8"))
    before, after = changes(tree)[number]
    texts = (ast.unparse(ast.fix_missing_locations(one)).split("\n")[0] for one in (before, after))
    line = getattr(before, "lineno", 0)
    source = ast.unparse(ast.fix_missing_locations(_Replaced(before, after).visit(tree)))
    return Mutant(module, line, *texts, source)


def chosen(count: int, seed: int, paths: Sequence[str]) -> Iterator[Mutant]:
    """Mutants of random lines of random modules."""
    rng = random.Random(seed)
    numbers = {}
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        module = path.relative_to(ROOT / PACKAGE)
        if path.name != "__init__.py" and (not paths or str(module).startswith(tuple(paths))):
            numbers[module] = len(changes(ast.parse(path.read_text("utf-8"))))
    if not any(numbers.values()):
        raise SystemExit(f"no module of {PACKAGE}/ begins with {' or '.join(paths)}")
    for module in rng.choices([*numbers], [*numbers.values()], k=count):
        yield mutant(module, rng.randrange(numbers[module]))


def near(module: Path) -> Iterator[str]:
    """The test files of a module's package, and those that import the module."""
    name = re.compile(rf"\b{PACKAGE}\.{'.'.join(module.with_suffix('').parts)}\b")
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        file = path.relative_to(ROOT).as_posix()
        if file.startswith(f"tests/{module.parts[0]}/") or name.search(path.read_text("utf-8")):
            yield file


def passes(folder: Path, tests: Iterable[str]) -> bool:
    """Whether tests of a copy pass; raises TimeoutExpired."""
    options = ("-x", "-q", "--tb=no", "-n", "auto", "-p", "no:cacheprovider")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-m", MARKS, *options, *tests],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        timeout=LIMIT_S,
        check=False,
    )
    return done.returncode in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)


def verdict(folder: Path, one: Mutant) -> str:
    """Whether tests notice a mutant."""
    file = folder / PACKAGE / one.module
    file.write_text(one.source, "utf-8")
    try:
        files = [*near(one.module)]
        noticed = (files and not passes(folder, files)) or not passes(folder, ())
        return "killed" if noticed else "survived"
    except subprocess.TimeoutExpired:
        return "undecided"
    finally:
        shutil.copy(ROOT / PACKAGE / one.module, file)


def copied(folder: Path) -> Path:
    """A copy of the project."""
    ignored = shutil.ignore_patterns("__pycache__")
    for name in (PACKAGE, "tests", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for path in (*ROOT.glob("*.md"), *map(ROOT.joinpath, LINKED)):
        (folder / path.name).symlink_to(path)
    return folder


def main() -> int:
    """Try the mutants; returns the exit code."""
    parser = argparse.ArgumentParser(description="Mutants that the tests should notice.")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--of", nargs="*", default=[], metavar="PATH", help="in fte_sniff/")
    options = parser.parse_args()
    verdicts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = copied(Path(name))
        mutants = [*chosen(options.count, options.seed, options.of)]
        if not (passes(folder, ()) or passes(folder, ())):
            raise SystemExit("a test fails without a mutant too")
        for one in mutants:
            found = verdict(folder, one)
            verdicts[found] += 1
            print(f"{found}: {one}", flush=True)
    print(*(f"{count} {found}" for found, count in verdicts.items()), sep=", ")
    return int(verdicts["survived"] > 0)


if __name__ == "__main__":
    sys.exit(main())
