"""Structure of the package: `python .ci/structure.py`.

Two rules help a reader: the docstring of a package names each of its modules, and no two public
classes have the same name. What may import what is checked by import-linter. The figures are for
comparison.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "fte_sniff"

_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_and_docstring_lines(text: str, tree: ast.Module) -> tuple[int, int]:
    """Lines that are not blank, a comment or part of a docstring; and lines of docstrings."""
    docstring = set(_docstring_lines(tree))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - docstring), len(docstring)


def _docstring_lines(tree: ast.Module) -> Iterator[int]:
    """Lines of every string that is a statement: docstrings, also those of attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def modules_without_a_line(trees: Mapping[Path, ast.Module]) -> list[Path]:
    """Modules and packages that the docstring of their package does not name."""
    found = []
    for init, tree in trees.items():
        if init.name != "__init__.py":
            continue
        named = set(re.findall(r"\w+", ast.get_docstring(tree) or ""))
        inside = [path for path in trees if path.parent == init.parent]
        inside += [path.parent for path in trees if path.parent.parent == init.parent]
        found += [path for path in inside if path.stem not in {*named, "__init__", "__main__"}]
    return sorted(set(found))


def classes_named_twice(trees: Mapping[Path, ast.Module]) -> list[str]:
    """Public class names that are defined more than once."""
    names = Counter(
        node.name
        for path, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    return sorted(name for name, count in names.items() if count > 1)


def main(root: Path = ROOT) -> int:
    """Print the figures and the broken rules; returns 1 if a rule is broken."""
    texts = {path: path.read_text("utf-8") for path in sorted((root / PACKAGE).rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    lines = [code_and_docstring_lines(texts[path], tree) for path, tree in trees.items()]
    print(f"Python files in {PACKAGE}: {len(trees)}")
    print(f"code lines: {sum(code for code, _ in lines)}")
    print(f"docstring lines: {sum(docstring for _, docstring in lines)}")
    print(f"test files: {len(list((root / 'tests').rglob('*.py')))}")
    unnamed = [str(path.relative_to(root)) for path in modules_without_a_line(trees)]
    twice = classes_named_twice(trees)
    if unnamed:
        print(f"breaks the rule: not in the docstring of its package: {', '.join(unnamed)}")
    if twice:
        print(f"breaks the rule: public class names used twice: {', '.join(twice)}")
    return int(bool(unnamed or twice))


if __name__ == "__main__":
    sys.exit(main())
