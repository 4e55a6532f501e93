"""Owns what is asked of the C library's memory, which bulk work takes and gives back by megabytes.

It must not know what the memory is used for.
"""

from __future__ import annotations

from functools import cache

import numpy as np

_BLOCK = 31 * 1024 * 1024
"""Bytes; the most that glibc learns from are 32 MiB."""


@cache
def keep_freed_memory() -> None:
    """Have what is freed kept for the next chunk, instead of given back and faulted in anew.

    Taking it anew costs as much as half the unpacking does. glibc keeps free memory of up to twice
    the largest block that was ever freed, and learns that from a block that is never touched, and
    so takes no memory. For other C libraries this does nothing. Once is enough for
    the process.
    """
    np.empty(_BLOCK, np.uint8)
