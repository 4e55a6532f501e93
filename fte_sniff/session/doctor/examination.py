"""Owns a look at the whole set-up: the machine, the folder, the ports, and one line's bytes.

It must not know how findings are shown. Findings come as they are found.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fte_sniff.analysis.baud_guess import (
    COMMON_BAUDS,
    SURE,
    Condition,
    Setting,
    Verdict,
    judge,
    judge_frames,
)
from fte_sniff.capture.diagnostics import (
    Finding,
    Level,
    Listener,
    bad,
    clock_finding,
    clock_state,
    device_findings,
    granted_findings,
    holder_findings,
    host_of,
    machine_findings,
    missing_adapter_hint,
    ok,
    warn,
)
from fte_sniff.capture.discovery import list_ports, listing_of
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.protocol import framer
from fte_sniff.session.doctor.surroundings import (
    framer_finding,
    terminal_findings,
    working_folder_finding,
)
from fte_sniff.session.doctor.verdicts import probe_finding, verdict_finding

ENOUGH = 4000
"""Bytes after which there is no need to listen on."""

PROBE_S = 1.0
"""Seconds that a probe listens at each baud, at most."""

PROBE_ENOUGH = 400
"""Bytes after which a probe goes on to the next baud."""


@dataclass(frozen=True, slots=True)
class Examination:
    """What is to be looked at."""

    port: str
    """A device, or a URL that pyserial opens."""
    settings: PortSettings
    seconds: float
    """How long to listen."""
    probe: bool
    """Whether other bauds may be tried."""


def look_around() -> Iterator[Finding]:
    """What can be told of the machine, the folder, the terminal and this installation."""
    yield working_folder_finding()
    yield from terminal_findings(os.environ, sys.stdout.encoding)
    yield framer_finding(Path(framer.__file__).parent, compiled=framer.COMPILED)
    yield clock_finding(clock_state())
    yield from machine_findings()


def look_at_ports() -> Iterator[Finding]:
    """What can be told of all ports without opening one."""
    found = list_ports()
    for port in found:
        yield from device_findings(port)
        # That a port is in use is wrong only where one wants to have it.
        for finding in holder_findings(port):
            yield replace(finding, level=Level.WARN)
    if not found:
        yield bad("ports", "no serial port is plugged in", missing_adapter_hint(host_of()))
    elif all(port.vid is None for port in found):
        yield warn("ports", "no USB adapter is plugged in", missing_adapter_hint(host_of()))


def examine(asked: Examination) -> Iterator[Finding]:
    """What can be told of one port by opening it and listening to it; nothing is written.

    Raises:
        PortError: it cannot be opened, or was lost.
    """
    name = asked.port
    port = listing_of(name)
    if port is not None:
        yield from device_findings(port)
        yield from holder_findings(port)
    with Listener(name, asked.settings) as listener:
        yield from granted_findings(name, listener.granted)
        heard = listener.listen(asked.seconds, ENOUGH)
        if heard.line_errors:
            what = f"line errors while listening: {heard.line_errors}"
            yield warn(name, what, "another baud or polarity, or a loose or unshielded wire")
        verdict = judge(heard.data, asked.settings.baud)
        yield verdict_finding(asked.port, asked.settings.baud, verdict)
        if asked.probe:
            yield _probe(asked, listener, verdict)


def _probe(asked: Examination, listener: Listener, verdict: Verdict) -> Finding:
    name = asked.port
    if verdict.condition is Condition.SOUND:
        return ok(name, "probe: not needed, the baud is right")
    if verdict.condition is Condition.SILENT:
        return warn(name, "probe: nothing comes that could be probed", "let the line talk")
    samples: dict[int, bytes] = {}
    best: tuple[Setting, Verdict] | None = None
    for baud in _by_promise(verdict, asked.settings.baud):
        data = listener.sample(baud, PROBE_S, PROBE_ENOUGH)
        if data is None:
            continue
        samples[baud] = data
        seen = judge_frames(data)
        if seen is not None and seen.share > (best[1].share if best else 0):
            best = Setting(baud, inverted=False), seen
            if seen.condition is Condition.SOUND:
                break
    return probe_finding(name, *(best or (_swapped(samples), None)))


def _swapped(samples: Mapping[int, bytes]) -> Setting | None:
    """The baud at which the bytes look like this very baud with swapped polarity."""
    for baud, data in samples.items():
        setting = Setting(baud, inverted=True)
        if dict(judge(data, baud).guesses).get(setting, 0) >= SURE:
            return setting
    return None


def _by_promise(verdict: Verdict, baud: int) -> list[int]:
    """The bauds to be tried: those first that the bytes so far speak for, each once."""
    guessed = [setting.baud for setting, _ in verdict.guesses]
    near = sorted(COMMON_BAUDS, key=lambda other: max(other / baud, baud / other))
    return list(dict.fromkeys([*guessed, *near]))
