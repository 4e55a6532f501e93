"""The number of examples of a property, where the profile's number does not fit.

The profiles are in `conftest.py`.
"""

from __future__ import annotations

from hypothesis import settings

QUICK, FULL = 15, 50
"""Examples of a property in a usual run, and in `.ci/full`."""


def examples(full: int, **further: int) -> settings:
    """Settings with `full` examples in `.ci/full`, scaled in other runs as all properties are."""
    return settings(max_examples=max(1, full * settings.default.max_examples // FULL), **further)
