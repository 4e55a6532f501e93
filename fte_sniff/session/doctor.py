"""Checks of `doctor`: whether an adapter is plugged in, and the line of one port.

What the error of a port explains is not checked before: permission, and the program that has it
open. Nothing is ever written to a port.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from enum import StrEnum
from functools import partial
from shlex import quote
from typing import NamedTuple

import serial

from fte_sniff.analysis.line_condition import LineCondition, LineDiagnosis, diagnose
from fte_sniff.capture.discovery import list_ports
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.serial_port import PortSettings, open_port, reader_of
from fte_sniff.errors import PortError, printable
from fte_sniff.protocol.spec import Direction


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARN = "warn"
    """It works, but could be better."""
    BAD = "bad"
    """It does not work, or recordings will be wrong."""


class Diagnosis(NamedTuple):
    """The result of one check."""

    level: Level
    about: str
    """The port, or the part of the machine."""
    what: str
    """One line for users. It may contain text from outside: print it with `printable`."""
    fix: str | None = None
    """A command to type, or what to do by hand; None if nothing is wrong."""


ok, warn, bad = (partial(Diagnosis, level) for level in Level)


PLUG_IN = (
    "plug the adapter in, and see `sudo dmesg | tail`, or the Device Manager of Windows: brltty"
    " takes some away (sudo apt remove brltty), and a container, WSL or a virtual machine needs it"
    " passed through"
)
"""What to do where a machine does not see an adapter."""


def check_adapters() -> Diagnosis:
    """Check whether an adapter is plugged in."""
    found = [port.device for port in list_ports() if port.usb_ids]
    if found:
        return ok("ports", f"USB adapters: {', '.join(found)}")
    others = "`fte-sniff doctor /dev/ttyS0` checks a built-in port, `doctor sim://` a simulated one"
    return warn("ports", "no USB adapter is plugged in", f"{PLUG_IN}; {others}")


def check_port(
    name: str, settings: PortSettings, seconds: float, *, probe: bool
) -> Iterator[Diagnosis]:
    """Open one port, listen to it for some seconds, and diagnose its line.

    With `probe`, other bauds are tried too. Raises PortError if the port cannot be opened.
    """
    with closing(open_port(name, settings)) as port:
        verdict = diagnose(read_for(name, port, seconds, _ENOUGH_BYTES))
    yield verdict_finding(name, settings.baud, verdict)
    if probe:
        yield _probe(name, settings, verdict)


def read_for(name: str, port: serial.Serial, seconds: float, enough: int) -> bytes:
    """Read for `seconds`, or until there are `enough` bytes; raises PortError on a loss."""
    read, data, deadline = reader_of(port), bytearray(), time.monotonic() + seconds
    while len(data) < enough and time.monotonic() < deadline:
        try:
            data += read()
        except OSError as error:
            raise PortError(
                f"{printable(name)} was lost: {one_line(error)}; check cable and power"
            ) from error
    return bytes(data)


# The line

_WIRE = {
    frozenset({Direction.CONTROL}): "commands (the host's TX wire)",
    frozenset({Direction.FEEDBACK}): "feedback (the controller's TX wire)",
    frozenset(Direction): "commands and feedback",
}


_VERDICTS: Mapping[LineCondition, tuple[Level, str, str | None]] = {
    LineCondition.SOUND: (
        Level.OK, "{share:.1%} of {size} at {baud} baud are in frames: {wire}", None
    ),
    LineCondition.DAMAGED: (
        Level.WARN,
        "only {share:.1%} of {size} at {baud} baud are in frames: a loose plug, no common ground,"
        " two senders on the wire, or bytes lost",
        "check plug and ground; fte-sniff live {port} --filter malformed",
    ),
    LineCondition.SILENT: (
        Level.BAD,
        "nothing came: a dead wire, or no device sends",
        "power the controller, join the grounds, put the adapter's RX on a TX wire",
    ),
    LineCondition.LOW: (
        Level.BAD,
        "nothing but 00 came ({size}): the wire is held low (no power, no ground, swapped"
        " polarity), or is far slower than {baud} baud",
        "check power and ground; fte-sniff doctor {port} --probe",
    ),
    LineCondition.TOO_LITTLE: (
        Level.WARN,
        "{size} came and no frame: too little to judge",
        "fte-sniff doctor {port} --duration 30",
    ),
    LineCondition.UNREADABLE: (
        Level.BAD,
        "no frame in {size} at {baud} baud: another baud rate, swapped polarity, or another device",
        "fte-sniff doctor {port} --probe",
    ),
}  # fmt: skip
"""Level, words and fix of each condition of a line."""


def verdict_finding(port: str, baud: int, verdict: LineDiagnosis) -> Diagnosis:
    """The finding for a verdict on bytes received at `baud`."""
    level, what, fix = _VERDICTS[verdict.condition]
    values = {
        "share": verdict.share,
        "size": f"{verdict.size:,} bytes",
        "baud": baud,
        "wire": _WIRE.get(verdict.directions, "frames"),
        "port": quote(port),
    }
    return Diagnosis(
        level, port, what.format_map(values), None if fix is None else fix.format_map(values)
    )


# Probing other bauds

COMMON_BAUDS = (
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800,
    500_000, 921_600, 1_000_000, 1_500_000, 2_000_000, 3_000_000,
)  # fmt: skip
"""Baud rates of common adapters and controllers."""

_ENOUGH_BYTES = 4000
"""Bytes after which listening ends early."""

_PROBE_S = 1.0
"""Longest time that a probe listens at each baud, seconds."""

_PROBE_BYTES = 400
"""Bytes after which a probe tries the next baud."""


def _probe(port: str, settings: PortSettings, verdict: LineDiagnosis) -> Diagnosis:
    if verdict.condition is LineCondition.SOUND:
        return ok(port, "probe: not needed, the baud is right")
    if verdict.condition is LineCondition.SILENT:
        return warn(port, "probe: nothing comes that could be probed", "let the device send")
    found, own = dict[int, LineDiagnosis](), settings.baud
    for baud in sorted(COMMON_BAUDS, key=lambda other: max(other / own, own / other)):
        try:
            opened = open_port(port, replace(settings, baud=baud))
        except PortError:  # it cannot have this baud
            continue
        with closing(opened):
            judged = diagnose(read_for(port, opened, _PROBE_S, _PROBE_BYTES))
        if judged.condition in (LineCondition.SOUND, LineCondition.DAMAGED):
            found[baud] = judged
        if judged.condition is LineCondition.SOUND:
            break
    return probe_finding(port, found)


def probe_finding(port: str, found: Mapping[int, LineDiagnosis]) -> Diagnosis:
    """The finding of a probe; `found` are the diagnoses by the baud at which frames came."""
    if not found:
        return bad(
            port,
            "probe: no common baud gives frames: swapped polarity, or another device",
            "check wire and ground; RS-232 and TTL levels are each other's opposite: put a level "
            "shifter (MAX3232) between, or use an adapter of the wire's own kind",
        )
    baud = max(found, key=lambda one: found[one].share)
    best = found[baud]
    what = f"probe: {best.share:.1%} of {best.size:,} bytes are in frames at {baud} baud"
    return bad(port, what, f"fte-sniff live {quote(port)} --baud {baud}")
