"""Owns loading what filters and searches need, while somebody begins to type one.

It must not know the screen. Loaded at the start it would keep the first rows from being shown;
loaded with the first letter, it would be felt.
"""

from __future__ import annotations

from importlib import import_module
from threading import Thread
from typing import Final

_NEEDED: Final = (
    "fte_sniff.analysis.filter.row_filter",
    "fte_sniff.analysis.filter.completion",
    "fte_sniff.analysis.search_frame",
)


def prepare() -> None:
    """Begin to load it; returns at once, and costs nothing where it is there already."""
    Thread(target=_load, name="loads the filter", daemon=True).start()


def _load() -> None:
    for name in _NEEDED:
        import_module(name)
