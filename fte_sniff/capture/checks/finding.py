"""Owns what a check says: how bad it is, of what, and the way out.

It must not know any check.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARN = "warn"
    """It works, but could be better."""
    BAD = "bad"
    """It does not work, or what is recorded will not be true."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at."""

    level: Level
    about: str
    """The port, or the part of the machine."""
    what: str
    """One line for people; may hold text from outside, so show it, never obey it."""
    way_out: str | None = None
    """What mends it: a command to be typed as it stands, or what to do by hand."""


def ok(about: str, what: str) -> Finding:
    """All is well."""
    return Finding(Level.OK, about, what)


def warn(about: str, what: str, way_out: str) -> Finding:
    """It could be better."""
    return Finding(Level.WARN, about, what, way_out)


def bad(about: str, what: str, way_out: str) -> Finding:
    """It is wrong."""
    return Finding(Level.BAD, about, what, way_out)
