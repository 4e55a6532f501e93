"""The layouts of other programs in samples/: each source has every topic and field."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

from fte_sniff.cli.live_data import datagram
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KINDS, MOTORS, NAME_OF_ROLE, Fault, Role, encode

LAYOUTS = Path(__file__).parents[1] / "samples" / "layouts"
FOXGLOVE: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text("utf-8"))


def foxglove_fields() -> set[tuple[str, str]]:
    """Topic and field of each message path; the field of a whole message is empty."""
    panels = FOXGLOVE["configById"].values()
    paths = [path["value"] for panel in panels for path in panel.get("paths", ())]
    whole = {(panel["topicPath"], "") for panel in panels if "topicPath" in panel}
    return whole | {(topic, field) for topic, _, field in (one.partition(".") for one in paths)}


def plotjuggler_fields() -> set[tuple[str, str]]:
    """Topic and field of each curve."""
    curves = ET.parse(LAYOUTS / "plotjuggler.xml").iter("curve")
    names = [curve.get("name", "").rpartition("/") for curve in curves]
    return {(topic, field) for topic, _, field in names}


def sent() -> dict[str, set[str]]:
    """By topic, the fields of the datagrams that a capture sends."""
    found: dict[str, set[str]] = defaultdict(set)
    entries: list[Row | PortEvent] = [PortEvent(1, "p", PortEventKind.LOST, "why")]
    entries += [Row("p", 0, b"1", 1, (Fault.NOISE,), framed=False)]
    for kind in KINDS:
        for motor in MOTORS if kind.names_motor else (0,):
            values = {field.name: field.low for field in kind.fields}
            named = NAME_OF_ROLE[Role.MOTOR]
            values |= {named: motor} if named in values else {}
            entries.append(Row("p", 0, encode(kind, values), 1))
    for entry in entries:
        inner, topic = json.loads(datagram(entry)), ""
        while "time" not in inner or not topic:
            inner.pop("timestamp", None)
            ((part, inner),) = inner.items()
            topic += f"/{part}"
        found[topic] |= {*inner}
    return found


@pytest.fixture(scope="module")
def recorded() -> dict[str, set[str]]:
    """By topic, the fields that its messages have by the schema in the file."""
    sample = LAYOUTS.parent / "damaged.mcap"
    with sample.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    found = {}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        files = FileDescriptorSet.FromString(schema.data).file
        messages = {
            f"{one.package}.{each.name}": each for one in files for each in one.message_type
        }
        found[channel.topic] = {field.name for field in messages[schema.name].field}
    return found


@pytest.mark.parametrize(
    "fields", [foxglove_fields(), plotjuggler_fields()], ids=["foxglove", "plotjuggler"]
)
def test_every_topic_and_field_is_in_a_recording(
    recorded: dict[str, set[str]], fields: set[tuple[str, str]]
) -> None:
    assert {topic for topic, _ in fields} <= set(recorded)
    for topic, field in fields - {("", "")}:
        assert not field or field in recorded[topic]


def test_every_topic_and_field_is_in_the_datagrams() -> None:
    by_topic = sent()
    for topic, field in plotjuggler_fields() - {("", "")}:
        assert field in by_topic[topic]


@pytest.mark.parametrize(
    "fields", [foxglove_fields(), plotjuggler_fields()], ids=["foxglove", "plotjuggler"]
)
def test_each_motor_has_target_and_actual_value_and_flags(fields: set[tuple[str, str]]) -> None:
    topics = {topic for topic, _ in fields}
    for motor in MOTORS:
        own = {field for topic, field in fields if topic.endswith(f"feedback/motor{motor}")}
        assert own == {
            NAME_OF_ROLE[one] for one in (Role.SPEED, Role.POSITION, Role.ERRORS, Role.ONLINE)
        }
        targets = {field for topic, field in fields if topic.endswith(f"control/motor{motor}")}
        assert targets == {NAME_OF_ROLE[one] for one in (Role.SPEED, Role.POSITION)}
    assert {"/fte/malformed", "/fte/port", "/fte/control/chassis"} <= topics


def panels_in(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels_in(layout["first"])
        yield from panels_in(layout["second"])


def test_each_panel_of_foxglove_has_a_place() -> None:
    placed = list(panels_in(FOXGLOVE["layout"]))
    assert sorted(placed) == sorted(FOXGLOVE["configById"])
