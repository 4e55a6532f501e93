"""The map of the package: docstrings name every module, and the structure check is right."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

import fte_sniff

ROOT = Path(fte_sniff.__file__).parent
PACKAGES = sorted(path.parent for path in ROOT.rglob("__init__.py"))
STRUCTURE = Path(__file__).parents[1] / ".ci/structure.py"


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: str(path.relative_to(ROOT.parent)))
def test_a_package_docstring_names_every_module(package: Path) -> None:
    tree = ast.parse((package / "__init__.py").read_text(encoding="utf-8"))
    docstring = ast.get_docstring(tree) or ""
    inside = {path.stem for path in package.glob("*.py")}
    inside |= {path.name for path in package.iterdir() if (path / "__init__.py").exists()}
    inside -= {"__init__", "__main__"}
    assert inside <= set(re.findall(r"\w+", docstring)), "not on the map"


def write_package(root: Path, modules: dict[str, str]) -> None:
    for name, text in modules.items():
        path = root / "fte_sniff" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


FILLED = "x = 1\n" * 200
SMALL = {f"part{n}.py": "x = 1\n" for n in range(11)}
OTHERS = {f"other{n}.py": FILLED for n in range(20)}


@pytest.mark.parametrize(
    ("modules", "broken"),
    [
        ({"a.py": FILLED}, ""),
        ({"a.py": "x = 1\n" * 701}, "longest module|median"),
        ({"a.py": "x = 1\n" * 149}, "median"),
        ({"a.py": "x = 1\n" * 301}, "median"),
        ({"a.py": FILLED + "class A: ...", "b.py": FILLED + "class A: ..."}, "twice: A"),
        ({"a.py": FILLED + "class _A: ...", "b.py": FILLED + "class _A: ..."}, ""),
        (
            {"a.py": FILLED + "import fte_sniff.part0\n"} | SMALL | OTHERS,
            "",
        ),
        (
            {"a.py": FILLED + "".join(f"from fte_sniff import part{n}\n" for n in range(11))}
            | SMALL
            | OTHERS,
            "one importer",
        ),
    ],
    ids=[
        "sound", "too long", "too small", "too large", "public twice", "private twice",
        "one small module", "many small modules",
    ],
)  # fmt: skip
def test_the_structure_check_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], modules: dict[str, str], broken: str
) -> None:
    write_package(tmp_path, modules)
    code = runpy.run_path(str(STRUCTURE))["main"](tmp_path)
    found = [line for line in capsys.readouterr().out.splitlines() if "breaks the rule" in line]
    rules = [rule for rule in broken.split("|") if rule]
    assert code == bool(rules)
    assert [rule for rule in rules if any(rule in line for line in found)] == rules
    assert len(found) == len(rules)


def test_the_structure_check_counts_code_and_docstrings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = '"""One\n\nline."""\n\n# comment\nx = (\n    1\n)\n"""Of x."""\n' + "y = 1\n" * 150
    write_package(tmp_path, {"a.py": text, "__init__.py": '"""Two."""\n'})
    runpy.run_path(str(STRUCTURE))["main"](tmp_path)
    out = capsys.readouterr().out
    assert "Python files in fte_sniff: 2\ncode lines: 153\ndocstring lines: 5\n" in out
