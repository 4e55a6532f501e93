"""Owns the topics: which there are, and to which of them a row goes.

It must not know what a message looks like. Topics follow what people plot without filtering: one
for each motor and direction, one for the chassis, one for everything that is not to be believed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

from fte_sniff.protocol import KINDS, MOTORS, Frame, FrameKind, Row, Status
from fte_sniff.protocol.spec import CMD_PLACE, KIND_BY_HEADER_AND_CMD, NUM_PLACE


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording."""

    name: str
    schema: str
    """The name of its messages' schema, without the package."""
    kinds: tuple[FrameKind, ...] = ()
    """The kinds of frame that its messages hold; none for damage and events."""


MALFORMED = Topic("/fte/malformed", "Malformed", KINDS)
"""Every Damage, and every Frame that the protocol does not know."""

EVENTS = Topic("/fte/port", "PortEvent")
"""What happened to the port itself."""


def _place(kind: FrameKind) -> tuple[str, tuple[str, ...]]:
    """The schema of a kind's messages, and the last part of each topic that it may go to."""
    if kind.names_motor:
        motors = tuple(f"motor{motor}" for motor in MOTORS)
        return f"Motor{kind.direction.capitalize()}", motors
    if kind.fields:
        return "Chassis", ("chassis",)
    return kind.name.capitalize(), (kind.name,)


def _frame_topics() -> Iterator[Topic]:
    kinds_of: dict[tuple[str, str], list[FrameKind]] = {}
    for kind in KINDS:
        schema, ends = _place(kind)
        for end in ends:
            kinds_of.setdefault((schema, f"/fte/{kind.direction}/{end}"), []).append(kind)
    for (schema, name), kinds in kinds_of.items():
        yield Topic(name, schema, tuple(kinds))


TOPICS: tuple[Topic, ...] = (*_frame_topics(), MALFORMED, EVENTS)
"""Every topic of a recording."""

TOPIC_BY_NAME: Mapping[str, Topic] = MappingProxyType({topic.name: topic for topic in TOPICS})


def _topics_of_kinds() -> Iterator[tuple[tuple[str, int | None], Topic]]:
    for kind in KINDS:
        _, ends = _place(kind)
        nums = MOTORS if kind.names_motor else (None,)
        for num, end in zip(nums, ends, strict=True):
            yield (kind.name, num), TOPIC_BY_NAME[f"/fte/{kind.direction}/{end}"]


_TOPIC_BY_KIND_AND_MOTOR = MappingProxyType(dict(_topics_of_kinds()))


def topic_of(row: Row) -> Topic:
    """Where a row goes: to its kind's topic if it can be believed, else to `MALFORMED`."""
    if not isinstance(row, Frame) or (row.faults and row.status is Status.MALFORMED):
        return MALFORMED
    return _topic_of_head(row.raw[: NUM_PLACE + 1])


@lru_cache(maxsize=1024)
def _topic_of_head(head: bytes) -> Topic:
    """Where frames go whose kind is not in doubt, by their bytes up to NUM."""
    kind = KIND_BY_HEADER_AND_CMD.get((head[0], head[CMD_PLACE]))
    if kind is None:
        return MALFORMED
    motor = head[NUM_PLACE] if kind.names_motor else None
    return _TOPIC_BY_KIND_AND_MOTOR.get((kind.name, motor), MALFORMED)
