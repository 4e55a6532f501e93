"""The page of a report: the texts of `findings` and `stats`, and plots by Bokeh, in one HTML file.

    rows ──► Bins: least and greatest of each value in each of 2,000 bins of time ──► curves, bands

So the page is small however long the recording is, and a spike of one row is seen; `view` shows the
rows. Colours are legible on light and dark backgrounds, of which the browser chooses one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import polars as pl
from bokeh.embed import file_html
from bokeh.layouts import column
from bokeh.models import (
    BoxZoomTool,
    HoverTool,
    PanTool,
    Range1d,
    ResetTool,
    Spacer,
    WheelZoomTool,
)
from bokeh.models.annotations import Title
from bokeh.plotting import figure
from bokeh.resources import INLINE

from fte_sniff.analysis.dataframe import table_frame
from fte_sniff.analysis.table import Table
from fte_sniff.errors import printable
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _
from fte_sniff.protocol import MOTORS, Direction, Fault, status_of
from fte_sniff.protocol.spec import FIELD_BY_NAME, NAME_OF_ROLE, VALUE_FIELDS, Role

BINS: Final = 2000
_LEAST_WIDTH_NS: Final = 1_000_000
_MOST_ROWS: Final = 200_000
"""Of the frames of bins, before they are joined."""

_MOTOR: Final = NAME_OF_ROLE[Role.MOTOR]
_QUANTITIES: Final = tuple(field.name for field in VALUE_FIELDS if field.unit)
_FLAGS: Final = tuple(field.name for field in VALUE_FIELDS if field.legal_bits is not None)
_VALUES: Final = (*_QUANTITIES, *_FLAGS)
_KEYS: Final = ("bin", "direction", _MOTOR)
_COLOURS: Final = {Direction.CONTROL: "#d9822b", Direction.FEEDBACK: "#3a7bd5"}
_FLAG, _QUIET = "#d03b3b", "#8a8f98"

_TEMPLATE: Final = """
{% block postamble %}
<style>
:root { color-scheme: light dark }
body { font-family: sans-serif; margin: 1.5em; max-width: 90em }
pre { overflow-x: auto; line-height: 1.35 }
</style>
{% endblock %}
{% block contents %}
<h1>{{ heading|e }}</h1>
{% for name, text in texts.items() %}<h2>{{ name|e }}</h2>
<pre>{{ text|e }}</pre>
{% endfor %}
{{ super() }}
{% endblock %}
"""


class Bins:
    """The values and faults of rows in bins of time, whose width doubles as the time grows."""

    def __init__(self) -> None:
        self._width_ns = _LEAST_WIDTH_NS
        self._values, self._faults = list[pl.DataFrame](), list[pl.DataFrame]()
        self.breaks: list[int] = []
        """When gaps begin, nanoseconds since 1970 UTC."""

    def observe(self, table: Table) -> None:
        """Add the counted rows of a table; those without a time have no place in a plot."""
        at = table.counted[table.rows.timed[table.counted]]
        rows, number = table.rows.select(at), table.runs.number[at]
        self.breaks += rows.t_ns[:-1][np.diff(number) != 0].tolist()
        names = ["time", "direction", _MOTOR, "faults", *_VALUES]
        frame = _in_bins(table_frame(rows, names), pl.col("time").cast(pl.Int64), self._width_ns)
        self._values.append(_extremes(frame, {name: (name, name) for name in _VALUES}))
        faults = frame.select("bin", "faults").explode("faults").drop_nulls("faults")
        self._faults.append(faults.group_by("bin", "faults").len("rows"))
        if sum(map(len, self._values)) > _MOST_ROWS:
            self._values, self._faults = [self.values()], [self.faults()]

    def values(self) -> pl.DataFrame:
        """By bin, direction and motor: the least and the greatest of each value, as `rpm_low`."""
        found = self._final(self._values)
        return _extremes(found, {name: (f"{name}_low", f"{name}_high") for name in _VALUES})

    def faults(self) -> pl.DataFrame:
        """By bin and fault, the number of rows."""
        found = self._final(self._faults)
        return found.group_by("bin", "faults").agg(pl.col("rows").sum()).sort("bin")

    def _final(self, frames: Sequence[pl.DataFrame]) -> pl.DataFrame:
        """The frames in at most `BINS` bins."""
        frame = pl.concat(frames)
        first, last = frame.select(pl.col("bin").min(), pl.col("bin").max().alias("last")).row(0)
        while first is not None and last - first > BINS * self._width_ns:
            self._width_ns *= 2
        return _in_bins(frame, pl.col("bin"), self._width_ns)


def _in_bins(frame: pl.DataFrame, t_ns: pl.Expr, width_ns: int) -> pl.DataFrame:
    return frame.with_columns(bin=t_ns // width_ns * width_ns)


def _extremes(frame: pl.DataFrame, sources: Mapping[str, tuple[str, str]]) -> pl.DataFrame:
    lows = [pl.col(low).min().alias(f"{name}_low") for name, (low, _high) in sources.items()]
    highs = [pl.col(high).max().alias(f"{name}_high") for name, (_low, high) in sources.items()]
    return frame.group_by(_KEYS).agg(*lows, *highs).sort("bin")


def page(title: str, texts: Mapping[str, str], bins: Bins) -> str:
    """The HTML of the report; `texts` are what is shown above the plots, by heading."""
    return file_html(
        column(*_plots(bins), Spacer(), sizing_mode="stretch_width"),
        INLINE,
        title,
        template=_TEMPLATE,
        template_variables={
            "heading": title,
            "texts": {_(name): text for name, text in texts.items()},
        },
    )


def _plots(bins: Bins) -> Iterator[Any]:
    values = bins.values()
    if not len(values):
        return
    first, last = values["bin"].to_list()[0] / 1e6, values["bin"].to_list()[-1] / 1e6
    shared = Range1d(first, last)
    faults = bins.faults()
    if len(faults):
        yield _fault_plot(faults, shared)
    for motor in (*MOTORS, None):
        own = values.filter(pl.col(_MOTOR).eq_missing(motor))
        for name in _QUANTITIES:
            if own[f"{name}_low"].count():
                yield _value_plot(own, motor, name, shared, bins.breaks)


def _figure(title: str, height: int, shared: Range1d, **options: Any) -> Any:
    zoom = WheelZoomTool(dimensions="width")
    drag = BoxZoomTool(dimensions="width")
    heading = Title(text=title, text_color=_QUIET)
    made = figure(
        title=heading,
        x_axis_type="datetime",
        x_range=shared,
        height=height,
        sizing_mode="stretch_width",
        tools=[drag, PanTool(dimensions="width"), zoom, ResetTool()],
        active_drag=drag,
        background_fill_alpha=0,
        border_fill_alpha=0,
        **options,
    )
    for axis in (*made.xaxis, *made.yaxis):
        axis.major_label_text_color = axis.axis_line_color = axis.major_tick_line_color = _QUIET
    made.grid.grid_line_color, made.grid.grid_line_alpha = _QUIET, 0.3
    return made


def _fault_plot(faults: pl.DataFrame, shared: Range1d) -> Any:
    words = [str(fault) for fault in Fault if str(fault) in faults["faults"]]
    made = _figure(_("Faults"), 90 + 24 * len(words), shared, y_range=words[::-1])
    data = {
        "x": (faults["bin"] / 1e6).to_list(),
        "y": faults["faults"].to_list(),
        "rows": faults["rows"].to_list(),
        "colour": [LOOKS[status_of((Fault(word),))].plot for word in faults["faults"]],
    }
    made.scatter("x", "y", size=8, marker="square", color="colour", source=data)
    shown = [(_("rows"), "@rows{0,0}"), (_("time"), "@x{%H:%M:%S}")]
    made.add_tools(HoverTool(tooltips=shown, formatters={"@x": "datetime"}))
    return made


def _value_plot(
    own: pl.DataFrame, motor: int | None, name: str, shared: Range1d, breaks: Sequence[int]
) -> Any:
    """The target and the present value of a motor, or of the chassis, over time."""
    subject = _("Chassis commands") if motor is None else _("motor {motor}", motor=motor)
    made = _figure(f"{subject}: {name} [{FIELD_BY_NAME[name].unit}]", 230, shared)
    for direction, colour in _COLOURS.items():
        part = own.filter(pl.col("direction") == str(direction)).drop_nulls(f"{name}_low")
        x = (part["bin"] / 1e6).to_list()
        low, high = part[f"{name}_low"].to_list(), part[f"{name}_high"].to_list()
        if x:
            made.varea(x, low, high, color=colour, alpha=0.35)
            made.step(x, high, mode="after", color=colour, legend_label=str(direction))
    top = own[f"{name}_high"].max()
    for flag in _FLAGS:
        usual = FIELD_BY_NAME[flag].default
        wrong = own.filter((pl.col(f"{flag}_low") != usual) | (pl.col(f"{flag}_high") != usual))
        if len(wrong):
            x = (wrong["bin"] / 1e6).to_list()
            made.scatter(x, top, marker="inverted_triangle", color=_FLAG, legend_label=flag)
    if breaks:
        made.vspan(x=[t_ns / 1e6 for t_ns in breaks], color=_QUIET, line_dash="dashed")
    made.legend.background_fill_alpha = 0
    made.legend.label_text_color, made.legend.click_policy = _QUIET, "hide"
    return made


def title_of(names: Sequence[str]) -> str:
    """The title of the page: the input's name, or how many there are."""
    if len(names) == 1:
        return printable(names[0])
    return _("{count:,} files", count=len(names))
