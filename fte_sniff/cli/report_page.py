"""The page of a report: plots by Bokeh, tables, and their data in one HTML file.

The page has the columns of a `Timeline`, deflated. Its script (`report_page.js`) unpacks them with
`DecompressionStream` and draws for every pixel the minimum and maximum of the visible range. All
texts from files reach the page through Jinja's escaping, or as text nodes that the script makes.
"""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from bokeh.document import Document
from bokeh.embed import components
from bokeh.models import (
    BasicTicker,
    BoxZoomTool,
    ColumnDataSource,
    DataRange1d,
    DatetimeTicker,
    DatetimeTickFormatter,
    HoverTool,
    NoOverlap,
    NumeralTickFormatter,
    Range1d,
    TapTool,
    WheelZoomTool,
)
from bokeh.plotting import figure
from bokeh.resources import Resources
from jinja2 import Environment

from fte_sniff import __version__
from fte_sniff.analysis.plots import ALL_MOTORS, MOST_DAMAGED, Points, Timeline, Trace
from fte_sniff.analysis.time_text import time_ns
from fte_sniff.errors import printable
from fte_sniff.formats.cell_text import UNKNOWN, rate_text, share_text, span_text
from fte_sniff.i18n import _
from fte_sniff.protocol import (
    MOTORS,
    Direction,
    Fault,
    faults_text,
    iso_time,
    spaced_hex,
    status_of,
    zone_at,
)
from fte_sniff.protocol.columns import LOOKS, Ground
from fte_sniff.protocol.spec import FIELD_BY_NAME, online_bit_text

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Finding
    from fte_sniff.protocol import Gap, Row
    from fte_sniff.protocol.rows import Ints

Json = dict[str, Any]
Intervals = Sequence[Sequence[float]]

FIRST_ROWS: Final = 5
"""Rows of each fault in the table of damage."""

_LONGEST_SHOWN: Final = 32
"""Bytes of a row that the page has."""

# Curves, motors and bands have no status, so their colours do not follow LOOKS.
_CURVES: Final = ("#3a7bd5", "#d9822b", "#3c9d5b", "#d03b3b")
_ACTUAL, _TARGET = _CURVES[:2]
_ERROR, _OFF = "#d03b3b", "#8a8f98"


@dataclass(frozen=True, slots=True)
class ReportFacts:
    """The texts of the page besides the statistics."""

    title: str
    gaps: Sequence[Gap]
    facts: Mapping[str, str]
    notes: Sequence[str]
    """What is wrong with the inputs, one line each."""
    delays_ns: Mapping[int, Sequence[tuple[float, float, int]]]
    """By motor, the histogram of its answer delays: from, to, and how many."""
    language: str = "en"
    findings: Sequence[Finding] = ()
    """What is wrong, best first."""
    zone: tzinfo = UTC
    """Zone of the times; the page has one offset, which is that at its first row."""

    version = __version__

    @property
    def made(self) -> str:
        """The time at which the page is made, UTC."""
        return f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S}"


def page(timeline: Timeline, numbers: Json, facts: ReportFacts) -> str:
    """The HTML of the report; `numbers` are those that `stats --format json` prints."""
    zone = zone_at(timeline.first_ns or 0, facts.zone)
    gaps = [
        [_axis_ms(gap.start_ns, zone), _axis_ms(gap.end_ns, zone)]
        for gap in facts.gaps
        if gap.start_ns is not None and gap.end_ns is not None
    ]
    plots = _Plots(timeline, gaps, zone)
    delays = _delay_plot(facts.delays_ns)
    parts = [*plots.figures.values(), *([delays] if delays else [])]
    document = Document()
    with document.models.freeze():  # else each plot collects the models of all plots again
        for part in parts:
            document.add_root(part)
    script, divs = components(tuple(parts)) if parts else ("", ())
    resources = Resources(mode="inline", components=["bokeh"])
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    environment.filters.update(
        span=lambda seconds: span_text(None if seconds is None else seconds * 1e9),
        rate=rate_text,
        share=share_text,
        printable=printable,
        translated=_,
        count=lambda number: UNKNOWN if number is None else f"{number:,}",
        at=lambda t_ns: _moment(t_ns, zone)[:19],
        moment=lambda time: _moment(None if time is None else time_ns(time), zone),
        axis_ms=lambda t_ns: _axis_ms(t_ns, zone),
    )
    own = files("fte_sniff.cli")
    return environment.from_string((own / "report_page.html").read_text("utf-8")).render(
        t=_capitalized,
        numbers=numbers,
        facts=facts,
        zone="" if zone == UTC else iso_time(0, zone)[-len("+08:00") :],
        gaps=[(_moment(gap.start_ns, zone), _moment(gap.end_ns, zone), gap) for gap in facts.gaps],
        notes=[*facts.notes, *_notes(timeline)],
        damage=_first_of_each(timeline, zone),
        plots={one.name: (one.tags[0], div) for one, div in zip(parts, divs, strict=True)},
        library=resources.render_js() if parts else "",
        style=_status_colours() + (own / "report_page.css").read_text("utf-8"),
        script=(own / "report_page.js").read_text("utf-8"),
        models=script,
        data=_packed(timeline, plots.meta, gaps, zone) if plots.figures else "",
    )


