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
from typing import Any, TypeVar

from fte_sniff.errors import FileError
from fte_sniff.session.worker_process import start_worker

_Result = TypeVar("_Result")
_Call = tuple["Future[Any]", Callable[..., Any], tuple[Any, ...], dict[str, Any]]


class WorkerPool(Executor):
    """Calls functions in other processes, which start when there is work for them."""

    def __init__(self, workers: int) -> None:
        """`workers` is the largest number of processes, at least 1."""
        self._most = workers
        self._calls: SimpleQueue[_Call | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._killed = False

    def submit(self, fn: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """Call a function of a module; it, its arguments and its result are pickled."""
        future: Future[_Result] = Future()
        self._calls.put((future, fn, args, kwargs))
        if len(self._threads) < self._most:
            thread = threading.Thread(target=self._serve, daemon=True)
            self._threads.append(thread)
            thread.start()
        return future

    def _serve(self) -> None:
        worker: tuple[subprocess.Popen[bytes], Connection] | None = None
        while (call := self._calls.get()) is not None and not self._killed:
            future, fn, args, kwargs = call
            if not future.set_running_or_notify_cancel():
                continue
            try:
                if worker is None:
                    worker = self._start()
                _, connection = worker
                connection.send((fn, args, kwargs))
                done, value = connection.recv()
            except (EOFError, OSError):
                future.set_exception(self._ended(worker))
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
            worker[0].wait()

    def _start(self) -> tuple[subprocess.Popen[bytes], Connection]:
        worker = start_worker(answer_calls)
        self._processes.add(worker[0])
        if self._killed:  # while it started
            worker[0].kill()
        return worker

    def _ended(self, worker: tuple[subprocess.Popen[bytes], Connection] | None) -> Exception:
        if worker is None:
            return FileError("a worker process cannot be started; try --jobs 1")
        process, connection = worker
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
            for process in list(self._processes):
                process.kill()
        for _ in self._threads:
            self._calls.put(None)
        if wait:
            for thread in self._threads:
                thread.join()


def answer_calls(connection: Connection) -> None:
    """Call the functions that come through a pipe, in a worker process, until it is closed."""
    with suppress(EOFError, OSError):
        while True:
            fn, args, kwargs = connection.recv()
            try:
                answer = True, fn(*args, **kwargs)
            except Exception as error:  # noqa: BLE001  # the caller raises it
                answer = False, error
            connection.send(answer)
