"""`--resolution` and `--gear-ratio`: refused where they say nothing, shown where they do."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import SAMPLES
from tests.cli.test_screen import terminal


@pytest.mark.parametrize(
    "options",
    [
        ("--gear-ratio", "20"),
        ("--resolution", "0"),
        ("--resolution", "-500"),
        ("--resolution", "nan"),
        ("--resolution", "inf"),
        ("--resolution", "many"),
    ],
)
def test_a_ratio_alone_and_what_is_no_number_above_0_are_refused(
    run, options: tuple[str, str]
) -> None:
    done = run("live", "sim://", "--no-record", "--count", "1", *options)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert options[0] in done.stderr
    assert done.stdout == ""


def test_positions_are_shown_in_turns_too(environment, tmp_path: Path) -> None:
    file, units = str(SAMPLES / "clean.mcap"), ("--resolution", "500", "--gear-ratio", "20")
    with terminal(environment, tmp_path, "view", file, *units, size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("GM")
        screen.until(" turns")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn
