"""How well `compare` tells what changed: false alarms of one recording, and power.

`python -m benchmarks.compare_quality --pairs 200 --changes 100`

False alarms: two halves of a generated hour in which nothing changes; hosts and controllers differ
from hour to hour (see `findings_quality`). Power: two recordings of ten minutes of one host, the
second with a change: answers take 20 % longer, 1 % of the answers are lost, the answers of one
motor take 50 % longer, or the host's period is 10 % longer. A change is found if a named one has
its measure, and its motor if it is about one.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from benchmarks.findings_quality import SECOND, START_NS, recording
from fte_sniff.analysis.compare import Comparison, compared, counted
from fte_sniff.analysis.segments import Counts, summed
from fte_sniff.protocol.rows import MOST_BYTES, Rows
from fte_sniff.protocol.spec import FRAME_LENGTH
from tests.analysis.captures import segments

HOUR_S = 3600.0
MINUTES_S = 600.0


def counts_of(rows: Rows) -> Counts:
    """What `compare` counts in rows."""
    return summed(map(counted, segments([rows])))


def halves(rng: np.random.Generator, seconds: float = HOUR_S) -> Comparison:
    """Compare the halves of a recording in which nothing changes."""
    rows = recording(rng, seconds, None)
    middle = START_NS + int(seconds / 2 * SECOND)
    return compared(
        counts_of(rows.select(rows.t_ns < middle)), counts_of(rows.select(rows.t_ns >= middle))
    )


class Host:
    """A host that polls four motors, and their answers; the same way in each recording."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.period = float(np.exp(rng.uniform(np.log(0.02), np.log(0.1))))
        self.jitter = rng.uniform(0.005, 0.05)
        self.delay = 0.0012 + 0.002 * rng.random()
        self.spread = rng.uniform(0.0001, 0.001)
        self.lost = 0.0003
        self.slower = np.ones(4)
        """By motor, how many times as long its answers take."""

    def recording(self, rng: np.random.Generator, seconds: float = MINUTES_S) -> Rows:
        """Rows of some seconds, with pauses of the host and targets that change."""
        count = int(seconds / self.period)
        periods = self.period * (1 + self.jitter * rng.standard_normal(count)).clip(0.3, 3)
        for _ in range(int(rng.poisson(seconds / 300))):
            periods[int(rng.integers(count))] += rng.uniform(0.3, 12)
        motors = np.tile(np.arange(1, 5), count)
        asked = np.repeat(np.cumsum(periods), 4) + np.tile(np.arange(4) * 0.0012, count)
        delay = (self.delay + rng.exponential(self.spread, len(asked))) * self.slower[motors - 1]
        answered = rng.random(len(asked)) >= self.lost
        values = (np.repeat(np.cumsum(periods) // rng.uniform(2, 9), 4) * 50 % 600).astype(np.int64)
        t = np.concatenate((asked, (asked + delay)[answered]))
        raw = np.concatenate(
            (_frames(0xAA, motors, values), _frames(0x55, motors, values)[answered])
        )
        order = np.argsort(t, kind="stable")
        t_ns = START_NS + np.rint(t[order] * SECOND).astype(np.int64)
        return Rows.blank(len(t), ("bus",), raw=raw[order], t_ns=t_ns)


def _frames(
    head: int, motors: npt.NDArray[np.int64], values: npt.NDArray[np.int64]
) -> npt.NDArray[np.uint8]:
    raw = np.zeros((len(motors), MOST_BYTES), np.uint8)
    raw[:, 0], raw[:, 1], raw[:, 2] = head, 1, motors
    raw[:, 3], raw[:, 4], raw[:, FRAME_LENGTH - 1] = values >> 8 & 0xFF, values & 0xFF, 0xEE
    raw[:, 8] = 0x0F if head == 0x55 else 0
    return raw


def _slower(host: Host) -> None:
    host.slower *= 1.2


def _lossy(host: Host) -> None:
    host.lost = 0.01


def _one_slower(host: Host) -> None:
    host.slower[2] *= 1.5


def _other_period(host: Host) -> None:
    host.period *= 1.1


CHANGES: dict[str, tuple[Callable[[Host], None], str, int | None]] = {
    "answers 20 % slower": (_slower, "delay", None),
    "1 % lost": (_lossy, "unanswered", None),
    "one motor slower": (_one_slower, "delay", 3),
    "another period": (_other_period, "period", None),
}
"""By name: what it does to a host, the measure that shows it, and the motor."""


def pair(seed: int, change: Callable[[Host], None] | None) -> Comparison:
    """Compare ten minutes of a host with ten others, after a change."""
    rng = np.random.default_rng(seed)
    host = Host(rng)
    before = counts_of(host.recording(rng))
    if change is not None:
        change(host)
    return compared(before, counts_of(host.recording(rng)))


def is_found(found: Comparison, measure: str, motor: int | None) -> bool:
    """Whether a change is named."""
    return any(one.measure == measure and one.motor == motor for one in found.changes)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=40, help="halves of an hour")
    parser.add_argument("--changes", type=int, default=20, help="pairs for each change")
    options = parser.parse_args()
    false = Counter[str]()
    rng = np.random.default_rng(options.seed)
    for _ in range(options.pairs):
        for one in halves(rng).changes:
            print(f"   {one.measure}: {one.text}")
            false[one.measure] += 1
    print(f"false changes in {options.pairs} pairs of half an hour: {false.total()}")
    for name, (change, measure, motor) in CHANGES.items():
        seeds = range(options.changes)
        found = sum(is_found(pair(seed, change), measure, motor) for seed in seeds)
        print(f"{name:22} named in {found} of {options.changes} pairs of ten minutes")
    none = sum(len(pair(seed, None).changes) for seed in range(options.changes))
    print(f"{'nothing':22} {none} changes in {options.changes} pairs of ten minutes")


if __name__ == "__main__":
    main()
