"""Owns what happens to standard output when whoever read it has gone. It knows no command."""

from __future__ import annotations

import os
import sys


def abandon_stdout() -> None:
    """Let what is still buffered for standard output go nowhere, so that the end stays quiet."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)
