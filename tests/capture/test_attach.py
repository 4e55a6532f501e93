"""Attaching with a real strace to a real host program at a pseudo-terminal."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fte_sniff.capture.attach import (
    LIMITS,
    Call,
    call_of,
)
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import holders_of
from fte_sniff.capture.source import HOST
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import PortError
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from tests.beside import Process, Work, held, running
from tests.capture.seen import Seen
from tests.support.columns import fed
from tests.support.tools import needs
from tests.waiting import BOUND_S, wait_until

ECHO = """
import os, sys, time
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
for word in sys.stdin:
    exec(word)
    print("done", flush=True)
"""
"""A host program: it runs each line of its standard input, and says so."""


class Host:
    """A host program that has the line open."""

    def __init__(self, process: Process) -> None:
        self.process = process
        self.pid = process.pid

    def does(self, code: str) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{code}\n".encode())
        self.process.stdin.flush()
        assert self.process.stdout.readline() == b"done\n"


@contextmanager
def host_at(device: str) -> Iterator[Host]:
    words = [sys.executable, "-c", ECHO, device]
    with running(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        host = Host(process)
        host.does("pass")
        yield host


@contextmanager
def attached(device: str, **options: object) -> Iterator[Seen]:
    with Seen(Wiring([device], way="attach", **options).open(Clock.tied())) as seen:
        yield seen


def tracer_of(pid: int) -> int:
    """The process that traces another one; 0 for none."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("TracerPid:")[2].split()[0])


def is_traced(pid: int) -> bool:
    return tracer_of(pid) != 0


@needs("strace")
def test_small_pieces_of_both_directions_are_seen_in_order(pty) -> None:
    chance = random.Random(1)
    sent, received = chance.randbytes(300), chance.randbytes(300)
    with host_at(pty.device) as host, attached(pty.device) as seen:
        for at in range(0, 300, 10):
            host.does(f"os.write(line, bytes.fromhex('{sent[at : at + 3].hex()}'))")
            host.does(
                f"os.writev(line, [bytes.fromhex('{sent[at + 3 : at + 4].hex()}'), b'',"
                f" bytes.fromhex('{sent[at + 4 : at + 10].hex()}')])"
            )
            pty.send(received[at : at + 10])
            host.does("os.read(line, 1) and os.readv(line, [bytearray(4), bytearray(5)])")
        wait_until(lambda: len(seen.data(pty.device)) == len(seen.data(HOST)) == 300)
        assert (seen.data(HOST), seen.data(pty.device)) == (sent, received)
        assert len(seen.chunks(HOST)) == 60
        assert len(seen.chunks(pty.device)) == 60
        seen.end()
        assert seen.source.lost is None
        assert seen.kinds(HOST) == []
        assert seen.kinds(pty.device) == ["wiring", "opened", "closed"]
        assert seen.events()[0].detail == LIMITS
        assert seen.events()[1].detail.endswith(f"(pid {host.pid}) has it open")


@needs("strace")
def test_rows_have_the_order_of_the_calls_and_their_times(pty) -> None:
    """Answers that come faster than the default baud allows are not dated before their commands."""
    numbers = range(1, 4)
    commands = [bytes.fromhex(f"AA010{one}006400000000EE") for one in numbers]
    answers = [bytes.fromhex(f"55010{one}00640000000FEE") for one in numbers]
    with host_at(pty.device) as host:
        source = Wiring([pty.device], way="attach").open(Clock.tied())
        host.does("import select")
        # Also the calls before the first read of strace's lines have their own times.
        for command, answer in zip(commands, answers, strict=True):
            pty.send(answer)
            host.does("select.select([line], [], [])")  # the next read returns at once
            host.does(f"os.write(line, bytes.fromhex('{command.hex()}')); os.read(line, 64)")
        with Seen(source) as seen:
            wait_until(lambda: seen.data(HOST) == b"".join(commands))
            pty.send(answers[0] + answers[1])
            host.does("select.select([line], [], []); time.sleep(0.002); os.read(line, 64)")
            wait_until(lambda: len(seen.data(pty.device)) == 50)
    rows = []
    for wire in (HOST, pty.device):
        framer = Framer(wire)
        for chunk in seen.chunks(wire):
            rows += fed(framer, chunk)
        rows += list(framer.finish())
    rows.sort(key=lambda row: row.t_ns)
    in_turn = [raw for pair in zip(commands, answers, strict=True) for raw in pair]
    assert [row.raw for row in rows] == [*in_turn, answers[0], answers[1]]
    assert rows[-1].t_ns == rows[-2].t_ns


