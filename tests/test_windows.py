"""The program where modules, functions and signals of POSIX do not exist, as on Windows.

Nobody has run it on Windows. Here it runs on Linux, after what Windows lacks was removed: its
output is that of an ordinary run.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from serial import SerialException
from serial.tools.list_ports_common import ListPortInfo

from fte_sniff import platform
from fte_sniff.capture.lasting_name import lasting_name
from fte_sniff.capture.port_errors import check_name, port_error
from fte_sniff.cli.input_files import FileName
from tests.beside import Work, running, server_socket
from tests.cli.program import Program, plain_environment
from tests.in_process import call
from tests.pseudo_terminals import Pty
from tests.slow import first
from tests.waiting import BOUND_S

pytestmark = pytest.mark.program

ROOT = Path(__file__).parents[1]

# Libraries that saw Linux when they were imported still need what they found. Not removed: what
# polars, platformdirs, shutil, subprocess and pyserial use on Linux (os.uname, getuid, statvfs,
# SIGKILL, O_NOCTTY, O_TMPFILE).
WITHOUT_POSIX = """
import asyncio, multiprocessing.connection, os, select, selectors, signal, subprocess, sys
import tempfile, time
import serial, serial.rfc2217, serial.tools.list_ports, serial.urlhandler.protocol_socket

selectors.DefaultSelector = selectors.SelectSelector
multiprocessing.connection.default_family = "AF_INET"
for name in "fcntl termios tty pty pwd grp resource".split():
    sys.modules[name] = None
