"""What users must be able to look up stands in the README of either language."""

from pathlib import Path

import pytest

from fte_sniff.protocol import COLUMNS, KINDS, Fault, Status

PAGES = ("README.md", "README.zh-CN.md")


@pytest.mark.parametrize("page", PAGES)
def test_every_name_of_the_row_contract_is_explained(page: str) -> None:
    text = (Path(__file__).parents[1] / page).read_text(encoding="utf-8")
    names = [column.name for column in COLUMNS]
    names += [kind.name for kind in KINDS] + [str(word) for word in (*Fault, *Status)]
    assert [name for name in names if f"`{name}`" not in text] == []


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("told", ["130", "| 4 |", "adapter TX ──", "--dtr", "GND"])
def test_exit_codes_and_wiring_are_told(page: str, told: str) -> None:
    assert told in (Path(__file__).parents[1] / page).read_text(encoding="utf-8")
