"""`stats` and `check` over many files: in one process, in several, on a cluster; tables."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len

import fte_sniff
from fte_sniff.cli.measuring import LEAST_NAME, TextTable
from tests.cli.processes import BOUND_S, PROGRAM
from tests.needs import needs
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
@needs("cluster")
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


@pytest.mark.parametrize("name", first(1, COMMANDS))
def test_a_cluster_gives_the_numbers_of_one_process(
    run, recordings: Path, address: str, name: str
) -> None:
    arguments = [*COMMANDS[name], recordings, "--format", "json"]
    one, many = run(*arguments, "--jobs", "1"), run(*arguments, "--cluster", address)
    assert (many.returncode, many.stdout, many.stderr) == (one.returncode, one.stdout, one.stderr)


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
