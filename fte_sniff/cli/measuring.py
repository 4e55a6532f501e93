"""Measure files for `stats` and `check`: here, in worker processes, or on a Dask cluster."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, explain_no_frames, print_notes
from fte_sniff.cli.options import all_of, format_option, install_command
from fte_sniff.cli.streams import EXIT_INTERRUPTED, print_err, progress_line
from fte_sniff.errors import FileError, UsageError, quoted
from fte_sniff.formats.writers import printable_json

if TYPE_CHECKING:
    from rich.text import Text

    from fte_sniff.session.file_jobs import (
        DelayedInterrupt,
        FileJob,
        FileMerger,
        Finished,
        Model,
    )
    from fte_sniff.session.inputs import InputReading


text_or_json_option = format_option(
    "A table for people, or one JSON object.", ["table", "json"], "table"
)
"""The `--format` option of a command that prints text, or a JSON object."""


def print_json(value: Any) -> None:
    """Print indented JSON on standard output, without a copy of the whole text."""
    encoder = json.JSONEncoder(ensure_ascii=False, indent=2)
    sys.stdout.writelines(map(printable_json, encoder.iterencode(value)))
    sys.stdout.write("\n")


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
    if merger.is_empty and reading.unreadable:
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
    from fte_sniff.platform import cores

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


HEAD_STYLE = "dim"
LEAST_NAME = 21
"""Cells that a name is shortened to at most."""


class TextTable:
    """A table that fits a width: names lose their start, then the last columns are dropped.

    `rich.table.Table` would wrap or cut cells in all columns instead.
    """

    def __init__(self, heads: Sequence[str]) -> None:
        self._lines = [("", list(heads), "")]

    def append(self, cells: Sequence[str], style: str = "", mark: str = "") -> None:
        """Append a line: the name, then a cell for each further head.

        `mark` is in a column left of the name, with its style.
        """
        self._lines.append((mark, list(cells), style))

    def lines(self, width: int | None) -> Iterator[Text]:
        """The lines in at most `width` cells, if they can be shortened so far; None: no limit."""
        from rich.cells import cell_len
        from rich.text import Text

        from fte_sniff.formats.cell_text import fit_path, fit_right, padded

        marks = max(cell_len(mark) for mark, _, _ in self._lines)
        names, *widths = (
            max(map(cell_len, column))
            for column in zip(*(cells for _, cells, _ in self._lines), strict=True)
        )
        if width is not None:
            room = width - marks
            names = max(min(names, LEAST_NAME), min(names, room - sum(widths) - 2 * len(widths)))
            while len(widths) > 1 and names + sum(widths) + 2 * len(widths) > room:
                widths.pop()
        for number, (mark, (name, *cells), style) in enumerate(self._lines):
            values = "".join(
                f"  {fit_right(cell, room)}" for cell, room in zip(cells, widths, strict=False)
            )
            lead = f"{padded(mark, marks)}{padded(fit_path(name, names), names)}"
            line = Text.assemble((lead, style), values, style="" if number else HEAD_STYLE)
            line.rstrip()
            yield line


def print_lines(lines: Callable[[int | None], Iterable[Text]]) -> None:
    """Print lines that fit a given width, None for any; with colours on a terminal.

    A longer line is cut, unless its overflow is `ignore`.
    """
    if not sys.stdout.isatty():
        sys.stdout.writelines(f"{line.plain.rstrip()}\n" for line in lines(None))
        return
    from rich.console import Console

    console = Console(file=sys.stdout)
    for line in lines(console.width):
        is_cut = line.overflow != "ignore"
        console.print(line, no_wrap=True, overflow=line.overflow or "ellipsis", crop=is_cut)
