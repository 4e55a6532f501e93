"""A number as a type of click, for options of commands and parameters of `sim://`."""

from __future__ import annotations

from math import isnan
from typing import Any

import click


class RealNumber(click.FloatRange):
    """A number in a range; `nan` is not one."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number; raises click's BadParameter for other text."""
        number = float(super().convert(value, param, ctx))
        if isnan(number):
            self.fail(f"{value} is not a number", param, ctx)
        return number
