"""Owns how logs write times, and such a time as a `Stamp`.

It must not know what stands around a time, nor which day or zone it belongs to.

    [14:03:22.123]   2026-01-31 10:15:02,123   2026年1月31日 10:15:02   2026-01-31T10:15:02.5+08:00
    2/8/2024 1:45:12.345 PM      08.02.2024 13:45:12.345                Docklight, Eltima
    [Thu Feb 08 13:45:12.345 2024]   [0 00:00:12.345]                   Tera Term, since it began
    1769860802.123   [1769860800.123456789]                             seconds since 1970
"""

from __future__ import annotations

import re
from dataclasses import dataclass

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_PARTS = {
    "CLOCK": r"(?P<h{0}>\d{{1,2}}):(?P<m{0}>\d{{2}}):(?P<s{0}>\d{{2}})",
    "MINUTES": r"(?P<h{0}>[01]?\d|2[0-3]):(?P<m{0}>[0-5]\d)",
    "DATE": r"(?:(?P<y{0}>\d{{4}})[-/.年](?P<o{0}>\d{{1,2}})[-/.月](?P<d{0}>\d{{1,2}})日?"
    r"|(?P<u{0}>\d{{1,2}})(?P<w{0}>[-/.])(?P<v{0}>\d{{1,2}})(?P=w{0})(?P<x{0}>\d{{4}}))[T ]\s*",
    "DAY": r"(?P<y{0}>\d{{4}})[-/.](?P<o{0}>\d{{1,2}})[-/.](?P<d{0}>\d{{1,2}})",
    "NAMED": r"(?:[A-Z][a-z]{{2}}\s+)?(?P<n{0}>"
    rf"{'|'.join(_MONTHS)})\s+(?P<d{{0}}>\d{{{{1,2}}}})",
    "FRACTION": r"(?P<f{0}>[0-9]{{1,9}})",
    "ZONE": r"(?:\s*(?P<z{0}>Z|UTC|[+-]\d{{2}}:?\d{{2}}))?",
    "MILLIS": r"(?P<t{0}>\d{{3}})",
    "LAST_YEAR": r"(?P<y{0}>\d{{4}})",
    "HALF": r"(?:\s*(?P<a{0}>[AP]M))?",
}
_NOT_BEHIND = r"(?!\w|:\S)"
"""Colons are between bytes too."""
_BOXED = (
    r"[\[(<{]\s*(?:DATE|\d{1,2}[-/.]\d{1,2}\s+)?CLOCK(?:[.,:]FRACTION)?HALFZONE\s*[\])>}]",
    r"[\[(]\s*NAMED\s+CLOCK(?:[.,]FRACTION)?\s+LAST_YEAR\s*[\])]",
    r"[\[(]\s*\d{1,4}\s+\d{1,2}:\d{2}:\d{2}[.,]\d{1,9}\s*[\])]",
)


@dataclass(frozen=True, slots=True)
class Stamp:
    """A time as it is written."""

    date: tuple[int, int, int] | None = None
    """Year, month, day."""
    clock_ns: int | None = None
    """Nanoseconds since midnight; None where the time is `epoch_ns` or counts from no known one."""
    zone_s: int | None = None
    """Seconds east of UTC, where the text says so."""
    epoch_ns: int | None = None
    """Nanoseconds since 1970 UTC, where the time is written so."""
    day_or_month: tuple[int, int, int] | None = None
    """Day and month, in the order of the log, and year: instead of `date`, as in 2/8/2024."""
    of_first_byte: bool = False
    """Whether the first byte of its line began then; else the last one had come by then."""


