"""Programs of others that some tests run."""

from __future__ import annotations

import shutil

import pytest


def needs(tool: str) -> pytest.MarkDecorator:
    """A mark for tests that run a program, which skips them where it is not installed."""
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed")
