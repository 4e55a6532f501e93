"""Owns the advice that mends a missing permission for a device.

It must not try to mend it: it names the command.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from pathlib import Path

from fte_sniff.errors import Said

_GROUP_MAY = stat.S_IRGRP | stat.S_IWGRP


def way_in(device: str) -> str:
    """One line that tells how the present user can be let in, from the device's owner and mode."""
    try:
        facts = Path(device).stat()
        group = grp.getgrgid(facts.st_gid)
    except (OSError, KeyError):
        return Said("ask the machine's administrator")
    if group.gr_gid == 0 or facts.st_mode & _GROUP_MAY != _GROUP_MAY:
        return Said(
            "its group {group} may not use it: let a group in with a "
            'udev rule, SUBSYSTEM=="tty", GROUP="dialout", MODE="0660"',
            group=group.gr_name,
        )
    user = _user()
    if user in group.gr_mem and group.gr_gid not in os.getgroups():
        return Said(
            "{user} is in the group {group}, but not since this login: log in again",
            user=user,
            group=group.gr_name,
        )
    return Said(
        "it belongs to the group {group}: sudo usermod -aG {group} {user}, then log in again",
        group=group.gr_name,
        user=user,
    )


def _user() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return "$USER"
