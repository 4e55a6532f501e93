"""What users rely on: the public names, and the README of either language."""

from importlib.metadata import version
from pathlib import Path

import pytest

import fte_sniff
from fte_sniff.protocol import COLUMNS, KINDS, Fault, Status


def test_public_names_are_pinned() -> None:
    assert fte_sniff.__all__ == [
        "KINDS",
        "Chunk",
        "Damage",
        "Fault",
        "FileError",
        "FilterError",
        "Frame",
        "Framer",
        "FteSniffError",
        "InputTextError",
        "PortError",
        "PortEvent",
        "RecordingWarning",
        "Row",
        "Status",
        "UsageError",
        "ValueRangeError",
        "encode",
        "read",
        "record",
        "scan",
    ]
    assert all(hasattr(fte_sniff, name) for name in fte_sniff.__all__)


def test_every_module_has_a_docstring() -> None:
    silent = [
        str(path)
        for path in Path(fte_sniff.__file__).parent.rglob("*.py")
        if not path.read_text(encoding="utf-8").lstrip().startswith(('"""', 'r"""'))
    ]
    assert silent == []


def test_version_is_that_of_the_package() -> None:
    assert version("fte-sniff").count(".") == 2


PAGES = ("README.md", "README.zh-CN.md")


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_the_row_contract_is_explained(page: str) -> None:
    text = (Path(__file__).parents[1] / page).read_text(encoding="utf-8")
    names = [column.name for column in COLUMNS]
    names += [kind.name for kind in KINDS] + [str(word) for word in (*Fault, *Status)]
    assert [name for name in names if f"`{name}`" not in text] == []


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("words", ["130", "| 4 |", "adapter TX ──", "--dtr", "GND"])
def test_exit_codes_and_wiring_are_explained(page: str, words: str) -> None:
    assert words in (Path(__file__).parents[1] / page).read_text(encoding="utf-8")
