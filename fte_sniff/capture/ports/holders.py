"""Owns the answer to who else has a device open, as far as the system tells.

It must not know what for. Linux tells through /proc, and of other users' programs only to root.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fte_sniff.errors import Said, shown

_PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class Holder:
    """A program that has a device open."""

    pid: int
    name: str
    """What the program calls itself, made printable."""

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


def holders_of(device: str) -> list[Holder]:
    """The other programs that have `device` open; empty where there are none or none can be seen.

    This process itself is not among them.
    """
    try:
        wanted = Path(device).stat()
    except (OSError, ValueError):
        return []
    return [
        Holder(pid, _name_of(pid))
        for pid in _others()
        if any((s.st_dev, s.st_ino) == (wanted.st_dev, wanted.st_ino) for s in _open_files(pid))
    ]


def have_open(holders: list[Holder]) -> str:
    """`socat (pid 7) has it open`, for one or several; for none, that nobody can be named."""
    if not holders:
        return Said("this or another program has it open")
    names = " and ".join(map(str, holders))
    if len(holders) > 1:
        return Said("{programs} have it open", programs=names)
    return Said("{program} has it open", program=names)


def sharing_note(device: str | None) -> str:
    """What to add where a port is told to be open: who else has it; empty where nobody has."""
    holders = holders_of(device) if device else []
    if not holders:
        return ""
    names = " and ".join(map(str, holders))
    if len(holders) > 1:
        return Said("; {programs} have it open too, and may take bytes away", programs=names)
    return Said("; {program} has it open too, and may take bytes away", program=names)


def _others() -> list[int]:
    if not _PROC.is_dir():
        return []
    pids = sorted(int(entry.name) for entry in _PROC.iterdir() if entry.name.isdecimal())
    return [pid for pid in pids if pid != os.getpid()]


def _open_files(pid: int) -> Iterator[os.stat_result]:
    try:
        with os.scandir(_PROC / str(pid) / "fd") as entries:
            for entry in entries:
                yield entry.stat()
    except OSError:
        # It belongs to another user, or has ended meanwhile: nothing can be said about it.
        return


def _name_of(pid: int) -> str:
    try:
        return shown((_PROC / str(pid) / "comm").read_text(errors="replace").strip())
    except OSError:
        return "a program"
