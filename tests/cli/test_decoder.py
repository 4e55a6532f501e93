"""`decoder`: decoders for other tools are printed."""

from __future__ import annotations

import pytest

from fte_sniff.formats.decoders import TOOLS


@pytest.mark.parametrize("tool", TOOLS)
def test_decoder_is_printed_whole(run, tool: str) -> None:
    done = run("decoder", tool)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == TOOLS[tool]()
    assert "@TABLES@" not in done.stdout
