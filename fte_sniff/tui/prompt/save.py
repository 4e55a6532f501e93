"""Owns the field that asks for the file that rows are saved to.

It must not know which rows, nor how they are written.
"""

from __future__ import annotations

from fte_sniff.session.save import EXAMPLE, FORMS
from fte_sniff.tui.language import _, later
from fte_sniff.tui.prompt.field import Check, Field, Take


class SaveField(Field):
    """Asks for a name; says while one types whether a file can be made there."""

    def __init__(self, check: Check, take: Take) -> None:
        super().__init__(
            later("save to"),
            check,
            take,
            EXAMPLE,
            _("enter saves, esc goes back; the name's end is the form: {forms}").format(
                forms=" ".join(FORMS)
            ),
        )