def _status_colours() -> str:
    """Colours of the statuses as CSS variables, by their names."""
    of_ground = {
        ground: "".join(
            f"--{status}: {look.inks[ground].text}; " for status, look in LOOKS.items() if look.inks
        )
        for ground in (Ground.LIGHT, Ground.DARK)
    }
    return (
        f":root {{ {of_ground[Ground.LIGHT]}}}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {of_ground[Ground.DARK]}}} }}\n"
    )


def _capitalized(text: str) -> str:
    """The translation of a heading or a note of the template, in which `t` marks them."""
    shown = _(text)
    return shown[:1].upper() + shown[1:]


def _notes(timeline: Timeline) -> Iterator[str]:
    if timeline.thinned:
        yield _("the plots show the minimum and maximum of bins of time, not every row")
    if any(len(series.points()[0]) >= MOST_DAMAGED for series in timeline.faults.values()):
        yield _("the page has the bytes of the first rows of each fault only")


def _moment(t_ns: int | None, zone: timezone, digits: int = 3) -> str:
    """Date and time in a zone: `2026-01-31 12:00:00.000`."""
    if t_ns is None:
        return UNKNOWN
    return iso_time(t_ns, zone).replace("T", " ")[: len("2026-01-31 12:00:00.") + digits]


def _axis_ms(t_ns: int, zone: timezone) -> float:
    """Place on the axis of time, whose labels are the local time at this place."""
    return t_ns / 1e6 + zone.utcoffset(None) / timedelta(milliseconds=1)


def _row_cells(row: Row, zone: timezone) -> list[str]:
    raw = spaced_hex(row.raw[:_LONGEST_SHOWN])
    more = len(row.raw) - _LONGEST_SHOWN
    return [
        _moment(row.t_ns, zone, 6),
        printable(row.port),
        f"{row.offset:,}",
        faults_text(row.faults).replace(",", ", "),
        f"{raw} … +{more:,}" if more > 0 else raw,
    ]


def _first_of_each(timeline: Timeline, zone: timezone) -> list[tuple[Fault, list[list[str]]]]:
    found = []
    for fault in Fault:
        rows = [row for row in timeline.damaged if fault in row.faults]
        rows.sort(key=lambda row: row.t_ns or 0)
        if rows:
            found.append((fault, [_row_cells(row, zone) for row in rows[:FIRST_ROWS]]))
    return found


