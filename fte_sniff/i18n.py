"""Translation: the language of the screen, and the names of its themes."""

from __future__ import annotations

import gettext
import re
from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from fte_sniff.errors import FteSniffError, TranslatableText, printable

DOMAIN: Final = "fte-sniff"

CATALOGUES: Final = Path(__file__).parent / "locale"

LANGUAGES: Final[Mapping[str, str]] = {"en": "English", "zh": "中文"}
"""Names of the languages, by their word on the command line."""

AUTO: Final = "auto"


@dataclass(slots=True)
class _Catalogue:
    """The catalogue in use; tasks of one screen share it, so that it can be switched."""

    texts: gettext.NullTranslations


_catalogue: ContextVar[_Catalogue] = ContextVar("catalogue")
_ENGLISH: Final = _Catalogue(gettext.NullTranslations())


def language_of(wanted: str | None, environment: Mapping[str, str]) -> str:
    """The wanted language, else that of the locale, else English.

    None and `AUTO` mean the locale: `LC_ALL`, `LC_MESSAGES` or `LANG` of the environment.
    """
    if wanted in LANGUAGES:
        return str(wanted)
    names = (environment.get(name) for name in ("LC_ALL", "LC_MESSAGES", "LANG"))
    locale = next(filter(None, names), "")
    return next((word for word in LANGUAGES if locale.lower().startswith(word)), "en")


def set_language(language: str) -> None:
    """Translate to this language, in this context and in tasks that start in it."""
    _catalogue.set(_Catalogue(_texts(language)))


def switch_language(language: str) -> None:
    """Translate to this language, in all tasks that share the one of `set_language`."""
    _catalogue.get().texts = _texts(language)


def _texts(language: str) -> gettext.NullTranslations:
    return gettext.translation(DOMAIN, CATALOGUES, [language], fallback=True)


_COUNTED: Final = re.compile(
    r"(\{(\w+)[^{}]*\} (?:row|byte|command|frame|hit|capture|column|finding|change))s\b"
    r"(?! (?:are|match|arrived))"
)
"""A number and its noun in an English text, unless a plural verb follows. Chinese has no plural."""


def _(text: str, /, **values: object) -> str:
    """The translated text, in which each `{name}` is the value of that name.

    A `TranslatableText` has its own values. Values that are such texts are translated too.
    """
    if isinstance(text, TranslatableText):
        return _(text.form, **text.values)
    # For gettext, the empty text is the key of a catalogue's header.
    shown = _catalogue.get(_ENGLISH).texts.gettext(text) if text else ""
    if not values:
        return shown  # A text from elsewhere may have braces.
    if 1 in values.values():
        shown = _COUNTED.sub(lambda noun: noun[1] if values.get(noun[2]) == 1 else noun[0], shown)
    texts = {name: _(one) for name, one in values.items() if isinstance(one, TranslatableText)}
    return shown.format(**(values | texts))


def error_text(error: FteSniffError) -> str:
    """The translated message of an error, on one line."""
    return printable(_(error.message))


def later(text: str) -> str:
    """Mark a text for the catalogues; `_` translates it where it is shown."""
    return text


THEMES: Final = ("textual-dark", "textual-light", "nord")
"""Names of the themes; the first is the default."""


_Choice = TypeVar("_Choice")


def choice_after(current: _Choice, choices: Sequence[_Choice]) -> _Choice:
    """The next choice; the first after the last one, and after what is not a choice."""
    number = choices.index(current) + 1 if current in choices else 0
    return choices[number % len(choices)]
