"""Measures the page of `report` in headless Chromium: size, first drawing, redraw after a zoom.

    python -m benchmarks.report_page [--rows 1000000] [--rounds 5]

The capture has commands and feedback of four motors in speed mode, with jitter in the times, noise
in the values and 0.1 % of damaged frames. The first drawing is timed from opening the file, in a
new browser each time; a redraw from the change of the range until every plot in sight is painted.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import monotonic

import numpy as np

from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.spec import FRAME_LENGTH, KIND_BY_NAME, MOTORS, encode
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.session.framing import rows_of_chunks
from tests.browser import drawn, open_browser
from tests.support.recorded_rows import START_NS, write_recording

_PERIOD_NS = 2_500_000
_DAMAGED = 0.001
_ZOOMS = ((0.4, 0.6), (0.45, 0.5), (0.471, 0.472), (0.0, 1.0), (0.1, 0.9))

REDRAW = """
const done = arguments[arguments.length - 1], [low, high] = [arguments[0], arguments[1]];
const models = Bokeh.documents[0], range = models.get_model_by_name("time");
const whole = window.wholeRange = window.wholeRange || [range.start, range.end];
const inSight = models.roots().filter((one) => one.x_range === range).map(
    (one) => Bokeh.index.find_one(one)).filter((view) => {
        const box = view.el.getBoundingClientRect();
        return box.bottom > 0 && box.top < innerHeight;
    });
const old = new Set(inSight), drawn = Number(document.documentElement.dataset.drawn);
let began;
const slots = inSight.map((view) => {
    const slot = () => {
        if (began === undefined || Number(document.documentElement.dataset.drawn) === drawn) return;
        old.delete(view);
        if (old.size) return;
        inSight.forEach((one, i) => one.repainted.disconnect(slots[i]));
        setTimeout(() => done(performance.now() - began));
    };
    view.repainted.connect(slot);
    return slot;
});
requestAnimationFrame(() => setTimeout(() => {
    began = performance.now();
    const width = whole[1] - whole[0];
    range.setv({start: whole[0] + low * width, end: whole[0] + high * width});
}));
"""


def frames(rows: int) -> Iterator[Chunk]:
    """One frame a chunk: commands to the motors, each followed by its feedback."""
    random = np.random.default_rng(1)
    gaps = random.gamma(4.0, _PERIOD_NS / 4, rows).astype(np.int64)
    times = (START_NS + np.cumsum(gaps)).tolist()
    noise = random.normal(0, 6, rows).astype(int).tolist()
    hits = random.random(rows) < _DAMAGED
    places = random.integers(0, FRAME_LENGTH, rows).tolist()
    for number in range(rows):
        motor = MOTORS[number // 2 % len(MOTORS)]
        target = int(900 * np.sin(number / 40_000 + motor)) // 50 * 50
        if number % 2:
            values = {"motor": motor, "rpm": target + noise[number]}
            frame = encode(KIND_BY_NAME["speed_feedback"], values)
        else:
            frame = encode(KIND_BY_NAME["speed"], {"motor": motor, "rpm": target})
        if hits[number]:
            frame = bytes(
                byte ^ 0x41 if at == places[number] else byte for at, byte in enumerate(frame)
            )
        yield Chunk("/dev/ttyUSB0", times[number], frame)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        recording, page = Path(folder, "rows.mcap"), Path(folder, "report.html")
        rows = rows_of_chunks(frames(options.rows), print)
        write_recording(recording, [PortFacts("/dev/ttyUSB0")], rows)
        command = [sys.executable, "-m", "fte_sniff", "report", str(recording), "-o", str(page)]
        began = monotonic()
        subprocess.run(command, check=True)
        print(f"written in {monotonic() - began:.1f} s, {page.stat().st_size / 1e6:.2f} MB")
        first, redraws = [], []
        for _round in range(options.rounds):
            with open_browser() as browser:
                began = monotonic()
                browser.get(page.as_uri())
                drawn(browser)
                first.append(monotonic() - began)
                redraws += [browser.execute_async_script(REDRAW, *zoom) for zoom in _ZOOMS]
        print(
            f"first drawing: median {median(first):.2f} s of {len(first)}, {max(first):.2f} at most"
        )
        print(
            f"redraw: median {median(redraws):.0f} ms of {len(redraws)}, {max(redraws):.0f} at most"
        )


if __name__ == "__main__":
    main()
