"""Worker processes as an executor.

Not `concurrent.futures.ProcessPoolExecutor`: its processes begin with the working folder on their
import path, print a traceback at Ctrl-C, and one that is killed breaks all others. Here each thread
of a pool has a process that `worker_process` started; a killed one fails its own job, and the next
job gets a new one.
"""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, ParamSpec, TypeVar

from fte_sniff.errors import FileError
from fte_sniff.session.worker_process import start_worker

_Result = TypeVar("_Result")
_Arguments = ParamSpec("_Arguments")


class WorkerPool(ThreadPoolExecutor):
    """Calls functions in other processes, which start when there is work for them.

    A process takes a call when it is ready; until then the call can be cancelled.
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
