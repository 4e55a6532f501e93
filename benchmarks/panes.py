"""Benchmark of the panes and of the filter's dropdown: models, past rows, drawing, counting.

    python -m benchmarks.panes [--rows 300000]

Shares are of one core at the most rows that a full-duplex link carries. The models are also
compared with packing the rows into the store, in the same run.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from time import process_time

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import BLOCK_ROWS, RowStore
from fte_sniff.analysis.search import MatchCounter, ValueCounter
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.capture.simulation import Simulation, parse_parameters
from fte_sniff.protocol import DEFAULT_BAUD, FRAME_LENGTH, Chunk, Framer, Row, byte_time_ns
from fte_sniff.protocol.rows import Rows
from fte_sniff.tui.painter import DARK
from fte_sniff.tui.panes.motors import WINDOWS_NS, MotorsView, grid
from fte_sniff.tui.panes.statistics import StatisticsPage
from tests.support.columns import fed

START_NS = 1_769_860_800_000_000_000
DISTINCT = 50_000
"""Rows that are simulated; further rows repeat them at later times."""

LINK_ROWS_S = 2 * 1_000_000_000 // (FRAME_LENGTH * byte_time_ns(DEFAULT_BAUD))
SIZES = ((80, 15), (199, 37))
"""Cells that a pane has on terminals of 80x24 and 200x60."""


def rows(count: int) -> list[Row]:
    framer, found = Framer("p"), list[Row]()
    for timed in Simulation(parse_parameters(f"seed=1&rate=1000&drop=0.005&frames={DISTINCT}")):
        found += fed(framer, Chunk("p", START_NS + timed.t_ns, timed.data))
    first, last = found[0].t_ns or 0, found[-1].t_ns or 0
    step = last - first + 1_000_000
    again = range(1, -(-count // len(found)))
    found += [replace(row, t_ns=(row.t_ns or 0) + n * step) for n in again for row in found]
    return found[:count]


def seconds(work: Callable[[], object], times: int = 1) -> float:
    """Processor time, the least of `times` runs."""
    best = float("inf")
    for _ in range(times):
        began = process_time()
        work()
        best = min(best, process_time() - began)
    return best


def live(every: list[Row], steps_per_s: int) -> float:
    """Share of a core that the models use at a full link, at this many steps per second."""
    store = RowStore(len(every))
    following, took, step = LiveModels(store, LineSetup()), 0.0, LINK_ROWS_S // steps_per_s
    for at in range(0, len(every) - step, step):
        store.append(Rows.of(every[at : at + step]))
        took += seconds(lambda: following.step(step))
    return took / (len(every) / LINK_ROWS_S)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=300_000)
    count = parser.parse_args().rows
    every = rows(count)
    store = RowStore(count)
    packing = seconds(lambda: store.append(Rows.of(every)))
    following = LiveModels(store, LineSetup())
    models = seconds(lambda: following.step(count))
    print(
        f"models    {count / models:>12,.0f} rows/s   {packing / models:.2f} times packing's speed"
    )
    for steps_per_s in (1, 6, 12):
        print(
            f"live      {live(every[:60_000], steps_per_s):>12.2%} of a core, {steps_per_s} steps/s"
        )
    index = count - 20_000
    state = seconds(lambda: following.motors_at(index), 5)
    print(f"look back {state * 1000:>12.1f} ms for the motors at any row")
    now = store.row(index).t_ns or 0
    for window in WINDOWS_NS[3], WINDOWS_NS[6], WINDOWS_NS[8]:
        took = seconds(lambda window=window: following.past(index, now - window), 3)
        print(f"          {took * 1000:>12.1f} ms for the traces of {window // 10**9} s before it")
    draw(following)
    values = ValueCounter(store, "rpm")
    counting = seconds(lambda: all(iter(values.step, False)))
    print(f"dropdown  {counting * 1000:>12.1f} ms for all {len(values.counts):,} values of rpm")
    for text in ("motor = 1", "motor = 1 AND rpm > 500"):
        matching = MatchCounter(store, RowFilter.parse(text).matches, BLOCK_ROWS)
        counting = seconds(lambda matching=matching: all(iter(matching.step, False)))
        print(f"          {counting * 1000:>12.1f} ms for the matches of {text}")


def draw(models: LiveModels) -> None:
    now = models.traces.last_ns
    states = tuple(models.motors.states(now))
    view = MotorsView(states, models.traces, models.events, now, WINDOWS_NS[3], LineSetup())
    for width, height in SIZES:
        motors = seconds(lambda w=width, h=height: grid(view, w, h, DARK), 5)
        page = StatisticsPage(models, now, width, DARK)
        statistics = seconds(lambda page=page: page.text, 5)
        print(f"draw      {motors * 1000:>12.1f} ms motors, {width}x{height}")
        print(f"          {statistics * 1000:>12.1f} ms statistics, {width}x{height}")


if __name__ == "__main__":
    main()
