"""Finished English texts are translated by their forms; what a user wrote stays as it is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fte_sniff.errors import TranslatableText
from fte_sniff.i18n import set_language, translated


@pytest.fixture(autouse=True)
def _chinese() -> Iterator[None]:
    set_language("zh")
    yield
    set_language("en")


@pytest.mark.parametrize(
    ("english", "chinese"),
    [
        ("silent for 2.0 s", "已静默 2.0 秒"),
        ("after 8.1 s as /dev/ttyUSB1", "8.1 秒后，现在是 /dev/ttyUSB1"),
        ("a.hex: its times name no zone, and are taken as UTC; --zone +08:00 sets it", None),
        ("3 rows, nothing malformed", "3 行，无损坏的行"),
        ("Invalid value for '--count': 0 is not in the range x>=1", "'--count' 的值无效"),
        ("x.mcap is a file, not a port; `fte-sniff view x.mcap` shows it", "x.mcap 是文件"),
    ],
)
def test_finished_text_is_recognised_by_its_form(english: str, chinese: str | None) -> None:
    shown = translated(english)
    assert shown != english
    assert shown.startswith(chinese or "a.hex: ")


@pytest.mark.parametrize("text", ["ok", "motor = 3 AND noise", "motor = -->", "rows; ok, noise"])
def test_what_a_user_wrote_stays_as_it_is(text: str) -> None:
    form = 'filter: {what} at character {at} of "{excerpt}"'
    shown = translated(TranslatableText(form, what="this is not a time", at=1, excerpt=text))
    assert f'"{text}"' in shown
    assert "不是时间" in shown
