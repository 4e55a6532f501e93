"""Owns how many threads bulk work is worth: as many as there are cores for this process.

It must not know what they do.
"""

from __future__ import annotations

import os


def cores() -> int:
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
