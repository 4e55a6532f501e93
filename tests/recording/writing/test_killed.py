"""Recordings whose writer is killed, by the package that everybody reads them with."""

import random
from pathlib import Path

import pytest

from benchmarks.recording_kill import kill_one


@pytest.mark.parametrize(("every_s", "seams"), [(0.0, False), (0.0, True), (0.2, False)])
def test_what_was_flushed_is_there_whenever_the_writer_is_killed(
    tmp_path: Path, every_s: float, seams: bool
) -> None:
    rng = random.Random()
    for number in range(3):
        left = kill_one(tmp_path / f"{number}.mcap", every_s, rng.uniform(0.0, 0.5), seams=seams)
        assert left.problem == ""
        assert left.missing == 0
        assert left.found <= left.written
        assert left.files > 1 or not seams or left.written < 10_000