@needs("strace")
def test_time_of_a_read_is_its_return_and_of_a_write_its_start(pty) -> None:
    clock = Clock.tied()
    with host_at(pty.device) as host, attached(pty.device) as seen:
        # A read that waits: strace prints its start long before its end.
        host.does("import threading")
        host.does("reader = threading.Thread(target=lambda: os.read(line, 64)); reader.start()")
        host.does("os.write(line, b'first')")
        wait_until(lambda: seen.data(HOST) == b"first")
        before = clock.now_ns()
        pty.send(b"later")
        host.does("reader.join()")
        after = clock.now_ns()
        wait_until(lambda: seen.data(pty.device) == b"later")
        (chunk,) = seen.chunks(pty.device)
        # The clock of strace's times is tied to the same system clock.
        assert before - 2_000_000 <= chunk.t_ns <= after + 2_000_000
        assert seen.chunks(HOST)[0].t_ns < before
        assert all(one.at_once for one in seen.items if isinstance(one, Chunk))


@needs("strace")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_target_that_ends_is_reported_and_the_next_program_is_seen(pty, number: int) -> None:
    with host_at(pty.device) as first, attached(pty.device) as seen:
        first.does("os.write(line, b'one')")
        first.process.send_signal(number)
        wait_until(lambda: "lost" in seen.kinds(pty.device))
        assert f"(pid {first.pid}) ended; waiting" in seen.events(pty.device)[-1].detail
        with host_at(pty.device) as second:
            assert f"(pid {second.pid})" in seen.wait_for("found_again").detail
            second.does("os.write(line, b'two')")
            wait_until(lambda: seen.data(HOST) == b"onetwo")
            seen.end()
            assert second.process.poll() is None
    assert seen.kinds() == ["wiring", "opened", "lost", "found_again", "closed"]


@needs("strace")
@pytest.mark.parametrize("options", [{"reconnect": False}, {"pid": True}])
def test_end_of_the_target_ends_the_capture_without_an_error(pty, options) -> None:
    with host_at(pty.device) as host:
        options = {name: host.pid if name == "pid" else of for name, of in options.items()}
        with attached(pty.device, **options) as seen:
            host.does("os.write(line, b'one')")
            host.process.kill()
            seen.ended()
            assert seen.data(HOST) == b"one"
            assert seen.source.lost is None
            assert seen.events(pty.device)[-1].detail.endswith(f"(pid {host.pid}) ended")


