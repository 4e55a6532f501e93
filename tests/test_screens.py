"""The scripts of the screen in `screens/`: keys in, what is on the screen out."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs import picture
from tests import screen
from tests.in_process import user_environment

FILES = sorted(Path(__file__).with_name("screens").glob("*.md"))
ALL = [
    pytest.param(
        one,
        id=f"{path.stem}: {one.name}",
        marks=[getattr(pytest.mark, name) for name in one.needs],
    )
    for path in FILES
    for one in screen.scripts_of(path)
]


@pytest.mark.parametrize("script", ALL)
def test_screen(
    script: screen.Script, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    screen.play(script, tmp_path, user_environment(tmp_path_factory.mktemp("home")))


def test_pictures_of_the_pages_can_be_made() -> None:
    drawn = picture.drawn("narrow")
    assert "REC" in drawn
    assert "unansw" in drawn
