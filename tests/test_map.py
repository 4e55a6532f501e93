"""The structure check finds what it promises; the package itself is checked in the gate."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

STRUCTURE = Path(__file__).parents[1] / ".ci/structure.py"


def write_package(root: Path, modules: dict[str, str]) -> None:
    for name, text in modules.items():
        path = root / "fte_sniff" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize(
    ("modules", "broken"),
    [
        ({"__init__.py": '"""a b"""', "a.py": "class A: ...", "b.py": "class B: ..."}, []),
        ({"a.py": "class A: ...", "b.py": "class A: ..."}, ["twice: A"]),
        ({"a.py": "class _A: ...", "b.py": "class _A: ..."}, []),
        ({"__init__.py": '"""a"""', "a.py": "", "b.py": ""}, ["its package: fte_sniff/b.py"]),
        ({"__init__.py": "", "a/__init__.py": ""}, ["its package: fte_sniff/a"]),
        ({"__init__.py": '"""a"""', "a/__init__.py": "", "a/b.py": ""}, ["fte_sniff/a/b.py"]),
    ],
    ids=["sound", "public twice", "private twice", "no line", "package", "inner module"],
)
def test_structure_check_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], modules: dict[str, str], broken: list[str]
) -> None:
    write_package(tmp_path, modules)
    code = runpy.run_path(str(STRUCTURE))["main"](tmp_path)
    found = [line for line in capsys.readouterr().out.splitlines() if "breaks the rule" in line]
    assert code == bool(broken)
    assert len(found) == len(broken)
    assert all(text in line for text, line in zip(broken, found, strict=True))


def test_structure_check_counts_code_and_docstrings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = '"""One\n\nline."""\n\n# comment\nx = (\n    1\n)\n"""Of x."""\n' + "y = 1\n" * 150
    write_package(tmp_path, {"a.py": text, "__init__.py": '"""Two: a."""\n'})
    assert runpy.run_path(str(STRUCTURE))["main"](tmp_path) == 0
    out = capsys.readouterr().out
    assert "Python files in fte_sniff: 2\ncode lines: 153\ndocstring lines: 5\n" in out
