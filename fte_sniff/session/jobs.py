"""One function over groups of files: in other processes, or on a cluster.

    groups of files ──map──> worker processes | a Dask cluster ──parts──> added up

What a group gives is a part that adds up, so `map` is enough, and its results are in order.
"""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import Final, TypeVar

from fte_sniff.errors import FileError, FteSniffError, UsageError

Group = TypeVar("Group")
Result = TypeVar("Result")

_CONNECT_S: Final = 10
"""How long a scheduler may take to answer at most."""


def mapped(
    function: Callable[[Group], Result], groups: Iterable[Group], executor: Executor
) -> Iterator[Result]:
    """The result for each group, in order.

    The function and the groups are pickled for another process. Raises what the function raises;
    FileError if the executor fails.
    """
    try:
        yield from executor.map(function, groups)
    except FteSniffError:
        raise
    except Exception as error:
        # An executor raises errors of its own kind, such as for a process that was killed.
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise FileError(f"what reads the files failed: {reason}; try --jobs 1") from error


@contextmanager
def executor_of(jobs: int, cluster: str | None = None) -> Iterator[Executor]:
    """The processes, or the cluster with this address, that read.

    Raises FileError if no scheduler answers at the address.
    """
    if cluster is not None:
        with _client(cluster) as executor:
            yield executor
    else:
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
            yield pool


@contextmanager
def _client(address: str) -> Iterator[Executor]:
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise UsageError(
            "--cluster needs the package distributed, which is not installed; install it with"
            " `pip install 'fte-sniff[cluster]'`"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise FileError(
            f"--cluster {address}: no scheduler answers ({reason}); start one with"
            " `dask scheduler`, and workers with `dask worker`"
        ) from None
    with client:
        yield client.get_executor(pure=False)
