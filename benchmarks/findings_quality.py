"""How well `findings` finds what is wrong: recall, false findings, and speed.

`python -m benchmarks.findings_quality --recordings 100 --hours 10 --rows 1000000`

The generator is independent of the program's simulator. A recording has 20 minutes of a host that
polls four motors, and one episode: answers of one motor are lost or late, frames of one direction
or 4 to 15 % of those of one motor are damaged, a flag is set for a while or for a second, a motor
is stuck (at a speed or a position) or silent, the host's commands are irregular, bits of one
motor's values flip, the UART reports errors, or the port is lost. Hosts and controllers differ in
rate, order, jitter, delay, pauses, and in whether they set speeds or positions; 0.1 % of all frames
are damaged, a third of them unseen.
An episode is found if one of the first five findings has its cause and motor, and the span of that
finding and that of the episode have half of their union in common.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis import events, statistics
from fte_sniff.analysis.findings import Cause, Finding
from fte_sniff.analysis.findings import find as find_counted
from fte_sniff.analysis.segments import summed
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import MOST_BYTES, Rows, fault_bits
from fte_sniff.protocol.spec import Fault
from tests.analysis.captures import segments

START_NS = 1_700_000_000 * 10**9
SECOND = 10**9
MINUTES = 20
FIRST = 5
"""Findings among which an episode must be."""

EPISODES = (
    *("lost", "late", "damage", "error", "offline", "brief_error", "brief_offline"),
    *("stuck", "stuck_position", "silent", "irregular", "jumps", "line_errors", "port_lost"),
    "motor_damage",
)

CAUSES = {
    "lost": {Cause.UNANSWERED},
    "late": {Cause.LATE},
    "damage": {Cause.DAMAGE},
    "motor_damage": {Cause.DAMAGE},
    "error": {Cause.ERROR_FLAG},
    "offline": {Cause.OFFLINE},
    "brief_error": {Cause.ERROR_FLAG},
    "brief_offline": {Cause.OFFLINE},
    "stuck": {Cause.OFF_TARGET},
    "stuck_position": {Cause.OFF_TARGET},
    "silent": {Cause.SILENCE},
    "irregular": {Cause.IRREGULAR_COMMANDS},
    "jumps": {Cause.JUMP},
    "line_errors": {Cause.PORT},
    "port_lost": {Cause.PORT},
}

LENGTHS = {"silent": 12.0, "brief_error": 1.2, "brief_offline": 1.2}
"""Seconds of episodes that do not have 20 to 180."""

OF_ALL_MOTORS = ("damage", "irregular", "line_errors", "port_lost")


@dataclass(frozen=True)
class Episode:
    """What goes wrong, and when."""

    kind: str
    start_s: float
    end_s: float
    motor: int
    share: float
    """Of the answers, or of the frames of a direction."""
    feedback: bool
    """The direction that is damaged."""


def episode(rng: np.random.Generator, kind: str, seconds: float) -> Episode:
    """An episode of 20 to 180 s, or as `LENGTHS` says."""
    length = LENGTHS.get(kind) or rng.uniform(20, 180)
    start = rng.uniform(30, seconds - 30 - length)
    share = rng.uniform(0.15, 0.6)
    return Episode(
        kind, start, start + length, int(rng.integers(1, 5)), share, bool(rng.integers(2))
    )


def recording(rng: np.random.Generator, seconds: float, what: Episode | None) -> Rows:
    """The rows of a host and a controller, in order of time."""
    period = float(np.exp(rng.uniform(np.log(0.02), np.log(0.15))))
    jitter = rng.uniform(0.005, 0.08)
    together = bool(rng.integers(2))
    times = _command_times(rng, seconds, period, jitter, what)
    count = len(times)
    motors = np.tile(np.arange(1, 5), count)
    slots = np.tile(np.arange(4), count) * (0.0012 if together else period / 4)
    asked = np.repeat(times, 4) + slots
    if together is False:
        asked += rng.normal(0, jitter * period / 16, len(asked))
        asked = np.maximum.accumulate(asked)
    delay = 0.0012 + 0.002 * rng.random() + rng.exponential(rng.uniform(0.0001, 0.0015), len(asked))
    is_position = what.kind == "stuck_position" if what is not None else rng.random() < 0.3
    if is_position:
        targets, present = _positions(rng, asked, motors, what)
    else:
        targets = _targets(rng, asked, motors)
        present = _present(rng, asked, motors, targets, what)
    inside = np.zeros(len(asked), np.bool_)
    if what is not None:
        inside = (asked >= what.start_s) & (asked < what.end_s)
    own = inside & (motors == (what.motor if what else 0))
    answered = rng.random(len(asked)) > 0.0003
    errors, online = np.zeros(len(asked), np.uint8), np.full(len(asked), 0x0F, np.uint8)
    if what is not None:
        hit = rng.random(len(asked)) < what.share
        if what.kind == "lost":
            answered &= ~(own & hit)
        elif what.kind == "late":
            late = (
                delay + rng.uniform(0.2, 0.6) * period + rng.exponential(0.1 * period, len(asked))
            )
            delay = np.where(own & hit, np.minimum(late, 0.9 * period), delay)
        elif what.kind == "silent":
            answered &= ~own
        elif what.kind in ("error", "brief_error"):
            errors[own] = 1 << int(rng.integers(8))
        elif what.kind in ("offline", "brief_offline"):
            online[inside] &= ~np.uint8(1 << (what.motor - 1))
        elif what.kind == "jumps":
            flips = 1 << rng.integers(8, 15, len(asked))
            present = np.where(
                own & (hit & (rng.random(len(asked)) < 0.3)), present ^ flips, present
            )
    control = _frames(0xAA, motors, targets, None, None, is_position)
    feedback = _frames(0x55, motors, present, errors, online, is_position)
    t = np.concatenate((asked, (asked + delay)[answered]))
    raw = np.concatenate((control, feedback[answered]))
    if what is not None and what.kind == "port_lost":
        kept = (t < what.start_s) | (t >= what.end_s)
        t, raw = t[kept], raw[kept]
    order = np.argsort(t, kind="stable")
    return _damaged(rng, t[order], raw[order], what)


def _command_times(
    rng: np.random.Generator, seconds: float, period: float, jitter: float, what: Episode | None
) -> npt.NDArray[np.float64]:
    count = int(seconds / period) + 1
    periods = period * (1 + jitter * rng.standard_normal(count)).clip(0.3, 3)
    for _ in range(int(rng.poisson(seconds / 300))):  # pauses of the host
        periods[int(rng.integers(count))] += rng.uniform(0.3, 12)
    times = np.cumsum(periods)
    if what is not None and what.kind == "irregular":
        inside = (times >= what.start_s) & (times < what.end_s)
        factors = np.exp(rng.uniform(-1.2, 1.2, int(inside.sum())))
        periods[inside] *= factors / factors.mean()
        times = np.cumsum(periods)
    found: npt.NDArray[np.float64] = times[times < seconds]
    return found


def _targets(
    rng: np.random.Generator, t: npt.NDArray[np.float64], motors: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Targets that change every few seconds, or follow a sine."""
    if rng.random() < 0.3:
        speed = 300 * np.sin(t / rng.uniform(1, 8) + motors)
        return speed.astype(np.int64)
    every = rng.uniform(2, 20)
    steps = (t / every).astype(np.int64) * 7919 + motors * 104_729
    return (steps * 2_654_435_761 % 1201 - 600) // 50 * 50


