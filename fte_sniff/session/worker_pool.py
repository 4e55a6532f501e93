"""Worker processes as an executor.

Not `concurrent.futures.ProcessPoolExecutor`: its processes begin with the working folder on their
import path, print a traceback at Ctrl-C, and one that is killed breaks all others. These are
started by `worker_process`; a killed one fails its own job, and the next job gets a new one.
"""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, Final, TypeVar

from fte_sniff.errors import FileError
from fte_sniff.session.worker_process import start_worker

_Result = TypeVar("_Result")
_Worker = tuple[subprocess.Popen[bytes], Connection]
_Call = tuple["Future[Any]", Callable[..., Any], tuple[Any, ...], dict[str, Any]]

_NOT_STARTED: Final = FileError("a worker process cannot be started; try --jobs 1")


class WorkerPool(Executor):
    """Calls functions in other processes, which start when there is work for them.

    A process takes a call when it is ready; until then the call can be cancelled.
    """

    def __init__(self, workers: int) -> None:
        """`workers` is the largest number of processes, at least 1."""
        self._most = workers
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._unfinished: set[Future[Any]] = set()
        """Those of calls that wait or run."""
        self._threads: list[threading.Thread] = []
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._starting: set[subprocess.Popen[bytes]] = set()
        self._killed = False

    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """Call a function of a module; it, its arguments and its result are pickled."""
        future: Future[_Result] = Future()
        self._unfinished.add(future)
        future.add_done_callback(self._unfinished.discard)
        self._calls.put((future, fn, args, kwargs))
        if len(self._threads) < self._most:
            thread = threading.Thread(target=self._serve, daemon=True)
            self._threads.append(thread)
            thread.start()
        return future

    def _serve(self) -> None:
        worker: _Worker | None = None
        while not self._killed:
            worker = worker or self._start()
            call = self._calls.get()
            if call is None:
                break
            future, fn, args, kwargs = call
            if not future.set_running_or_notify_cancel():
                continue
            if worker is None:
                future.set_exception(_NOT_STARTED)
                continue
            process, connection = worker
            try:
                connection.send((fn, args, kwargs))
                done, value = connection.recv()
            except (EOFError, OSError):
                future.set_exception(self._ended(process, connection))
                worker = None
                continue
            except Exception as error:  # noqa: BLE001  # it cannot be pickled
                future.set_exception(error)
                continue
            if done:
                future.set_result(value)
            else:
                future.set_exception(value)
        if worker is not None:
            worker[1].close()
            worker[0].kill()  # it is idle
            worker[0].wait()

    def _start(self) -> _Worker | None:
        """A worker that is ready, or that has ended already; None if it cannot be started."""
        try:
            worker = start_worker(answer_calls)
        except OSError:
            return None
        process, connection = worker
        self._processes.add(process)
        self._starting.add(process)
        if self._killed:  # while it started
            process.kill()
        with suppress(EOFError, OSError):  # the caller notices it
            connection.recv()
        self._starting.discard(process)
        return worker

    def _ended(self, process: subprocess.Popen[bytes], connection: Connection) -> Exception:
        connection.close()
        code = process.wait()
        self._processes.discard(process)
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return ChildProcessError(f"its worker process {how}; try again with fewer --jobs")

    def __exit__(self, kind: object, *_: object) -> None:
        """End the processes; at once if an exception ended the context."""
        self.shutdown(cancel_futures=kind is not None)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after their work; with `cancel_futures`, kill them."""
        if cancel_futures:
            self._killed = True
        for process in list(self._processes) if self._killed else self._unneeded():
            process.kill()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()

    def _unneeded(self) -> list[subprocess.Popen[bytes]]:
        """The processes that still start although no call is left for them."""
        left = any(not future.running() for future in list(self._unfinished))
        return [] if left else list(self._starting)


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
