"""Options of units; the command that installs an extra fits the environment."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from fte_sniff.analysis.filter.terms import FILTER_HELP
from fte_sniff.cli import options
from fte_sniff.cli.options import install_command
from tests.cli.conftest import SAMPLES
from tests.cli.terminals import terminal


@pytest.mark.parametrize(("extra", "package"), [("report", "bokeh"), ("cluster", "distributed")])
def test_the_command_names_the_packages_with_their_versions(extra: str, package: str) -> None:
    words = shlex.split(install_command(extra))
    assert words[-1].startswith(package)
    assert ">=" in words[-1]
    assert not any("fte-sniff" in word for word in words[1:])


def test_the_command_is_that_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(options, "find_spec", lambda _name: object())
    assert install_command("report").startswith(f"{sys.executable} -m pip install 'bokeh")
    monkeypatch.setattr(options, "find_spec", lambda _name: None)
    start = f"uv pip install --python {sys.executable} 'bokeh"
    assert install_command("report").startswith(start)
    environment = tmp_path / "fte-sniff-2"
    environment.mkdir()
    (environment / "pipx_metadata.json").write_text("{}")
    monkeypatch.setattr(sys, "prefix", str(environment))
    assert install_command("report").startswith("pipx inject fte-sniff-2 'bokeh")


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
def test_a_ratio_alone_and_what_is_not_a_number_above_0_are_refused(
    run, options: tuple[str, str]
) -> None:
    done = run("live", "sim://", "--no-record", "--count", "1", *options)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert options[0] in done.stderr
    assert done.stdout == ""


@pytest.mark.pending
def test_positions_are_shown_in_turns_too(environment, tmp_path: Path) -> None:
    file, units = str(SAMPLES / "clean.mcap"), ("--resolution", "500", "--gear-ratio", "20")
    with terminal(environment, tmp_path, "view", file, *units, size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("GM")
        screen.until(" turns")
        screen.type("Q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn


@pytest.mark.parametrize("text", ["help", " HELP "])
def test_a_filter_called_help_shows_the_language_and_reads_no_file(run, text: str) -> None:
    done = run("decode", "none.mcap", "--filter", text)
    assert (done.returncode, done.stdout, done.stderr) == (0, FILTER_HELP + "\n", "")
