"""Translation: the language of the screen, and the names of its themes."""

from __future__ import annotations

import gettext
import re
from collections.abc import Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain
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

    A `TranslatableText` has its own values. Values that are such texts, or phrases, are translated
    too.
    """
    if isinstance(text, TranslatableText):
        return _(text.form, **text.values)
    # For gettext, the empty text is the key of a catalogue's header.
    shown = _catalogue.get(_ENGLISH).texts.gettext(text) if text else ""
    if not values:
        return shown  # A text from elsewhere may have braces.
    if 1 in values.values():
        shown = _COUNTED.sub(lambda noun: noun[1] if values.get(noun[2]) == 1 else noun[0], shown)
    texts = {
        name: translated(one)
        for name, one in values.items()
        if isinstance(one, TranslatableText) or (isinstance(one, str) and " " in one)
    }
    return shown.format(**(values | texts))


def error_text(error: FteSniffError) -> str:
    """The translated message of an error, on one line."""
    return printable(translated(error.message))


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


def translated(text: str) -> str:
    """A finished English text, such as the detail of a recorded event, in the language in use.

        silent for 2.0 s     is matched by the form  silent for {seconds:.1f} s
        FORM; FORM           is translated part by part

    The form with the most letters decides; its values are translated too if they are phrases.
    """
    texts = _catalogue.get(_ENGLISH).texts
    known = _catalogued(texts)
    if isinstance(text, TranslatableText) and (not known or text.form in known):
        return _(text)
    return _of_finished(texts, str(text))


@lru_cache(500)
def _of_finished(texts: gettext.NullTranslations, text: str) -> str:
    known = _catalogued(texts)
    if not known or text in known or " " not in text or len(text) > _MOST_LETTERS:
        return known.get(text, text)
    for form, pattern in _patterns(texts):
        if (found := pattern.fullmatch(text)) is not None:
            values = {
                name: _of_finished(texts, value) if " " in value else value
                for name, value in found.groupdict().items()
            }
            return _filled(known[form], values)
    for parted in (text.rpartition("; "), text.partition(": "), text.rpartition(", ")):
        if parted[0] and parted[2]:
            before, after = (
                _of_finished(texts, part) if " " in part else part for part in parted[::2]
            )
            if (before, after) != parted[::2]:
                return f"{before}{known.get(parted[1], parted[1])}{after}"
    return text


def _filled(form: str, values: Mapping[str, str]) -> str:
    return _VALUE.sub(lambda value: values[value[1]], form)


_VALUE: Final = re.compile(r"\{(\w+)[^{}]*\}")
_LEAST_LETTERS: Final = 4
"""Letters of a form that can be recognised; `{what}; {fix}` has none."""
_MOST_LETTERS: Final = 500
"""Characters of a text that is recognised, so that a hostile one does not take long."""


def _catalogued(texts: gettext.NullTranslations) -> Mapping[str, str]:
    """The translations by their English texts; none for English."""
    found: Mapping[str, str] = vars(texts).get("_catalog", {})
    return found


@cache
def _patterns(texts: gettext.NullTranslations) -> Sequence[tuple[str, re.Pattern[str]]]:
    """The forms with values, those with the most letters first, and what matches their texts."""
    forms = filter(_VALUE.search, _catalogued(texts))
    letters = {form: len(re.sub(r"\W", "", _VALUE.sub("", form))) for form in forms}
    ordered = sorted(letters, key=lambda form: -letters[form])
    return [(form, _pattern(form)) for form in ordered if letters[form] >= _LEAST_LETTERS]


def _pattern(form: str) -> re.Pattern[str]:
    literals, names = _VALUE.split(form)[::2], _VALUE.findall(form)
    # A form of one word has short values, so that `motor {motor}` is not `motor = 3 AND noise`.
    value = ".*?" if len(re.findall(r"\w\w+", " ".join(literals))) > 1 else r"\S*?"
    groups = [
        f"(?P={name})" if name in names[:number] else f"(?P<{name}>{value})"
        for number, name in enumerate(names)
    ]
    parts = zip(map(re.escape, literals), [*groups, ""], strict=True)
    return re.compile("".join(chain.from_iterable(parts)), re.DOTALL)
