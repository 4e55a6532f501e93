"""Owns sentences with values in them that can be said again in another language.

It must not know any language but its own: a `Said` is its English text, and keeps beside it the
form and the values that it was made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeAlias

Value: TypeAlias = "str | int"


class Said(str):
    """A text out of a form with named places, `expected {wanted}`, and what stands in them."""

    __slots__ = ("form", "values")

    form: str
    values: Mapping[str, Value]
    """Texts among them may be `Said` too, or stand in a table that can be translated."""

    def __new__(cls, form: str, **values: Value) -> Said:
        """The form with the values in their places."""
        made = super().__new__(cls, form.format(**values))
        made.form, made.values = form, MappingProxyType(values)
        return made
