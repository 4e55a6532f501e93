"""Owns what can be wrong around a capture: the folder, the terminal, how the program is installed.

It must not know ports.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

from fte_sniff.capture.diagnostics import Finding, bad, ok, warn
from fte_sniff.errors import reason_of

LOW_BYTES = 2**30
"""Less room than this may not last for a long capture."""

LEAST_BYTES = 50 * 2**20
"""Less room than this does not last."""

_ELSEWHERE = "cd ~, or name a recording with -o"


def working_folder_finding() -> Finding:
    """As `folder_finding`, of the folder in which recordings are made unless another is named."""
    try:
        return folder_finding(Path.cwd())
    except OSError:
        return bad("folder", "the working folder is gone", "cd ~")


def folder_finding(folder: Path) -> Finding:
    """Whether a recording can be made in a folder, and has room to grow."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return bad("folder", f"{folder}: {reason_of(error)}", _ELSEWHERE)
    own = os.access in os.supports_effective_ids
    if not os.access(folder, os.W_OK | os.X_OK, effective_ids=own):
        return bad("folder", f"{folder} cannot be written to", _ELSEWHERE)
    room = f"{free / 2**30:,.1f} GiB free in {folder}"
    way_out = "make room, or record elsewhere: fte-sniff live PORT -o /other/disk/x.mcap"
    if free < LEAST_BYTES:
        return bad("folder", room, way_out)
    return warn("folder", room, way_out) if free < LOW_BYTES else ok("folder", room)


def terminal_findings(environment: Mapping[str, str], encoding: str) -> Iterator[Finding]:
    """Whether the screen of `live` can be drawn.

    Args:
        environment: the variables of this process.
        encoding: of standard output.
    """
    term = environment.get("TERM", "")
    if term in ("", "dumb", "unknown"):
        what = f"TERM is {term!r}: the screen cannot be drawn"
        yield warn("terminal", what, "export TERM=xterm-256color, or use live --plain")
    else:
        yield ok("terminal", f"TERM is {term}")
    if encoding.lower().replace("-", "") != "utf8":
        what = f"its encoding is {encoding}: some signs cannot be shown"
        yield warn("terminal", what, "export LC_ALL=C.UTF-8")


def framer_finding(room: Path, *, compiled: bool) -> Finding:
    """Whether the framer runs as fast as it can, and is what its source says.

    Args:
        room: the folder of its source, beside which lies what was compiled of it.
        compiled: whether that is what runs.
    """
    if not compiled:
        return warn(
            "framer",
            "interpreted, so large files take longer; no row is different",
            "install a C compiler and Python's headers (Debian, Ubuntu: sudo apt install gcc "
            "python3-dev), then fte-sniff again: pip install .",
        )
    edited = _edited_since_compiled(room)
    if edited is None:
        return ok("framer", "compiled")
    return warn(
        "framer",
        f"compiled before {edited} was changed: what runs is not what the source says",
        "install fte-sniff again: pip install -e . (or pip install .)",
    )


def _edited_since_compiled(room: Path) -> str | None:
    """A source that is younger than what was compiled of all of them; None where none is."""
    made = [path.stat().st_mtime for path in room.glob("*__mypyc.*")]
    younger = (path for path in sorted(room.glob("*.py")) if path.stat().st_mtime > max(made))
    return next((path.name for path in younger), None) if made else None
