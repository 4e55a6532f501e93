"""The screen is what `docs/pictures` show; `python docs/picture.py` makes them anew."""

import re
from html import unescape

import pytest

from docs.picture import FOLDER, PICTURES, drawn


def shown(picture: str) -> list[tuple[float, float, str]]:
    """Every text on a picture, and where it stands: what other fonts and colours leave as it is."""
    found = []
    for attributes, text in re.findall(r"<text ([^>]*clip-path[^>]*)>([^<]*)</text>", picture):
        place = dict(re.findall(r'(\w+)="([\d.]+)"', attributes))
        found.append((float(place["y"]), float(place["x"]), unescape(text)))
    return sorted(found)


@pytest.mark.parametrize("name", PICTURES)
def test_the_screen_is_as_on_its_picture(name: str) -> None:
    kept = (FOLDER / f"{name}.svg").read_text("utf-8")
    assert shown(drawn(name)) == shown(kept)


def test_there_is_no_picture_of_what_is_gone() -> None:
    assert {path.stem for path in FOLDER.iterdir()} == set(PICTURES)
