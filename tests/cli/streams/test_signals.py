"""How a command that runs on hears of its end."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import os, signal, sys, time
from fte_sniff.cli import streams as signals
signals.OUTPUT_PATIENCE_S = signals._REPEAT_S = 0.05

class Slow:
    def __del__(self, now=time.monotonic):
        # Python has let go of its signal handlers by now, and takes its time.
        deadline = now() + 0.5
        while now() < deadline:
            pass

slow = Slow()
with signals.ending_signals(lambda: None):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.2)
"""


def test_an_end_that_takes_long_is_no_death_by_alarm(environment) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=environment,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
