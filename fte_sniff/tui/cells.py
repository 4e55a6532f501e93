"""Values of rows as text: in short words, and in the columns of the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, timezone, tzinfo
from functools import cache, lru_cache
from typing import Final, TypeAlias

from rich.cells import cell_len

from fte_sniff.errors import ExplainedWord, printable
from fte_sniff.formats import cell_text
from fte_sniff.formats.cell_text import (
    ELLIPSIS,
    clock_text,
    elapsed_text,
    fit,
    fit_right,
    short_names,
)
from fte_sniff.i18n import _, later, translated
from fte_sniff.protocol.columns import COLUMN_BY_NAME, ColumnType, spaced_hex
from fte_sniff.protocol.items import Gap, PortEvent, PortEventKind
from fte_sniff.protocol.spec import (
    FIELD_BY_NAME,
    FRAME_LENGTH,
    VALUE_FIELDS,
    Direction,
    Field,
    FrameKind,
)

FEEDBACK = "fb"
"""Abbreviation of "feedback" where a kind's name does not fit."""


@cache
def value_heads(kind: FrameKind) -> tuple[tuple[str, ...], ...]:
    """The labels of a kind's fields, those without numbers of a unit, and the shortest."""
    names = tuple(f"{field.option}=" for field in kind.fields)
    some = tuple("" if field.unit else f"{field.option}=" for field in kind.fields)
    return names, some, tuple(name[:1].upper() for name in some)


ValuePart: TypeAlias = tuple[str, Field]
"""A value with its short name, and its field."""


def _is_telling(field: Field, value: int) -> bool:
    return field.legal_bits is None or value != field.default


def value_parts(
    kind: FrameKind, raw: bytes, width: int, shown: Callable[[Field, int], bool] = _is_telling
) -> list[ValuePart]:
    """A frame's values by their short names, `motor=1`, which fit into `width` cells with spaces.

    Only values that are `shown`; by default, flag bytes with their default value are left out. If
    the text does not fit the width, names go: `motor=1 1000`, at last `M1 1000`.
    """
    parts: list[ValuePart] = []
    values = [(field, field.read(raw)) for field in kind.fields]
    for heads in value_heads(kind):
        parts = [
            (head + _number(field, value), field)
            for head, (field, value) in zip(heads, values, strict=True)
            if shown(field, value)
        ]
        if sum(len(text) + 1 for text, _field in parts) <= width + 1:
            break
    return parts


def _number(field: Field, value: int) -> str:
    return f"{value}" if field.legal_bits is None else f"{value:02X}"


def short_kind(name: str, width: int) -> str:
    """The name of a kind in at most `width` cells; feedback keeps a mark of its direction."""
    stem = name.removesuffix(f"_{Direction.FEEDBACK}")
    if len(name) > width and stem != name:
        return f"{stem[: max(0, width - len(FEEDBACK) - 1)]} {FEEDBACK}"[: max(0, width)]
    return fit(name, width).rstrip()


