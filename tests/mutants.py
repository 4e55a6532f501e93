"""Mutants of the program: small faults that the tests should notice.

    python -m tests.mutants [--count 100] [--seed 1] [--of PATH ...]

Each mutant is one changed expression or statement in a copy of the project. First all tests run
once, with a probe at each statement that is to change: it records the tests that execute it. Then
these tests run for each mutant, the nearest first, then the fastest. What an import executes
belongs to no test: there the tests are those of the module, those that import it, and those of
its package.

A mutant that no test notices has survived. One is undecided if its tests do not end, or fail
without it too. Exit code 1 if one survived.
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
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from os.path import commonpath
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
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+)$", re.MULTILINE)
"""A line of pytest's summary, with the test, and often ` - ` and a message."""
DURATION = re.compile(r"^([\d.]+)s (?:setup|call|teardown) +(.+)$", re.MULTILINE)
PROBE = """
import os
from contextlib import suppress
from pathlib import Path

seen = set()

def reached(statement):
    test = os.environ.get("PYTEST_CURRENT_TEST", "")
    if (statement, test) not in seen:
        seen.add((statement, test))
        with suppress(OSError):
            name = f"{hash((statement, test)):x}"
            Path(FOLDER, name).write_text(f"{statement}\\t{test}")
"""
"""A module of the copy. A record is a file, because some tests limit the sizes of files."""
MOST_S = 120.0
"""Duration of the tests of a mutant in the first run, at most."""
LONGER = 10
"""How many times as long they may take with the mutant, and a minute more."""


class Mutant(NamedTuple):
    """One change of a module."""

    module: Path
    """Its path in the package."""
    line: int
    statement: int
    """The line of the innermost statement around the change."""
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
    def __init__(self, new: Mapping[ast.AST, ast.AST | list[ast.stmt]]) -> None:
        self._new = new

    def visit(self, node: ast.AST) -> Any:
        self.generic_visit(node)
        return self._new.get(node, node)


def changes(
    node: ast.AST, around: ast.stmt | None = None
) -> Iterator[tuple[ast.AST, ast.AST, ast.stmt]]:
    """Nodes inside a node, each with a changed copy and the innermost statement around it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.AnnAssign) and child.value is None:
            continue
        statement = child if isinstance(child, ast.stmt) else around
        if statement is not None:
            yield from ((child, new, statement) for new in changes_of(child))
        yield from changes(child, statement)


def replaced(tree: ast.AST, new: Mapping[ast.AST, ast.AST | list[ast.stmt]]) -> str:
    """The source of a tree with replaced nodes."""
    return ast.unparse(ast.fix_missing_locations(_Replaced(new).visit(tree)))


def tree_of(module: Path) -> ast.Module:
    """The syntax tree of a module of the program."""
    return ast.parse((ROOT / PACKAGE / module).read_text("utf-8"))


def mutant(module: Path, number: int) -> Mutant:
    """The change of a module with this number."""
    tree = tree_of(module)
    before, after, statement = [*changes(tree)][number]
    line = getattr(before, "lineno", statement.lineno)
    texts = (ast.unparse(ast.fix_missing_locations(one)).split("\n")[0] for one in (before, after))
    return Mutant(module, line, statement.lineno, *texts, replaced(tree, {before: after}))


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
    numbers = {module: len([*changes(tree_of(module))]) for module in modules}
    for module in rng.choices(modules, sizes, k=count):
        if numbers[module]:
            yield mutant(module, rng.randrange(numbers[module]))


class Tests(NamedTuple):
    """What a run of all tests shows."""

    seconds: Mapping[str, float]
    """Of each test that passes."""
    reaching: Mapping[str, Collection[str]]
    """The tests that execute a statement, by module and line; empty is outside of all tests."""

    def of(self, one: Mutant) -> dict[str, float]:
        """The tests to run for a mutant, in this order, with their seconds."""
        reaching = self.reaching.get(f"{one.module}:{one.statement}", ())
        # A fixture of a module runs in the setup of its first test.
        files = {test.partition("::")[0] for test in reaching if test.endswith(" (setup)")}
        if "" in reaching:
            files.update(near(one.module))
        tests = {test.rpartition(" (")[0] for test in reaching}
        own, place = own_tests(one.module), f"tests/{one.module}"

        def order(found: tuple[str, float]) -> tuple[bool, int, float]:
            test, seconds = found
            return not test.startswith(own), -len(commonpath((test, place))), seconds

        found = [
            (test, seconds)
            for test, seconds in self.seconds.items()
            if test in tests or test.partition("::")[0] in files
        ]
        found.sort(key=order)
        sums = accumulate(seconds for _, seconds in found)
        return dict(one for one, total in zip(found, sums, strict=True) if total < MOST_S)


def own_tests(module: Path) -> tuple[str, str]:
    """The file and the folder of a module's own tests."""
    inside = module.with_suffix("")
    return f"tests/{inside.parent}/test_{inside.name}.py", f"tests/{inside}/"