@needs("strace")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_target_goes_on_however_the_capture_ends(pty, number: int) -> None:
    code = (
        "import sys; from fte_sniff.capture.wiring import *;"
        "source = Wiring([sys.argv[1]], way='attach').open(Clock.tied()); print(flush=True);"
        "[None for _ in source]"
    )
    with host_at(pty.device) as host:
        words = [sys.executable, "-c", code, pty.device]
        with running(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as capture:
            assert capture.stdout.readline() == b"\n"
            assert is_traced(host.pid)
            capture.send_signal(number)
            capture.wait(BOUND_S)
        # A strace that nobody reads ends with its next line.
        for _ in range(3):
            host.does("os.write(line, b'more')")
        wait_until(lambda: not is_traced(host.pid))
        host.does("os.write(line, b'end')")
        wait_until(lambda: pty.arrived(0.1).endswith(b"end"))
        assert host.process.poll() is None


CALLS = {
    "read": ("in", "os.read(line, 999)"),
    "readv": ("in", "os.readv(line, [bytearray(400), bytearray(600)])"),
    "preadv2": ("in", "os.preadv(line, [bytearray(400), bytearray(600)], -1)"),
    "write": ("out", "os.write(line, data)"),
    "writev": ("out", "os.writev(line, [data[:400], b'', data[400:]])"),
    "pwritev2": ("out", "os.pwritev(line, [data[:400], data[400:]], -1)"),
    "sendfile": ("count", "os.sendfile(line, file.fileno(), 0, 999)"),
    "splice": ("count", "os.write(far, data); os.splice(near, line, 999)"),
}


@needs("strace")
@pytest.mark.parametrize("call", CALLS)
def test_bytes_of_each_call_are_seen_or_counted(pty, call: str) -> None:
    """Bytes that strace does not print are counted on their wire."""
    way, code = CALLS[call]
    data = random.Random(4).randbytes(999)
    with host_at(pty.device) as host, attached(pty.device) as seen:
        host.does("import tempfile; file = tempfile.TemporaryFile(); near, far = os.pipe()")
        host.does(f"data = bytes.fromhex('{data.hex()}'); file.write(data); file.flush()")
        if way == "in":
            pty.send(data)
            wait_until(lambda: pty.unread == len(data))
        host.does(code)
        wire = pty.device if way == "in" else HOST
        if way == "count":
            event = seen.wait_for("overrun", wire=wire)
            assert event.count == 999
            assert event.detail.endswith(f"strace does not show all that {call} moves")
        else:
            seen.wait(lambda s: s.data(wire) == data)
        assert not seen.chunks(HOST if way == "in" else pty.device)


@needs("strace")
def test_call_over_64_kib_is_seen_in_order(pty) -> None:
    data = random.Random(5).randbytes(100_000)
    with host_at(pty.device) as host, attached(pty.device) as seen:
        host.does("import random; data = random.Random(5).randbytes(100_000)")
        writing = Work(host.does, "os.writev(line, [data[:70_000], data[70_000:]])")
        while writing.is_alive():
            pty.arrived(0.1)
        writing.ended()
        seen.wait(lambda s: s.data(HOST) == data)
        assert seen.kinds() == ["wiring", "opened"]


@needs("strace")
def test_target_that_opens_its_port_under_another_name_is_followed(pty, new_pty) -> None:
    second, third = new_pty(), new_pty()
    with host_at(pty.device) as host, attached(pty.device) as seen:
        host.does("os.write(line, b'one')")
        for number, other in enumerate((second, third), 1):
            host.does(f"os.close(line); line = os.open('{other.device}', os.O_RDWR | os.O_NOCTTY)")
            event = seen.wait_for("found_again", number, pty.device)
            assert event.detail.endswith(
                f"(pid {host.pid}) opened {other.device} instead, which is watched now"
            )
            host.does(f"os.write(line, b'{number}')")
            seen.wait(lambda s, number=number: s.data(HOST).endswith(b"%d" % number))
        assert seen.data(HOST) == b"one12"


@needs("strace")
def test_port_that_is_opened_beside_it_is_not_followed(pty, new_pty) -> None:
    other = new_pty()
    with host_at(pty.device) as host, attached(pty.device) as seen:
        host.does(f"other = os.open('{other.device}', os.O_RDWR | os.O_NOCTTY)")
        for number in range(3):
            host.does("time.sleep(0.1); os.write(other, b'secret'); os.write(line, b'x')")
            seen.wait(lambda s, number=number: s.data(HOST) == b"x" * (number + 1))
        assert "found_again" not in seen.kinds()


@needs("strace")
def test_hundred_forks_are_seen(pty) -> None:
    with host_at(pty.device) as host, attached(pty.device) as seen:
        host.does(
            "[os.waitpid(os.fork() or (os.write(line, b'%03d' % n), os._exit(0))[0], 0)"
            " for n in range(100)]"
        )
        seen.wait(lambda s: len(s.data(HOST)) == 300)
        assert seen.data(HOST) == b"".join(b"%03d" % n for n in range(100))
        host.does("os.write(line, b'end')")
        seen.wait(lambda s: s.data(HOST).endswith(b"end"))


@needs("strace")
def test_unwatchable_ports_are_one_sentence_with_the_fix(pty, tmp_path, monkeypatch) -> None:
    def refused(device: str, **options: object) -> str:
        with pytest.raises(PortError) as error:
            Wiring([device], way="attach", **options).open(Clock.tied())
        assert "\n" not in str(error.value)
        return str(error.value)

    assert "no such port" in refused("/dev/ttyNOWHERE")
    assert "/dev/null is not a serial port" in refused("/dev/null")
    pty.let_go()
    assert "start the program first" in refused(pty.device)
    with host_at(pty.device) as host:
        wrong = refused(pty.device, pid=os.getppid())
        assert f"process {os.getppid()} does not have {pty.device} open; " in wrong
        assert f"(pid {host.pid}) has it open" in wrong
        with attached(pty.device):
            busy = refused(pty.device)
            assert "a debugger does already: use sudo, or end the debugger" in busy
        monkeypatch.setenv("PATH", str(tmp_path))
        assert "sudo apt install strace" in refused(pty.device)
        assert not is_traced(host.pid)


def test_strace_that_refuses_names_the_way(pty, tmp_path, monkeypatch) -> None:
    """A program in its place fails as strace does where ptrace is forbidden."""
    script = tmp_path / "strace"
    script.write_text(
        "#!/bin/sh\n"
        "echo 'strace: attach: ptrace(PTRACE_SEIZE, 7): Operation not permitted' >&2\nexit 1\n"
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with held(pty.near):
        wait_until(lambda: holders_of(pty.device))
        with pytest.raises(PortError, match=r"may not watch it, .* use sudo"):
            Wiring([pty.device], way="attach").open(Clock.tied())
        script.write_text("\0")
        with pytest.raises(PortError, match=r"strace ended: .*Exec format error"):
            Wiring([pty.device], way="attach").open(Clock.tied())
        script.write_text("#!/bin/sh\nprintf 'strace: a\\nstrace: b\\n' >&2\nexit 1\n")
        with pytest.raises(PortError, match=r"strace ended: strace: b$"):
            Wiring([pty.device], way="attach").open(Clock.tied())


@pytest.mark.parametrize("line", [r'write(3, "\xaa\x01\x', r'read(3, "\x55\x0'])
def test_line_of_strace_that_is_cut_is_a_gap_of_both_wires(
    pty, tmp_path, monkeypatch, line: str
) -> None:
    """A program in its place writes a line whose end never comes."""
    script = tmp_path / "strace"
    script.write_text(
        "#!/bin/sh\necho 'strace: Process 7 attached' >&2\n"
        f"printf '%s' '7 1700.000100 {line}' >&2\n"
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with held(pty.near):
        wait_until(lambda: holders_of(pty.device))
        with attached(pty.device, reconnect=False) as seen:
            seen.ended()
    for wire in (HOST, pty.device):
        lost = [e.detail for e in seen.events(wire) if e.kind == "overrun"]
        assert lost == ["bytes may be lost: a line of strace cannot be read"]


TTY_X = "".join(f"\\x{byte:02x}" for byte in b"/dev/ttyX")
"""A name as strace prints it."""


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (
            r'7 1.0 writev(3, [{iov_base="\x01", iov_len=1}, {iov_base="\x02\x03",'
            r" iov_len=2}], 2) = 3 <0.1>",
            Call("writev", True, 1_000_000_000, b"\x01\x02\x03"),
        ),
        (
            r'7 1.0 read(3, "\x01"..., 9000) = 9000 <0.1>',
            Call("read", False, 1_100_000_000, b"\x01", 8999),
        ),
        (
            r'7 1.0 writev(3</dev/ttyX>, [{iov_base="\x01"..., iov_len=5},'
            r' {iov_base="\x02", iov_len=1}], 2) = 6 <0.1>',
            Call("writev", True, 1_000_000_000, b"\x01", 5),
        ),
        (r'7 1.0 read(3, "", 64) = 0 <0.000010>', None),
        (r"7 1.0 +++ exited with 0 +++", None),
        (r"7 1.0 +++ killed by SIGKILL +++", None),
    ],
)
def test_line_of_strace_is_a_call(line: str, expected: Call | None) -> None:
    assert call_of(line, "/dev/ttyX") == expected


@pytest.mark.parametrize(
    "line",
    [
        r'7 1700.000100 read(3, "\xaa\x',
        r'7 1700.000100 read(3, "\xaa\x01", 64) = ',
        "7 1700.0",
        "",
        "bash: strace: not found",
        "\N{SNOWMAN}",
    ],
)
def test_line_that_is_cut_or_not_of_strace_is_refused(line: str) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - any text
        call_of(line, "/dev/ttyX")
