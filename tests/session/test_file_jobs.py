"""Jobs for files: any split of a capture into files gives the numbers of one file."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fte_sniff
from fte_sniff.analysis.rules import RuleCheck, parse_rule
from fte_sniff.analysis.statistics import LineSetup, StatisticsSummary
from fte_sniff.errors import FileError, InputTextError
from fte_sniff.protocol import KIND_BY_NAME, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.session.file_jobs import (
    FileJob,
    FileMerger,
    FileResult,
    WorkerPool,
    finished_jobs,
)
from fte_sniff.session.inputs import Input, InputReading, RecordingInput
from tests.analysis.pieces import Step, captures, pieces_of, state_of
from tests.analysis.test_measures import EXPECTED
from tests.analysis.test_statistics import SECOND, frame
from tests.beside import running
from tests.cli.processes import BOUND_S, wait_until
from tests.examples import examples
from tests.support.in_workers import opened_or_killed
from tests.support.recorded_rows import write_recording

START = "2026-01-31T12:00:00.000000000Z"
PORTS = [PortFacts("a", 115_200), PortFacts("b", 115_200)]


def opened(path: Path) -> Input:
    return RecordingInput(Recording(path))


def new_model(rules):
    return partial(StatisticsSummary, LineSetup()) if rules is None else partial(RuleCheck, rules)


def measured(paths: Sequence[Path], model, executor=None, filter_text: str | None = None):
    make = new_model(model)
    merger = FileMerger(make(), InputReading([]))
    jobs = [FileJob(path, opened, make, filter_text=filter_text) for path in paths]
    for job, result in finished_jobs(jobs, executor, 3, helps=True):
        assert not isinstance(result, FileError), result
        merger.add(job, result)
    return merger.model


def write_parts(folder: Path, parts: Sequence[Sequence[Row | PortEvent]]) -> list[Path]:
    folder.mkdir()
    paths = []
    for number, part in enumerate(parts, 1):
        rows = [one for one in part if isinstance(one, Row)]
        events = [one for one in part if isinstance(one, PortEvent)]
        facts = {"start": START, "host": "here", "part": str(number)}
        paths.append(folder / f"{number}.mcap")
        write_recording(paths[-1], PORTS, [Rows.of(rows, events=events)], facts)
    return paths


def numbers(model: StatisticsSummary | RuleCheck) -> object:
    if isinstance(model, RuleCheck):
        found = model.verdicts()
        return [replace(one, row=one.row and one.row._replace(file="")) for one in found]
    parts = model.total, model.statistics, model.answers, model.flags
    return [state_of(part) for part in parts]


@examples(25, deadline=None)
@given(captures(), st.lists(st.integers(0, 25), max_size=3))
def test_any_split_into_files_gives_the_numbers_of_one_file(
    tmp_path_factory: pytest.TempPathFactory, steps: list[Step], cuts: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("split")
    rows = [one for one in steps if isinstance(one, Row) and one.t_ns is not None]
    rows.sort(key=lambda row: row.t_ns or 0)
    whole = write_parts(folder / "whole", [rows])
    parts = list(pieces_of(rows, cuts))
    split = write_parts(folder / "split", parts)
    held = {
        (row.t_ns, row.port, row.offset, str(path))
        for path, part in zip(split, parts, strict=True)
        for row in part
    }
    rules = [parse_rule(text) for text in EXPECTED]
    with ThreadPoolExecutor(2) as executor:
        for model in (None, rules):
            expected = numbers(measured(whole, model))
            assert numbers(measured(split, model)) == expected
            found = measured(split, model, executor)
            assert numbers(found) == expected
    named = [one.row for one in found.verdicts() if one.row]
    assert {(one.t_ns, one.port, one.offset, one.file) for one in named} <= held


def sent(kind: str, t_ns: int, port: str, number: int) -> Row:
    values = dict.fromkeys((field.name for field in KIND_BY_NAME[kind].fields), 1)
    return Row(port, 10 * number, encode(KIND_BY_NAME[kind], values), t_ns)


def two_wires(lost: range, seconds: int = 10) -> list[Row | PortEvent]:
    """A command on `a` and its answer on `b` every second, but none while `b` is lost, or later."""
    found: list[Row | PortEvent] = []
    for number in range(seconds):
        t_ns = 10**18 + number * SECOND
        found.append(sent("speed", t_ns, "a", number))
        if number == lost.start:
            found.append(PortEvent(t_ns + 1, "b", PortEventKind.LOST, "unplugged"))
        if number not in lost and number != seconds - 2:
            found.append(sent("speed_feedback", t_ns + SECOND // 100, "b", number))
        if number == lost.stop - 1:
            found.append(PortEvent(t_ns + SECOND // 2, "b", PortEventKind.FOUND_AGAIN, ""))
    return found


@pytest.mark.parametrize("cuts", [[], [7], [4, 11], [5, 8, 10], [3, 3, 20]])
def test_the_time_of_a_lost_port_is_not_a_gap_and_leaves_no_command_unanswered(
    tmp_path: Path, cuts: list[int]
) -> None:
    """Commands are seen while the wire of their answers is lost, for five seconds."""
    steps = two_wires(range(2, 7))
    ends = [0, *cuts, len(steps)]
    parts = [steps[start:end] for start, end in pairwise(ends)]
    paths = write_parts(tmp_path / "parts", parts)
    # The answer in second 8 is missing too; only that one is known to be.
    rules = {"unanswered()": 1, "delay(max)": 10, "max_gap(feedback)": 2, "max_gap(control)": 1}
    parsed = [parse_rule(f"{measure} == 0") for measure in rules]
    with ThreadPoolExecutor(2) as executor:
        for one in (None, executor):
            motor = measured(paths, None, one).answers.stats()[0]
            counts = motor.commands, motor.pairing.answered, motor.pairing.unanswered
            assert counts == (10, 4, 1)
            found = [verdict.value for verdict in measured(paths, parsed, one).verdicts()]
            assert found == pytest.approx([*rules.values()])


def test_a_baud_that_changed_in_one_file_holds_in_the_next(tmp_path: Path) -> None:
    rows = [reset_at(number) for number in range(6)]
    change = PortEvent(rows[1].t_ns + 1, "a", PortEventKind.BAUD_CHANGED, "", 9600)
    whole = measured(write_parts(tmp_path / "whole", [[*rows, change]]), None)
    parts = [[*rows[:3], change], rows[3:4], rows[4:]]
    split = measured(write_parts(tmp_path / "split", parts), None)
    assert [one.statistics.ports()[0].baud for one in (whole, split)] == [9600, 9600]
    assert numbers(split) == numbers(whole)


def reset_at(number: int) -> Row:
    row = frame("reset", 10**18 + number * SECOND, port="a")
    return type(row)(row.port, 10 * number, row.raw, row.t_ns)


def test_files_of_other_captures_are_not_continued(tmp_path: Path) -> None:
    rows = [reset_at(number) for number in range(4)]
    whole = measured(write_parts(tmp_path / "one", [rows]), None)
    other = [type(row)(row.port, row.offset + 7, row.raw, row.t_ns) for row in rows[2:]]
    paths = [
        write_parts(tmp_path / "a", [rows[:2]])[0],
        tmp_path / "b.mcap",
    ]
    write_recording(paths[1], PORTS, [Rows.of(other)], {"start": "x", "host": "here"})
    apart = measured(paths, None)
    assert whole.statistics.streams(None)[0].periods.count == 3
    assert apart.statistics.streams(None)[0].periods.count == 2


def test_a_killed_worker_costs_its_own_file_alone(tmp_path: Path) -> None:
    paths = write_parts(tmp_path / "parts", [[reset_at(0)], [reset_at(1)]])
    opens = partial(opened_or_killed, reader=os.getpid(), mark=tmp_path / "mark")
    make = partial(StatisticsSummary, LineSetup())
    with WorkerPool(1) as pool:
        jobs = [FileJob(path, opens, make) for path in paths]
        found = list(finished_jobs(jobs, pool, 2, helps=True))
    # Which of both files the worker took depends on how fast it started.
    assert [isinstance(result, FileResult) for _, result in found].count(True) == 1
    ((job, lost),) = [one for one in found if isinstance(one[1], FileError)]
    assert re.fullmatch(rf"{re.escape(job.name)}: .* was killed by signal 9; .*", str(lost))


def test_what_is_wrong_with_a_recording_is_a_warning(tmp_path: Path) -> None:
    (good,) = write_parts(tmp_path / "good", [[reset_at(number) for number in range(9)]])
    good.write_bytes(good.read_bytes()[:-20])
    with pytest.warns(
        fte_sniff.RecordingWarning, match="could not be read: the file is damaged or cut off"
    ) as caught:
        assert fte_sniff.stats(good)["rows"] == 9
    assert [one.filename for one in caught] == [__file__]


def test_check_in_python_gives_the_same_with_any_executor(tmp_path: Path) -> None:
    rows = [reset_at(number) for number in range(9)]
    write_parts(tmp_path / "parts", [rows[:3], rows[3:5], rows[5:]])
    rules = ["count(kind = 'reset') == 9", "max_gap(kind = 'reset') == 1", "duration() == 8"]
    with ThreadPoolExecutor(2) as executor:
        parts = tmp_path / "parts"
        found = [fte_sniff.check(parts, rules, executor=one) for one in (None, executor)]
    assert found[0] == found[1]
    assert [one.result for one in found[0]] == ["pass"] * 3
    assert fte_sniff.check(parts, rules[0]) == found[0][:1]
    with pytest.raises(FileError):
        fte_sniff.check(tmp_path / "absent.mcap", rules)
    with pytest.raises(InputTextError):
        fte_sniff.check(tmp_path / "parts", ["count(x) == 0"])
    log = tmp_path / "log.txt"
    log.write_text("55 01 02 00 00 00 00 00 0F EE\n")
    for use in (fte_sniff.read, fte_sniff.stats):
        with pytest.raises(FileError, match="make one of a log: `fte-sniff decode --input hex"):
            use(log)


WAIT_IN = (
    "import os, pathlib, signal; pathlib.Path({folder!r}, str(os.getpid())).touch(); signal.pause()"
)
"""What a worker calls is of the standard library, so that it need not load this module."""


def test_workers_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    program = (
        "from fte_sniff.session.file_jobs import WorkerPool\n"
        f"WorkerPool(1).submit(exec, {WAIT_IN.format(folder=str(tmp_path))!r}).result()"
    )
    with running([sys.executable, "-c", program]) as process:
        wait_until(lambda: bool(list(tmp_path.iterdir())))
        (worker,) = tmp_path.iterdir()
        process.kill()
    os.kill(int(worker.name), signal.SIGKILL)  # it is in the middle of its work
    assert process.wait(BOUND_S) == -signal.SIGKILL
