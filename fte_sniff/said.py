"""Owns sentences with values in them that can be said again in another language.

It must not know any language but its own: a `Said` is its English text, and keeps beside it the
form and the values that it was made of. Files and command lines have the English text; the screen
says the form in its language, wherever in the program it was said.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType


class Said(str):
    """A text out of a form with named places, `expected {wanted}`, and what stands in them.

    It goes from process to process whole.
    """

    __slots__ = ("form", "values")

    form: str
    values: Mapping[str, object]
    """Those that are `Said` themselves are said in the other language too, and no other text is."""

    def __new__(cls, form: str, **values: object) -> Said:
        """The form with the values in their places."""
        made = super().__new__(cls, form.format(**values))
        made.form, made.values = form, MappingProxyType(values)
        return made

    def __reduce__(self) -> tuple[object, ...]:
        return _again, (self.form, dict(self.values))


def _again(form: str, values: dict[str, object]) -> Said:
    return Said(form, **values)
