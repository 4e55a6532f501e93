"""Layouts of Foxglove and PlotJuggler, made from the topics of a recording.

    layouts/foxglove.json       speed, position and flags of each motor, chassis, damage, events
    layouts/plotjuggler.xml     the same curves, in tabs

`samples/make.py` writes and checks them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from fte_sniff.protocol.spec import MOTORS, NAME_OF_ROLE, Direction, Role
from fte_sniff.recording.schema import EVENTS, MALFORMED, TOPICS, Topic, value_fields

_COLOURS = ("#d9822b", "#3a7bd5", "#3c9d5b", "#d03b3b")
_FLAGS = (Role.ERRORS, Role.ONLINE)


@dataclass(frozen=True, slots=True)
class Curve:
    """One number of a topic over time."""

    topic: str
    field: str
    label: str


@dataclass(frozen=True, slots=True)
class Plot:
    """Curves with one axis."""

    title: str
    curves: tuple[Curve, ...]


def _curves(field: str, topics: Sequence[Topic], labels: Sequence[str]) -> tuple[Curve, ...]:
    return tuple(
        Curve(topic.name, field, label)
        for topic, label in zip(topics, labels, strict=True)
        if field in {one.name for one in value_fields(topic)}
    )


def _topic_of(direction: Direction, motor: int) -> Topic:
    end = f"/{direction}/motor{motor}"
    return next(topic for topic in TOPICS if topic.name.endswith(end))


def motor_plots(role: Role) -> list[Plot]:
    """Target and actual value of a role, a plot for each motor."""
    field = NAME_OF_ROLE[role]
    return [
        Plot(
            f"motor {motor}: {field}",
            _curves(
                field,
                [_topic_of(one, motor) for one in (Direction.CONTROL, Direction.FEEDBACK)],
                ("target", "actual"),
            ),
        )
        for motor in MOTORS
    ]


def flag_plots() -> list[Plot]:
    """The flag bytes that the feedback of each motor has, a plot for each of them."""
    topics = [_topic_of(Direction.FEEDBACK, motor) for motor in MOTORS]
    labels = [f"motor {motor}" for motor in MOTORS]
    fields = [NAME_OF_ROLE[role] for role in _FLAGS]
    return [Plot(field, _curves(field, topics, labels)) for field in fields]


def chassis_plots() -> list[Plot]:
    """The fields of commands that name no motor, a plot for each topic."""
    motor_fields = {NAME_OF_ROLE[Role.MOTOR]}
    return [
        Plot(topic.name, tuple(Curve(topic.name, field.name, field.name) for field in fields))
        for topic in TOPICS
        if (fields := value_fields(topic)) and motor_fields.isdisjoint(one.name for one in fields)
    ]


def damage_plots() -> list[Plot]:
    """The damaged rows, by their lengths, and port events by their counts."""
    return [
        Plot("damaged rows", (Curve(MALFORMED.name, "length", "bytes"),)),
        Plot("port events", (Curve(EVENTS.name, "count", "count"),)),
    ]


def write(folder: Path) -> None:
    """Write both layouts."""
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(foxglove(), indent=2, ensure_ascii=False)
    (folder / "foxglove.json").write_text(f"{text}\n", "utf-8")
    (folder / "plotjuggler.xml").write_text(plotjuggler(), "utf-8")


# Foxglove


def foxglove() -> dict[str, Any]:
    """The layout: speeds at the left, positions beside them, flags and damage at the right."""
    panels: dict[str, Any] = {}

    def add(kind: str, name: str, config: dict[str, Any]) -> str:
        number = f"{kind}!{name}"
        panels[number] = {"foxglovePanelTitle": name, **config}
        return number

    def column(plots: Sequence[Plot]) -> Any:
        return _stacked([add("Plot", plot.title, _plot(plot)) for plot in plots], "column")

    states = [_path(curve) for plot in flag_plots() for curve in plot.curves]
    bottom = [
        add("StateTransitions", "flags", {"paths": states, "isSynced": True}),
        add("RawMessages", "damaged rows", {"topicPath": MALFORMED.name}),
        add("RawMessages", "port events", {"topicPath": EVENTS.name}),
    ]
    right = _stacked([column(chassis_plots()), *bottom], "column")
    columns = [column(motor_plots(role)) for role in (Role.SPEED, Role.POSITION)]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stacked([*columns, right], "row"),
    }


def _plot(plot: Plot) -> dict[str, Any]:
    return {
        "paths": [
            {**_path(curve), "enabled": True, "color": colour}
            for curve, colour in zip(plot.curves, _COLOURS, strict=False)
        ],
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _path(curve: Curve) -> dict[str, Any]:
    value = f"{curve.topic}.{curve.field}"
    return {"value": value, "timestampMethod": "receiveTime", "label": curve.label}


def _stacked(parts: Sequence[Any], direction: str) -> Any:
    """The parts, equally high or wide, as nested pairs."""
    first, *others = parts
    if not others:
        return first
    return {
        "direction": direction,
        "first": first,
        "second": _stacked(others, direction),
        "splitPercentage": round(100 / len(parts), 1),
    }


# PlotJuggler


def plotjuggler() -> str:
    """The layout, with a tab for speeds, positions, flags and the rest."""
    root = ET.Element("root")
    window = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for name, plots in _tabs():
        tab = ET.SubElement(window, "Tab", tab_name=name, containers="1")
        sizes = ";".join([f"{1 / len(plots):.6f}"] * len(plots))
        container = ET.SubElement(tab, "Container")
        splitter = ET.SubElement(
            container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes
        )
        for plot in plots:
            _add_plot(ET.SubElement(splitter, "DockArea", name=plot.title), plot)
    ET.SubElement(window, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.indent(root, " ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _tabs() -> Iterator[tuple[str, list[Plot]]]:
    for role in (Role.SPEED, Role.POSITION):
        yield str(role), motor_plots(role)
    yield "flags", flag_plots()
    yield "chassis and damage", [*chassis_plots(), *damage_plots()]


def _add_plot(area: ET.Element, plot: Plot) -> None:
    found = ET.SubElement(
        area, "plot", style="Lines", mode="TimeSeries", flip_x="false", flip_y="false"
    )
    ET.SubElement(found, "limitY")
    for curve, colour in zip(plot.curves, _COLOURS, strict=False):
        ET.SubElement(found, "curve", name=f"{curve.topic}/{curve.field}", color=colour)
