"""`stats` and `check` over many files: in one process, in several, on a cluster; tables."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from distributed import Client
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

import fte_sniff
from fte_sniff.analysis.statistics import StatisticsSummary
from fte_sniff.cli.measuring import LEAST_NAME, TextTable, processes_for
from fte_sniff.session.file_jobs import FileJob
from fte_sniff.session.inputs import RecordingInput
from tests.cli.processes import BOUND_S, PROGRAM, children_of, ended, started, wait_until
from tests.slow import first
from tests.support.dask_cluster import cluster
from tests.support.recorded_rows import make_recordings

FILES = 12


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    make_recordings(folder, FILES, 4000)
    return folder


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with cluster(2, tmp_path_factory.mktemp("cluster")) as found:
        yield found


COMMANDS = {
    "stats": ["stats"],
    "check": [
        *("check", "--expect", "max_gap(motor = 1) < 0.001", "--expect", "unanswered() == 0"),
        *("--expect", "delay(p95) < 1", "--expect", "count(motor = 4) == 0"),
    ],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_several_processes_give_the_numbers_of_one(run, recordings: Path, name: str) -> None:
    one, two = (
        run(*COMMANDS[name], recordings, "--format", "json", "--jobs", jobs) for jobs in "12"
    )
    assert json.loads(one.stdout)["rows"] == FILES * 4000
    assert (two.returncode, two.stdout, two.stderr) == (one.returncode, one.stdout, one.stderr)


def test_stats_in_python_are_those_of_the_command_with_any_executor(run, recordings: Path) -> None:
    with ThreadPoolExecutor(2) as executor:
        found = [fte_sniff.stats(recordings, executor=one) for one in (None, executor)]
    printed = json.loads(run("stats", recordings, "--format", "json").stdout)
    assert found == [printed, printed]


@pytest.mark.parametrize(
    ("jobs", "files", "processes"),
    [(None, 1, 1), (None, 2, 2), (None, 4, 4), (None, 9, 4), (3, 2, 2), (3, 9, 3), (9, 9, 9)],
)
def test_each_core_has_a_process_but_never_more_than_files(
    monkeypatch: pytest.MonkeyPatch, jobs: int | None, files: int, processes: int
) -> None:
    monkeypatch.setattr("fte_sniff.recording.mcap.reader.cores", lambda: 4)
    job = FileJob(Path("x"), RecordingInput, StatisticsSummary)
    assert processes_for(jobs, [job] * files) == processes


@pytest.mark.parametrize("name", first(1, COMMANDS))
def test_a_cluster_gives_the_numbers_of_one_process(
    run, recordings: Path, address: str, name: str
) -> None:
    arguments = [*COMMANDS[name], recordings, "--format", "json"]
    one, many = run(*arguments, "--jobs", "1"), run(*arguments, "--cluster", address)
    assert (many.returncode, many.stdout, many.stderr) == (one.returncode, one.stdout, one.stderr)


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_midway_still_gives_them(
    run, environment: dict[str, str], tmp_path: Path, recordings: Path
) -> None:
    arguments = ["stats", str(recordings), "--format", "json"]
    expected = run(*arguments, "--jobs", "1").stdout
    with (
        cluster(2, tmp_path) as address,
        Client(address, set_as_default=False) as client,
        started(environment, tmp_path, *arguments, "--cluster", address) as process,
    ):
        assert process.stdout is not None
        wait_until(lambda: any(client.processing().values()))
        busy = next(worker for worker, tasks in client.processing().items() if tasks)
        worker_pid = client.run(os.getpid, workers=[busy])[busy]
        os.kill(worker_pid, signal.SIGKILL)
        reported = process.stdout.read().decode()
        assert process.wait(BOUND_S) == 0
    assert reported == expected


def test_a_cluster_that_loses_its_scheduler_ends_with_one_line(
    environment: dict[str, str], tmp_path: Path, recordings: Path
) -> None:
    with cluster(2, tmp_path) as address, Client(address, set_as_default=False) as client:
        scheduler = client.run_on_scheduler(os.getpid)
        for worker in client.run(os.getpid).values():
            os.kill(worker, signal.SIGSTOP)  # no file is done before the scheduler is gone
        with started(
            environment, tmp_path, "stats", str(recordings), "--cluster", address
        ) as process:
            wait_until(lambda: any(client.processing().values()))
            os.kill(scheduler, signal.SIGKILL)
            code, _, line = ended(process)
    assert code == 4
    assert line.count("\n") == 1
    assert "scheduler" in line
    assert f"0 of {FILES} files were read" in line


def test_a_file_that_the_workers_cannot_see_is_named(
    environment: dict[str, str], tmp_path: Path, recordings: Path, address: str
) -> None:
    first, second = sorted(recordings.iterdir())[:2]
    number = 200  # the workers have no such descriptor
    with first.open() as own:
        os.dup2(own.fileno(), number)
        unseen = f"/proc/self/fd/{number}"
        done = subprocess.run(
            [*PROGRAM, "stats", unseen, str(second), "--cluster", address, "--format", "json"],
            env=environment,
            pass_fds=[number],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=BOUND_S,
        )
    os.close(number)
    assert done.returncode == 4, done.stderr
    assert json.loads(done.stdout)["rows"] == 4000
    (line,) = done.stderr.splitlines()
    assert unseen in line
    assert "worker" in line


def test_ctrl_c_ends_all_processes_and_reports_what_was_read(
    environment: dict[str, str], tmp_path: Path, recordings: Path
) -> None:
    os.mkfifo(tmp_path / "waits.hex")
    writer = os.open(tmp_path / "waits.hex", os.O_RDWR)  # nothing is written
    arguments = ["stats", str(recordings), "waits.hex", "--jobs", "3"]
    with started(environment, tmp_path, *arguments) as process:
        wait_until(lambda: len(children_of(process.pid)) == 2)
        workers = children_of(process.pid)
        process.send_signal(signal.SIGINT)
        code, _, line = ended(process)
    os.close(writer)
    assert code == 130
    assert line.startswith("fte-sniff: interrupted; ")
    assert line.count("\n") == 1
    assert not any(Path(f"/proc/{worker}").exists() for worker in workers)


@pytest.mark.slow
def test_ctrl_c_while_a_cluster_reads_reports_what_was_read(
    environment: dict[str, str], tmp_path: Path, recordings: Path, address: str
) -> None:
    os.mkfifo(tmp_path / "waits.hex")
    writer = os.open(tmp_path / "waits.hex", os.O_RDWR)  # nothing is written
    arguments = ["stats", str(recordings), "waits.hex", "--cluster", address]
    with (
        Client(address, set_as_default=False) as client,
        started(environment, tmp_path, *arguments) as process,
    ):
        wait_until(lambda: any(client.processing().values()))
        process.send_signal(signal.SIGINT)
        code, _, line = ended(process)
    os.close(writer)
    assert code == 130
    assert line.startswith("fte-sniff: interrupted; ")
    assert line.count("\n") == 1


WORDS = st.text(st.sampled_from("ab/ 测é"), max_size=40)
CELLS = st.text(st.sampled_from("019.,msµ–"), max_size=12)


def table_of(lines: list[list[str]]) -> TextTable:
    table = TextTable(lines[0])
    for line in lines[1:]:
        table.append(line, mark="! ")
    return table


@st.composite
def tables(draw: st.DrawFn) -> list[list[str]]:
    columns = draw(st.integers(1, 5))
    line = st.tuples(WORDS, *[CELLS] * columns).map(list)
    return draw(st.lists(line, min_size=2, max_size=6))


@given(tables())
def test_without_a_width_nothing_is_cut(lines: list[list[str]]) -> None:
    reported = [text.plain for text in table_of(lines).lines(None)]
    assert len(reported) == len(lines)
    for text, cells in zip(reported, lines, strict=True):
        for cell in cells:
            assert cell.strip() in text


@given(tables(), st.integers(40, 120))
def test_it_keeps_to_the_width(lines: list[list[str]], width: int) -> None:
    reported = [text.plain for text in table_of(lines).lines(width)]
    assert max(map(cell_len, reported)) <= width
    assert len(reported) == len(lines)


def test_names_are_shortened_before_columns_are_left_out() -> None:
    lines = [["file", "rows", "bytes"], ["logs/" + "x" * 60 + "/end.mcap", "1,000", "10,000"]]
    head, line = (text.plain for text in table_of(lines).lines(50))
    assert line.endswith("end.mcap  1,000  10,000")
    assert head.endswith(" rows   bytes")
    head, line = (text.plain for text in table_of(lines).lines(LEAST_NAME + 10))
    assert "bytes" not in head
    assert line.endswith("end.mcap  1,000")