of_windows = "SIGABRT SIGFPE SIGILL SIGINT SIGSEGV SIGTERM SIG_DFL SIG_IGN".split()
of_linux = "SIGKILL SIGCHLD".split()
removed = {
    os: "fork forkpty killpg getpgrp tcgetpgrp openpty ttyname mkfifo pread pwrite fdatasync fchmod"
    " sched_getaffinity O_CLOEXEC O_NOFOLLOW O_DIRECTORY".split(),
    select: "poll epoll".split(),
    time: "clock_gettime clock_gettime_ns CLOCK_MONOTONIC CLOCK_BOOTTIME".split(),
    signal: ["setitimer", "getitimer", "alarm", "pause", "sigwait", "pthread_sigmask"]
    + ["pthread_kill", "ITIMER_REAL", "SIG_BLOCK", "SIG_UNBLOCK", "SIG_SETMASK"]
    + [one for one in dir(signal) if one[:3] == "SIG" and one not in of_windows + of_linux],
}
for module, names in removed.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
"""

BLOCKED = f"""
blocking = {WITHOUT_POSIX!r}
exec(blocking)
import fte_sniff.session.control as control
control._START = blocking + '\\n' + control._START
"""

Result = tuple[int, bytes, bytes]


def environment_in(folder: Path, **variables: str) -> dict[str, str]:
    """Ours, with settings of the program in `folder`."""
    return plain_environment() | {
        "FTE_SNIFF_CONFIG": str(folder / "config.toml"),
        "XDG_STATE_HOME": str(folder / "state"),
        "NO_COLOR": "1",
        **variables,
    }


@pytest.fixture
def without_posix() -> Program:
    return Program(BLOCKED)


def run(program: Program, folder: Path, *words: str) -> Result:
    """Exit code, standard output and standard error."""
    return program.run(list(words), b"", folder, environment_in(folder))[:3]


def ordinary(folder: Path, *words: str) -> Result:
    """Those of an ordinary run."""
    return call(words, b"", folder, environment_in(folder))[:3]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with samples, rules, and a recording to repair."""
    for name in ("damaged.mcap", "clean.mcap", "damaged.raw", "damaged.hex"):
        (tmp_path / name).write_bytes((ROOT / "samples" / name).read_bytes())
    whole = (tmp_path / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    (tmp_path / "old.csv").write_text("old\n")
    (tmp_path / "rules.toml").write_text('[[rule]]\nmeasure = "malformed"\nmax = 1000\n')
    return tmp_path


FRAME = "AA 02 02 03 E8 00 00 27 10 EE"

COMMANDS = [
    "--version",
    f"hex {FRAME}",
    "decode damaged.mcap --filter malformed",
    "decode clean.mcap --format raw -o -",
    "decode clean.mcap -o old.csv --force",
    "decode clean.mcap -o out.mcap",
    "stats damaged.mcap clean.mcap --jobs 2",
    "repair cut.mcap -o clean.mcap --force",
    "ports",
    "live /dev/absent --plain",
    "decode damaged.hex --format csv",
    "decode clean.mcap -o out.parquet",
    "check damaged.mcap --expect count(malformed)==0",
    "completion bash",
    "decode clean.mcap -o old.csv",
]


def copied(folder: Path, other: Path) -> Path:
    """The files of a folder in another."""
    for path in folder.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    return other


def files_of(folder: Path) -> dict[str, bytes]:
    """The content of each file in a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("words", first(10, COMMANDS))
def test_command_does_the_same_without_posix(
    folder: Path,
    tmp_path_factory: pytest.TempPathFactory,
    without_posix: Program,
    words: str,
) -> None:
    other = copied(folder, tmp_path_factory.mktemp("other"))
    expected = ordinary(folder, *words.removesuffix(" --jobs 2").split())
    assert run(without_posix, other, *words.split()) == expected
    assert b"Traceback" not in expected[2]
    assert files_of(other) == files_of(folder)


@pytest.mark.parametrize("command", ["bridge sim://", "simulate"])
def test_command_that_needs_a_pseudo_terminal_names_another_way(
    tmp_path: Path, without_posix: Program, command: str
) -> None:
    code, output, errors = run(without_posix, tmp_path, *command.split())
    assert (code, output, errors.count(b"\n")) == (2, b"", 1)
    assert b"pseudo-terminals, which Windows does not have: use it in WSL" in errors


def test_port_that_cannot_be_shared_is_named(
    tmp_path: Path, without_posix: Program, pty: Pty
) -> None:
    code, output, errors = run(without_posix, tmp_path, "live", "--share", pty.device, "--headless")
    assert (code, output, errors.count(b"\n")) == (2, b"", 1)
    assert b"cannot be shared: URLs and Windows ports cannot" in errors


def test_simulated_port_is_recorded_without_posix(tmp_path: Path, without_posix: Program) -> None:
    """Rows, file and exit code are those of an ordinary run."""
    words = ("live", "sim://?seed=1&flip=0.01", "--plain", "--count", "300", "-o")
    recorded = []
    without = partial(run, without_posix)
    for name, program in (("x.mcap", ordinary), ("y.mcap", without)):
        code, output, errors = program(tmp_path, *words, name)
        assert code == 0, errors
        assert output.count(b"\n") == 301
        assert errors.endswith(f"recorded to {name}\n".encode())
        recorded.append(ordinary(tmp_path, "decode", name, "--format", "raw", "-o-")[:2])
    assert recorded[0] == recorded[1]


STARTED = [sys.executable, "-c", f"{BLOCKED}\nfrom fte_sniff.__main__ import main\nmain()"]
"""The program without POSIX, as a process of its own."""


@contextmanager
def served(data: bytes) -> Iterator[int]:
    """The TCP port of a server that sends data to one client, and waits for its end."""
    with server_socket() as server:

        def serve() -> None:
            connection = server.accept()[0]
            with connection:
                connection.sendall(data)
                connection.recv(1)

        serving = Work(serve)
        yield server.getsockname()[1]
        serving.ended()


def test_socket_is_recorded_without_posix(tmp_path: Path, without_posix: Program) -> None:
    data = (ROOT / "samples" / "clean.raw").read_bytes()
    with served(data) as port:
        url = f"socket://127.0.0.1:{port}"
        words = ("live", url, "--plain", "--count", str(len(data) // 10), "-o", "x.mcap")
        code, _, errors = run(without_posix, tmp_path, *words)
    assert code == 0, errors
    decoded = run(without_posix, tmp_path, "decode", "x.mcap", "--format", "raw", "-o-")
    assert decoded[:2] == (0, data)


def test_ctrl_c_ends_a_capture_without_posix(tmp_path: Path) -> None:
    with running(
        [*STARTED, "live", "sim://", "--headless", "-o", "x.mcap"],
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        env=environment_in(tmp_path),
    ) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == b"capturing sim://, recording to x.mcap\n"
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=BOUND_S)[1]
    assert process.returncode == 0, errors
    assert errors.endswith(b"recorded to x.mcap\n")


def test_screen_opens_without_posix(folder: Path, pty: Pty) -> None:
    """With a driver of Textual for tests, which presses the keys, on a real terminal."""
    driver = "textual.drivers.headless_driver:HeadlessDriver"
    done = subprocess.run(
        [*STARTED, "view", "damaged.mcap"],
        stdin=pty.near,
        stdout=pty.near,
        stderr=subprocess.PIPE,
        cwd=folder,
        env=environment_in(folder, TEXTUAL_DRIVER=driver, TEXTUAL_PRESS="down,end,Q"),
        timeout=BOUND_S,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


ENCODED = [
    "decode 记录.mcap --limit 5",
    "stats 记录.mcap",
    "live sim:// --plain --count 3 -o 新.mcap",
    "decode 没有.mcap",
    "live --help",
    "decode 记录.mcap --format jsonl --limit 5",
    "report 记录.mcap -o 报告.html",
    "doctor",
]


@pytest.mark.parametrize("encoding", first(1, ["gbk", "cp1252"]))
@pytest.mark.parametrize("words", first(4, ENCODED))
def test_console_of_any_encoding_shows_the_output(folder: Path, encoding: str, words: str) -> None:
    """What an encoding lacks is written with backslashes."""
    environment = environment_in(folder, PYTHONIOENCODING=encoding)
    (folder / "clean.mcap").rename(folder / "记录.mcap")
    code, output, errors = Program(BLOCKED).run(words.split(), b"", folder, environment)
    assert code in (0, 1, 4), errors
    assert b"Traceback" not in errors
    named = {"stats": "记录.mcap", "report": "报告.html", "live": "新.mcap"}.get(words.split()[0])
    if named is not None and "--help" not in words:
        assert named.encode(encoding, "backslashreplace") in output + errors


@pytest.mark.parametrize(
    "name", ["C:\\logs\\x.mcap", "C:/logs/x.mcap", "\\\\server\\share\\x.mcap", "x.mcap"]
)
def test_path_of_windows_is_a_file_name(name: str) -> None:
    assert str(FileName().convert(name, None, None)) == name


@pytest.mark.parametrize("name", ["COM3", "\\\\.\\COM10"])
def test_port_of_windows_is_a_port_name(name: str) -> None:
    check_name(name)
    assert lasting_name(name, name, [ListPortInfo(name)]) == name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("PermissionError(13, 'Access is denied.', None, 5)", "COM3 is busy: "),
        ("FileNotFoundError(2, 'The system cannot find it.', None, 2)", "COM3: no such port; "),
    ],
)
def test_error_of_pyserial_on_windows_is_explained(text: str, message: str) -> None:
    error = SerialException(f"could not open port 'COM3': {text}")
    assert str(port_error("COM3", "COM3", error)).startswith(message)


def test_name_of_a_new_recording_is_valid_on_windows(
    tmp_path: Path, without_posix: Program
) -> None:
    assert run(without_posix, tmp_path, "live", "sim://", "--plain", "--count", "1")[0] == 0
    (made,) = tmp_path.glob("*.mcap")
    assert re.fullmatch(r"fte-sniff-[\w-]+\.mcap", made.name)


def test_what_a_system_lacks_is_left_out() -> None:
    assert platform.signals("SIGINT", "SIGBREAK_OF_NOBODY") == (signal.SIGINT,)
    assert platform.open_flags("O_RDWR", "O_OF_NOBODY") == os.O_RDWR
