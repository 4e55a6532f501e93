"""Packages of the extras: the command that installs one where the program runs."""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import requires
from importlib.util import find_spec
from pathlib import Path

_PROGRAM = "fte-sniff"


def install_command(extra: str) -> str:
    """The command that adds the packages of an extra to this environment.

    It names the packages themselves: fte-sniff is on no package index, and an installation from its
    folder would compile the framer again.
    """
    needs = [
        need.split(";")[0].strip() for need in requires(_PROGRAM) or () if f'"{extra}"' in need
    ]
    packages = " ".join(map(shlex.quote, needs))
    prefix = Path(sys.prefix)
    if (prefix / "pipx_metadata.json").exists():
        return f"pipx inject {shlex.quote(prefix.name)} {packages}"
    python = shlex.quote(sys.executable)
    if find_spec("pip") is None:
        return f"uv pip install --python {python} {packages}"
    return f"{python} -m pip install {packages}"
