"""The number of examples of a property, where the profile's number does not fit.

The profiles are in `conftest.py`.
"""

from __future__ import annotations

from hypothesis import settings

HOUSE = 50
"""Examples of a property in a usual run."""


def examples(usual: int, **further: int) -> settings:
    """Settings with `usual` examples in a usual run, scaled in others as all properties are."""
    return settings(max_examples=max(1, usual * settings.default.max_examples // HOUSE), **further)
