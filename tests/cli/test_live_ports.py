"""`live` on ports that go and come, and on two wires: real terminals, servers and processes."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic

import pytest

from fte_sniff.protocol import PortEventKind
from fte_sniff.recording.reader import RecordingReader
from tests.cli.processes import (
    BOUND_S,
    FRAME,
    Process,
    ended,
    hears,
    holding,
    started,
    until,
    wait_until,
    wire,
)

SPEED = bytes.fromhex("AA010103E800000000EE")
FEEDBACK = bytes.fromhex("550101000000000000EE")


class Adapter:
    """A link such as udev keeps, and the far end of the terminal that it leads to."""

    def __init__(self, folder: Path) -> None:
        self.name = str(folder / "adapter")
        self.far = -1

    def plug(self) -> str:
        """Put a new terminal behind the link; its name."""
        self.far, near = os.openpty()
        tty.setraw(near)
        device = os.ttyname(near)
        os.close(near)
        Path(self.name).symlink_to(device)
        return device

    def pull(self) -> None:
        Path(self.name).unlink(missing_ok=True)
        with suppress(OSError):
            os.close(self.far)


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    adapter = Adapter(tmp_path)
    yield adapter
    adapter.pull()


def told(process: Process, wanted: str) -> str:
    """What it says on standard error until `wanted` is in a whole line, its output read too."""
    assert process.stdout is not None
    assert process.stderr is not None
    found, deadline = b"", monotonic() + BOUND_S
    while not (wanted.encode() in found and found.endswith(b"\n")):
        assert monotonic() < deadline, found
        for stream in select.select([process.stdout, process.stderr], [], [], 1.0)[0]:
            more = os.read(stream.fileno(), 1 << 16)
            found += more if stream is process.stderr else b""
    return found.decode()


def rows_of(run, file: str) -> list[dict]:
    done = run("decode", file, "--format", "jsonl")
    assert done.returncode == 0
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_lost_port_is_waited_for_and_found_again(
    run, environment, tmp_path: Path, adapter: Adapter
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        hears(process, adapter.far)
        os.write(adapter.far, SPEED + FRAME[:6])
        # What the system has not handed over yet goes with the line; so wait until all is read.
        until(process, b"rpm=1000")
        adapter.pull()
        assert "waiting for it to come back" in told(process, "adapter lost: ")
        device = adapter.plug()
        assert f"s as {device}" in told(process, "adapter found again: after ")
        os.write(adapter.far, FRAME[6:] + SPEED * 3)
        until(process, b"rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "port events: lost 1, found_again 1" in errors
    rows = rows_of(run, "x.mcap")
    # The frame that was cut in two is two pieces, and no byte is missing.
    pieces = [row["raw"] for row in rows if row["faults"]]
    assert pieces == [FRAME[:6].hex().upper(), FRAME[6:].hex().upper()]
    assert [row["offset"] for row in rows] == [
        sum(row["length"] for row in rows[:number]) for number in range(len(rows))
    ]
    assert rows[-1]["raw"] == SPEED.hex().upper()
    events = [event.kind for event in RecordingReader(tmp_path / "x.mcap").events()]
    assert events == [
        PortEventKind.OPENED,
        PortEventKind.LOST,
        PortEventKind.FOUND_AGAIN,
        PortEventKind.CLOSED,
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_end_while_it_waits_comes_at_once(
    run, environment, tmp_path: Path, adapter: Adapter, number: int
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        hears(process, adapter.far)
        adapter.pull()
        told(process, "lost: ")
        process.send_signal(number)
        code, _, errors = ended(process)
    assert code == 0
    assert "recorded to x.mcap" in errors
    assert rows_of(run, "x.mcap")


def test_a_duration_ends_it_while_it_waits(environment, tmp_path: Path, adapter: Adapter) -> None:
    adapter.plug()
    with started(
        environment, tmp_path, "live", adapter.name, "--no-record", "--duration", "3"
    ) as process:
        hears(process, adapter.far)
        adapter.pull()
        assert ended(process)[0] == 0


def test_no_reconnect_ends_instead(run, environment, tmp_path: Path, adapter: Adapter) -> None:
    adapter.plug()
    with started(
        environment, tmp_path, "live", adapter.name, "--no-reconnect", "-o", "x.mcap"
    ) as process:
        hears(process, adapter.far)
        adapter.pull()
        code, _, errors = ended(process)
    assert code == 3
    assert "adapter was lost" in errors
    assert rows_of(run, "x.mcap")


def test_a_server_that_goes_and_comes_is_found_again(environment, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        name = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with started(environment, tmp_path, "live", name, "--no-record") as process:
            server.settimeout(BOUND_S)
            connection, _ = server.accept()
            connection.sendall(SPEED * 3)
            until(process, b"rpm=1000")
            connection.close()
            told(process, "lost: the other end has hung up; waiting")
            connection, _ = server.accept()
            told(process, "found again: after ")
            connection.sendall(SPEED * 3)
            until(process, b"rpm=1000")
            process.send_signal(signal.SIGINT)
            assert ended(process)[0] == 0
            connection.close()


def test_a_port_that_is_not_there_at_the_start_is_an_error(run) -> None:
    done = run("live", "sim://", "/dev/ttyNOPE", "--no-record")
    assert done.returncode == 3
    assert "/dev/ttyNOPE: no such port" in done.stderr
    assert done.stderr.count("\n") == 1


@contextmanager
def two_wires() -> Iterator[list[tuple[int, str]]]:
    with wire() as one, wire() as two:
        yield [one, two]


def test_two_wires_are_one_time_line(run, environment, tmp_path: Path) -> None:
    with (
        two_wires() as wires,
        started(
            environment, tmp_path, "live", *(name for _, name in wires), "-o", "x.mcap"
        ) as process,
    ):
        hears(process, wires[0][0])
        for _ in range(30):
            os.write(wires[0][0], FRAME)
            os.write(wires[1][0], FEEDBACK)
            select.select([], [], [], 0.005)
        os.write(wires[0][0], SPEED)
        until(process, b"rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "port events" not in errors
    rows = rows_of(run, "x.mcap")
    assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)
    for _, name in wires:
        own = [row for row in rows if row["port"] == name]
        assert len(own) >= 30
        assert [row["offset"] for row in own] == list(range(0, 10 * len(own), 10))
    recorded = list(RecordingReader(tmp_path / "x.mcap"))
    # A frame and its answer were sent within a millisecond: which was first is not certain.
    assert any(row.order_uncertain for row in recorded)
    metadata = RecordingReader(tmp_path / "x.mcap").metadata["fte-sniff"]
    assert metadata["port.1.time_uncertainty_ns"] == "1000000"


def test_mixed_wiring_is_pointed_out_once(run, tmp_path: Path) -> None:
    ports = ["sim://?wire=both&rate=1000", "sim://?wire=feedback&rate=1000"]
    done = run("live", *ports, "--no-record", "--duration", "1.5")
    assert done.returncode == 0
    about = [line for line in done.stderr.splitlines() if " wiring: " in line]
    assert 1 <= len(about) <= 2
    assert any("swapped or mixed wiring" in line for line in about)


def test_one_port_twice_is_refused(run) -> None:
    done = run("live", "/dev/ttyUSB0", "/dev/ttyUSB0")
    assert done.returncode == 2
    assert "named twice" in done.stderr


def test_three_ports_are_refused(run) -> None:
    done = run("live", "a", "b", "c")
    assert done.returncode == 2
    assert "one for each of two wires" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
def test_a_kept_recording_outlives_its_view(run, environment, tmp_path: Path, number: int) -> None:
    file = tmp_path / "x.mcap"
    with started(
        environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap", "--keep-recording"
    ) as process:
        said = told(process, "ends it then")
        (capture,) = holding(file)
        assert f"`kill {capture}`" in said
        try:
            until(process, b"speed_feedback")
            process.send_signal(number)
            process.wait(BOUND_S)
            size = file.stat().st_size
            wait_until(lambda: file.stat().st_size > size + 20_000)
        finally:
            os.kill(capture, signal.SIGTERM)
    wait_until(lambda: not holding(file))
    assert "cut" not in run("decode", "x.mcap").stderr


def test_a_kept_recording_ends_when_its_view_asks(run, environment, tmp_path: Path) -> None:
    with started(
        environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap", "--keep-recording"
    ) as process:
        until(process, b"speed_feedback")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "recorded to x.mcap" in errors
    assert holding(tmp_path / "x.mcap") == []


def test_there_is_nothing_to_keep_without_a_recording(run) -> None:
    done = run("live", "sim://", "--no-record", "--keep-recording")
    assert done.returncode == 2
    assert "nothing to keep" in done.stderr


def test_a_flood_at_three_million_baud_loses_nothing(run, environment, tmp_path: Path) -> None:
    frames = 60_000
    with (
        wire() as (far, name),
        started(
            environment, tmp_path, "live", name, "--baud", "3000000", "-o", "x.mcap"
        ) as process,
    ):
        os.set_blocking(process.stdout.fileno(), False)  # type: ignore[union-attr]
        hears(process, far)
        flood(process, far, SPEED * frames)
        wait_until(lambda: drained(process) or count(tmp_path / "x.mcap") >= frames)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "overrun" not in errors
    rows = list(RecordingReader(tmp_path / "x.mcap"))
    assert sum(row.raw == SPEED for row in rows) == frames
    assert not any(row.faults for row in rows)


def flood(process: Process, far: int, data: bytes) -> None:
    """Send all of it, no faster than 3,000,000 baud would, reading what is printed meanwhile."""
    start, sent = monotonic(), 0
    while sent < len(data):
        due = min(len(data), int((monotonic() - start) * 300_000) + 1)
        if due > sent:
            sent += os.write(far, data[sent:due])
        drained(process)


def drained(process: Process) -> bool:
    """Read what is printed; never true, so that it can stand in a condition."""
    with suppress(BlockingIOError):
        assert process.stdout is not None
        while os.read(process.stdout.fileno(), 1 << 20):
            pass
    return False


def count(file: Path) -> int:
    return sum(1 for _ in RecordingReader(file))