class _Plots:
    """The figures, whose sources the script fills, and what it needs to know of them."""

    def __init__(self, timeline: Timeline, gaps: Intervals, zone: timezone) -> None:
        self._gaps = gaps
        self.figures: dict[str, Any] = {}
        self.meta: list[Json] = []
        self._numbers = {trace: number for number, trace in enumerate(timeline.traces)}
        self._timeline = timeline
        if timeline.first_ns is None or timeline.last_ns is None:
            return
        first, last = (_axis_ms(t_ns, zone) for t_ns in (timeline.first_ns, timeline.last_ns))
        pad = max(1.0, (last - first) * 0.01)
        ends = (first - pad, last + pad)
        self._range = Range1d(
            start=ends[0], end=ends[1], bounds=ends, min_interval=0.05, name="time"
        )
        if timeline.faults:
            self._add_faults()
        for motor in MOTORS:
            for name in dict.fromkeys(
                trace.field for trace in timeline.traces if trace.motor == motor
            ):
                self._add_motor(motor, name)
        self._add_chassis()

    def _figure(self, name: str, title: str, height: int, **options: Any) -> Any:
        made = figure(
            x_axis_type="datetime",
            x_range=self._range,
            height=height,
            sizing_mode="stretch_width",
            name=name,
            tags=[title],
            tools=[BoxZoomTool(dimensions="width")],
            toolbar_location=None,
            min_border_left=115,
            **options,
        )
        wheel = WheelZoomTool(dimensions="width", modifiers="ctrl")
        made.add_tools(wheel)
        made.toolbar.active_scroll = wheel
        made.xaxis.major_label_policy = NoOverlap()
        made.xaxis.ticker = DatetimeTicker(desired_num_ticks=5)
        made.xaxis.formatter = DatetimeTickFormatter(
            microseconds="%H:%M:%S.%f", milliseconds="%H:%M:%S.%3N", seconds="%H:%M:%S",
            minsec="%H:%M:%S", minutes="%H:%M", hourmin="%H:%M",
        )  # fmt: skip
        made.extra_y_ranges = {"share": Range1d(start=0, end=1)}
        if self._gaps:
            self._bands(made, f"{name}-gap", _OFF, _("rows are missing"))
        self.figures[name] = made
        return made

    def _bands(self, made: Any, name: str, colour: str, label: str, **options: Any) -> None:
        made.quad(
            left="left", right="right", bottom=0, top=1, y_range_name="share", source=_empty(name,
            "left", "right"), fill_color=colour, fill_alpha=0.2, line_color=colour, line_alpha=0.4,
            name=label, **options,
        )  # fmt: skip

    def _add_faults(self) -> None:
        words = [str(fault) for fault in Fault if fault in self._timeline.faults]
        made = self._figure(
            "faults",
            _("Faults"),
            90 + 22 * len(words),
            y_range=Range1d(start=len(words) - 0.5, end=-0.5),
        )
        made.yaxis.ticker = list(range(len(words)))
        made.yaxis.major_label_overrides = dict(enumerate(words))
        made.ygrid.visible = False
        made.add_tools(TapTool())
        made.scatter(
            "x", "y", size="size", marker="square", fill_color="colour", line_color=None,
            fill_alpha=0.8,
            source=_empty("faults-rows", "x", "y", "size", "colour", "first", "last"),
        )  # fmt: skip
        self.meta.append({
            "name": "faults",
            "colours": [LOOKS[status_of((Fault(word),))].plot for word in words],
        })  # fmt: skip

    def _add_motor(self, motor: int, name: str) -> None:
        field = FIELD_BY_NAME.get(name)
        if field is None:
            return
        traces = [one for one in self._timeline.traces if one.motor in (motor, ALL_MOTORS)]
        commands = [one for one in traces if one.kind.direction is Direction.CONTROL]
        plot = f"{name}-{motor}"
        unit = "" if field.unit.lower() == name else f" [{field.unit}]"
        title = _("Motor {motor}: {name}").format(motor=motor, name=f"{name}{unit}")
        made = self._figure(plot, title, 230, y_range=Range1d(start=0, end=1))
        if self._timeline.errors[motor].points()[1].any():
            self._bands(made, f"{plot}-error", _ERROR, "ERROR")
        if not self._timeline.online[motor].points()[1].all():
            label = _("{bit} is 0", bit=_(online_bit_text(motor)))
            self._bands(made, f"{plot}-offline", _OFF, label, hatch_pattern="/")
        self._line(made, f"{plot}-target", _TARGET, _("target"), holds=True)
        actual = self._line(made, f"{plot}-actual", _ACTUAL, _("actual"), holds=False)
        made.scatter(
            "x", 0.02, size=6, marker="triangle", source=_empty(f"{plot}-commands", "x"),
            fill_color=_TARGET, line_color=None, y_range_name="share",
            name=_("commands"),
        )  # fmt: skip
        self._finish(made, plot, actual)
        targets = [one for one in commands if one.field == name]
        others = [one for one in commands if one.field != name]
        feedback = [one for one in traces if one not in commands and one.field == name]
        self.meta.append({
            "name": plot,
            "number": motor,
            "target": self._numbered(targets),
            "others": self._numbered(others),
            "actual": self._numbered(feedback),
            "limits": self._timeline.limits(feedback, targets, others),
        })  # fmt: skip

    def _line(self, made: Any, source: str, colour: str, label: str, *, holds: bool) -> list[Any]:
        """A line, with dots where it is too short to be seen."""
        options = {"source": _empty(source, "x", "y"), "line_width": 1.5, "line_color": colour}
        line = (
            made.step("x", "y", mode="after", name=label, **options)
            if holds
            else made.line("x", "y", name=label, **options)
        )
        dots = made.scatter(
            "x", "y", size=5, source=_empty(f"{source}-dots", "x", "y"), color=colour
        )
        line.js_link("visible", dots, "visible")
        return [line, dots]

    def _add_chassis(self) -> None:
        traces = [one for one in self._timeline.traces if one.motor == ALL_MOTORS and one.field]
        if not traces:
            return
        made = self._figure("chassis", _("Chassis commands"), 230, y_range=Range1d(start=0, end=1))
        for trace, colour in zip(traces, _CURVES, strict=False):
            field = FIELD_BY_NAME[trace.field]
            label = f"{field.option} [{field.unit}]"
            self._line(made, f"chassis-{trace.field}", colour, label, holds=True)
        self._finish(made, "chassis", [])
        others = [
            one
            for one in self._timeline.traces
            if one.kind.direction is Direction.CONTROL and one not in traces
        ]
        found = [self._timeline.limits([], [one], others) for one in traces]
        limits = [each for each in found if each is not None]
        self.meta.append({
            "name": "chassis",
            "lines": {one.field: self._numbers[one] for one in traces},
            "others": self._numbered(others),
            "limits": [min(low for low, _high in limits), max(high for _low, high in limits)],
        })  # fmt: skip

    def _finish(self, made: Any, plot: str, hovered: Sequence[Any]) -> None:
        made.yaxis.ticker = BasicTicker(min_interval=1, num_minor_ticks=0)
        made.yaxis.formatter = NumeralTickFormatter(format="0,0")
        outliers = made.scatter(
            "x", "y", size=9, marker="marker", fill_color="colour", line_color=None,
            source=_empty(f"{plot}-outliers", "x", "y", "marker", "colour", "value"),
            y_range_name="share", name=_("outliers"),
        )  # fmt: skip
        for renderers, value in ((list(hovered), "@y"), ([outliers], "@value")):
            made.add_tools(
                HoverTool(
                    renderers=renderers,
                    tooltips=[("", f"@x{{%H:%M:%S.%3N}}  {value}{{0,0}}")],
                    formatters={"@x": "datetime"},
                )
            )

    def _numbered(self, traces: Iterable[Trace]) -> list[int]:
        return [self._numbers[trace] for trace in traces]