def near(module: Path) -> Iterator[str]:
    """The test files of a module, of its package, and those that import it."""
    inside = module.with_suffix("")
    name = re.compile(rf"\b{PACKAGE}\.{'.'.join(inside.parts)}\b")
    for path in (ROOT / "tests").rglob("test_*.py"):
        file = path.relative_to(ROOT).as_posix()
        package = f"tests/{inside.parts[0]}/"
        if file.startswith((package, *own_tests(module))) or name.search(path.read_text("utf-8")):
            yield file


def probed(module: Path, lines: Collection[int]) -> str:
    """The source of a module with a probe before the statements at some lines."""
    tree = tree_of(module)
    new: dict[ast.AST, list[ast.stmt]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and node.lineno in lines:
            probe = f"__import__('{PACKAGE}.reached').reached.reached('{module}:{node.lineno}')"
            new[node] = [*ast.parse(probe).body, node]
    return replaced(tree, new)


def all_tests(folder: Path, mutants: Collection[Mutant]) -> Tests:
    """Run all tests of a copy, with a probe at the statement of each mutant."""
    records, probe = folder / "records", folder / PACKAGE / "reached.py"
    records.mkdir()
    probe.write_text(f"FOLDER = {str(records)!r}\n{PROBE}")
    modules = {one.module for one in mutants}
    for module in modules:
        lines = {one.statement for one in mutants if one.module == module}
        (folder / PACKAGE / module).write_text(probed(module, lines), "utf-8")
    run = _pytest(folder, [], "-n", "auto", "-vv", "--durations", "0")
    if run.returncode == pytest.ExitCode.USAGE_ERROR:
        raise SystemExit(run.stderr)
    for module in modules:
        shutil.copy(ROOT / PACKAGE / module, folder / PACKAGE / module)
    probe.unlink()
    seconds = defaultdict[str, float](float)
    for duration, test in DURATION.findall(run.stdout):
        seconds[test] += float(duration)
    for test in failed_tests(run.stdout, seconds):
        seconds.pop(test, None)
    reaching = defaultdict[str, set[str]](set)
    for record in records.iterdir():
        statement, test = record.read_text().split("\t")
        reaching[statement].add(test)
    return Tests(seconds, reaching)


def _pytest(
    folder: Path, tests: Iterable[str], *options: str, limit_s: float | None = None
) -> subprocess.CompletedProcess[str]:
    command = [
        *(sys.executable, "-m", "pytest", "-m", MARKS),
        *("-rfE", "--tb=no", "-p", "no:cacheprovider"),
        *options,
        *tests,
    ]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=limit_s, check=False
    )


def failed_tests(output: str, known: Collection[str]) -> list[str]:
    """The tests of a summary; the name of a test may have a ` - ` too, as before its message."""
    found = []
    for line in FAILED.findall(output):
        ends = [len(line), *(one.start() for one in re.finditer(" - ", line))]
        found += [line[:end] for end in ends if line[:end] in known][:1]
    return found


def verdict(folder: Path, one: Mutant, tests: Mapping[str, float]) -> str:
    """Whether tests notice a mutant. A test that also fails without it decides nothing."""
    if not tests:
        return "survived"
    limit_s = 60 + LONGER * sum(tests.values())
    file = folder / PACKAGE / one.module
    try:
        file.write_text(one.source, "utf-8")
        run = _pytest(folder, tests, "-x", limit_s=limit_s)
        if run.returncode == pytest.ExitCode.OK:
            return "survived"
        failed = failed_tests(run.stdout, tests)
        # The source without comments, as that of the mutant: some tests read it.
        file.write_text(ast.unparse(tree_of(one.module)), "utf-8")
        run = _pytest(folder, failed or tests, "-x", limit_s=limit_s)
        return "killed" if run.returncode == pytest.ExitCode.OK else "undecided"
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
        tests = all_tests(folder, mutants)
        for one in mutants:
            selected = tests.of(one)
            found = verdict(folder, one, selected)
            verdicts[found] += 1
            tried = f"{len(selected)} tests" if selected else "not executed"
            print(f"{found} ({tried}): {one}", flush=True)
    print(*(f"{count} {found}" for found, count in verdicts.items()), sep=", ")
    return int(verdicts["survived"] > 0)


if __name__ == "__main__":
    sys.exit(main())
