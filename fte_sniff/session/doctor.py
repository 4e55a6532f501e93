"""Run the checks and judge them."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote

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
    LineListener,
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
from fte_sniff.errors import reason_of
from fte_sniff.protocol import Direction, framer

LOW_BYTES = 2**30
"""Less room than this may not last for a long capture."""

LEAST_BYTES = 50 * 2**20
"""Less room than this does not last."""

_ELSEWHERE = "cd ~, or name a recording with -o"


def working_folder_finding() -> Finding:
    """As `folder_finding`, of the folder in which recordings are made unless another is named."""
    try:
        return folder_finding(Path.cwd())
    except OSError:
        return bad("folder", "the working folder is gone", "cd ~")


def folder_finding(folder: Path) -> Finding:
    """Whether a recording can be made in a folder, and has room to grow."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return bad("folder", f"{folder}: {reason_of(error)}", _ELSEWHERE)
    own = os.access in os.supports_effective_ids
    if not os.access(folder, os.W_OK | os.X_OK, effective_ids=own):
        return bad("folder", f"{folder} cannot be written to", _ELSEWHERE)
    room = f"{free / 2**30:,.1f} GiB free in {folder}"
    way_out = "make room, or record elsewhere: fte-sniff live PORT -o /other/disk/x.mcap"
    if free < LEAST_BYTES:
        return bad("folder", room, way_out)
    return warn("folder", room, way_out) if free < LOW_BYTES else ok("folder", room)


def terminal_findings(environment: Mapping[str, str], encoding: str) -> Iterator[Finding]:
    """Whether the screen of `live` can be drawn.

    Args:
        environment: the variables of this process.
        encoding: of standard output.
    """
    term = environment.get("TERM", "")
    if term in ("", "dumb", "unknown"):
        what = f"TERM is {term!r}: the screen cannot be drawn"
        yield warn("terminal", what, "export TERM=xterm-256color, or use live --plain")
    else:
        yield ok("terminal", f"TERM is {term}")
    if encoding.lower().replace("-", "") != "utf8":
        what = f"its encoding is {encoding}: some signs cannot be shown"
        yield warn("terminal", what, "export LC_ALL=C.UTF-8")


def framer_finding(room: Path, *, compiled: bool) -> Finding:
    """Whether the framer runs as fast as it can, and is what its source says.

    Args:
        room: the folder of its source, beside which lies what was compiled of it.
        compiled: whether that is what runs.
    """
    if not compiled:
        return warn(
            "framer",
            "interpreted, so large files take longer; no row is different",
            "install a C compiler and Python's headers (Debian, Ubuntu: sudo apt install gcc "
            "python3-dev), then fte-sniff again: pip install .",
        )
    edited = _edited_since_compiled(room)
    if edited is None:
        return ok("framer", "compiled")
    return warn(
        "framer",
        f"compiled before {edited} was changed: what runs is not what the source says",
        "install fte-sniff again: pip install -e . (or pip install .)",
    )


def _edited_since_compiled(room: Path) -> str | None:
    """A source that is younger than what was compiled of all of them; None where none is."""
    made = [path.stat().st_mtime for path in room.glob("*__mypyc.*")]
    younger = (path for path in sorted(room.glob("*.py")) if path.stat().st_mtime > max(made))
    return next((path.name for path in younger), None) if made else None


_WIRE = {
    frozenset({Direction.CONTROL}): "commands (the host's TX wire)",
    frozenset({Direction.FEEDBACK}): "feedback (the controller's TX wire)",
    frozenset(Direction): "commands and feedback",
}
_POLARITY = (
    "RS-232 and TTL levels are each other's opposite: put a level shifter (MAX3232) between, or "
    "use an adapter of the wire's own kind"
)


def verdict_finding(port: str, baud: int, verdict: Verdict) -> Finding:
    """What a verdict reached at `baud` means for the one at the wire."""
    size = f"{verdict.size:,} bytes"
    typed = quote(port)
    probe = f"fte-sniff doctor {typed} --probe"
    match verdict.condition:
        case Condition.SOUND:
            wire = _WIRE.get(verdict.directions, "frames")
            return ok(port, f"{verdict.share:.1%} of {size} at {baud} baud stand in frames: {wire}")
        case Condition.DAMAGED:
            return warn(
                port,
                f"only {verdict.share:.1%} of {size} at {baud} baud stand in frames: a loose plug, "
                "no common ground, two talkers on the wire, or bytes lost",
                f"check plug and ground; fte-sniff live {typed} --filter malformed",
            )
        case Condition.SILENT:
            return bad(
                port,
                "nothing came: a dead wire, or nobody talks",
                "power the controller, join the grounds, put the adapter's RX on a TX wire",
            )
        case Condition.LOW:
            return bad(
                port,
                f"nothing but 00 came ({size}): the wire is held low (no power, no ground, swapped "
                f"polarity), or is far slower than {baud} baud",
                f"check power and ground; {probe}",
            )
        case Condition.TOO_LITTLE:
            what = f"{size} came and no frame: too little to tell by"
            return warn(port, what, f"fte-sniff doctor {typed} --seconds 30")
        case Condition.TEXT:
            what = f"{size} of text and no frame: some other device sends here"
            return bad(port, what, "fte-sniff ports")
    return _frameless(port, baud, verdict, f"no frame in {size} at {baud} baud", probe)


def _frameless(port: str, baud: int, verdict: Verdict, what: str, probe: str) -> Finding:
    if verdict.condition is Condition.FOREIGN:
        what += ", and no common baud makes such bytes: another protocol, or noise on an open wire"
        return bad(port, what, f"check that RX is on a wire; {probe}")
    setting, probability = verdict.guesses[0]
    if verdict.condition is Condition.INVERTED:
        at = "" if setting.baud == baud else f", and {setting.baud} baud"
        return bad(port, f"{what}: it looks like swapped polarity{at}", _POLARITY)
    if probability >= SURE and setting.baud <= baud:
        what += f": it looks like {setting.baud} baud"
        return bad(port, what, f"fte-sniff live {quote(port)} --baud {setting.baud}")
    if setting.baud > baud:
        return bad(port, f"{what}: it looks like a faster line", probe)
    likely = " or ".join(dict.fromkeys(str(setting.baud) for setting, _ in verdict.guesses[:3]))
    return bad(port, f"{what}: the baud is wrong, perhaps {likely}", probe)


def probe_finding(port: str, found: Setting | None, verdict: Verdict | None) -> Finding:
    """What trying other bauds brought: a setting, and the verdict there where frames came."""
    if found is None:
        what = "probe: no common baud gives frames"
        return bad(port, what, "check wire, ground and polarity; is it this controller's line?")
    if verdict is None:
        return bad(port, f"probe: swapped polarity at {found.baud} baud", _POLARITY)
    what = (
        f"probe: {verdict.share:.1%} of {verdict.size:,} bytes stand in frames at {found.baud} baud"
    )
    return bad(port, what, f"fte-sniff live {quote(port)} --baud {found.baud}")


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
    with LineListener(name, asked.settings) as listener:
        yield from granted_findings(name, listener.granted)
        heard = listener.listen(asked.seconds, ENOUGH)
        if heard.line_errors:
            what = f"line errors while listening: {heard.line_errors}"
            yield warn(name, what, "another baud or polarity, or a loose or unshielded wire")
        verdict = judge(heard.data, asked.settings.baud)
        yield verdict_finding(asked.port, asked.settings.baud, verdict)
        if asked.probe:
            yield _probe(asked, listener, verdict)


def _probe(asked: Examination, listener: LineListener, verdict: Verdict) -> Finding:
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
