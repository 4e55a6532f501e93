"""`bridge` as a program: the test is the host program at one end, the controller at the other."""

from __future__ import annotations

import os
import select
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from tests.cli.conftest import decoded
from tests.cli.processes import (
    BOUND_S,
    Process,
    ended,
    started,
    until,
    wait_until,
    wire,
)

pytestmark = pytest.mark.program

SPEED = bytes.fromhex("AA010103E800000000EE")
ANSWER = bytes.fromhex("5501010000000000 0FEE")


@contextmanager
def bridged(environment, folder: Path, *options: str) -> Iterator[tuple[Process, int, str]]:
    """A bridge with its link `motors`: the process, the controller's end, and the port's name."""
    with (
        wire() as (far, name),
        started(
            environment, folder, "bridge", name, "--link", "motors", "--plain", *options
        ) as process,
    ):
        wait_until(lambda: (folder / "motors").exists() or process.poll() is not None)
        yield process, far, name


def opened(folder: Path, baud: int = 115200) -> serial.Serial:
    return serial.Serial(str(folder / "motors"), baud, timeout=BOUND_S)


def talk(host: serial.Serial, far: int) -> None:
    """One command there and one answer back."""
    host.write(SPEED)
    heard = b""
    while len(heard) < len(SPEED):
        assert select.select([far], [], [], BOUND_S)[0]
        heard += os.read(far, 100)
    assert heard == SPEED
    os.write(far, ANSWER)
    assert host.read(len(ANSWER)) == ANSWER


@pytest.mark.smoke
def test_both_directions_are_passed_on_shown_and_recorded(run, environment, tmp_path: Path):
    with bridged(environment, tmp_path, "-o", "x.mcap") as (process, far, name):
        with opened(tmp_path) as host:
            talk(host, far)
            shown = until(process, b"speed_feedback").decode()
        process.send_signal(signal.SIGINT)
        code, rest, errors = ended(process)
    assert code == 0
    assert "motor=1 rpm=1000" in shown + rest
    assert "a host program can open motors" in errors
    rows = decoded(run, "x.mcap")
    directions = {row["port"]: row["direction"] for row in rows}
    assert directions == {"host": "control", name: "feedback"}
    assert not (tmp_path / "motors").is_symlink()


def test_a_lost_port_ends_both(run, environment, tmp_path: Path):
    with bridged(environment, tmp_path, "-o", "x.mcap") as (process, far, name):
        with opened(tmp_path) as host:
            talk(host, far)
            os.close(far)
            with pytest.raises(serial.SerialException):
                host.read(1)
        code, _, errors = ended(process)
    assert code == 3
    assert f"{name} was lost" in errors
    assert len(decoded(run, "x.mcap")) == 2


def test_after_a_kill_the_link_can_be_had_again(environment, tmp_path: Path):
    with bridged(environment, tmp_path, "--no-record") as (process, far, _):
        with opened(tmp_path) as host:
            talk(host, far)
        process.kill()
        ended(process)
        # The capture process meets the end of the view, and takes the link with it.
        wait_until(lambda: not (tmp_path / "motors").is_symlink())
    with bridged(environment, tmp_path, "--no-record") as (_, far, _), opened(tmp_path) as host:
        talk(host, far)


def test_what_is_in_the_way_of_the_link_stays(run, tmp_path: Path):
    (tmp_path / "motors").write_text("mine")
    done = run("bridge", "sim://?host=off", "--link", "motors", "--no-record")
    assert done.returncode == 4
    assert done.stderr == "fte-sniff: motors exists already: remove it, or name another\n"
    assert (tmp_path / "motors").read_text() == "mine"


def test_a_host_program_in_front_of_a_simulated_controller(environment, tmp_path: Path):
    with started(
        environment, tmp_path, "bridge", "sim://?host=off", "--link", "motors", "--no-record"
    ) as process:
        wait_until(lambda: (tmp_path / "motors").exists())
        with opened(tmp_path) as host:
            host.write(SPEED)
            until(process, b"motor=1 rpm=1000 error=0x00")
        process.terminate()
        assert ended(process)[0] == 0


def test_a_simulated_controller_prints_its_device_as_the_docs_show(environment, tmp_path: Path):
    docs = (Path(__file__).parents[2] / "docs" / "develop.md").read_text("utf-8")
    shown = docs.partition("$ fte-sniff simulate --link ./controller\n")[2].partition("```")[0]
    with started(environment, tmp_path, "simulate", "--link", "./controller") as process:
        lines = [stream.readline().decode() for stream in (process.stdout, process.stderr)]
        process.terminate()
    assert "".join(lines) == shown


def test_damaged_recording_is_played_and_its_losses_are_named(
    run, environment, samples: Path, tmp_path: Path
) -> None:
    content = bytearray((samples / "clean.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "cut.mcap").write_bytes(content)
    told = run("decode", "cut.mcap", "-o", "x.raw", "--filter", "direction = 'feedback'").stderr
    options = ("--replay", "cut.mcap", "--speed", "1000", "--link", "motors")
    with started(environment, tmp_path, "simulate", *options) as process:
        wait_until(lambda: (tmp_path / "motors").exists())
        expected = (tmp_path / "x.raw").read_bytes()
        with opened(tmp_path) as host:
            assert host.read(len(expected)) == expected
        code, _, errors = ended(process)
    note, waits, played = errors.splitlines()
    assert code == 0
    assert note == told.splitlines()[0]
    assert "cut.mcap: bytes " in note
    assert waits.startswith(f"{len(expected) // 10:,} feedback frames wait")
    assert played == f"played {len(expected):,} bytes"
