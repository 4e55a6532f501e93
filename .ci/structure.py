"""Size and structure of the package, and the rules that it keeps: `python .ci/structure.py`.

The rules do not grow with features: no module above 700 lines, a median of 150 to 300 lines, at
most 10 small modules with a single importer beside them, and no public class name twice. The other
figures are printed for comparison only.
"""

from __future__ import annotations

import ast
import io
import statistics
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "fte_sniff"

LONGEST = 700
MEDIAN = range(150, 301)
SMALL = 150
MOST_SMALL = 10

_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


@dataclass(frozen=True)
class Module:
    """One source file, measured."""

    name: str
    """Dotted; a package has the name of its folder."""
    is_package: bool
    tree: ast.Module
    lines: int
    code: int
    """Lines that are not blank, a comment or part of a docstring."""
    docstring: int


def read_module(path: Path, root: Path) -> Module:
    """Parse and measure a file below `root`."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    docstring = set(_docstring_lines(tree))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    parts = path.relative_to(root).with_suffix("").parts
    is_package = parts[-1] == "__init__"
    name = ".".join(parts[:-1] if is_package else parts)
    lines = len(text.splitlines())
    return Module(name, is_package, tree, lines, len(code - docstring), len(docstring))


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    """Lines of every string that is a statement: docstrings, also those of attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def imported_names(tree: ast.Module) -> Iterator[str]:
    """Dotted names that a file imports, anywhere in it."""
    for node in ast.walk(tree):
        match node:
            case ast.ImportFrom(module=str(module), names=names):
                yield module
                yield from (f"{module}.{alias.name}" for alias in names)
            case ast.Import(names=names):
                yield from (alias.name for alias in names)


def small_single_importers(modules: Mapping[str, Module]) -> list[str]:
    """Modules below `SMALL` lines that only one module imports, which is in the same package."""
    importers: dict[str, set[str]] = defaultdict(set)
    plain = {name: module for name, module in modules.items() if not module.is_package}
    for name, module in plain.items():
        for imported in imported_names(module.tree):
            if imported in plain:
                importers[imported].add(name)
    return sorted(
        name
        for name, by in importers.items()
        if len(by) == 1
        and plain[name].lines < SMALL
        and next(iter(by)).rpartition(".")[0] == name.rpartition(".")[0]
    )


def classes_named_twice(modules: Mapping[str, Module]) -> list[str]:
    """Public class names that are defined more than once."""
    names = Counter(
        node.name
        for module in modules.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    return sorted(name for name, count in names.items() if count > 1)


def report(modules: Mapping[str, Module], test_files: int) -> Iterator[tuple[str, bool]]:
    """Lines of the report; each with whether it breaks a rule."""
    inner = [module for module in modules.values() if not module.is_package]
    longest = max(inner, key=lambda module: module.lines)
    median = round(statistics.median(module.lines for module in inner))
    small = small_single_importers(modules)
    twice = classes_named_twice(modules)
    yield f"Python files in {PACKAGE}: {len(modules)}", False
    yield f"code lines: {sum(module.code for module in modules.values())}", False
    yield f"docstring lines: {sum(module.docstring for module in modules.values())}", False
    yield f"test files: {test_files}", False
    yield (
        f"median module: {median} lines ({MEDIAN[0]} to {MEDIAN[-1]})",
        median not in MEDIAN,
    )
    yield (
        f"longest module: {longest.name}, {longest.lines} lines (at most {LONGEST})",
        longest.lines > LONGEST,
    )
    yield (
        f"modules below {SMALL} lines with one importer beside them: {len(small)} "
        f"(at most {MOST_SMALL})",
        len(small) > MOST_SMALL,
    )
    yield from ((f"  {name}", False) for name in small)
    yield f"public class names used twice: {', '.join(twice) or 'none'}", bool(twice)


def main(root: Path = ROOT) -> int:
    """Print the report; returns 1 if a rule is broken."""
    paths = sorted((root / PACKAGE).rglob("*.py"))
    modules = {module.name: module for module in (read_module(path, root) for path in paths)}
    test_files = len(list((root / "tests").rglob("*.py")))
    broken = False
    for line, breaks in report(modules, test_files):
        print(line + ("  <-- breaks the rule" if breaks else ""))
        broken = broken or breaks
    return int(broken)


if __name__ == "__main__":
    sys.exit(main())
