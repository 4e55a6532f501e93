"""Owns how a verdict on a line's bytes is put into words, and the way out of each.

It must not know how a verdict is reached.
"""

from __future__ import annotations

from shlex import quote

from fte_sniff.analysis.baud_guess import SURE, Condition, Setting, Verdict
from fte_sniff.capture.diagnostics import Finding, bad, ok, warn
from fte_sniff.protocol import Direction

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
