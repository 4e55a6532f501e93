"""Wires that carry the wrong direction."""

from __future__ import annotations

import pytest

from fte_sniff.protocol import Damage, Fault, Frame, PortEvent, PortEventKind
from fte_sniff.session.wiring import SETTLED, UNEXPECTED, WiringWatch
from tests.support.columns import in_columns

CONTROL = bytes.fromhex("AA0000000000000000EE")
FEEDBACK = bytes.fromhex("5501010000000000000FEE")[:9] + b"\xee"


def look(watch: WiringWatch, port: str, raw: bytes, count: int, **more: object) -> list[PortEvent]:
    return [
        reported
        for number in range(count)
        for reported in watch.observe(
            port, in_columns(Frame(port, 10 * number, raw, number, **more))
        )  # type: ignore[arg-type]
    ]


def test_a_wire_each_is_as_it_should_be() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", CONTROL, 1000) == []
    assert look(watch, "b", FEEDBACK, 1000) == []


def test_one_port_may_carry_both() -> None:
    watch = WiringWatch(["a"])
    assert look(watch, "a", CONTROL, 100) + look(watch, "a", FEEDBACK, 100) == []


def test_the_others_header_is_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", CONTROL, SETTLED)
    look(watch, "b", FEEDBACK, SETTLED)
    assert look(watch, "a", FEEDBACK, UNEXPECTED - 1) == []
    (reported,) = look(watch, "a", FEEDBACK, 50)
    assert (reported.port, reported.kind) == ("a", PortEventKind.WIRING)
    assert reported.detail.startswith("feedback frames on the wire that carries control frames")
    (reported,) = look(watch, "b", CONTROL, 50)
    assert reported.port == "b"
    assert look(watch, "a", FEEDBACK, 50) + look(watch, "b", CONTROL, 50) == []


def test_two_adapters_on_one_wire_are_pointed_out_once() -> None:
    watch = WiringWatch(["a", "b"])
    assert look(watch, "a", FEEDBACK, SETTLED) == []
    (reported,) = look(watch, "b", FEEDBACK, 100)
    assert "on a too" in reported.detail
    assert look(watch, "a", FEEDBACK, 100) == []


def test_a_wire_like_another_that_carries_both_directions_is_pointed_out_as_mixed_too() -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", FEEDBACK, SETTLED)
    assert len(look(watch, "b", FEEDBACK, SETTLED)) == 1
    (reported,) = look(watch, "b", CONTROL, 50)
    assert "swapped or mixed wiring" in reported.detail
    assert look(watch, "b", CONTROL, 50) + look(watch, "b", FEEDBACK, 50) == []


@pytest.mark.parametrize("faults", [(Fault.AMBIGUOUS,), (Fault.UNKNOWN_CMD,)])
def test_what_is_doubtful_is_no_cause(faults: tuple[Fault, ...]) -> None:
    watch = WiringWatch(["a", "b"])
    look(watch, "a", CONTROL, SETTLED)
    assert look(watch, "a", FEEDBACK, 100, faults=faults) == []
    assert watch.observe("a", in_columns(Damage("a", 0, FEEDBACK, 1, (Fault.TRUNCATED,)))) == []