def _empty(name: str, *columns: str) -> ColumnDataSource:
    return ColumnDataSource({column: [] for column in columns}, name=name)


def _delay_plot(delays: Mapping[int, Sequence[tuple[float, float, int]]]) -> Any:
    """Answer delays, with the motors stacked; None without any."""
    every = [bar for bars in delays.values() for bar in bars]
    if not every:
        return None
    ends = min(low for low, _high, _count in every), max(high for _low, high, _count in every)
    made = figure(
        height=230, sizing_mode="stretch_width", toolbar_location=None, tools="",
        name="delays", tags=[_("Answer delays [ms]")], x_axis_type="log", y_axis_label=_("answers"),
        min_border_left=115, x_range=Range1d(start=ends[0] / 1.05e6, end=ends[1] * 1.05e-6),
        y_range=DataRange1d(start=0),
    )  # fmt: skip
    made.xaxis.major_label_policy = NoOverlap()
    made.yaxis.ticker = BasicTicker(min_interval=1, num_minor_ticks=0)
    tops: Counter[float] = Counter()
    for motor, bars in delays.items():
        bottoms = [tops[low] for low, _high, _count in bars]
        tops.update({low: count for low, _high, count in bars})
        made.quad(
            left=[low / 1e6 for low, _high, _count in bars],
            right=[high / 1e6 for _low, high, _count in bars],
            bottom=bottoms,
            top=[tops[low] for low, _high, _count in bars],
            fill_color=_CURVES[motor - 1],
            fill_alpha=0.6,
            line_color=None,
            name=_("motor {motor}").format(motor=motor),
        )
    return made


def _packed(timeline: Timeline, plots: Sequence[Json], gaps: Intervals, zone: timezone) -> str:
    """The data of the plots: the length of a JSON text, the text, and the columns; in base64.

    Times are in units since the first one, so that 32 bits hold them. Each column has the
    differences of its numbers, first all lowest bytes, then the next, which deflate best.
    """
    first, last = timeline.first_ns or 0, timeline.last_ns or 0
    unit = max(1000, (last - first) // (2**32 - 1) + 1)
    columns: list[bytes] = []
    sizes: list[int] = []

    def append(series: Points) -> None:
        t_ns, values = series.points()
        sizes.append(len(t_ns))
        columns.extend((_column((t_ns - first) // unit), _column(values)))

    words = [fault for fault in Fault if fault in timeline.faults]
    for series in (
        *timeline.traces.values(),
        *(timeline.errors[motor] for motor in MOTORS),
        *(timeline.online[motor] for motor in MOTORS),
        *(timeline.faults[fault] for fault in words),
    ):
        append(series)
    meta = {
        "first": _axis_ms(first, zone),
        "last": _axis_ms(last, zone),
        "unit": unit / 1e6,
        "sizes": sizes,
        "plots": plots,
        "traces": len(timeline.traces),
        "gaps": gaps,
        "breaks": [_axis_ms(t_ns, zone) for t_ns in timeline.breaks],
        "damaged": [_row_cells(row, zone) for row in timeline.damaged],
    }
    text = json.dumps(meta, separators=(",", ":")).encode()
    packed = zlib.compress(len(text).to_bytes(4, "little") + text + b"".join(columns), 9)
    return b64encode(packed).decode()


def _column(numbers: Ints) -> bytes:
    differences = np.diff(numbers, prepend=0).astype(np.uint32)
    return np.ascontiguousarray(differences.view(np.uint8).reshape(-1, 4).T).tobytes()


def title_of(names: Sequence[str]) -> str:
    """The title of the page: the input's name, or how many there are."""
    if len(names) == 1:
        return printable(names[0])
    return _("{count:,} files").format(count=len(names))