def _present(
    rng: np.random.Generator,
    t: npt.NDArray[np.float64],
    motors: npt.NDArray[np.int64],
    targets: npt.NDArray[np.int64],
    what: Episode | None,
) -> npt.NDArray[np.int64]:
    """Speeds that approach their targets; a stuck motor keeps its speed."""
    found = np.zeros(len(t), np.int64)
    lag = rng.uniform(0.1, 0.6)
    for motor in range(1, 5):
        own = np.flatnonzero(motors == motor)
        share = 1 - np.exp(-np.diff(t[own], prepend=t[own[0]]) / lag)
        value, values = 0.0, np.zeros(len(own))
        stuck = np.zeros(len(own), np.bool_)
        if what is not None and what.kind == "stuck" and what.motor == motor:
            stuck = (t[own] >= what.start_s) & (t[own] < what.end_s)
        for at, target in enumerate(targets[own].tolist()):
            value += share[at] * ((0 if stuck[at] else target) - value)
            values[at] = value
        found[own] = np.rint(values + rng.normal(0, 1.5, len(own)) * (values != 0))
    return found


def _positions(
    rng: np.random.Generator,
    t: npt.NDArray[np.float64],
    motors: npt.NDArray[np.int64],
    what: Episode | None,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Positions that are set every few seconds, and are approached at a limited speed."""
    every, speed = rng.uniform(4, 20), rng.uniform(1500, 6000)
    steps = (t / every).astype(np.int64) * 7919 + motors * 104_729
    targets = (steps * 2_654_435_761 % 4001 - 2000) // 10 * 10
    present = np.zeros(len(t), np.int64)
    for motor in range(1, 5):
        own = np.flatnonzero(motors == motor)
        reach = speed * np.diff(t[own], prepend=t[own[0]])
        stuck = np.zeros(len(own), np.bool_)
        if what is not None and what.kind == "stuck_position" and what.motor == motor:
            stuck = (t[own] >= what.start_s) & (t[own] < what.end_s)
        value, values = 0.0, np.zeros(len(own))
        for at, target in enumerate(targets[own].tolist()):
            if not stuck[at]:
                value += float(np.clip(target - value, -reach[at], reach[at]))
            values[at] = value
        present[own] = np.rint(values)
    return targets, present


def port_events(rng: np.random.Generator, what: Episode) -> list[PortEvent]:
    """What the port reports in an episode."""
    start, end = (START_NS + int(one * SECOND) for one in (what.start_s, what.end_s))
    if what.kind == "port_lost":
        return [
            PortEvent(start, "bus", PortEventKind.LOST, ""),
            PortEvent(end, "bus", PortEventKind.FOUND_AGAIN, ""),
        ]
    if what.kind != "line_errors":
        return []
    count = int(rng.integers(5, 60))
    times = np.sort(rng.integers(start, end, count)).tolist()
    return [PortEvent(t_ns, "bus", PortEventKind.LINE_ERROR, "") for t_ns in times]


def _frames(
    head: int,
    motors: npt.NDArray[np.int64],
    values: npt.NDArray[np.int64],
    errors: npt.NDArray[np.uint8] | None,
    online: npt.NDArray[np.uint8] | None,
    is_position: bool,
) -> npt.NDArray[np.uint8]:
    raw = np.zeros((len(motors), 10), np.uint8)
    raw[:, 0], raw[:, 1], raw[:, 2], raw[:, 9] = head, 1, motors, 0xEE
    if is_position:
        at = 5 if head == 0xAA else 3
        raw[:, 1] = 2
        raw[:, at : at + 4] = values.astype(">i4").view(np.uint8).reshape(-1, 4)
        if head == 0xAA:
            raw[:, 4] = 200
    else:
        raw[:, 3], raw[:, 4] = values >> 8 & 0xFF, values & 0xFF
    if errors is not None:
        raw[:, 7] = errors
    if online is not None:
        raw[:, 8] = online
    return raw


def _damaged(
    rng: np.random.Generator,
    t: npt.NDArray[np.float64],
    raw: npt.NDArray[np.uint8],
    what: Episode | None,
) -> Rows:
    """The rows as a framer labels them; half of the damage changes a value and is not seen."""
    count = len(t)
    hit = rng.random(count) < 0.001
    if what is not None and what.kind == "damage":
        own = (t >= what.start_s) & (t < what.end_s)
        own &= raw[:, 0] == (0x55 if what.feedback else 0xAA)
        hit |= own & (rng.random(count) < what.share)
    if what is not None and what.kind == "motor_damage":
        own = (t >= what.start_s) & (t < what.end_s) & (raw[:, 2] == what.motor)
        hit |= own & (rng.random(count) < what.share / 4)
    wide = np.zeros((count, MOST_BYTES), np.uint8)
    wide[:, :10] = raw
    rows = Rows.blank(
        count,
        ("bus",),
        raw=wide,
        t_ns=START_NS + np.rint(t * SECOND).astype(np.int64),
        offset=np.arange(count) * 10,
    )
    bad = np.flatnonzero(hit)
    unseen = rng.random(len(bad)) < 0.3
    flips = bad[unseen]
    rows.raw[flips, rng.integers(3, 9, len(flips))] ^= (1 << rng.integers(0, 8, len(flips))).astype(
        np.uint8
    )
    cut, noise = bad[~unseen][::2], bad[~unseen][1::2]
    rows.framed[cut] = rows.framed[noise] = False
    rows.length[cut] = rng.integers(3, 10, len(cut))
    rows.raw[noise, :10] = rng.integers(0, 256, (len(noise), 10), dtype=np.uint8)
    rows.faults[cut] = fault_bits([Fault.TRUNCATED])
    rows.faults[noise] = fault_bits([Fault.NOISE])
    return rows


def find(rows: Rows, batch: int = 65_536, happened: Sequence[PortEvent] = ()) -> list[Finding]:
    """The findings of the rows, and of what happened to the port."""
    parts = (rows[start : start + batch] for start in range(0, len(rows), batch))
    return [*find_counted(summed(map(events.counted, segments([*happened, *parts])))).found]


def is_found(findings: Sequence[Finding], what: Episode) -> bool:
    """Whether one of the first findings is the episode."""
    for one in findings[:FIRST]:
        start, end = ((t_ns - START_NS) / SECOND for t_ns in (one.first_ns, one.last_ns))
        common = min(end, what.end_s) - max(start, what.start_s)
        union = max(end, what.end_s) - min(start, what.start_s)
        motor = what.kind in OF_ALL_MOTORS or one.motor == what.motor
        if one.cause in CAUSES[what.kind] and motor and common >= union / 2:
            return True
    return False


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", type=int, default=80, help="with an episode each")
    parser.add_argument("--hours", type=int, default=10, help="without an episode")
    parser.add_argument("--rows", type=int, default=1_000_000, help="for the speed")
    parser.add_argument("--misses", action="store_true", help="print what was found instead")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    found, tried = Counter[str](), Counter[str]()
    for number in range(options.recordings):
        kind = EPISODES[number % len(EPISODES)]
        what = episode(rng, kind, 60.0 * MINUTES)
        rows = recording(rng, 60.0 * MINUTES, what)
        findings = find(rows, happened=port_events(rng, what))
        tried[kind] += 1
        found[kind] += is_found(findings, what)
        if options.misses and not is_found(findings, what):
            print(f"missed {what}")
            for one in findings[:FIRST]:
                start, end = ((t - START_NS) / SECOND for t in (one.first_ns, one.last_ns))
                print(f"   {one.cause} {one.motor} {start:.0f} to {end:.0f}: {one.text}")
    for kind in EPISODES:
        print(f"{kind:14} {found[kind]} of {tried[kind]}")
    print(f"{'all':14} {found.total()} of {tried.total()}")
    false = list[Finding]()
    for _ in range(options.hours):
        false += find(recording(rng, 3600.0, None))
    print(f"false findings in {options.hours} hours: {len(false)}")
    for one in false:
        print(f"   {one.cause} {one.motor}: {one.text}")
    if options.rows:
        print_speed(rng, options.rows)


def print_speed(rng: np.random.Generator, count: int) -> None:
    """Compare with the counts of `stats`."""
    rows = recording(rng, 3600.0, None)
    while len(rows) < count:
        rows = Rows.concat([rows, rows.replace(t_ns=rows.t_ns + 3600 * SECOND)])
    rows, seconds = rows[:count], []
    for count_table in (statistics.counted, events.counted):
        start = process_time()
        parts = (rows[at : at + 65_536] for at in range(0, count, 65_536))
        summed(map(count_table, segments(parts)))
        seconds.append(process_time() - start)
    print(
        f"{count:,} rows: stats {seconds[0]:.2f} s, findings {seconds[1]:.2f} s of processor time"
    )


if __name__ == "__main__":
    main()
