"""Times in the lines of a log: one table of their forms, and the clock that they are read by.

A time is a date with a clock, a clock alone, or a number: since 1970, or since a start.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, tzinfo
from functools import cache, lru_cache
from itertools import islice, pairwise, product
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.formats.logs.text import LATEST_NS, NO_TIME
from fte_sniff.protocol import DEFAULT_BAUD, byte_time_ns

if TYPE_CHECKING:
    from fte_sniff.formats.logs.text import Array, LogOptions

SECOND: Final = 10**9
_DAY_NS: Final = 86_400 * SECOND
_QUARTER_S: Final = 900
_LONGEST_STEP: Final = 3600
"""Between whole seconds of two lines, in the median; if it is longer, they are not seconds."""

_MONTHS: Final = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
_NAMED: Final = rf"(?=[ADFJMNOSadfjmnos])(?i:{_MONTHS})[a-z]*"
_MONTH_DAY: Final = r"(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01])"
_YEAR: Final = r"(?:19|2[01])\d\d"
_DATES: Final = (
    ("date", rf"{_YEAR}(?:[-/.]|年)[01]?\d(?:[-/.]|月)[0-3]?\d(?:日)?"),  # ISO 8601; in Chinese
    ("date", rf"\d{{1,2}}\.\d{{1,2}}\.(?:{_YEAR}|\d\d)"),  # day first: in German and Russian
    ("date", rf"\d{{1,2}}[-/]\d{{1,2}}[-/](?:{_YEAR}|\d\d)"),  # Docklight, Eltima, Windows
    ("date", rf"20\d\d{_MONTH_DAY}"),  # embedded loggers, PLCs
    ("date", rf"2\d{_MONTH_DAY}(?=[T_ -]\d{{6}}\.\d)"),  # the same with a short year
    ("date", rf"\d{{1,2}}[- ]{_NAMED}[- ]{_YEAR}"),  # git, Apache
    ("date", rf"{_NAMED} +\d{{1,2}}(?:,? {_YEAR}|(?= +[\d:.]+ 20\d\d\b))"),  # ctime, Tera Term
    ("year-less", rf"{_NAMED} +\d{{1,2}}"),  # syslog, ts
    ("year-less", r"\d\d[-/]\d\d"),  # logcat, LLCOM
)
"""Kinds of dates, their regular expressions, and who writes them; an earlier one is preferred."""
_HALF: Final = "[AaPp][Mm]|上午|下午"
_CLOCK: Final = (  # the colons may be absent after a date of digits
    rf"(?:(?P<half>{_HALF}) *)?"
    r"(?P<h>2[0-4]|[01]?\d)(?::|时|(?<=\d{10})|(?<=\d{6}[T_-]\d\d)|(?<=\d{6} \d\d)(?=\d{4}\.))"
    r"(?P<mi>[0-5]\d)(?::|分|(?<=\d{12})|(?<=\d{6}[T_ -]\d{4}))(?P<s>[0-5]\d|60)(?:秒)?"
    r"FRACTION"
    rf"(?![\d_]|:\w)(?: ?(?P<half2>(?:{_HALF})(?![A-Za-z])))?(?: (?P<y>20\d\d)(?!\d))?"
    r"(?P<zone> ?(?:Z|UTC)(?!\w)| ?(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)(?!\d))?"
)
_POINT: Final = (
    r"(?:(?:\.(?:000(?=\d{6}  length))?|[:,](?=\d{3}(?!\d)|\d{6}[+-]))"  # socat 1.7.4.4 pads
    r"(?P<f>\d{1,9})(?:,(?P<us>\d{3})(?=\]))?)?"  # Zephyr writes milliseconds,microseconds
)
_APART: Final = r" (?P<f>\d{3})(?: ?ms)?(?P<us>)(?!\w)"
"""Milliseconds after a space."""
_BEGIN: Final = r"(?<![\w.])(?<!\b[0-9A-Fa-f]{2}:)(?<!\b\d:)(?<!::)"
_THEN: Final = r"(?:[T-]|[,_ ] *|(?<=\d{8}))"
_WHOLE: Final = r"(?<![\w.+-])(?<!\d:)(?P<n>\d+)"
_FRACTION: Final = r"\.(?P<f>\d{1,9})\d*"
_NUMBER: Final = rf"{_WHOLE}(?:{_FRACTION})?(?![\w.])"
_ENOUGH_LINES: Final = 20_000
"""That show how many digits of a fraction are always 0."""
_UNITS: Final = {"s": SECOND, "ms": 10**6, "us": 1000, "µs": 1000, "ns": 1}
_FORMS: Final[tuple[tuple[str, int, str], ...]] = (
    *(
        (kind, SECOND, f"{_BEGIN}(?P<date>{one}){_THEN}{_CLOCK.replace('FRACTION', fraction)}")
        for fraction in (_APART, _POINT)
        for kind, one in _DATES
    ),
    *(
        ("clock", SECOND, f"{_BEGIN}(?P<date>){_CLOCK.replace('FRACTION', fraction)}")
        for fraction in (_APART, _POINT)
    ),
    *(  # `time`, candump; JavaScript; ROS, InfluxDB
        ("epoch", 10 ** (18 - digits), _NUMBER.replace(r"\d+", rf"[12]\d{{{digits}}}"))
        for digits in (9, 12, 15, 18)
    ),
    ("since", 0, _NUMBER),  # the heading of the column has the unit: DSView, Saleae
    # usbmon: 32 bits of the uptime
    ("since", 1000, _WHOLE.replace(r"\d+", r"[1-4]\d{9}") + r"(?P<f>)(?![\w.])"),
    *(
        ("since", scale, rf"(?<![\w.-])(?<!\d:)(?P<n>\d+)(?:{_FRACTION})?(?= ?{unit}\b)")
        for unit, scale in _UNITS.items()
    ),
    ("since", 10**6, r"\b[EWIDV] \(" + _NUMBER),  # ESP-IDF
    ("since", SECOND, rf"{_WHOLE}{_FRACTION}(?![\w.])"),  # dmesg, tshark
)
"""Kinds of times, nanoseconds of one, and regular expressions; an earlier one is preferred."""
_PRECISE: Final = _CLOCK.replace("FRACTION", _POINT)
_ANY: Final = (  # digits that go on in a word may be bytes
    rf"{_BEGIN}(?:(?:{'|'.join(one for _, one in _DATES)}){_THEN})?{_PRECISE}"
    r"(?!(?<=\d)[+/-]?\w)"
)
_HEADING: Final = (
    r"(?:[^,\n]*(?:time|stamp|start|\bts\b|时间)[^,\n]*[\[(_ ]|[^\w,\n]*(?:t_?)?)"
    r"([nuµm]s)(?:ec|\b)[^,\n]*"
)
_IN_NAME: Final = r"(?<!\d)(20\d\d\D?\d\d\D?\d\d)(?:\D{1,4}(\d\d\D?\d\d\D?\d\d))?(?!\d)"
OF_CLOCK: Final = frozenset({"h", "mi", "s", "f", "us", "n"})
"""Fields that may differ in lines of the same shape; their dates and zones are equal."""
_LACKING: Final = {
    "zone": "name no zone, and are taken as UTC; --zone +08:00 says another",
    "since": "count seconds from a start, {:%Y-%m-%dT%H:%M:%SZ} by {}; --start sets another",
    "clock": "have no date: the date is {:%Y-%m-%d} by {}; --date 2026-01-31 sets another",
    "year-less": "have no date: the year is {:%Y} by {}; --date 2026-01-31 sets another",
}
"""What times may lack: by kind, and the zone."""

Fields = Mapping[str, tuple[int, int]]
"""By name, where a field of a time begins and ends in the line."""


@cache
def _compiled(pattern: str) -> re.Pattern[bytes]:
    return re.compile(pattern.encode())


def masked(text: bytes) -> bytes:
    """The text with the first date or time of each line hidden, which cannot be bytes."""
    first = _compiled(rf"(?m)^(.*?)({_ANY})")
    return first.sub(lambda found: found[1] + b"~" * len(found[2]), text)


def beside_times(pattern: bytes) -> re.Pattern[bytes]:
    """Finds each line of a text that may match a pattern once its first time is `masked`.

    It is faster than to hide the times. A time is passed over at the start of a line, if white
    space follows, so that the rest matches as it would after a hidden time. Elsewhere a time
    that is hidden lets a run before it end with a sign, such as `=`.
    """
    time = re.sub("[?]P<[^>]+>", "?:", _ANY).encode()
    return re.compile(
        rb"(?m)^(?:[\[({<]?(?>%b)[\])}>]?(?=\s))?+.*?(?:%b|[+/=-](?=%b))" % (time, pattern, time)
    )


@dataclass(slots=True)
class TimeRule:
    """Where the lines of a log have their times, and how they are read.

    Attributes:
        where: `before` or `after` the bytes, `above` or `below` them in a line, or `none`.
        kind: `date`, `year-less`, `clock`, `epoch` or `since`; `unread` numbers in headings.
        scale: nanoseconds of one of the numbers.
        column: which of the times in a line.
        is_local: whether the times name no zone; else all do, or count seconds.
        day_first: whether dates such as 5/3/2026 begin with the day.
        year: of dates without one.
        first_byte: whether the first byte of a line began then; else the last one had arrived.
        samplerate: numbers in a second, if they count samples.
    """

    where: str = "none"
    kind: str = "date"
    scale: int = SECOND
    pattern: str = _NUMBER
    column: int = 0
    is_local: bool = False
    resolution_ns: int = SECOND
    day_first: bool = False
    year: int = 1972
    first_byte: bool = False
    samplerate: int | None = None

    def find(self, text: bytes, start: int, stop: int) -> Fields | None:
        """Where the fields of the time are in a part of a line."""
        found = _compiled(self.pattern).finditer(text, start, stop)
        for one in islice(found, self.column, self.column + 1):
            fields = {name: one.span(name) for name, part in one.groupdict().items() if part}
            if fields.keys().isdisjoint(("zone", "n")) == self.is_local:
                return fields
        return None

    def stamp(self, text: bytes, fields: Fields, read: Callable[..., Any] | None = None) -> Any:
        """The time of the fields of a line in nanoseconds, None if it is impossible.

        It counts from 1970, midnight or a start, as the `kind` says. For many lines of the same
        shape, `read` reads a column of numbers between two offsets, and the time is a column.
        """
        part = {name: text[slice(*span)] for name, span in fields.items()}
        number = defaultdict[str, Any](int)
        number |= {name: int(own) for name, own in part.items() if own.isdigit()}
        if read is not None:
            number |= {name: read(*fields[name]) for name in number.keys() & OF_CLOCK}
        # The latest is in 2116, or counted from a start before then.
        for name, most in {"h": 24, "mi": 59, "s": 60, "n": LATEST_NS // 2 // self.scale}.items():
            own = number[name]
            if (own if isinstance(own, int) else own.max()) > most:
                return None
        if half := part.get("half") or part.get("half2"):
            number["h"] = number["h"] % 12 + 12 * (half.lower() in (b"pm", "下午".encode()))
        east = (number["zh"] * 60 + number["zm"]) * (-1 if part.get("sign") == b"-" else 1)
        seconds = (number["h"] * 60 + number["mi"] - east) * 60 + number["s"]
        ns = number["f"] * self.scale // 10 ** len(part.get("f", b"")) + number["us"] * 1000
        whole, rate = number["n"], self.samplerate
        if rate is None:
            ns += whole * self.scale + seconds * SECOND
        else:
            ns += whole // rate * SECOND + whole % rate * SECOND // rate
        if "date" not in part:
            return ns
        day = _day(part["date"], number["y"] or self.year, self.day_first)
        return day and ns + _midnight_ns(day)

    def decide(self, texts: Iterable[bytes], near: date, *, given: bool) -> list[str]:
        """Decide the resolution, and the order of day and month; returns notes about them.

        Texts of the log are read until they show both, or the order and many times; else the
        order is that whose date is near that of the file, or the date that is `given`.
        """
        if self.kind == "unread":
            return ["numbers in the lines above the bytes may be times; they are not read"]
        form, fractions, dates = _compiled(self.pattern), {b""}, {b""}
        days: list[list[date]] = [[], []]
        lines = 0
        for text in texts if "date" in form.groupindex else ():
            lines += text.count(b"\n")
            found = {one.group("date", "f", "us") for one in form.finditer(text)}
            fractions |= {(f or b"") + (us or b"") for _, f, us in found}
            dates |= {one for one, _, _ in found}
            digits = max(len(fraction.rstrip(b"0")) for fraction in fractions)
            self.resolution_ns = SECOND // 10**digits
            days = [
                [day for one in dates if (day := _day(one, self.year, order))]
                for order in (False, True)
            ]
            certain = days[0] == days[1] or len(days[0]) != len(days[1])
            if certain and (digits == max(map(len, fractions)) or lines >= _ENOUGH_LINES):
                break
        plausible = [(len(own), -len({(one.year, one.month) for one in own})) for own in days]
        nearest = [-min((abs((one - near).days) for one in own), default=0) for own in days]
        self.day_first = (plausible[1], nearest[1]) >= (plausible[0], nearest[0])
        if given or days[0] == days[1] or plausible[0] != plausible[1]:
            return []
        order = "day" if self.day_first else "month"
        return [
            f"its dates, such as {max(dates).decode()}, could be day or month first, and are read"
            f" {order} first; --date 2026-01-31 says the first date"
        ]


def _midnight_ns(day: date) -> int:
    return (day - date(1970, 1, 1)).days * _DAY_NS


@lru_cache
def _day(text: bytes, year: int, day_first: bool) -> date | None:
    """The day of a date, None if there is none; the year is that of dates without one."""
    century = "20" if text.isdigit() and len(text) == 6 else ""
    words = re.findall(rf"{_MONTHS}|\b\d{{4}}|\d\d?", century + text.decode().lower())
    is_day_first = b"." in text or (day_first and len(words) == 3)
    numbers = "%d %m" if is_day_first else "%m %d"
    for form in ("%Y %m %d", "%d %b %Y", "%b %d %Y", f"{numbers} %Y", f"{numbers} %y"):
        with suppress(ValueError):
            return datetime.strptime(" ".join([*words, str(year)][:3]), form).date()
    return None


class StepUnit(NamedTuple):
    """What shows the unit of numbers that rise from byte to byte."""

    bytewise: bool = False
    """Whether each time is that of one byte."""
    baud: int = DEFAULT_BAUD
    samplerate: int | None = None

    def unit(self, steps: Sequence[float], *, whole: bool) -> int:
        """Nanoseconds of one; 0 if it is not known.

        Most bytes of a frame follow each other without a pause. Whole numbers may count samples of
        any rate, so they are times only if the pause is exactly that of a byte.
        """
        if self.samplerate and whole:
            return max(1, SECOND // self.samplerate)
        if not self.bytewise or not steps:
            return 0
        byte_ns, step = byte_time_ns(self.baud), steps[len(steps) // 2]
        least, most = (0.95, 1.1) if whole else (0.03, 30)
        units = (
            unit for unit in _UNITS.values() if least * byte_ns <= step * unit <= most * byte_ns
        )
        return next(units, 0)


def time_rule(
    texts: Sequence[tuple[bytes, bytes, bytes, bytes]], steps: StepUnit, *, is_below: bool
) -> tuple[TimeRule, TimeRule | None]:
    """Where lines have their times, by a sample of texts before, after, above and below bytes.

    Where a finer time is beside a coarser one, the finer one; the coarser one comes with it if the
    finer one has no date. Times in other lines are above the bytes, or if `is_below` below them.
    """
    found = list[tuple[TimeRule, list[int]]]()
    for rule, stamps in _fitting(texts, steps, is_below=is_below):
        if rule.kind == "unread":
            return rule, None
        found.append((rule, stamps))
        if rule.where in ("above", "below") or rule.kind not in ("date", "year-less", "clock"):
            break
    if not found:
        return TimeRule(), None
    first, its = found[0]
    for rule, stamps in found[1:]:
        apart = [(one - other) % _DAY_NS for one, other in zip(its, stamps, strict=False)]
        apart = [one - apart[0] for one in apart]
        near = [min(one % _DAY_NS, -one % _DAY_NS) for one in apart]
        is_finer = _resolution(stamps) < _resolution(its)
        if is_finer and len(its) == len(stamps) and max(near) <= 2 * _resolution(its):
            has_date = rule.kind in (first.kind, "date", "epoch")
            return rule, None if has_date else first
    return first, None


def _resolution(stamps: Iterable[int]) -> int:
    """The finest power of ten of nanoseconds that divides them all."""
    common = math.gcd(*stamps)
    return next((10**power for power in range(9, 0, -1) if common % 10**power == 0), 1)


def _fitting(
    texts: Sequence[tuple[bytes, bytes, bytes, bytes]], steps: StepUnit, *, is_below: bool
) -> Iterator[tuple[TimeRule, list[int]]]:
    """The times in texts that fit, the preferred first, with their stamps in the texts."""
    parts = {where: [text[at] for text in texts] for at, where in enumerate(("before", "after"))}
    parts["above"] = [*dict.fromkeys(text[2] for text in texts)]
    parts["below"] = [*dict.fromkeys(text[3] for text in texts)]
    sides = ("below", "above") if is_below else ("above",)
    for form, where in [*product(_FORMS, ("before", "after")), *product(_FORMS, sides)]:
        pattern = _compiled(form[-1])
        rows = [[*pattern.finditer(part)] for part in parts[where]]
        for column in range(max(map(len, rows), default=0)):
            found = [row[column] for row in rows if len(row) > column]
            rule = TimeRule(where, *form, column)
            if 2 * len(found) > len(rows) and _fits(rule, found, texts[0], steps):
                unread = where in ("above", "below") and rule.kind in ("epoch", "since")
                spans = (
                    {name: one.span(name) for name, own in one.groupdict().items() if own}
                    for one in found
                )
                stamps = (
                    rule.stamp(one.string, own) for one, own in zip(found, spans, strict=True)
                )
                yield TimeRule(kind="unread") if unread else rule, [one or 0 for one in stamps]


def _fits(
    rule: TimeRule,
    found: Sequence[re.Match[bytes]],
    text: Sequence[bytes],
    unit_of: StepUnit,
) -> bool:
    """Whether what is found are times: numbers rise, and their unit is known."""
    if "date" in found[0].groupdict():
        rule.is_local = 2 * sum(one["zone"] is None for one in found) >= len(found)
        if _APART in rule.pattern and not _are_milliseconds(found):
            return False
        return rule.where not in ("above", "below") or len(found) > 1
    times = [float(b"%b.%b" % (one["n"], one["f"] or b"0")) for one in found]
    steps = sorted(later - earlier for earlier, later in pairwise(times)) or [0]
    rises = steps[len(steps) // 50] >= 0
    digits = max(len(one["f"] or b"") for one in found)
    unit = _unit(text, rule.where, found[0].start())
    counts = not (unit or rule.scale or digits)
    rule.samplerate = unit_of.samplerate if counts else None
    unit = unit or rule.scale or unit_of.unit(steps, whole=not digits)
    if rule.kind == "epoch":
        is_slow = not digits and len(steps) > 2 and steps[len(steps) // 2] > _LONGEST_STEP
        changes = unit in (0, rule.scale) and not (is_slow and rule.scale == SECOND)
    else:
        changes = len(set(times)) > 2 or (len(times) < 3 and rule.where not in ("above", "below"))
    rule.scale = rule.scale or unit
    rule.resolution_ns = max(1, rule.scale // 10**digits)
    return rule.scale > 0 and rises and changes


def _are_milliseconds(found: Sequence[re.Match[bytes]]) -> bool:
    """Whether numbers after clocks rise within a second, and start again in the next."""
    rows = [tuple(int(one[name]) for name in ("h", "mi", "s", "f")) for one in found]
    pairs = [*pairwise(rows)]
    rises = 50 * sum(later < earlier for earlier, later in pairs) <= len(pairs)
    counts = all(later[3] - earlier[3] in (0, 1) for earlier, later in pairs)
    return rises and not counts


def _unit(text: Sequence[bytes], where: str, start: int) -> int:
    """Nanoseconds of one, by the heading of the column of times that begins there; 0 without."""
    before, after, above, _ = (one.translate(bytes.maketrans(b";\t", b",,")) for one in text)
    columns = "^" + r"[^,\n]*," * before[:start].count(b",") + _HEADING
    if where == "after":
        columns = _HEADING + r",[^,\n]*" * after[start:].count(b",") + "$"
    found = re.findall(f"(?im){columns}", above.decode("utf-8", "replace"))
    return _UNITS[found[-1].lower()] if found else 0


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(self, rule: TimeRule, options: LogOptions, count: Callable[..., None]) -> None:
        """A clock; `count` gets what lines do, the first, an example, and how many they are."""
        self._rule, self._options, self._count = rule, options, count
        self._base_ns, self._last, self._last_ns = 0, NO_TIME, 0
        self.notes: list[str] = []
        """What the times lack, and where that comes from."""

    def settle(
        self,
        stamps: Sequence[int],
        name: str,
        written_ns: int | None,
        coarse: TimeRule | None = None,
        later: Sequence[int] = (),
    ) -> None:
        """Decide what the times count from: by options, the file's name, or when it was written.

        Stamps are those of a sample, with the first and last of the log; a pipe was never written.
        If `coarse` times are beside them, which are `later` by some nanoseconds, by these.
        """
        rule, options, self._last = self._rule, self._options, stamps[0]
        shown = rule if coarse is None or not later else coarse
        if shown.is_local and options.zone is None:
            self.notes.append(f"its times {_LACKING['zone']}")
        if shown.kind in _LACKING:
            self._base_ns = self._dated(shown, stamps, name, written_ns)
        if shown is not rule:
            base_ns = self._base_ns + max(later)  # the coarse times are cut off
            if rule.kind == "clock":
                base_ns = round(base_ns / _DAY_NS) * _DAY_NS
            elif shown.is_local and options.zone is not None:
                import numpy as np

                base_ns = int(_utc_ns(np.array([base_ns]), options.zone)[0])
            self._base_ns = base_ns

    def _dated(
        self, rule: TimeRule, stamps: Sequence[int], name: str, written_ns: int | None
    ) -> int:
        """What the stamps of a rule without a date count from, with a note."""
        kind, options = rule.kind, self._options
        since, day = kind == "since", options.day
        midnights = sum(later < earlier - _DAY_NS // 2 for earlier, later in pairwise(stamps))
        passed = max(stamps) if since else midnights * _DAY_NS
        bases = {
            "": options.start_ns if since else _midnight_ns(day) if day else None,
            "the file's name": time_in_name(name, options.zone or UTC if since else None),
            f"the file's modification time{' minus the last time' * since}": (
                written_ns and written_ns - passed
            ),
            "the time of the first read": time_ns(),
        }
        source, base_ns = next((source, base) for source, base in bases.items() if base is not None)
        begin = datetime.fromtimestamp(base_ns // SECOND, UTC)
        rule.year = begin.year
        if source:
            self.notes.append(f"its times {_LACKING[kind].format(begin, source)}")
        return {"since": base_ns, "clock": _midnight_ns(begin.date())}.get(kind, 0)

    def shown(self, stamp: int) -> str:
        """The time of one of the first lines."""
        import numpy as np

        t_ns = np.array([self._base_ns + stamp])
        if self._rule.is_local and self._options.zone is not None:
            t_ns = _utc_ns(t_ns, self._options.zone)
        return f"{np.datetime_as_string(t_ns.astype('datetime64[ns]'))[0]}Z"

    def times(self, ns: Array, lines: Array) -> Array:
        """The times of consecutive lines, by their stamps; without one, that before."""
        import numpy as np

        missing = ns == NO_TIME
        if missing.any():
            alone = missing & (self._rule.where not in ("above", "below"))
            self._report("lack a time; that of the line before is taken", alone, lines)
            numbers, size = np.arange(1, len(ns) + 1) * ~missing, len(ns)
            last = np.maximum.accumulate(numbers)
            if self._rule.where == "below":  # that of the next, if there is one
                following = np.where(missing, size + 1, numbers)[::-1]
                following = np.minimum.accumulate(following)[::-1]
                last = np.where(following > size, last, following)
            ns = np.append(self._last, ns)[last]
        finer = ~missing & (ns % self._rule.resolution_ns != 0)
        self._report("show a finer time than the first lines", finer, lines)
        t_ns = ns + self._base_ns
        if self._rule.kind == "clock":
            t_ns += _DAY_NS * np.cumsum(np.append(self._last, ns[:-1]) - _DAY_NS // 2 > ns)
        self._last, self._base_ns = int(ns[-1]), int(t_ns[-1] - ns[-1])
        if self._rule.is_local and self._options.zone is not None:
            t_ns = _utc_ns(t_ns, self._options.zone)
        before = np.append(self._last_ns, t_ns[:-1])
        fall_s = f"{(before - t_ns)[(t_ns < before).argmax()] / SECOND:,.9g} s"
        self._report("step back in time", t_ns < before, lines, fall_s)
        self._last_ns = int(t_ns[-1])
        return np.maximum(t_ns, 0)

    def _report(self, what: str, which: Any, lines: Array, example: str = "") -> None:
        if which.any():
            self._count(what, int(lines[which.argmax()]), example, int(which.sum()))


def _utc_ns(local_ns: Array, zone: tzinfo) -> Array:
    """Local times in UTC; zones change at quarters of an hour."""
    import numpy as np

    quarters, each = np.unique(local_ns // (_QUARTER_S * SECOND), return_inverse=True)
    starts = (datetime.fromtimestamp(one * _QUARTER_S, UTC) for one in quarters.tolist())
    starts_s = np.array([one.replace(tzinfo=zone).timestamp() for one in starts], np.int64)
    return starts_s[each] * SECOND + local_ns % (_QUARTER_S * SECOND)


def time_in_name(name: str, zone: tzinfo | None) -> int | None:
    """The time in a file name, or without a zone the date; nanoseconds since 1970, or None."""
    for day, clock in re.findall(_IN_NAME, Path(name).name):
        digits = re.sub(r"\D", "", day + clock if zone else day).ljust(14, "0")
        with suppress(ValueError):
            if clock or not zone:
                when = datetime.strptime(digits, "%Y%m%d%H%M%S").replace(tzinfo=zone or UTC)
                return int(when.timestamp()) * SECOND
    return None
