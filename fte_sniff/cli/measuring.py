"""Measure files for `stats` and `check`: here, in worker processes, or on a Dask cluster."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import click

from fte_sniff.cli.extras import install_command
from fte_sniff.cli.input_files import STDIN, InputQuery
from fte_sniff.cli.options import all_of
from fte_sniff.cli.output import explain_no_frames, print_notes
from fte_sniff.cli.progress import progress_line
from fte_sniff.cli.streams import EXIT_INTERRUPTED, print_err
from fte_sniff.errors import FileError, UsageError, quoted

if TYPE_CHECKING:
    from fte_sniff.session.file_jobs import (
        DelayedInterrupt,
        FileJob,
        FileMerger,
        Finished,
        Model,
    )
    from fte_sniff.session.inputs import InputReading

_WAITING_PER_WORKER: Final = 2

_SCHEMES: Final = ("tcp", "tls", "ws", "wss")
"""Of schedulers; `inproc` is not another process, and `ucx` needs a package of its own."""

jobs_options = all_of(
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Processes that read the files.  [default: the usable cores; 1 for a single file]",
    ),
    click.option(
        "--cluster",
        metavar="ADDRESS",
        help="Read the files on a Dask cluster, such as tcp://192.168.0.9:8786; its workers see the"
        " same files.",
    ),
)


@dataclass(slots=True)
class FilesMeasured:
    """The measurements of files, also after Ctrl-C."""

    reading: InputReading
    files: int
    read: int = 0
    interrupted: bool = False

    def finish(self, *, refused: bool = False) -> None:
        """Print notes about the files and exit unless all is well; `refused` means exit code 1."""
        reading = self.reading
        print_notes(reading)
        if self.interrupted:
            files = f"{self.read} of {self.files} files"
            print_err(f"fte-sniff: interrupted; {files} and {reading.tally.rows:,} rows were read")
            sys.exit(EXIT_INTERRUPTED)
        if advice := explain_no_frames(reading.tally, reading):
            print_err(f"fte-sniff: {advice}")
        if reading.unreadable:
            sys.exit(FileError.exit_code)
        if refused:
            sys.exit(1)


def measure(
    query: InputQuery,
    make_model: Callable[[], Model],
    jobs: int | None,
    cluster: str | None,
) -> tuple[Model, FilesMeasured]:
    """Count all rows of the files.

    Raises:
        FileError: no file can be read, or the cluster cannot be reached.
        UsageError: the options contradict each other, or the cluster's address is invalid.
        InputTextError: a filter, time, date or zone is invalid.
    """
    from fte_sniff.session.file_jobs import DelayedInterrupt, FileMerger, finished_jobs

    if cluster is not None:
        if jobs is not None:
            raise UsageError("--jobs is for this machine; leave it out with --cluster")
        _check_address(cluster)
        query = replace(query, files=tuple(_absolute(path) for path in query.files))
    with progress_line(reads_stdin=STDIN in query.files) as line:
        todo, reading = query.jobs(make_model, line.progress)
        merger, measured = FileMerger(make_model(), reading), FilesMeasured(reading, len(todo))
        interrupts = DelayedInterrupt()
        try:
            with (
                _executor(processes_for(jobs, todo), cluster) as (executor, waiting),
                interrupts.installed(),
            ):
                here = cluster is None
                results = finished_jobs(
                    todo, executor, waiting, interrupts, line.progress, helps=here
                )
                _merge(results, merger, measured, interrupts)
        except KeyboardInterrupt:
            measured.interrupted = True
    if not merger.files and reading.unreadable:
        raise reading.unreadable[0]
    return merger.model, measured


def _merge(
    results: Iterator[Finished[Model]],
    merger: FileMerger[Model],
    measured: FilesMeasured,
    interrupts: DelayedInterrupt,
) -> None:
    """Merge the results, up to a lost executor; raises KeyboardInterrupt."""
    try:
        for job, result in results:
            with interrupts.held():
                if isinstance(result, FileError):
                    measured.reading.skip(result)
                    continue
                merger.add(job, result)
                measured.read += not result.interrupted
            if result.interrupted:
                raise KeyboardInterrupt
    except FileError as error:
        files = f"{measured.read} of {measured.files} files were read"
        measured.reading.skip(FileError(f"{error}; {files}"))


def _check_address(address: str) -> None:
    """Raise UsageError if no scheduler can have that address."""
    try:
        parts = urlsplit(address if "://" in address else f"tcp://{address}")
        is_valid = parts.scheme in _SCHEMES and parts.hostname and parts.port
    except ValueError:  # no number of a port
        is_valid = False
    if not is_valid:
        raise UsageError(
            f"--cluster {quoted(address)} is not the address of a Dask scheduler; write it as"
            " tcp://192.168.0.9:8786"
        )


def _absolute(path: Path) -> Path:
    if path == STDIN:
        raise UsageError("--cluster reads files; '-' is standard input of this machine")
    return path.absolute()


def processes_for(jobs: int | None, todo: list[FileJob[Model]]) -> int:
    """The number of processes that read, this one included."""
    from fte_sniff.recording.mcap.records import cores

    files = sum(isinstance(job.source, Path) for job in todo)
    return max(1, min(jobs or cores(), files))


@contextmanager
def _executor(jobs: int, cluster: str | None) -> Iterator[tuple[Executor | None, int]]:
    """The executor, None for this process, and the number of jobs that it should have waiting."""
    if cluster is not None:
        with _cluster(cluster) as found:
            yield found
    elif jobs == 1:
        yield None, 1
    else:
        from fte_sniff.session.file_jobs import WorkerPool

        with WorkerPool(jobs - 1) as pool:
            yield pool, _WAITING_PER_WORKER * jobs


@contextmanager
def _cluster(address: str) -> Iterator[tuple[Executor, int]]:
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise UsageError(
            "--cluster needs the package distributed, which is not installed; install it with"
            f" `{install_command('cluster')}`"
        ) from None
    import asyncio
    import logging

    if urlsplit(address).scheme == "tls" and not _security(distributed)["ssl_context"]:
        raise UsageError(
            f"--cluster {address} needs certificates; name them in Dask's settings"
            " (distributed.comm.tls), or use tcp://"
        )

    logging.disable()  # what Dask and Tornado log about lost workers is reported here by file
    dask = import_module("dask")
    own_s = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    connect_s = min(_CONNECT_S, own_s)
    try:
        asyncio.run(asyncio.wait_for(_find_scheduler(distributed, address), connect_s))
        client = distributed.Client(address, timeout=connect_s, set_as_default=False)
    except Exception as error:  # noqa: BLE001  # whatever another program answers
        late = isinstance(error, TimeoutError)
        reason = f"nothing within {connect_s:g} s" if late else str(error) or type(error).__name__
        raise FileError(
            f"--cluster {address}: no scheduler answers ({reason.splitlines()[0]}); start one"
            " with `dask scheduler`, and workers with `dask worker`"
        ) from None
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            print_err("fte-sniff: the cluster has no worker yet; start one with `dask worker`")
        yield client.get_executor(pure=False), _WAITING_PER_WORKER * max(1, threads)


async def _find_scheduler(distributed: ModuleType, address: str) -> None:
    """Raise an error of any kind if no scheduler answers; a Client would hang, or close late."""
    async with distributed.rpc(address, connection_args=_security(distributed)) as server:
        identity = await server.identity()
    if identity.get("type") != "Scheduler":
        raise ValueError(f"a {str(identity.get('type')).lower()} has this address")


def _security(distributed: ModuleType) -> Mapping[str, Any]:
    """What Dask's settings say about TLS."""
    found: Mapping[str, Any] = distributed.Security().get_connection_args("client")
    return found


_CONNECT_S: Final = 10
"""How long a scheduler may take to answer at most; Dask's own setting may be shorter."""
