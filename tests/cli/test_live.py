"""`live`: output and recording, ports that come and go, two wires; ports are never written to."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic

import pytest

from fte_sniff.cli.streams import NOT_BEGUN
from fte_sniff.protocol.items import PortEventKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import FRAME_LENGTH
from fte_sniff.recording.reader import Recording
from tests.beside import Work, running, server_socket
from tests.cli.conftest import decoded
from tests.cli.processes import (
    BOUND_S,
    FRAME,
    Process,
    children_of,
    ended,
    first_output,
    holding,
    rows_in,
    started,
    stderr_until,
    until,
    wait_until,
    wire,
)
from tests.cli.program import Program
from tests.cli.terminals import terminal
from tests.rfc2217_server import DTR_OFF, DTR_ON, RTS_OFF, RTS_ON, serving
from tests.slow import first
from tests.support.columns import read_rows
from tests.support.recorded_rows import events_in
from tests.support.tools import needs
from tests.waiting import while_waiting

pytestmark = pytest.mark.program

SPEED = bytes.fromhex("AA010103E800000000EE")
SILENT = "sim://?host=off&wire=control"
KEPT = ("--keep-recording", "--duration", "15 min")
"""Its end is for a test that is killed: nothing else would end the capture."""


@pytest.mark.parametrize("command", ["live", "bridge"])
def test_duration_ends_a_line_where_nobody_is_ever_heard(run, command: str) -> None:
    done = run(command, SILENT, "--plain", "--duration", "0.4", "--no-record")
    assert done.returncode == 0
    assert "nothing came" in done.stderr


@pytest.mark.smoke
def test_a_real_terminal(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--plain", "-o", "x.mcap") as process,
    ):
        first_output(process, far)
        os.write(far, b"\x13\x37" + SPEED)
        assert b"motor=1 rpm=1000" in until(process, b"motor=1 rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "recorded to x.mcap" in errors
    rows = decoded(run, "x.mcap")
    assert rows[-1]["raw"] == SPEED.hex().upper()
    assert rows[-2]["faults"] == ["noise"]


def test_unplugged_keeps_all_that_came_before(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--plain", "-o", "x.mcap") as process,
    ):
        first_output(process, far)
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


@pytest.mark.parametrize(
    "form", first(1, [((),), (("--format", "jsonl"),), (("--format", "csv"),)])
)
def test_rows_that_nobody_reads_any_more_end_a_recording_with_the_reason(
    run, environment, tmp_path: Path, form: tuple[str, ...]
) -> None:
    words = ("live", "sim://?rate=1000", "-o", "x.mcap", *form)
    with started(environment, tmp_path, *words) as process:
        until(process, b"speed_feedback")
        process.stdout.close()
        process.stdout = None
        code, _, errors = ended(process)
    assert code == 0
    reason = "standard output has no reader any more: the capture ends; with --keep-recording"
    assert errors.count(reason) == 1
    assert errors.index(reason) < errors.index("recorded to x.mcap")
    assert "BrokenPipe" not in errors
    assert run("decode", "x.mcap").returncode == 0


def test_recording_that_is_kept_goes_on_without_a_reader(environment, tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    words = ("live", "sim://?rate=1000", "-o", str(file), *KEPT, "--format", "jsonl")
    with started(environment, tmp_path, *words) as process:
        until(process, b"speed_feedback")
        process.stdout.close()
        process.stdout = None
        before = rows_in(file)
        wait_until(lambda: rows_in(file) > before + 500)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert f"recorded to {file}" in errors


def test_a_killed_view_leaves_a_closed_file(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        process.kill()
        process.wait(BOUND_S)
    # The capture process ends by itself once it finds that nobody listens.
    wait_until(lambda: holding(tmp_path / "x.mcap") == [])
    done = run("decode", "x.mcap")
    assert done.returncode == 0
    assert done.stdout.count("\n") > 1


def test_a_killed_capture_is_reported_and_its_file_opens(run, environment, tmp_path: Path) -> None:
    with started(environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap") as process:
        until(process, b"speed_feedback")
        (capture,) = children_of(process.pid)
        os.kill(capture, signal.SIGKILL)
        code, _, errors = ended(process)
    assert code == 4
    assert "ended unexpectedly; the last rows may not be in x.mcap" in errors
    assert run("decode", "x.mcap").returncode == 0


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


def test_a_lost_port_is_waited_for_and_found_again(
    run, environment, tmp_path: Path, adapter: Adapter
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        first_output(process, adapter.far)
        os.write(adapter.far, SPEED + FRAME[:6])
        # What the system has not handed over yet goes with the line; so wait until all is read.
        until(process, b"rpm=1000")
        adapter.pull()
        assert "waiting for it" in stderr_until(process, "adapter lost: ")
        device = adapter.plug()
        assert f"s as {device}" in stderr_until(process, "adapter found again: after ")
        os.write(adapter.far, FRAME[6:] + SPEED * 3)
        until(process, b"rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, _errors = ended(process)
    assert code == 0
    rows = decoded(run, "x.mcap")
    # The frame that was cut in two is two pieces, and no byte is missing.
    pieces = [row["raw"] for row in rows if row["faults"]]
    assert pieces == [FRAME[:6].hex().upper(), FRAME[6:].hex().upper()]
    assert [row["offset"] for row in rows] == [
        sum(row["length"] for row in rows[:number]) for number in range(len(rows))
    ]
    assert rows[-1]["raw"] == SPEED.hex().upper()
    events = [event.kind for event in events_in(Recording(tmp_path / "x.mcap"))]
    assert events == [
        PortEventKind.OPENED,
        PortEventKind.LOST,
        PortEventKind.FOUND_AGAIN,
        PortEventKind.CLOSED,
    ]


def test_events_that_came_while_the_view_stood_still_are_counted(
    run, environment, tmp_path: Path, adapter: Adapter
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        first_output(process, adapter.far)
        process.send_signal(signal.SIGSTOP)
        for times in (1, 2, 3):
            adapter.pull()
            wait_until(lambda times=times: f"lost {times}" in run("decode", "x.mcap").stderr)
            before = len(decoded(run, "x.mcap"))
            adapter.plug()
            for _ in while_waiting(lambda: "rows after the port was found again"):
                os.write(adapter.far, FRAME)
                if len(decoded(run, "x.mcap")) > before:
                    break
        process.send_signal(signal.SIGCONT)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    assert (errors.count(" lost: "), errors.count(" found again: ")) == (3, 3)


def test_bytes_that_came_before_the_end_are_recorded(run, environment, tmp_path: Path) -> None:
    with (
        wire() as (far, name),
        started(environment, tmp_path, "live", name, "--headless", "-o", "x.mcap") as process,
    ):
        stderr_until(process, "capturing")
        os.write(far, SPEED * 100)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0, errors
    assert [row["raw"] for row in decoded(run, "x.mcap")] == [SPEED.hex().upper()] * 100


@pytest.mark.parametrize("number", first(1, [signal.SIGINT, signal.SIGTERM]))
def test_the_end_while_it_waits_comes_at_once(
    run, environment, tmp_path: Path, adapter: Adapter, number: int
) -> None:
    adapter.plug()
    with started(environment, tmp_path, "live", adapter.name, "-o", "x.mcap") as process:
        first_output(process, adapter.far)
        adapter.pull()
        stderr_until(process, "lost: ")
        process.send_signal(number)
        code, _, errors = ended(process)
    assert code == 0
    assert "recorded to x.mcap" in errors
    assert decoded(run, "x.mcap")


@pytest.mark.parametrize("command", ["live", "bridge"])
def test_an_end_before_the_capture_begins_is_reported(
    environment, tmp_path: Path, command: str
) -> None:
    with server_socket() as server:
        port = f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
        words = (command, port, "-o", "x.mcap", "--headless")
        with started(environment, tmp_path, *words) as process:
            connection, _ = server.accept()  # and never answers
            process.send_signal(signal.SIGINT)
            assert ended(process) == (0, "", f"{NOT_BEGUN}\n")
            connection.close()
    assert not (tmp_path / "x.mcap").exists()


def test_a_server_that_goes_and_comes_is_found_again(environment, tmp_path: Path) -> None:
    with server_socket() as server:
        name = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with started(environment, tmp_path, "live", name, "--no-record") as process:
            server.settimeout(BOUND_S)
            connection, _ = server.accept()
            connection.sendall(SPEED * 3)
            until(process, b"rpm=1000")
            connection.close()
            stderr_until(process, "lost: the other end has hung up; waiting")
            connection, _ = server.accept()
            stderr_until(process, "found again: after ")
            connection.sendall(SPEED * 3)
            until(process, b"rpm=1000")
            process.send_signal(signal.SIGINT)
            assert ended(process)[0] == 0
            connection.close()


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
        first_output(process, wires[0][0])
        for _ in range(30):
            os.write(wires[0][0], FRAME)
            os.write(wires[1][0], FEEDBACK)
            select.select([], [], [], 0.005)
        os.write(wires[0][0], SPEED)
        until(process, b"rpm=1000")
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "lost" not in errors
    rows = decoded(run, "x.mcap")
    assert [row["time"] for row in rows] == sorted(row["time"] for row in rows)
    for _, name in wires:
        own = [row for row in rows if row["port"] == name]
        assert len(own) >= 30
        assert [row["offset"] for row in own] == list(range(0, 10 * len(own), 10))
    recorded = read_rows(tmp_path / "x.mcap")
    # A frame and its answer were sent within a millisecond: which was first is not certain.
    assert any(row.unordered for row in recorded)
    metadata = Recording(tmp_path / "x.mcap").facts
    assert metadata["port.1.time_uncertainty_ns"] == "1000000"


def test_mixed_wiring_is_pointed_out_once(run, tmp_path: Path) -> None:
    ports = ["sim://?wire=both&rate=1000", "sim://?wire=feedback&rate=1000"]
    done = run("live", *ports, "--no-record", "--duration", "1.5")
    assert done.returncode == 0
    about = [line for line in done.stderr.splitlines() if " note: " in line]
    assert 1 <= len(about) <= 2
    assert any("swapped or mixed wiring" in line for line in about)


def test_a_kept_recording_outlives_its_view(run, environment, tmp_path: Path) -> None:
    file = tmp_path / "x.mcap"
    with started(
        environment, tmp_path, "live", "sim://?rate=1000", "-o", "x.mcap", *KEPT
    ) as process:
        said = stderr_until(process, "ends it then")
        (capture,) = children_of(process.pid)
        assert f"`kill {capture}`" in said
        try:
            until(process, b"speed_feedback")
            process.kill()
            process.wait(BOUND_S)
            size = file.stat().st_size
            wait_until(lambda: file.stat().st_size > size + 20_000)
        finally:
            os.kill(capture, signal.SIGTERM)
    wait_until(lambda: not holding(file))
    assert "cut" not in run("decode", "x.mcap").stderr


@pytest.mark.parametrize("frames", first(1, [15_000, 60_000]))
def test_a_flood_at_three_million_baud_loses_nothing(
    run, environment, tmp_path: Path, frames: int
) -> None:
    with (
        wire() as (far, name),
        started(
            environment, tmp_path, "live", name, "--baud", "3000000", "-o", "x.mcap"
        ) as process,
    ):
        os.set_blocking(process.stdout.fileno(), False)  # type: ignore[union-attr]
        first_output(process, far)
        flood(process, far, SPEED * frames)
        wait_until(lambda: drained(process) or rows_in(tmp_path / "x.mcap") >= frames)
        process.send_signal(signal.SIGINT)
        code, _, errors = ended(process)
    assert code == 0
    assert "overrun" not in errors
    rows = read_rows(tmp_path / "x.mcap")
    assert sum(row.raw == SPEED for row in rows) == frames
    assert not any(row.faults for row in rows)


def flood(process: Process, far: int, data: bytes) -> None:
    """Send all its frames, no faster than 3,000,000 baud, reading what is printed meanwhile."""
    start, sent = monotonic(), 0
    while sent < len(data):
        due = min(len(data), int((monotonic() - start) * 30_000 + 1) * FRAME_LENGTH)
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


_MODEM = frozenset({DTR_ON, DTR_OFF, RTS_ON, RTS_OFF})
_NOISY = FRAME + bytes(range(256)) + b"\x03\x04\x11\x13\x1a\x1c\r\n\x7f\xff" + FRAME
"""Frames, and all that a terminal could answer, echo or obey."""


class Watched:
    """The far end of a line: it sends all the while, and keeps all that it gets."""

    def __init__(self, far: int) -> None:
        self.got = b""
        self._far = far
        self._ends, self._ending = os.pipe()
        self._work = Work(self._run)

    def end(self) -> None:
        os.write(self._ending, b"!")
        self._work.ended()
        os.close(self._ends)
        os.close(self._ending)
        # What was written before the last program let go of the line is there yet.
        while select.select([self._far], [], [], 0)[0]:
            self.got += os.read(self._far, 65536)

    def _run(self) -> None:
        # What nobody reads must not fill the line.
        os.set_blocking(self._far, False)
        while True:
            ready, _, _ = select.select([self._ends, self._far], [], [], 0.005)
            if self._ends in ready:
                return
            if self._far in ready:
                self.got += os.read(self._far, 65536)
            try:
                os.write(self._far, _NOISY)
            except BlockingIOError:
                continue


@contextmanager
def watched_wire() -> Iterator[tuple[Watched, str]]:
    """A terminal whose far end is watched from before it is opened until after it is closed."""
    with wire() as (far, name):
        watched = Watched(far)
        try:
            yield watched, name
        finally:
            watched.end()


def listens(process: Process) -> None:
    until(process, b"reset")


@pytest.mark.parametrize(
    ("options", "number"),
    first(
        2,
        [
            ("-o x.mcap --filter cmd=0", signal.SIGKILL),
            ("--dtr on --rts off --no-record", signal.SIGTERM),
            ("--dtr off --rts on --no-record", signal.SIGHUP),
            ("--dtr on --rts on --no-record", signal.SIGINT),
            ("--baud 250000 --no-record", signal.SIGTERM),
        ],
    ),
)
def test_no_byte_whatever_the_options_and_however_it_ends(
    environment, tmp_path: Path, options: str, number: int
):
    with (
        watched_wire() as (watched, name),
        started(environment, tmp_path, "live", name, "--plain", *options.split()) as process,
    ):
        listens(process)
        process.send_signal(number)
        ended(process)
    assert watched.got == b""


def test_no_byte_from_a_screen_with_busy_keys(environment, tmp_path: Path):
    with (
        watched_wire() as (watched, name),
        terminal(environment, tmp_path, "live", name, "--no-record") as screen,
    ):
        screen.until("LIVE")
        # Typed ahead: into the table, into a prompt, and the keys that leave both.
        screen.type("jjkk G g /motor = 1\r \x1b[A\x1b[B\x1b[5~\x1b[6~")
        screen.type("Q")
        assert screen.ended() == 0
    assert watched.got == b""


@pytest.mark.parametrize(("dtr", "rts"), [("on", "off"), ("off", "on")])
def test_an_rfc2217_server_is_asked_for_the_lines_and_given_no_byte(
    environment, tmp_path: Path, dtr: str, rts: str
):
    with watched_wire() as (watched, name), serving(name) as server:
        options = ("--dtr", dtr, "--rts", rts, "--no-record", "--plain")
        with started(environment, tmp_path, "live", server.url, *options) as process:
            listens(process)
            process.terminate()
            assert ended(process)[0] == 0
        assert server.data == b""
        asked = {DTR_ON if dtr == "on" else DTR_OFF, RTS_ON if rts == "on" else RTS_OFF}
        assert _MODEM.intersection(server.controls) == asked
        assert set(server.bauds) == {115200}
    assert watched.got == b""


def test_a_socket_is_given_no_byte(environment, tmp_path: Path):
    with server_socket() as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        with started(environment, tmp_path, "live", url, "--plain", "--no-record") as process:
            client, _ = listening.accept()
            with client:
                client.sendall(_NOISY * 3)
                listens(process)
                process.terminate()
                assert ended(process)[0] == 0
                client.settimeout(BOUND_S)
                assert client.recv(100) == b""


ECHO = """
import os, sys
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
while True: os.write(line, os.read(line, 64))
"""
"""A host program that returns what it reads."""


@contextmanager
def echoed_wire() -> Iterator[tuple[int, str, subprocess.Popen[bytes]]]:
    """The far end of a wire, its device, and the host program that has opened it."""
    with wire() as (far, device), running([sys.executable, "-c", ECHO, device]) as host:
        wait_until(lambda: host.pid in holding(Path(device)))
        yield far, device, host


@needs("strace")
def test_attached_capture_records_both_directions_of_another_program(
    environment: dict[str, str], tmp_path: Path
) -> None:
    with (
        echoed_wire() as (far, device, host),
        started(environment, tmp_path, "live", "--attach", device, "-o", "x.mcap") as capture,
    ):
        stderr_until(capture, "note: times are those of system calls")
        for _ in range(5):
            os.write(far, FRAME)
        wait_until(lambda: (tmp_path / "x.mcap").exists() and rows_in(tmp_path / "x.mcap") == 10)
        capture.send_signal(signal.SIGINT)
        code, _, _ = ended(capture)
        assert (code, host.poll()) == (0, None)
    reader = Recording(tmp_path / "x.mcap")
    rows = [row for item in reader.items() if isinstance(item, Rows) for row in item]
    assert {port: b"".join(r.raw for r in rows if r.port == port) for port in (device, "host")} == {
        device: 5 * FRAME,
        "host": 5 * FRAME,
    }
    assert "mmap and io_uring are not seen" in str([*reader.items()])


@needs("strace")
@pytest.mark.parametrize("killed", ["strace", "target"])
def test_killed_strace_and_a_target_that_ends_are_one_line_and_cost_no_row(
    run, environment: dict[str, str], tmp_path: Path, killed: str
) -> None:
    file = tmp_path / "x.mcap"

    def echoed(far: int, rows: int) -> None:
        os.write(far, FRAME)
        wait_until(lambda: file.exists() and rows_in(file) == rows)

    with echoed_wire() as (far, device, host):
        words = ["live", "--attach", device, "-o", "x.mcap"]
        words += ["--pid", str(host.pid)] if killed == "target" else []
        with started(environment, tmp_path, *words) as capture:
            stderr_until(capture, "note: times are those of system calls")
            echoed(far, 2)
            if killed == "strace":
                status = Path(f"/proc/{host.pid}/status").read_text()
                os.kill(int(re.findall(r"TracerPid:\t(\d+)", status)[0]), signal.SIGKILL)
                lost = stderr_until(capture, f"{device} found again: after")
                assert f"{device} lost: strace was ended by SIGKILL; waiting" in lost
                assert lost.count("\n") == 2
                echoed(far, 4)
                capture.send_signal(signal.SIGINT)
            else:
                host.kill()
            code, _, errors = ended(capture)
    assert code == 0
    if killed == "target":
        assert errors.count(f"(pid {host.pid}) ended") == 1
    rows = decoded(run, "x.mcap")
    assert {row["raw"] for row in rows} == {FRAME.hex().upper()}
    assert len(rows) == (4 if killed == "strace" else 2)


@pytest.mark.terminal
def test_the_screen_of_a_capture_of_some_rows_ends_without_a_warning(
    environment: dict[str, str], tmp_path: Path
) -> None:
    errors = tmp_path / "errors.txt"
    command = ("live", "sim://?rate=1000", "--no-record", "--count", "2000")
    with terminal(environment, tmp_path, *command, errors=errors) as screen:
        assert screen.ended() == 0
    assert "Warning" not in errors.read_text()


def test_a_capture_starts_in_a_folder_that_was_removed(environment, tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    command = ("live", "sim://", "--plain", "--count", "3", "-o", f"{tmp_path / 'x.mcap'}")
    removed = "import os; os.chdir('gone'); os.rmdir('../gone')"
    done = Program(removed).run(command, b"", tmp_path, environment)
    assert done.code == 0, done.errors
    assert rows_in(tmp_path / "x.mcap") == 3