class Times:
    """Finds times at the front of lines."""

    def __init__(self, begin: str, word: str, direction: str) -> None:
        """Times of a log.

        Args:
            begin: what bytes begin with; a time without any mark must stand before that.
            word: a word for a direction.
            direction: that, or an arrow.
        """
        behind = rf"(?=[\s,;]+{begin}(?:[\s,](?!.*:)|\Z))"
        forms = (
            *_BOXED,
            rf"DATECLOCK(?:[.,:]FRACTION)?HALFZONE{_NOT_BEHIND}",
            rf"CLOCK[.,]FRACTION{_NOT_BEHIND}",
            rf"CLOCK(?::MILLIS{_NOT_BEHIND})?HALF(?=\s*{direction})",
            f"CLOCK{behind}",
            f"CLOCK:MILLIS{behind}",
            f"(?:DATE)?MINUTES{behind}",
            f"DAY{behind}",
        )
        pattern = re.compile(
            rf"\s*(?:{'|'.join(_form(number, form) for number, form in enumerate(forms))}"
            r"|[\[(]\s*(?P<count>\d{1,10}\.\d{3,9})\s*[\])]"
            rf"|(?P<plain>\d{{1,10}}\.\d{{3,9}})(?=\s+(?:{word}))"
            rf"|(?P<epoch>1\d{{9}}(?:\.\d{{1,9}})?){behind}"
            rf"|(?P<realterm>1\d{{9}}(?:\.\d{{1,9}})?)(?=,\s*{begin}(?:[0-9A-F]{{2}})*\s*\Z))",
            re.IGNORECASE,
        )
        self._match = pattern.match
        self._parts = _parts(pattern)

    def at(self, line: str, at: int = 0) -> tuple[Stamp, int] | None:
        """The time that stands there and where it ends; None where none does."""
        time = self._match(line, at)
        if time is None:
            return None
        parts = self._parts[time.lastindex] if time.lastindex else ()
        found = {name: text for name, group in parts if (text := time[group]) is not None}
        return _stamp(found), time.end()


def _form(number: int, pattern: str) -> str:
    for name, part in _PARTS.items():
        pattern = pattern.replace(name, part.format(number))
    return pattern


def _parts(pattern: re.Pattern[str]) -> dict[int, tuple[tuple[str, int], ...]]:
    """By any group of a form, its parts: the letter of each and its group."""
    forms: dict[str, list[tuple[str, int]]] = {}
    form_of: dict[int, str] = {}
    for name, group in pattern.groupindex.items():
        numbered = name[1:].isdecimal()
        form_of[group] = name[1:] if numbered else name
        forms.setdefault(form_of[group], []).append((name[0] if numbered else "", group))
    return {group: tuple(forms[form]) for group, form in form_of.items()}


def _stamp(found: dict[str, str]) -> Stamp:
    if "" in found:
        whole, _, fraction = found[""].partition(".")
        # What has fewer digits counts from when something was switched on.
        since_1970 = int(whole) * 10**9 + int(fraction.ljust(9, "0"))
        return Stamp(epoch_ns=since_1970 if len(whole) >= 9 else None)
    if "h" not in found:
        return Stamp()
    hours = int(found["h"])
    if "a" in found:
        hours = hours % 12 + (12 if found["a"].upper() == "PM" else 0)
    seconds = (hours * 60 + int(found["m"])) * 60 + int(found.get("s", 0))
    fraction = found.get("f") or found.get("t") or ""
    clock_ns = seconds * 10**9 + int(fraction.ljust(9, "0"))
    zone_s = _zone(found.get("z"))
    if "u" in found and found["w"] != ".":
        unordered = (int(found["u"]), int(found["v"]), int(found["x"]))
        return Stamp(None, clock_ns, zone_s, day_or_month=unordered)
    return Stamp(_date(found), clock_ns, zone_s)


def _date(found: dict[str, str]) -> tuple[int, int, int] | None:
    if "u" in found:
        # With full stops, the day is first wherever dates are written so.
        return int(found["x"]), int(found["v"]), int(found["u"])
    if "n" in found:
        return int(found["y"]), _MONTHS.index(found["n"].lower()) + 1, int(found["d"])
    return (int(found["y"]), int(found["o"]), int(found["d"])) if "y" in found else None


def _zone(text: str | None) -> int | None:
    if text is None:
        return None
    if text.upper() in ("Z", "UTC"):
        return 0
    digits = text[1:].replace(":", "")
    east = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return -east if text[0] == "-" else east
