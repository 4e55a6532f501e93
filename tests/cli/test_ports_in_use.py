"""A port that another program reads, and a wire that falls silent, as a user sees them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.beside import held
from tests.cli.processes import ended, first_output, started, stderr_until, wire

FRAME = bytes.fromhex("55 01 02 03 E8 00 00 00 0F EE")


@pytest.mark.parametrize("command", ["live", "bridge"])
def test_port_that_another_program_holds_is_refused(run, command: str) -> None:
    with wire() as (_, name):
        near = os.open(name, os.O_RDWR | os.O_NOCTTY)
        with held(near) as other:
            os.close(near)
            done = run(command, name, "--no-record", "--duration", "1")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr == (
        f"fte-sniff: {name} is busy: sleep (pid {other.pid}) has it open; watch that program with "
        f"`fte-sniff live --attach {name}`, or read beside it with --share, which may "
        "take bytes from it\n"
    )


@pytest.mark.parametrize("mode", ["--plain", "--headless"])
def test_other_reader_is_one_line_and_a_note_of_the_recording(
    run, environment, tmp_path: Path, mode: str
) -> None:
    with wire() as (far, name):
        words = ("live", name, "--share", mode, "-o", "x.mcap")
        with started(environment, tmp_path, *words) as process:
            near = os.open(name, os.O_RDWR | os.O_NOCTTY)
            with held(near) as other:
                os.close(near)
                # Until it is started, the process has the name of this one.
                expected = f"(pid {other.pid}) has it open too, and may take bytes away\n"
                said = stderr_until(process, expected)
                for _ in range(20):
                    os.write(far, FRAME)
            process.send_signal(signal.SIGTERM)
            said += ended(process)[2]
    assert said.count(" has it open too") == 1
    assert "another program had the port open" in run("findings", "x.mcap").stdout


@pytest.mark.parametrize("mode", ["--plain", "--headless"])
def test_silence_is_two_lines_and_counted(run, environment, tmp_path: Path, mode: str) -> None:
    with wire() as (far, name):
        words = ("live", name, mode, "-o", "x.mcap", "--silence", "0.3")
        with started(environment, tmp_path, *words) as process:
            if mode == "--plain":
                first_output(process, far)
            else:
                stderr_until(process, "recording to")
                os.write(far, FRAME * 20)
            stderr_until(process, f"{name}: silent for 0.3 s\n")
            os.write(far, FRAME * 20)
            stderr_until(process, f"{name}: bytes again after ")
            process.send_signal(signal.SIGTERM)
            assert ended(process)[0] == 0
    assert "the wire was silent" in run("findings", "x.mcap").stdout


def test_share_does_not_go_with_attach(run) -> None:
    done = run("live", "--attach", "--share", "/dev/ttyUSB0")
    assert done.returncode == 2
    assert "there is nothing to share: leave one out" in done.stderr
    assert "URLs and Windows ports cannot" in run("live", "--share", "sim://").stderr
