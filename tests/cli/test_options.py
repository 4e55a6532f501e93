"""The language of filters is explained; the command that installs an extra fits the environment."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from fte_sniff.analysis.filter.terms import FILTER_HELP
from fte_sniff.cli import options
from fte_sniff.cli.options import install_command


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


@pytest.mark.parametrize("text", ["help", " HELP "])
def test_a_filter_called_help_shows_the_language_and_reads_no_file(run, text: str) -> None:
    done = run("decode", "none.mcap", "--filter", text)
    assert (done.returncode, done.stdout, done.stderr) == (0, FILTER_HELP + "\n", "")
