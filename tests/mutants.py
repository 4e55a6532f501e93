"""Mutants of the program: small faults that the tests should notice.

    python -m tests.mutants [--count 100] [--seed 1] [--of PATH ...]

Each mutant is one changed expression or statement in a copy of the project. The tests that run are
those of the module, then those that import it, then those of its package. A mutant that no test
notices has survived. One is undecided if its tests do not end, or fail without it too. Exit code 1
if one survived.
"""

from __future__ import annotations

import argparse
import ast
import copy
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.waiting import BOUND_S

ROOT = Path(__file__).parents[1]
PACKAGE = "fte_sniff"
FRAMER = "protocol/framer"
"""Compiled modules, whose source is interpreted for a mutant."""
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
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
"""A line of pytest's summary, with the test."""
MOST_FILES = 6
"""Of the test files that import a module."""


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
        case ast.Return(value=ast.expr()):
            yield ast.Return(ast.Constant(None))


class _Change(ast.NodeTransformer):
    def __init__(self, number: int) -> None:
        self._number = number
        self.changed: tuple[ast.AST, ast.AST] | None = None

    def visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.AnnAssign) and not isinstance(node.value, ast.expr):
            return node
        for new in changes_of(node):
            if self._number == 0:
                self.changed = node, new
                self._number -= 1
                return ast.copy_location(new, node)
            self._number -= 1
        return self.generic_visit(node)


def mutant(module: Path, number: int) -> Mutant | None:
    """The change of a module with this number; None if it has fewer."""
    tree = ast.parse((ROOT / PACKAGE / module).read_text("utf-8"))
    change = _Change(number)
    changed = change.visit(copy.deepcopy(tree))
    if change.changed is None:
        return None
    before, after = change.changed
    line = getattr(before, "lineno", 0)
    texts = (
        ast.unparse(ast.fix_missing_locations(one)).partition("\n")[0] for one in (before, after)
    )
    return Mutant(module, line, *texts, ast.unparse(ast.fix_missing_locations(changed)))


def chosen(count: int, seed: int, paths: Sequence[str]) -> Iterator[Mutant]:
    """Mutants of random lines of random modules."""
    rng = random.Random(seed)
    modules = [
        path.relative_to(ROOT / PACKAGE)
        for path in sorted((ROOT / PACKAGE).rglob("*.py"))
        if path.name != "__init__.py"
    ]
    modules = [one for one in modules if not paths or str(one).startswith(tuple(paths))]
    if not modules:
        raise SystemExit(f"no module of {PACKAGE}/ begins with {' or '.join(paths)}")
    sizes = [(ROOT / PACKAGE / module).stat().st_size for module in modules]
    numbers = {module: sum(1 for _ in _all(module)) for module in modules}
    for module in rng.choices(modules, sizes, k=count):
        if numbers[module]:
            found = mutant(module, rng.randrange(numbers[module]))
            assert found is not None
            yield found


def _all(module: Path) -> Iterator[ast.AST]:
    for node in ast.walk(ast.parse((ROOT / PACKAGE / module).read_text("utf-8"))):
        yield from changes_of(node)


def tests_of(module: Path) -> list[list[str]]:
    """The tests to run, one group after the other."""
    inside = module.with_suffix("")
    tests = ROOT / "tests"
    own = [tests / inside.parent / f"test_{inside.name}.py", tests / inside]
    name = re.compile(rf"\b{PACKAGE}\.{'.'.join(inside.parts)}\b")
    importing = [
        path for path in sorted(tests.rglob("test_*.py")) if name.search(path.read_text("utf-8"))
    ]
    groups = [
        [path for path in own if path.exists()],
        importing[:MOST_FILES],
        sorted((tests / inside.parts[0]).rglob("test_*.py")),
    ]
    return [[str(path.relative_to(ROOT)) for path in group] for group in groups if group]


def notices(folder: Path, tests: Sequence[str], *options: str) -> str:
    """The first test of a copy that fails; empty if none does. `options` are those of pytest.

    Raises:
        subprocess.TimeoutExpired: they do not end.
        SystemExit: they cannot run, as with a compiled framer of other sources.
    """
    command = [
        sys.executable,
        *("-m", "pytest", "-q", "-x", "-rfE", "--tb=no", "-p", "no:cacheprovider"),
        *options,
        *tests,
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, timeout=BOUND_S, check=False)
    if done.returncode == pytest.ExitCode.USAGE_ERROR:
        raise SystemExit(done.stderr.decode())
    failed = FAILED.search(done.stdout.decode())
    return failed[1] if failed else ""


def verdict(folder: Path, one: Mutant) -> str:
    """Whether the tests notice a mutant. A test that also fails without it decides nothing."""
    options = ["--interpreted"] if str(one.module).startswith(FRAMER) else []
    file = folder / PACKAGE / one.module
    before = file.read_text("utf-8")
    try:
        file.write_text(one.source, "utf-8")
        failed = next(
            filter(None, (notices(folder, s, *options) for s in tests_of(one.module))), ""
        )
        file.write_text(before, "utf-8")
        if not failed:
            return "survived"
        return "undecided" if notices(folder, [failed], *options) else "killed"
    except subprocess.TimeoutExpired:
        return "undecided"
    finally:
        file.write_text(before, "utf-8")


def copied(folder: Path) -> Path:
    """A copy of the project, with the compiled modules."""
    ignored = shutil.ignore_patterns("__pycache__")
    for name in (PACKAGE, "tests", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignored)
    for name in ("samples", "benchmarks", "pyproject.toml", "README.md", "CONTRIBUTING.md", ".ci"):
        (folder / name).symlink_to(ROOT / name)
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
        for one in chosen(options.count, options.seed, options.of):
            found = verdict(folder, one)
            verdicts[found] += 1
            print(f"{found}: {one}", flush=True)
    print(*(f"{count} {found}" for found, count in verdicts.items()), sep=", ")
    return int(verdicts["survived"] > 0)


if __name__ == "__main__":
    sys.exit(main())
