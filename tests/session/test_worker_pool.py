"""Worker processes as an executor: results, errors, deaths, and a clean end."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from fte_sniff.errors import FileError
from fte_sniff.session.worker_pool import WorkerPool
from tests.beside import running
from tests.cli.processes import BOUND_S, wait_until


def square(number: int) -> int:
    return number * number


def fail(path: str) -> None:
    raise FileError("{path} is empty", path=path)


def die(code: int) -> None:
    if code < 0:
        os.kill(os.getpid(), -code)
    os._exit(code)


def wait_in(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    signal.pause()


def import_path() -> list[str]:
    return sys.path


def test_results_and_errors_come_back_in_order() -> None:
    with WorkerPool(2) as pool:
        futures = [pool.submit(square, number) for number in range(20)]
        failed = pool.submit(fail, "a.mcap")
        assert [future.result(BOUND_S) for future in futures] == [n * n for n in range(20)]
        with pytest.raises(FileError, match=r"^a.mcap is empty$"):
            failed.result(BOUND_S)


@pytest.mark.parametrize(
    ("code", "message"), [(-signal.SIGKILL, "killed by signal 9"), (3, "ended with exit code 3")]
)
def test_a_process_that_ends_fails_its_own_job_alone(code: int, message: str) -> None:
    with WorkerPool(1) as pool:
        before, lost, after = (
            pool.submit(square, 2), pool.submit(die, code), pool.submit(square, 3),
        )  # fmt: skip
        assert before.result(BOUND_S) == 4
        with pytest.raises(ChildProcessError, match=message):
            lost.result(BOUND_S)
        assert after.result(BOUND_S) == 9


def test_what_cannot_be_sent_fails_alone() -> None:
    with WorkerPool(1) as pool:
        lost, after = pool.submit(lambda: 1), pool.submit(square, 3)
        with pytest.raises(Exception, match=r"pickle|local object"):
            lost.result(BOUND_S)
        assert after.result(BOUND_S) == 9


def test_the_working_folder_is_not_on_the_import_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "struct.py").write_text("raise SystemExit(77)")
    monkeypatch.chdir(tmp_path)
    with WorkerPool(1) as pool:
        found = pool.submit(import_path).result(BOUND_S)
    assert not {"", ".", str(tmp_path)} & set(found)


def test_cancelled_work_ends_at_once_and_leaves_no_process(tmp_path: Path) -> None:
    with WorkerPool(2) as pool:
        futures = [pool.submit(wait_in, str(tmp_path)) for _ in range(4)]
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
        pool.shutdown(wait=False, cancel_futures=True)
    assert not any(Path("/proc", one.name).exists() for one in tmp_path.iterdir())
    assert not futures[0].cancelled()


def test_workers_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    program = (
        "from tests.session.test_worker_pool import *\n"
        f"WorkerPool(1).submit(wait_in, {str(tmp_path)!r}).result()"
    )
    with running([sys.executable, "-c", program]) as process:
        wait_until(lambda: bool(list(tmp_path.iterdir())))
        (worker,) = tmp_path.iterdir()
        process.kill()
    os.kill(int(worker.name), signal.SIGKILL)  # it is in the middle of its work
    assert process.wait(BOUND_S) == -signal.SIGKILL
