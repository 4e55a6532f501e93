"""How all tests are run: Hypothesis times nothing, since a busy machine would fail what is right.

What it tries stays random, so that runs find what earlier ones did not; a failure prints how to
repeat it. `--hypothesis-profile thorough` tries twenty times as much.
"""

from __future__ import annotations

from hypothesis import settings

from tests.examples import HOUSE

settings.register_profile("house", deadline=None, print_blob=True, max_examples=HOUSE)
settings.register_profile("thorough", settings.get_profile("house"), max_examples=20 * HOUSE)
settings.load_profile("house")