def bytes_text(raw: bytes, width: int) -> str:
    """The bytes as hex; if they are too long for the width, the first bytes and the length."""
    if len(raw) <= max(FRAME_LENGTH, (width + 1) // 3):
        return spaced_hex(raw)
    count = f" {ELLIPSIS} {len(raw)} bytes"
    return spaced_hex(raw[: max(0, (width - len(count) + 1) // 3)]) + count


def span_text(ns: float | None) -> str:
    """A duration in three digits, in the language of the screen: `2.15 ms`."""
    return _(cell_text.span_text(ns))


def turns_text(pulses: int, pulses_per_turn: float) -> str:
    """A position in turns of the output shaft."""
    return _("{turns:,.3f} turns", turns=pulses / pulses_per_turn)


WITH_DETAIL: Final = later("{event}: {detail}")


def event_text(event: PortEvent, zone: tzinfo = UTC) -> str:
    """A port event on one line, with its time of day in a zone."""
    text = f"{event.port} {_(event_words(event.kind))}"
    if event.detail.startswith(event_words(event.kind)):
        text = f"{event.port} {translated(event.detail)}"
    elif event.detail:
        text = _(WITH_DETAIL, event=text, detail=translated(event.detail))
    return printable(f"{clock_text(event.t_ns, 3, zone)}  {text}")


def event_words(kind: PortEventKind) -> str:
    """A kind of event in English words."""
    return kind.replace("_", " ")


def landmark_text(what: PortEvent | Gap, zone: tzinfo = UTC) -> str:
    """A port event or a gap on one line."""
    if isinstance(what, PortEvent):
        return event_text(what, zone)
    text = _("rows are missing here")
    if what.rows:
        text = _("{count:,} rows are missing here", count=what.rows)
    if what.reason:
        text = _(WITH_DETAIL, event=text, detail=translated(what.reason))
    return printable(text)


class TimeStyle(ExplainedWord):
    """How times of rows are shown; the value is the column's head."""

    CLOCK = "time UTC", "times are the time of day, UTC"
    LOCAL = (
        "time local",
        "times are the time of day in the zone of --zone, or else of this machine",
    )
    START = "+ start", "times count from the first row"
    MARK = "+ mark", "times count from the last mark that was set"

    @property
    def is_elapsed(self) -> bool:
        """Whether times are counted from another time."""
        return self not in (TimeStyle.CLOCK, TimeStyle.LOCAL)


DELTA: Final = "delta"
"""Name of the column of the time since the row above."""


@dataclass(frozen=True, slots=True)
class TableView:
    """How the table shows rows."""

    ports: tuple[str, ...] = ()
    """Ports so far; from two on there is a column for them."""
    times: TimeStyle = TimeStyle.CLOCK
    choice: tuple[str, ...] | None = None
    """The columns from left to right, at least one; None where the width of the window decides."""
    changes: bool = False
    """Whether bytes that changed are highlighted, and the others dimmed."""
    zone: timezone = UTC
    """Offset of local times; one for the whole table, also where clocks are changed later."""

    @property
    def shown_zone(self) -> timezone:
        """Zone of the times of day."""
        return self.zone if self.times is TimeStyle.LOCAL else UTC


VALUES = "values"
"""Column of all values of a row, without space for a column each."""

VALUE_NAMES = tuple(field.name for field in VALUE_FIELDS)


_BEFORE_VALUES = ("time", DELTA, VALUES, "port", "kind")
_BEHIND_VALUES = ("raw", "faults", "offset", "length", "status", "direction", "cmd")

ORDER = tuple(dict.fromkeys((*_BEFORE_VALUES, *VALUE_NAMES, *_BEHIND_VALUES, *COLUMN_BY_NAME)))
"""All columns, the most useful first."""

SHOWN = ("time", DELTA, "port", "kind", VALUES, *_BEHIND_VALUES)
"""Columns of a table for which the user has not chosen any."""


MIN_WIDTH = 3

LONG_VALUES_WIDTH = 45
"""Cells of the longest values of a row in one column."""

_PORT_WIDTH = 12
_WIDTHS = {
    "time": len("12:00:00.000000"),
    DELTA: len("999.999 ms"),
    VALUES: LONG_VALUES_WIDTH,
    **{"offset": 10, "faults": 19, "raw": 3 * FRAME_LENGTH - 1, "answer_ms": 9},
}
"""Cells of columns whose values or words do not decide."""


@dataclass(frozen=True, slots=True, eq=False)
class TableColumn:
    """One column of the table."""

    name: str
    """Name in the row contract."""
    width: int
    number: bool
    """Whether it is aligned to the right."""
    view: TableView

    @property
    def head_cell(self) -> str:
        """The column's name, aligned as its cells."""
        head, times = _("Δt" if self.name == DELTA else self.name), self.view.times
        if self.name == "time":
            zone = str(self.view.zone).removeprefix("UTC")
            head = _("time {zone}", zone=zone) if times is TimeStyle.LOCAL else _(times)
            if cell_len(head) > self.width:  # the zone or the start of the count is more important
                head = head.rpartition(" ")[2]
        return (fit_right if self.number else fit)(head, self.width)

    def sized(self, width: int) -> TableColumn:
        """The column with another width, at least `MIN_WIDTH`."""
        return replace(self, width=max(width, MIN_WIDTH))


def column_of(name: str, view: TableView) -> TableColumn:
    """The column of that name with its full width."""
    column, field = COLUMN_BY_NAME.get(name), FIELD_BY_NAME.get(name)
    texts = [name, *(column.words if column else ())]
    if name == "port":
        texts += short_names((*map(printable, view.ports),), _PORT_WIDTH).values()
    elif field is not None and field.legal_bits is None:
        texts += [str(field.low), str(field.high)]
    width = _WIDTHS.get(name) or max(map(len, texts))
    is_number = name == DELTA or (column is not None and column.type is ColumnType.INT)
    return TableColumn(name, width, is_number, view)


@lru_cache(1 << 13)
def padded_cell(column: TableColumn, value: object) -> str:
    """A value of a column in exactly its `width` cells; blank for None."""
    if value is None:
        return " " * column.width
    text = _text_of(column.name, value, column.width, column.view)
    return (fit_right if column.number else fit)(text, column.width)


def _text_of(name: str, value: object, width: int, view: TableView) -> str:
    """The text of a value in about `width` cells."""
    field = FIELD_BY_NAME.get(name)
    if field is not None and field.legal_bits is not None:
        return f"{value:02X}"
    match name, value:
        case "time", int() if view.times.is_elapsed:
            return elapsed_text(value, width)
        case "time", int():  # without the hour where it does not fit
            clock = clock_text(value, 9, view.shown_zone)
            return clock[:width] if width >= len("12:00:00.000") else clock[3:][:width]
        case "delta", int():
            text = f"{value / 1e6:.3f} ms"
            return text if len(text) <= width else f"{value / 1e9:.3f} s"
        case "port", str():  # shortened, but still different from each other
            names = map(printable, dict.fromkeys((*view.ports, value)))
            return short_names(tuple(names), width)[printable(value)]
        case "kind", str():
            return short_kind(value, width)
        case "raw", str():
            return bytes_text(bytes.fromhex(value), width)
        case "faults", tuple():
            return ",".join(value)
    return printable(str(value))


MARK_WIDTH = 1
"""Cells of the mark in front of a row."""

RAISED_MARK = "^"
"""Sign of a row without faults whose flag bytes report a motor's error."""

WITH_DELTA = 119
"""Cells from which on there is a column of time differences."""

_SIZES: Final = (
    (96, {"time": len("12:00:00.000"), "kind": 17}, 30),
    (76, {"time": len("12:00:00.000"), "kind": 11}, 21),
    (49, {"time": len("12:00:00.000"), "kind": 8, "port": 8}, 12),
    (0, {"time": len("00:00.000"), "kind": 8, "port": 4}, 14),
)
"""By the least cells of the window: widths of columns, at most, and of the values, at least."""


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Columns of a table, with one cell between them."""

    columns: tuple[TableColumn, ...]

    @property
    def width(self) -> int:
        """Cells of the mark and all columns."""
        return MARK_WIDTH + sum(column.width + 1 for column in self.columns)

    def without(self, hidden: int) -> TableLayout:
        """The layout with `hidden` columns after the first scrolled out."""
        return TableLayout((self.columns[0], *self.columns[1 + hidden :]))

    def within(self, width: int) -> TableLayout:
        """The columns that fit into `width` cells.

        The last one is narrowed, so that its cells show that they are cut, or left out.
        """
        if self.width <= width:
            return self
        whole: list[TableColumn] = []
        left = width - MARK_WIDTH
        for column in self.columns:
            if column.width + 1 > left:
                # The faults of a row are shown at its values where their column is not whole.
                narrow = left - 1 < MIN_WIDTH or column.name == "faults"
                cut = () if narrow else (column.sized(left - 1),)
                return TableLayout((*whole, *cut))
            left -= column.width + 1
            whole.append(column)
        return self


@cache
def layout_for(width: int, view: TableView) -> TableLayout:
    """The layout of a view in a table of `width` cells."""
    names = view.choice
    if names is None:
        hidden = {"port"} if len(view.ports) < 2 else set()
        hidden |= {DELTA} if width < WITH_DELTA else set()
        names = tuple(name for name in SHOWN if name not in hidden)
    _least, most, values = next(one for one in _SIZES if width >= one[0])
    columns = [column_of(name, view) for name in names]
    columns = [one.sized(min(one.width, most.get(one.name, one.width))) for one in columns]
    if VALUES in names:  # they have the space that remains up to the bytes
        end = names.index("raw") + 1 if "raw" in names else len(names)
        layout = TableLayout(tuple(columns[:end]))
        rest = width - 1 - layout.width + LONG_VALUES_WIDTH
        at = names.index(VALUES)
        columns[at] = columns[at].sized(max(values, min(rest, LONG_VALUES_WIDTH)))
    return TableLayout(tuple(columns))
