"""A Dask cluster on this machine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.beside import running
from tests.waiting import BOUND_S


@contextmanager
def cluster(workers: int, folder: Path) -> Iterator[str]:
    """The address of a scheduler with workers of one thread, all on this machine."""
    environment = os.environ | {"PYTHONPATH": os.getcwd()}  # noqa: PTH109
    file = folder / "scheduler.json"
    common = ["--no-dashboard", "--scheduler-file", str(file)]
    scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common]
    worker = ["distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", *common]
    worker += ["--local-directory", str(folder)]
    with ExitStack() as processes:
        for command in (scheduler, *[worker] * workers):
            processes.enter_context(
                running(
                    [sys.executable, "-m", *command],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=environment,
                )
            )
        from distributed import Client

        with Client(scheduler_file=str(file), timeout=BOUND_S, set_as_default=False) as client:
            if workers:
                client.wait_for_workers(workers, timeout=BOUND_S)
            address = client.scheduler.address
        yield address
