"""What `live` keeps: rotation, triggers, bounds, pipes, and how often it is flushed."""

import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader

from fte_sniff.cli.options import Seconds
from fte_sniff.cli.recording_options import options_from, options_with, recording_options
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.retention import OnFull, RecordingOptions, TriggerWindow
from tests.cli.processes import BOUND_S, PROGRAM, ended, started, stderr_until, until

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
SIM = "sim://?seed=1&rate=500"
FAST = ("sim://?seed=1&rate=5000", "--baud", "1000000")
"""Many rows in little time."""


def _parse(decorator: Decorator, *arguments: str) -> tuple[RecordingOptions, str]:
    """The recording options that a command line gives, and the command's help."""
    found: list[RecordingOptions] = []

    @click.command()
    @decorator
    def command(**given: Any) -> None:
        found.append(options_from(None, **given))

    done = CliRunner().invoke(command, arguments)
    assert done.exit_code == 0, done.output
    return found[0], " ".join(CliRunner().invoke(command, ["--help"]).output.split())


def test_options_that_are_not_given_have_the_defaults_of_a_recording() -> None:
    assert _parse(recording_options)[0] == RecordingOptions()
    triggered, _ = _parse(recording_options, "--trigger", "error > 0")
    assert triggered == RecordingOptions(trigger_window=TriggerWindow())


@pytest.mark.parametrize(
    ("text", "seconds"), [("100ms", 0.1), ("2.5 s", 2.5), ("5min", 300.0), ("1m30s", 90.0)]
)
def test_every_time_takes_every_unit(text: str, seconds: float) -> None:
    trigger = ["--trigger", "error > 0", "--before", text, "--after", text]
    found, _ = _parse(recording_options, *trigger, "--rotate", "1d")
    assert found.trigger_window == TriggerWindow(seconds, seconds)
    assert found.rotate_s == 86_400
    context = click.Context(click.Command("x"))
    assert Seconds(min=0).convert(text, click.Option(["--duration"]), context) == seconds


def test_other_defaults_of_a_recording_are_those_of_the_options() -> None:
    defaults = RecordingOptions(
        flush_every_s=2.5, max_bytes=3_000_000_000, on_full=OnFull.ROTATE_OLDEST
    )
    found, shown = _parse(options_with(defaults))
    assert found == defaults
    window = TriggerWindow()
    times = f"{window.before_s:g}s]", f"{window.after_s:g}s]"
    for default in ("2.5;", "3GB", "rotate-oldest", *times):
        assert f"[default: {default}" in shown


def test_rotated_files_hold_every_row_once(run, tmp_path: Path) -> None:
    done = run("live", SIM, "--plain", "-o", "x.mcap", "--rotate", "1s", "--duration", "3.5")
    assert done.returncode == 0
    files = sorted(tmp_path.glob("*.mcap"))
    assert [file.name for file in files][:2] == ["x_00001.mcap", "x_00002.mcap"]
    assert f"recorded to x_00001.mcap to {files[-1].name}\n" in done.stderr
    assert f"{len(files)} files; all of them: fte-sniff decode 'x_*.mcap'" in done.stderr
    readers = [RecordingReader(file) for file in files]
    rows = [row for reader in readers for row in reader]
    assert all((reader.ending, reader.losses) == ("", ()) for reader in readers)
    assert [row.offset for row in rows] == list(range(0, 10 * len(rows), 10))
    assert f"{len(rows):,} rows" in done.stderr


def test_a_trigger_keeps_what_surrounds_its_rows(run, tmp_path: Path) -> None:
    trigger = "kind = 'speed_feedback' AND motor = 4 AND offset < 400"
    options = ("--trigger", trigger, "--before", "0.02s", "--after", "0.1s")
    done = run("live", SIM, "--plain", "-o", "x.mcap", *options, "--count", "900")
    assert done.returncode == 0
    reader = RecordingReader(tmp_path / "x.mcap")
    kept = list(reader)
    assert (reader.ending, reader.losses) == ("", ())
    assert 0 < len(kept) < 300
    assert reader.metadata["fte-sniff"]["trigger"] == trigger
    with (tmp_path / "x.mcap").open("rb") as file:
        left_out = [
            int(one.metadata["rows"])
            for one in make_reader(file).iter_metadata()
            if one.name == "fte-sniff.left-out"
        ]
    assert sum(left_out) == 900 - len(kept)
    assert "900 rows" in done.stderr
    assert f"recorded {len(kept)} of 900 rows (1 event) to x.mcap" in done.stderr


def test_a_trigger_that_never_fired_is_reported(run, tmp_path: Path) -> None:
    done = run("live", SIM, "--plain", "-o", "x.mcap", "--trigger", "rpm > 30000", "--count", "90")
    assert done.returncode == 0
    assert "recorded 0 of 90 rows (--trigger never fired) to x.mcap" in done.stderr
    decoded = run("decode", "x.mcap")  # the wire was not silent
    assert decoded.stderr == "0 rows; 90 rows in 1 place left out when recorded\n"
    for command in (("stats", "x.mcap"), ("report", "x.mcap", "-o", "x.html")):
        assert "check the wire" not in run(*command).stderr


