"""Language choice and translated names."""

from __future__ import annotations

import gettext
from collections.abc import Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import Final

from fte_sniff.errors import FteSniffError, TranslatableText, UsageError, printable

DOMAIN: Final = "fte-sniff"
"""The name of the catalogues."""

CATALOGUES: Final = Path(__file__).parent / "locale"
"""The folder of the catalogues."""

LANGUAGES: Final[Mapping[str, str]] = {"en": "English", "zh": "中文"}
"""What can be spoken, by the word for it on the command line."""

AUTO: Final = "auto"
"""The language of the locale."""

_spoken: ContextVar[gettext.NullTranslations] = ContextVar("spoken")
_ENGLISH: Final = gettext.NullTranslations()


def language_of(wanted: str | None, environment: Mapping[str, str]) -> str:
    """The language to speak: the one that is wanted, else the one of the locale, else English.

    Args:
        wanted: a word of `LANGUAGES`; None or `AUTO` for that of the locale.
        environment: holds the locale, in `LC_ALL`, `LC_MESSAGES` or `LANG`.

    Raises:
        UsageError: that language is not spoken.
    """
    if wanted not in (None, AUTO):
        if wanted not in LANGUAGES:
            known = ", ".join(LANGUAGES)
            raise UsageError(f"the screen does not speak {wanted!r}; it speaks {known}")
        return str(wanted)
    names = (environment.get(name) for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    locale = next(filter(None, names), "")
    return next((word for word in LANGUAGES if locale.lower().startswith(word)), "en")


def speak(language: str) -> None:
    """Say everything in this language from now on, in this context and what begins in it."""
    _spoken.set(gettext.translation(DOMAIN, CATALOGUES, [language], fallback=True))


def _(text: str) -> str:
    """The text in the language that is spoken; one with values in it, with the values too."""
    if isinstance(text, TranslatableText):
        values = {
            name: _(value) if isinstance(value, TranslatableText) else value
            for name, value in text.values.items()
        }
        return _(text.form).format(**values)
    # To gettext, the empty text is the name of a catalogue's header.
    return _spoken.get(_ENGLISH).gettext(text) if text else ""


def worded(error: FteSniffError) -> str:
    """What went wrong, in the language that is spoken, on one line."""
    return printable(_(error.message))


def later(text: str) -> str:
    """The same text, for the catalogues to find; `_` says it in its language where it is shown."""
    return text


CONTRAST_DARK: Final = "contrast-dark"
CONTRAST_LIGHT: Final = "contrast-light"

THEMES: Final = ("textual-dark", "textual-light", CONTRAST_DARK, CONTRAST_LIGHT, "nord")
"""All of them; the first is the usual one."""


def theme_after(name: str) -> str:
    """The theme behind the one of that name; the first where there is none."""
    at = THEMES.index(name) + 1 if name in THEMES else 0
    return THEMES[at % len(THEMES)]
