"""`decoder`: decoders for other tools are printed."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from fte_sniff.formats.decoders import TOOLS
from tests.support.tools import needs


@pytest.mark.parametrize("tool", TOOLS)
def test_decoder_is_printed_whole(run, tool: str) -> None:
    done = run("decoder", tool)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == TOOLS[tool]()
    assert "@TABLES@" not in done.stdout


@needs("sigrok-cli")
def test_sigrok_finds_the_decoder(run, tmp_path: Path) -> None:
    path = tmp_path / ".local/share/libsigrokdecode/decoders/fte/__init__.py"
    path.parent.mkdir(parents=True)
    path.write_text(run("decoder", "sigrok").stdout, "utf-8")
    environment = {**os.environ, "HOME": str(tmp_path)}
    environment.pop("XDG_DATA_HOME", None)
    shown = subprocess.run(
        ["sigrok-cli", "-P", "fte", "--show"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Name: FTE\n" in shown.stdout
