"""How many examples a property is tried with, where the profile's own number is not right.

The profiles stand in `conftest.py`.
"""

from __future__ import annotations

from hypothesis import settings

HOUSE = 50
"""Examples that a property is usually tried with."""


def examples(usual: int, **further: int) -> settings:
    """So many in a usual run, and as many more in another as all properties have there."""
    return settings(max_examples=max(1, usual * settings.default.max_examples // HOUSE), **further)