@pytest.mark.parametrize("name", ["-", "/dev/stdout"])
def test_the_recording_on_standard_output_is_all_that_is_there(
    environment, tmp_path: Path, name: str
) -> None:
    done = subprocess.run(
        [*PROGRAM, "live", SIM, "-o", name, "--count", "200"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=environment,
        cwd=tmp_path,
        timeout=BOUND_S,
    )
    assert done.returncode == 0
    assert b"recording to standard output" in done.stderr
    (tmp_path / "x.mcap").write_bytes(done.stdout)
    reader = RecordingReader(tmp_path / "x.mcap")
    assert len(list(reader)) == 200
    assert (reader.ending, reader.losses) == ("", ())
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


def test_a_reader_of_the_recording_that_goes_ends_it_in_one_line(
    environment, tmp_path: Path
) -> None:
    with started(environment, tmp_path, "live", SIM, "-o", "-") as process:
        assert process.stdout is not None
        assert process.stdout.read(100).startswith(b"\x89MCAP")
        process.stdout.close()
        assert process.stderr is not None
        reported = process.stderr.read().decode()
        assert process.wait(BOUND_S) == 4
    said = r"fte-sniff: standard output: its reader is gone; the recording ended after [\d,]+ rows"
    assert len(re.findall(said, reported)) == reported.count("gone") == 1
    assert "not recorded" not in reported
    assert "Traceback" not in reported


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--rotate", "1"], "at least 100 kB"),
        (["--rotate", "0s"], "at least 1 s"),
        (["--rotate", "soon"], "512MB or 1h"),
        (["--rotate", "none", "--on-full", "rotate-oldest"], "leave out --rotate none"),
        (["--max-size", "5"], "--max-size: a file has at least 100 kB"),
        (["--max-size", "big"], "512MB, 2GB or none"),
        (["--rotate", "1GB", "--max-size", "1GB"], "room for two files"),
        (["--rotate", "9" * 400], "9…' is too large for a size; use for example 512MB"),
        (["--rotate", "9" * 400 + "s"], "9…' is too large for a time; use for example 100ms"),
        (["--max-size", "9" * 400], "9…' is too large"),
        (["--min-free", "9" * 400 + "TiB"], "9…' is too large"),
        (["--trigger", "motor = 1", "--before", "9" * 400 + "s"], "9…' is too large"),
        (["--trigger", "motor = 1", "--after", "9" * 400 + "h"], "9…' is too large"),
        (["--before", "5s"], "--trigger"),
        (["--rotate", "5m"], "'5m' is ambiguous; write 5MB or 5min"),
        (["--duration", "5 parsecs"], "100ms, 10s, 5min or 1h"),
        (["--after", "5"], "10s, 5min or 1h"),
        (["--trigger", "speed ="], "speed ="),
        (["--rotate", "1h", "-o", "-"], "cannot be rotated"),
        (["--flush-every", "0"], "0.05"),
        (["--on-full", "panic"], "rotate-oldest"),
        (["-o", "a.csv"], "name it a.mcap, and convert it with `fte-sniff decode a.mcap"),
        (["-o", "a.BIN"], "recorded as MCAP"),
    ],
)
def test_what_cannot_be_kept_so_is_one_line(
    run, tmp_path: Path, options: list[str], words: str
) -> None:
    done = run("live", SIM, "--count", "1", *options)
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.splitlines()) <= 3
    assert list(tmp_path.iterdir()) == []


def test_too_little_room_is_reported_before_the_first_row(run, tmp_path: Path) -> None:
    done = run("live", SIM, "--count", "1", "--min-free", "100000TB")
    assert done.returncode == 4
    assert "--min-free" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_bound_of_a_forgotten_capture_is_reported_at_once_and_the_rows_go_on(
    environment, tmp_path: Path
) -> None:
    options = ("--max-size", "100kB", "--plain", "-o", "x.mcap")
    with started(environment, tmp_path, "live", *FAST, *options) as process:
        stderr_until(process, "its files have reached 100 kB (--max-size)")
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 4
    assert "were not recorded" in errors
    assert RecordingReader(tmp_path / "x.mcap").metadata


def test_the_oldest_file_makes_room_where_that_is_asked_for(environment, tmp_path: Path) -> None:
    options = ("--max-size", "200kB", "--on-full", "rotate-oldest", "--flush-every", "0.1")
    with started(environment, tmp_path, "live", *FAST, *options, "-o", "x.mcap") as process:
        while not (tmp_path / "x_00009.mcap").exists():
            until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    files = sorted(tmp_path.glob("*.mcap"))
    assert files[0].name != "x_00001.mcap"
    rows = [row for file in files for row in RecordingReader(file)]
    first = rows[0].offset
    gone = int(files[0].stem[-5:]) - 1
    assert f"recorded to {files[0].name} to {files[-1].name}; {gone} older file" in errors
    assert f" with {first // 10:,} rows deleted (--on-full rotate-oldest)" in errors
    assert [row.offset for row in rows] == list(range(first, first + 10 * len(rows), 10))
