"""Measure many files: one job a file, in this process or by an executor; results merge in order.

    files ──jobs──> this process | worker processes | a cluster ──results──> one model

A model counts consecutive rows; `merge` adds those of the next file. Only as many results wait as
the executor works on, so memory does not grow with the number of files.
"""

from __future__ import annotations

import signal
import subprocess
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, ParamSpec, TypeVar

from fte_sniff.analysis.model import BaudChange, RowModel, StreamChange
from fte_sniff.errors import FileError, FteSniffError, RecordingWarning, printable
from fte_sniff.protocol import Gap, GapKind
from fte_sniff.session.inputs import (
    ANOTHER,
    Input,
    InputBatch,
    InputEnds,
    InputReading,
    Progress,
    ReadingCounts,
    RecordingInput,
    by_first_time,
)
from fte_sniff.session.worker_process import start_worker

if TYPE_CHECKING:
    from fte_sniff.analysis.rules import Verdict
    from fte_sniff.recording.reader import TimeRange
    from fte_sniff.session.files import Paths
Model = TypeVar("Model", bound=RowModel)


class DelayedInterrupt:
    """Ctrl-C as KeyboardInterrupt, delayed while a model changes."""

    def __init__(self) -> None:
        self._held = self._pending = False

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Context in which it handles SIGINT, unless that is ignored, as in a background job."""
        before = signal.getsignal(signal.SIGINT)
        if not callable(before):
            yield
            return
        signal.signal(signal.SIGINT, self._on_signal)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _on_signal(self, *_: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # the next one ends the program
        if not self._held:
            raise KeyboardInterrupt
        self._pending = True

    @contextmanager
    def held(self) -> Iterator[None]:
        """Context that raises KeyboardInterrupt at its end if Ctrl-C came in it."""
        self._held = True
        try:
            yield
        finally:
            self._held = False
            if self._pending:
                self._pending = False
                raise KeyboardInterrupt


@dataclass(frozen=True, slots=True)
class FileJob(Generic[Model]):
    """One file to measure."""

    source: Path | Input
    """An input that can be read only once is open already."""
    opened: Callable[[Path], Input]
    make_model: Callable[[], Model]
    span: TimeRange | None = None
    """Only rows in it; None for all."""
    filter_text: str | None = None
    """Only rows that it matches; None for all."""
    baud: int | None = None
    """The baud of every port; None for that of the file."""
    size: int | None = None
    """Bytes of the file; None if unknown."""

    def open(self) -> Input:
        """The input, opened."""
        return self.source if isinstance(self.source, Input) else self.opened(self.source)

    @property
    def name(self) -> str:
        """The file, for display."""
        return self.source.name if isinstance(self.source, Input) else str(self.source)


@dataclass(slots=True)
class FileResult(Generic[Model]):
    """What a job found."""

    model: Model
    counts: ReadingCounts
    ends: InputEnds = field(default_factory=InputEnds)
    named_bauds: Mapping[str, int] = field(default_factory=dict)
    """By port, as the file names them."""
    bauds: dict[str, int] = field(default_factory=dict)
    """By port, at the end."""
    lost: frozenset[str] = frozenset()
    """Ports that are lost at the end."""
    found: frozenset[str] = frozenset()
    """Ports that were found again, but not lost in this file before."""
    interrupted: bool = False
    """Whether Ctrl-C came before all rows were read."""


def count_file(
    job: FileJob[Model],
    interrupts: DelayedInterrupt | None = None,
    progress: Progress | None = None,
    bauds: Mapping[str, int] | None = None,
    lost: Iterable[str] = (),
) -> FileResult[Model]:
    """Do one job; raises FteSniffError as `Input.batches`.

    With `interrupts`, Ctrl-C ends the job with the rows so far. `bauds` are those at its start, by
    port, where they differ from what the file names; `lost` are the ports that are lost there.
    """
    one = job.open()
    wanted = _compiled(job.filter_text)
    reading = InputReading([one], job.span, wanted, baud=job.baud, progress=progress)
    result = FileResult(job.make_model(), reading.counts)
    result.model.begin(one.name)
    result.named_bauds = {port.name: port.baud for port in one.ports if port.baud}
    reading.detector.lost |= set(lost)
    for port in lost:
        result.model.observe_change(Gap(GapKind.PORT, port=port, port_lost=True))
    try:
        for batch in reading.batches_of(one):
            _count(result, batch, bauds or {}, interrupts)
    except KeyboardInterrupt:
        if interrupts is None:
            raise
        result.interrupted = True
    if reading.unreadable and not reading.tally.rows:
        raise reading.unreadable[0]
    result.counts = reading.counts
    result.ends = one.ends
    result.lost = frozenset(reading.detector.lost)
    result.found = frozenset(reading.detector.found)
    return result


def _count(
    result: FileResult[Model],
    batch: InputBatch,
    bauds: Mapping[str, int],
    interrupts: DelayedInterrupt | None,
) -> None:
    changes = [_at_start(change, bauds) for change in batch.changes]
    changes = [change for change in changes if not _is_another(change.what)]
    for change in changes:
        if isinstance(change.what, BaudChange):
            result.bauds[change.what.port] = change.what.baud
    with interrupts.held() if interrupts is not None else nullcontext():
        result.model.observe(batch.rows, changes)


def _compiled(text: str | None) -> Any:
    if text is None:
        return None
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(text)


def _is_another(what: Gap | BaudChange) -> bool:
    """Whether it reports another recording; here the caller knows that."""
    return isinstance(what, Gap) and what.kind is ANOTHER[0]


def _at_start(change: StreamChange, bauds: Mapping[str, int]) -> StreamChange:
    """The change; the baud that the file names at its start is replaced by the one in force."""
    what = change.what
    if change.index == 0 and isinstance(what, BaudChange) and what.port in bauds:
        return StreamChange(0, BaudChange(what.port, bauds[what.port]))
    return change


class FileMerger(Generic[Model]):
    """Merges the results of consecutive files into a model and a reading."""

    def __init__(self, model: Model, reading: InputReading) -> None:
        self.model, self._reading = model, reading
        self._before: FileResult[Model] | None = None

    @property
    def is_empty(self) -> bool:
        """Whether no file was added."""
        return self._before is None

    def add(self, job: FileJob[Model], result: FileResult[Model]) -> None:
        """Add the next file."""
        before = self._before
        lost = result.found  # if the file before it is not read
        if before is not None and result.ends.follows(before.ends):
            lost |= before.lost
        else:
            self.model.observe_change(Gap(ANOTHER[0], reason=ANOTHER[1], port_lost=False))
        # The next file of a capture names the baud of the beginning, not of the end.
        bauds = {} if before is None else _bauds_in_force(before, result)
        if bauds or lost:
            result = count_file(job, bauds=bauds, lost=sorted(lost))
        self.model.merge(result.model)
        self._reading.include(result.counts)
        self._before = replace(result, model=self.model)


def _bauds_in_force(before: FileResult[Any], result: FileResult[Any]) -> dict[str, int]:
    """The ports whose baud at the end of a file holds on, although the next names the same."""
    return {
        port: before.bauds[port]
        for port, baud in result.named_bauds.items()
        if before.named_bauds.get(port) == baud and before.bauds.get(port, baud) != baud
    }


Finished = tuple[FileJob[Model], FileResult[Model] | FileError]


def finished_jobs(
    jobs: Iterable[FileJob[Model]],
    executor: Executor | None = None,
    most_waiting: int = 1,
    interrupts: DelayedInterrupt | None = None,
    progress: Progress | None = None,
    *,
    helps: bool = False,
) -> Iterator[Finished[Model]]:
    """Do the jobs and yield their results in order; an unreadable file is a FileError.

    Args:
        jobs: what to do.
        executor: does the jobs; None for this process.
        most_waiting: most jobs that are submitted and not yielded yet.
        interrupts: delays Ctrl-C for jobs of this process.
        progress: of all jobs.
        helps: whether this process does jobs that the executor has not begun.

    Raises FteSniffError if a file cannot be read with these options, or the executor failed.
    """
    waiting: deque[_Submitted[Model]] = deque()
    for job in jobs:
        if executor is None or isinstance(job.source, Input):
            waiting.append(_Submitted(job))
        else:
            waiting.append(_Submitted(job, executor.submit(count_file, job)))
        if len(waiting) >= most_waiting:
            yield _finished(waiting, helps, interrupts, progress)
    while waiting:
        yield _finished(waiting, helps, interrupts, progress)


@dataclass(slots=True)
class _Submitted(Generic[Model]):
    """A job that is waiting, under way or done."""

    job: FileJob[Model]
    future: Future[FileResult[Model]] | None = None
    """Of the executor; None if this process does the job."""
    finished: Finished[Model] | None = None
    """Of this process."""

    def take(self) -> bool:
        """Whether this process does the job now, as the executor has not begun it."""
        if self.future is None or not self.future.cancel():
            return False
        self.future = None
        return True


def _finished(
    waiting: deque[_Submitted[Model]],
    helps: bool,
    interrupts: DelayedInterrupt | None,
    progress: Progress | None,
) -> Finished[Model]:
    """The first job; while the executor works on it, this process does later ones."""
    first, *later = waiting
    if helps and not first.take():
        for other in later:
            if first.future is None or first.future.done():
                break
            if other.take():
                other.finished = _done_here(other.job, None, progress)
    waiting.popleft()
    if first.finished is not None:
        return first.finished
    if first.future is None:
        return _done_here(first.job, interrupts, progress)
    return _done_elsewhere(first.job, first.future, progress)


def _done_here(
    job: FileJob[Model], interrupts: DelayedInterrupt | None, progress: Progress | None
) -> Finished[Model]:
    try:
        return job, count_file(job, interrupts, progress)
    except FileError as error:
        return job, error


def _done_elsewhere(
    job: FileJob[Model], future: Future[FileResult[Model]], progress: Progress | None
) -> Finished[Model]:
    try:
        result = future.result()
    except FileError as error:
        return job, FileError(f"{error} (as its worker sees it)")
    except FteSniffError:
        raise
    except CancelledError:  # nobody here cancels it
        reason = "what reads the files is gone, such as the scheduler of a cluster"
        raise FileError(reason) from None
    except Exception as error:  # noqa: BLE001
        # What an executor raises is its own business; which file is concerned is known here.
        reason = str(error) or type(error).__name__
        return job, FileError(f"{job.name}: no worker could read it: {reason}")
    if progress is not None:
        progress.files_done += 1
        progress.advance(job.size or 0, result.counts.tally.rows)
    return job, result


# The public functions


def check(
    paths: Paths, rules: str | Sequence[str], *, executor: Executor | None = None
) -> list[Verdict]:
    """The verdicts of rules about recordings, all together, in the order of the rules.

    Args:
        paths: a recording, a folder of them, a pattern such as `logs/*.mcap`, or several of these.
        rules: a text such as `count(malformed) == 0`, see docs/check.md, or several.
        executor: reads the files, such as `dask.distributed.Client(...).get_executor()`; by
            default they are read here, one after the other.

    Raises:
        FileError: a file cannot be read or is not a recording, or there is none.
        InputTextError: a rule is invalid.

    Warns:
        RecordingWarning: what `fte-sniff check` reports about a file, such as damage.
    """
    from fte_sniff.analysis.rules import RuleCheck, parse_rule

    listed = [rules] if isinstance(rules, str) else rules
    make = partial(RuleCheck, [parse_rule(text) for text in listed])
    return _measured(paths, make, executor)[0].verdicts()


def stats(paths: Paths, *, executor: Executor | None = None) -> dict[str, Any]:
    """The numbers of recordings, all together: the object of `stats --format json` (docs/stats.md).

    Takes the paths and the executor of `check`, and raises FileError and warns as it does.
    """
    from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary
    from fte_sniff.session.stats_json import statistics_json

    return statistics_json(*_measured(paths, partial(StatisticsSummary, LineSetup()), executor))


def _measured(
    paths: Paths, make: Callable[[], Model], executor: Executor | None
) -> tuple[Model, InputReading]:
    from fte_sniff.session.files import recordings_in

    found = recordings_in(paths)
    if len(found) > 1:  # opened for their first times, and closed: there may be thousands
        found.sort(key=lambda path: by_first_time(_opened(path)))
    jobs = [FileJob(path.absolute(), _opened, make) for path in found]
    reading = InputReading([])
    merger = FileMerger(make(), reading)
    for job, result in finished_jobs(jobs, executor, _MOST_WAITING):
        if isinstance(result, FileError):
            raise result
        merger.add(job, result)
    for note in reading.notes:
        warnings.warn(printable(note), RecordingWarning, stacklevel=3)
    return merger.model, reading


_MOST_WAITING: Final = 32


def _opened(path: Path) -> Input:
    from fte_sniff.recording.reader import Recording

    return RecordingInput(Recording(path))


# Worker processes as an executor

_Result = TypeVar("_Result")
_Arguments = ParamSpec("_Arguments")


class WorkerPool(ThreadPoolExecutor):
    """Calls functions in other processes, which start when there is work for them.

    A process takes a call when it is ready; until then the call can be cancelled.

    Not `concurrent.futures.ProcessPoolExecutor`: its processes begin with the working folder on
    their import path, print a traceback at Ctrl-C, and one that is killed breaks all others. Here
    each thread has a process that `start_worker` started; a killed one fails its own job, and the
    next job gets a new one.
    """

    def __init__(self, workers: int) -> None:
        """`workers` is the largest number of processes, at least 1."""
        super().__init__(workers, initializer=self._start)
        self._own = threading.local()
        """Of each thread, the `worker`: its process and the pipe to it; None without one."""
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._is_ended = False

    def submit(
        self,
        fn: Callable[_Arguments, _Result],
        /,
        *args: _Arguments.args,
        **kwargs: _Arguments.kwargs,
    ) -> Future[_Result]:
        """Call a function of a module; it, its arguments and its result are pickled."""
        return super().submit(self._call, fn, args, kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """Kill the processes, also those that work; calls without a result fail."""
        self._is_ended = True
        for process in list(self._processes):
            process.kill()
        super().shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._processes) if wait else ():
            process.wait()

    def _start(self) -> None:
        """Start the process of this thread, and wait until it is ready."""
        self._own.worker = None
        with suppress(EOFError, OSError):  # the next call notices it
            process, connection = self._own.worker = start_worker(answer_calls)
            self._processes.add(process)
            if self._is_ended:  # while it started
                process.kill()
            connection.recv()

    def _call(self, fn: Callable[..., _Result], args: Any, kwargs: Any) -> _Result:
        if self._own.worker is None:
            self._start()
        if self._own.worker is None:
            raise FileError("a worker process cannot be started; try --jobs 1")
        process, connection = self._own.worker
        try:
            connection.send((fn, args, kwargs))
            done, value = connection.recv()
        except (EOFError, OSError):
            self._own.worker = None
            connection.close()
            code = process.wait()
            self._processes.discard(process)
            how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
            raise ChildProcessError(
                f"its worker process {how}; try again with fewer --jobs"
            ) from None
        if done:
            found: _Result = value
            return found
        raise value


def answer_calls(connection: Connection) -> None:
    """Call the functions that come through a pipe, in a worker process, until it is closed."""
    with suppress(EOFError, OSError):
        connection.send(None)  # it is ready
        while True:
            fn, args, kwargs = connection.recv()
            try:
                answer = True, fn(*args, **kwargs)
            except Exception as error:  # noqa: BLE001  # the caller raises it
                answer = False, error
            connection.send(answer)
