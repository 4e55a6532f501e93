"""Owns how a time in seconds is read from the command line. It knows no command."""

from __future__ import annotations

import re
from math import isnan
from typing import Any, Final

import click

_SECONDS: Final = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
_TIME: Final = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d)", re.IGNORECASE)


def seconds_of(text: str) -> float | None:
    """A number with its unit, `10s`, `5min`, `1h`, `2d`, in seconds; None for all else."""
    found = _TIME.fullmatch(text)
    return None if found is None else float(found[1]) * _SECONDS[found[2].lower()]


class Seconds(click.FloatRange):
    """A time: seconds, or a number with its unit.

    Infinity is one, but what is not a number is none.
    """

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The seconds; what is none, or out of range, is refused."""
        told = seconds_of(value) if isinstance(value, str) else None
        seconds = float(super().convert(value if told is None else told, param, ctx))
        if isnan(seconds):
            self.fail(f"{value!r} is not a number of seconds.", param, ctx)
        return seconds
