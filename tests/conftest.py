"""Settings of all tests.

Hypothesis has no deadline, because a busy machine would exceed it. Examples of a usual run are the
same each time, so that its result is that of the commit. `--hypothesis-profile full` runs those of
`.ci/full`, which are random and more; `thorough` twenty times as many. A failure prints how to
repeat it.
"""

from __future__ import annotations

import gc
import os
import signal
import sys

import pytest
from hypothesis import Phase, settings

from tests.examples import FULL, QUICK
from tests.needs import needs_of
from tests.pseudo_terminals import new_pty, pty, until  # noqa: F401

# Tests close terminals and press Ctrl-C. A handler is not inherited; that a signal is ignored is:
# SIGHUP under nohup, SIGINT in the background of a script.
for number, handler in (
    (signal.SIGHUP, lambda *_: None),
    (signal.SIGINT, signal.default_int_handler),
):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, handler)

# To explain a failure takes as long as to shrink it: together longer than a test may take.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink)
settings.register_profile("full", deadline=None, print_blob=True, max_examples=FULL, phases=PHASES)
settings.register_profile(
    "quick", settings.get_profile("full"), max_examples=QUICK, derandomize=True
)
settings.register_profile("thorough", settings.get_profile("full"), max_examples=20 * FULL)
settings.load_profile("quick")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--bless", action="store_true", help="write the present output of sessions")


# What is collected stays to the end; to look for garbage in it takes a third of the time.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
    # An app is many objects in cycles: to look for them again and again is a quarter of a test.
    # Not to look for old ones at all would take more than a gigabyte in each worker.
    gc.set_threshold(200_000, 10, 5)
    # Tests of full disks limit the size of files. A module first imported under such a limit would
    # leave a truncated .pyc file, and break later imports. What pytest makes of the test modules
    # is kept, also by its workers: that takes most of the time of collecting them.
    sys.dont_write_bytecode = True
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark a test with what its fixtures need."""
    for name in needs_of(item):
        item.add_marker(name)
