"""`decoder`: decoders for other tools are printed, and installed where the tool looks."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from fte_sniff.formats.decoders import TOOLS
from tests.cli.processes import PROGRAM
from tests.support.tools import needs

INSTALLED = {
    "sigrok": ".local/share/libsigrokdecode/decoders/fte/__init__.py",
    "wireshark": ".local/lib/wireshark/plugins/fte.lua",
}


@pytest.fixture
def home(tmp_path: Path, environment: dict[str, str]) -> Path:
    """The home folder of the program."""
    environment.pop("XDG_DATA_HOME", None)
    environment["HOME"] = str(tmp_path / "home")
    return tmp_path / "home"


@pytest.mark.parametrize("tool", TOOLS)
def test_decoder_is_printed_whole(run, tool: str) -> None:
    done = run("decoder", tool)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == TOOLS[tool].text()
    assert "@TABLES@" not in done.stdout


@pytest.mark.parametrize("tool", INSTALLED)
def test_decoder_is_installed_and_replaced(run, home: Path, tool: str) -> None:
    path = home / INSTALLED[tool]
    for _ in range(2):
        done = run("decoder", tool, "--install")
        assert (done.returncode, done.stdout) == (0, "")
        assert done.stderr.startswith(f"{path} is written; ")
        assert path.read_text("utf-8") == TOOLS[tool].text()
        assert path.stat().st_mode & 0o444 == 0o444
        path.write_text("old")


@needs("tshark")
def test_tshark_finds_the_installed_dissector(run, home: Path, samples: Path) -> None:
    assert run("decoder", "wireshark", "--install").returncode == 0
    done = run("decode", samples / "damaged.mcap", "-o", home / "x.pcapng")
    assert done.returncode == 0
    words = [
        "tshark",
        "-r",
        home / "x.pcapng",
        "-Y",
        "fte.motor == 1",
        "-T",
        "fields",
        "-e",
        "fte.raw",
    ]
    shown = subprocess.run(
        words,
        env={**os.environ, "HOME": str(home)},
        capture_output=True,
        text=True,
        check=True,
    )
    rows = run("decode", samples / "damaged.mcap", "--format", "jsonl", "--filter", "motor = 1")
    expected = [json.loads(line)["raw"].lower() for line in rows.stdout.splitlines()]
    assert shown.stdout.splitlines() == expected


@needs("sigrok-cli")
def test_sigrok_finds_the_installed_decoder(run, home: Path) -> None:
    assert run("decoder", "sigrok", "--install").returncode == 0
    environment = {**os.environ, "HOME": str(home)}
    environment.pop("XDG_DATA_HOME", None)
    shown = subprocess.run(
        ["sigrok-cli", "-P", "fte", "--show"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Name: FTE\n" in shown.stdout


@pytest.mark.parametrize("tool", INSTALLED)
def test_folder_that_cannot_be_made_is_one_line(run, home: Path, tool: str) -> None:
    home.mkdir()
    (home / ".local").write_text("a file")
    done = run("decoder", tool, "--install")
    assert (done.returncode, done.stdout) == (4, "")
    assert INSTALLED[tool] in done.stderr
    assert f"print it with: fte-sniff decoder {tool} > FILE" in done.stderr
    assert done.stderr.count("\n") == 1


AS_A_USER = ("setpriv", "--bounding-set=-dac_override") if os.geteuid() == 0 else ()
"""Takes from root the right to write where it may not."""


@pytest.mark.skipif(
    bool(AS_A_USER) and shutil.which("setpriv") is None, reason="root may write everywhere"
)
@pytest.mark.parametrize("tool", INSTALLED)
def test_folder_without_permission_is_one_line(home: Path, tool: str, environment) -> None:
    folder = (home / INSTALLED[tool]).parent
    folder.mkdir(parents=True)
    folder.chmod(0o500)
    words = [*AS_A_USER, *PROGRAM, "decoder", tool, "--install"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (4, "")
    assert f"{home / INSTALLED[tool]} cannot be written: Permission denied" in done.stderr
    assert f"print it with: fte-sniff decoder {tool} > FILE" in done.stderr
    assert done.stderr.count("\n") == 1
    assert [*folder.iterdir()] == []


def test_a_decoder_is_not_installed_through_a_link(run, home: Path) -> None:
    path = home / INSTALLED["wireshark"]
    path.parent.mkdir(parents=True)
    (home / "precious").write_text("mine")
    path.symlink_to(home / "precious")
    done = run("decoder", "wireshark", "--install")
    assert (done.returncode, done.stdout) == (4, "")
    assert f"{path} is a link" in done.stderr
    assert done.stderr.count("\n") == 1
    assert (home / "precious").read_text() == "mine"
