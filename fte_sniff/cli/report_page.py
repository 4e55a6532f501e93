"""The page of a report: the texts of `findings` and `stats`, and plots by Bokeh, in one HTML file.

    rows ──► least and greatest of each value in at most 2,000 windows of time ──► curves, bands

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
from bokeh.models import Range1d, Spacer
from bokeh.plotting import figure
from bokeh.resources import INLINE
from bokeh.themes import Theme

from fte_sniff.analysis.dataframe import table_frame
from fte_sniff.analysis.segments import Counts, added
from fte_sniff.analysis.table import MOTOR, QUANTITIES, Table
from fte_sniff.errors import printable
from fte_sniff.formats.looks import LOOKS
from fte_sniff.i18n import _
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.spec import FIELD_BY_NAME, MOTORS, VALUE_FIELDS, Direction, Fault, status_of

MOST_WINDOWS: Final = 2000
_SHORTEST: Final = 20
"""The shortest window has 2 to this power of nanoseconds, about a millisecond."""

_FLAGS: Final = tuple(field.name for field in VALUE_FIELDS if field.legal_bits is not None)
_VALUES: Final = (*QUANTITIES, *_FLAGS)
_COLOURS: Final = {Direction.CONTROL: "#d9822b", Direction.FEEDBACK: "#3a7bd5"}
_FLAG, _QUIET = "#d03b3b", "#8a8f98"

_PARTS: Final = ("major_label_text", "axis_line", "major_tick_line", "minor_tick_line")
_LEGEND: Final = {"background_fill_alpha": 0, "label_text_color": _QUIET, "click_policy": "hide"}
_STYLES: Final = {
    "Plot": {"background_fill_alpha": 0, "border_fill_alpha": 0, "outline_line_color": None},
    "Title": {"text_color": _QUIET},
    "Axis": {f"{part}_color": _QUIET for part in _PARTS},
    "Grid": {"grid_line_color": _QUIET, "grid_line_alpha": 0.3},
    "Legend": _LEGEND,
}
"""Of Bokeh's models: legible on light and dark backgrounds."""

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


def counted(table: Table) -> Counts:
    """What the plots show of a table: values and faults by window, and when gaps begin.

    Rows without a time have no place in a plot.
    """
    at = table.counted[table.rows.timed[table.counted]]
    rows, number = table.rows.select(at), table.runs["number"][at]
    frame = table_frame(rows, ["direction", MOTOR, "faults", *_VALUES]).with_columns(
        window=pl.Series(rows.t_ns >> _SHORTEST << _SHORTEST)
    )
    faults = frame.select("window", fault="faults").explode("fault").drop_nulls()
    breaks = rows.t_ns[:-1][np.diff(number) != 0]
    return {
        "plot values": frame.group_by("window", "direction", MOTOR).agg(
            *(pl.col(name).min().alias(f"least {name}") for name in _VALUES),
            *(pl.col(name).max().alias(f"greatest {name}") for name in _VALUES),
        ),
        "plot faults": faults.group_by("window", "fault").agg(
            pl.len().cast(pl.Int64).alias("sum rows")
        ),
        "plot breaks": pl.DataFrame({"break": breaks}, {"break": pl.Int64}),
    }


def in_few(frame: pl.DataFrame) -> pl.DataFrame:
    """Counts by window in at most `MOST_WINDOWS` of them, by time."""
    t_ns = frame["window"].to_numpy()
    bits = int(np.ptp(t_ns) // MOST_WINDOWS).bit_length() if len(t_ns) else 0
    longer = frame.with_columns(pl.col("window") // (1 << bits) * (1 << bits))
    return added([longer]).sort("window")


def page(title: str, texts: Mapping[str, str], counts: Counts) -> str:
    """The HTML of the report; `texts` are what is shown above the plots, by heading."""
    return file_html(
        column(*_plots(counts), Spacer(), sizing_mode="stretch_width"),
        INLINE,
        title,
        theme=Theme(json={"attrs": _STYLES}),
        template=_TEMPLATE,
        template_variables={
            "heading": title,
            "texts": {_(name): text for name, text in texts.items()},
        },
    )


def _plots(counts: Counts) -> Iterator[Any]:
    values, faults = in_few(counts["plot values"]), in_few(counts["plot faults"])
    if not len(values):
        return
    shared = Range1d(*(values["window"].to_numpy()[[0, -1]] / 1e6).tolist())
    breaks = (counts["plot breaks"]["break"] / 1e6).to_list()
    if len(faults):
        yield _fault_plot(faults, shared)
    for motor in (*MOTORS, None):
        own = values.filter(pl.col(MOTOR).eq_missing(motor))
        for name in QUANTITIES:
            if own[f"least {name}"].count():
                yield _value_plot(own, motor, name, shared, breaks)


def _figure(title: str, height: int, shared: Range1d, **options: Any) -> Any:
    return figure(
        title=title,
        x_axis_type="datetime",
        x_range=shared,
        height=height,
        sizing_mode="stretch_width",
        tools="xbox_zoom,xpan,xwheel_zoom,reset",
        active_drag="xbox_zoom",
        **options,
    )


def _fault_plot(faults: pl.DataFrame, shared: Range1d) -> Any:
    words = [str(fault) for fault in Fault if str(fault) in faults["fault"]]
    shown = [(_("rows"), "@rows{0,0}"), (_("time"), "@time")]
    height = 90 + 24 * len(words)
    made = _figure(_("Faults"), height, shared, y_range=words[::-1], tooltips=shown)
    data = {
        "x": (faults["window"] / 1e6).to_list(),
        "y": faults["fault"].to_list(),
        "rows": faults["sum rows"].to_list(),
        "time": [iso_time(window)[11:19] for window in faults["window"]],
        "colour": [LOOKS[status_of((Fault(word),))].plot for word in faults["fault"]],
    }
    made.scatter("x", "y", size=8, marker="square", color="colour", source=data)
    return made


def _value_plot(
    own: pl.DataFrame, motor: int | None, name: str, shared: Range1d, breaks: Sequence[float]
) -> Any:
    """The target and the present value of a motor, or of the chassis, over time."""
    subject = _("Chassis commands") if motor is None else _("motor {motor}", motor=motor)
    made = _figure(f"{subject}: {name} [{FIELD_BY_NAME[name].unit}]", 230, shared)
    for direction, colour in _COLOURS.items():
        part = own.filter(pl.col("direction") == str(direction)).drop_nulls(f"least {name}")
        x = (part["window"] / 1e6).to_list()
        low, high = part[f"least {name}"].to_list(), part[f"greatest {name}"].to_list()
        if x:
            made.varea(x, low, high, color=colour, alpha=0.35)
            made.step(x, high, mode="after", color=colour, legend_label=str(direction))
    top = own[f"greatest {name}"].max()
    for flag in _FLAGS:
        usual = FIELD_BY_NAME[flag].default
        ends = (pl.col(f"{end} {flag}") != usual for end in ("least", "greatest"))
        if len(wrong := own.filter(pl.any_horizontal(ends))):
            x = (wrong["window"] / 1e6).to_list()
            made.scatter(x, top, marker="inverted_triangle", color=_FLAG, legend_label=flag)
    if breaks:
        made.vspan(x=breaks, color=_QUIET, line_dash="dashed")
    return made


def title_of(names: Sequence[str]) -> str:
    """The title of the page: the input's name, or how many there are."""
    if len(names) == 1:
        return printable(names[0])
    return _("{count:,} files", count=len(names))
