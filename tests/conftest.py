"""How all tests are run: Hypothesis times nothing, since a busy machine would fail what is right.

What it tries stays random, so that runs find what earlier ones did not; a failure prints how to
repeat it.
"""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("house", deadline=None, print_blob=True)
settings.load_profile("house")
