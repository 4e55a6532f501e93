"""`live` on real terminals and sim://: however it ends, the file is closed and nothing lost."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
from pathlib import Path
from time import monotonic

import pytest

from tests.cli.processes import BOUND_S, FRAME, PROGRAM, ended, hears, holding, started, until, wire

SPEED = bytes.fromhex("AA010103E800000000EE")
SILENT = "sim://?host=off&wire=control"


def test_count_ends_it_and_the_recording_holds_just_that(run, tmp_path: Path) -> None:
    done = run("live", "sim://?seed=1&rate=1000", "--plain", "--count", "25", "-o", "x.mcap")
    assert done.returncode == 0
    header, *lines = done.stdout.splitlines()
    assert header.split() == ["time", "offset", "kind", "values", "raw", "faults"]
    assert len(lines) == 25
    recorded = run("decode", "x.mcap")
    assert recorded.stdout == done.stdout
    assert "recorded to x.mcap" in done.stderr


@pytest.mark.parametrize("duration", ["0.4", "0.4s", "0.005 min"])
def test_duration_ends_it(run, duration: str) -> None:
    done = run("live", "sim://?rate=500", "--duration", duration, "--no-record")
    assert done.returncode == 0
    assert 20 <= done.stdout.count("\n") <= 300


@pytest.mark.parametrize("command", ["live", "bridge"])
def test_duration_ends_a_line_where_nobody_is_ever_heard(run, command: str) -> None:
    done = run(command, SILENT, "--plain", "--duration", "0.4", "--no-record")
    assert done.returncode == 0
    assert "nothing came" in done.stderr


def test_no_controller_is_simulated_that_nobody_could_hear(run) -> None:
    done = run("simulate", "--wire", "control")
    assert (done.returncode, done.stdout) == (2, "")
    assert "add --host on" in done.stderr


def test_doctor_finds_a_line_silent_where_nobody_is_ever_heard(run) -> None:
    assert "nothing came" in run("doctor", SILENT, "--seconds", "0.4").stdout


def test_the_default_recording_is_named_after_the_time_and_told(run, tmp_path: Path) -> None:
    done = run("live", "sim://?rate=1000", "--count", "3")
    (recording,) = tmp_path.iterdir()
    assert recording.name.startswith("fte-sniff-20")
    assert recording.name.endswith("Z.mcap")
    assert done.stderr.count(recording.name) == 2


def test_no_record_leaves_nothing(run, tmp_path: Path) -> None:
    run("live", "sim://?rate=1000", "--count", "3", "--no-record")
    assert list(tmp_path.iterdir()) == []


def test_the_filter_is_for_the_eyes_and_all_is_recorded(run, tmp_path: Path) -> None:
    arguments = ["--count", "40", "-o", "x.mcap", "--filter", "motor = 2"]
    done = run("live", "sim://?seed=1&rate=1000", *arguments)
    shown = done.stdout.splitlines()[1:]
    assert shown
    assert all("motor=2" in line for line in shown)
    assert len(run("decode", "x.mcap").stdout.splitlines()) == 41


def test_a_real_terminal(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--plain", "-o", "x.mcap") as process,
    ):
        hears(process, far)
        os.write(far, b"\x13\x37" + SPEED)
        assert b"motor=1 rpm=1000" in until(process, b"motor=1 rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "recorded to x.mcap" in errors
    rows = decoded(run, "x.mcap")
    assert rows[-1]["raw"] == SPEED.hex().upper()
    assert rows[-2]["faults"] == ["noise"]


def test_nothing_is_written_to_the_wire(environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--plain", "--no-record") as process,
    ):
        hears(process, far)
        process.terminate()
        assert ended(process)[0] == 0
        assert select.select([far], [], [], 0)[0] == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_with_the_file_closed(run, environment, tmp_path: Path, number) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        process.send_signal(number)
        code, output, errors = ended(process)
    assert code == 0
    assert "Traceback" not in errors
    done = run("decode", "x.mcap")
    assert "cut" not in done.stderr
    assert done.stdout.splitlines()[-1] in output or not output


def test_unplugged_keeps_all_that_came_before(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--plain", "-o", "x.mcap") as process,
    ):
        hears(process, far)
        os.write(far, FRAME * 50 + SPEED + FRAME[:4])
        # The system drops what nobody has read when the far end hangs up: wait until it is read.
        until(process, b"motor=1 rpm=1000")
        os.close(far)
        code, _, errors = ended(process)
    assert code == 3
    assert f"{name} was lost" in errors
    assert "Traceback" not in errors
    rows = decoded(run, "x.mcap")
    assert len(rows) >= 52
    assert rows[-1]["raw"] == FRAME[:4].hex().upper()


def test_a_closed_pipe_ends_it_quietly(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        assert process.stdout is not None
        process.stdout.close()
        process.stdout = None
        code, _, errors = ended(process)
    assert code == 0
    assert "Traceback" not in errors
    assert "BrokenPipe" not in errors
    assert run("decode", "x.mcap").returncode == 0


def test_a_killed_view_leaves_a_closed_file(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        process.kill()
        process.wait()
    # The capture process ends by itself once it finds that nobody listens.
    deadline = monotonic() + BOUND_S
    while (holders := holding(tmp_path / "x.mcap")) and monotonic() < deadline:
        select.select([], [], [], 0.02)
    assert holders == []
    done = run("decode", "x.mcap")
    assert done.returncode == 0
    assert done.stdout.count("\n") > 1


def test_a_killed_capture_is_told_and_its_file_opens(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        (capture,) = holding(tmp_path / "x.mcap")
        os.kill(capture, signal.SIGKILL)
        code, _, errors = ended(process)
    assert code == 3
    assert "ended unexpectedly" in errors
    assert run("decode", "x.mcap").returncode == 0


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--duration", "nan"], 2, "not a number of seconds"),
        (["--flush-every", "nan"], 2, "not a number of seconds"),
        (["--duration", "0"], 2, "x>0"),
        (["--duration", "-1"], 2, "x>0"),
        (["--duration", "soon"], 2, "soon"),
        (["--baud", "0"], 2, "50..12000000"),
        (["--baud", "-1"], 2, "50..12000000"),
        (["--baud", "99999999999999999999"], 2, "50..12000000"),
        (["--baud", "300"], 3, "300 baud carries at most"),
    ],
)
def test_what_cannot_be_asked_for_is_one_line(run, tmp_path: Path, options, code, words) -> None:
    done = run("live", "sim://?rate=1000", "--count", "3", *options)
    assert done.returncode == code
    assert done.stderr.count("\n") == 1
    assert words in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seconds", ["inf", "1e308"])
def test_a_duration_beyond_all_bounds_is_none(run, seconds: str) -> None:
    done = run("live", "sim://?rate=1000", "--duration", seconds, "--count", "3", "--no-record")
    assert done.returncode == 0
    assert done.stdout.count("\n") == 4


def test_a_working_folder_that_is_gone_is_one_line(environment, tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    done = subprocess.run(
        ["sh", "-c", 'rmdir "$PWD" && exec "$@"', "sh", *PROGRAM, "live", "sim://", "--count", "3"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        cwd=tmp_path / "gone",
        env=environment,
        timeout=BOUND_S,
        check=False,
    )
    assert done.returncode == 4
    assert done.stderr.count(b"\n") == 1
    assert b"the working folder is gone" in done.stderr


def decoded(run, name: str) -> list[dict]:
    done = run("decode", name, "--format", "jsonl")
    assert done.returncode == 0
    return [json.loads(line) for line in done.stdout.splitlines()]
