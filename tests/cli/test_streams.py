"""Standard streams that are closed, full or without a reader; signals at any moment."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fte_sniff.cli.streams import NOT_BEGUN
from tests.cli.conftest import ROOT, SAMPLES
from tests.cli.processes import BOUND_S, PROGRAM, ended, started, wait_until
from tests.cli.program import Program
from tests.cli.terminals import terminal
from tests.slow import crossed, first

FRAME = "AA 02 02 03 E8 00 00 27 10 EE"
ENCODE = "encode speed --motor 1 --rpm 1"


def shell(command: str, environment: dict[str, str], folder: Path) -> tuple[str, str, str]:
    """Run a command in which `F` is the program; exit codes of a pipe's parts, stdout, stderr."""
    program = " ".join(PROGRAM)
    script = f'F() {{ {program} "$@"; }}\n{command}\necho "codes ${{PIPESTATUS[@]}}" >&3'
    done = subprocess.run(
        ["bash", "-c", f"exec 3>codes\n{script}"],
        cwd=folder,
        env=environment,
        capture_output=True,
        stdin=subprocess.DEVNULL,
        timeout=BOUND_S,
        check=False,
    )
    codes = (folder / "codes").read_text().removeprefix("codes ").strip()
    return codes, done.stdout.decode(errors="replace"), done.stderr.decode()


@pytest.fixture
def bash(environment: dict[str, str], tmp_path: Path, samples: Path):
    for name in ("clean.mcap", "clean.raw"):
        (tmp_path / name).write_bytes((samples / name).read_bytes())
    return lambda command: shell(command, environment, tmp_path)


WRITERS = [
    f"F hex {FRAME}",
    "F decode clean.mcap --format csv",
    "F stats clean.mcap",
    "F --help",
    f"F hex {FRAME} --format csv",
    f"F {ENCODE}",
    "F decode clean.mcap",
    "F decode clean.mcap --filter help",
    "F stats clean.mcap --format json",
]
"""Commands that write; the first are one of each way to write."""


@pytest.mark.parametrize("command", first(3, WRITERS))
def test_a_closed_output_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} >&-")
    assert codes == "4"
    assert errors.count("\n") == 1
    assert "standard output cannot be written: Bad file descriptor; redirect it" in errors


@pytest.mark.parametrize("command", first(4, WRITERS))
def test_a_full_output_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} >/dev/full")
    assert codes == "4"
    assert errors.count("\n") == 1
    assert "disk is full; redirect it to another place" in errors


@pytest.mark.parametrize(
    "command", first(2, ["F doctor", "F decode clean.raw", *WRITERS, "F ports"])
)
def test_a_message_that_cannot_be_written_does_not_fail_the_command(bash, command: str) -> None:
    plain, expected, _ = bash(command)
    codes, output, _ = bash(f"{command} 2>/dev/full")
    free = r"[\d.]+ \w+ free"  # other programs write too
    assert (codes, re.sub(free, "", output)) == (plain, re.sub(free, "", expected))


@pytest.mark.parametrize("command", first(4, ["F decode clean.mcap --format mcap -o -", *WRITERS]))
def test_a_reader_that_leaves_ends_it_quietly(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} | true")
    assert codes in ("0 0", "0")
    assert "Traceback" not in errors
    assert "rror" not in errors


@pytest.mark.parametrize(("end", "form"), crossed(["bin", "log"], ["table", "hex", "jsonl", "csv"]))
def test_the_head_of_many_bytes(bash, tmp_path: Path, end: str, form: str) -> None:
    frame = bytes.fromhex(FRAME)
    many = frame * 300_000 if end == "bin" else f"{FRAME}\n".encode() * 100_000
    (tmp_path / f"many.{end}").write_bytes(many)
    codes, output, errors = bash(f"F decode many.{end} --format {form} | head -3")
    assert codes == "0 0"
    assert output.count("\n") == 3
    assert errors == ""


@pytest.mark.parametrize(("way", "form"), crossed(["raw", "hex", "log"], ["table", "jsonl", "csv"]))
def test_rows_come_while_the_input_goes_on(
    environment: dict[str, str], tmp_path: Path, way: str, form: str
) -> None:
    """All but the last row, which the bytes behind it decide."""
    line = {"hex": f"{FRAME}\n", "log": f"12:00:00.001 TX {FRAME}\n"}
    frames = 3 * (line[way].encode() if way in line else bytes.fromhex(FRAME))
    arguments = ("decode", "-", "--format", form)
    with started(environment, tmp_path, *arguments, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for lines in (2 if form == "jsonl" else 3, 3):
            process.stdin.write(frames)
            process.stdin.flush()
            for _ in range(lines):
                assert process.stdout.readline()
        process.stdin.close()
        assert process.wait(BOUND_S) == 0


@pytest.mark.parametrize("command", ["F hex -", "F decode -", "F decode - --input raw"])
def test_a_closed_input_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} <&-")
    assert codes in ("2", "4")
    assert errors.count("\n") == 1


HOOK = """
import os, signal, sys

MOMENTS = {moments!r}

def once():
    os.kill(os.getpid(), signal.SIGINT)

def twice():
    try:
        once()
    finally:
        # The first was heard already, and is on its way out.
        once()

def look(event, arguments):
    if MOMENTS and [event, arguments[0] if arguments else None] == MOMENTS[0][:2]:
        globals()[MOMENTS.pop(0)[2]]()

sys.addaudithook(look)
"""
Moments = list[tuple[str, str, str]]
"""Events of the interpreter, what they are about, and how Ctrl-C is pressed then."""
HOW = pytest.mark.parametrize("how", first(1, ["once", "twice"]))
Hooked = Callable[[Moments], dict[str, str]]


@pytest.fixture
def hooked(environment, tmp_path_factory: pytest.TempPathFactory) -> Hooked:
    """The environment in which Ctrl-C is pressed at these moments, one after the other."""

    def hooked(moments: Moments) -> dict[str, str]:
        folder = tmp_path_factory.mktemp("hook")
        text = HOOK.format(moments=[list(moment) for moment in moments])
        (folder / "sitecustomize.py").write_text(text)
        return environment | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}

    return hooked


def assert_quiet_end(environment: dict[str, str], folder: Path, *arguments: str) -> None:
    done = subprocess.run(
        [*PROGRAM, *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=environment,
        cwd=folder,
        timeout=BOUND_S,
        check=False,
    )
    if arguments[0] == "live" and done.returncode == 0:
        assert done.stderr.decode() == f"{NOT_BEGUN}\n"
    else:
        # A shell makes 130 of the one as of the other.
        assert (done.returncode in (130, -signal.SIGINT), done.stderr) == (True, b"")
    assert list(folder.iterdir()) == []


DECODE = ("decode", str(SAMPLES / "damaged.mcap"))


@HOW
@pytest.mark.parametrize(
    ("module", "arguments"),
    first(
        5,
        [
            ("fte_sniff.cli", ("encode", "reset")),
            ("fte_sniff.session.live_session", ("live", "sim://")),
            ("polars", (*DECODE, "--filter", "motor = 1")),
            ("numpy.linalg", (*DECODE, "-o", "rows.mcap")),
            ("click", ("live", "sim://")),
            ("fte_sniff.protocol.spec", ("encode", "reset")),
            ("fte_sniff.cli.capturing", ("live", "sim://")),
            ("numpy", (*DECODE, "-o", "rows.csv")),
        ],
    ),
)
def test_it_ends_in_silence(
    hooked: Hooked, tmp_path: Path, module: str, arguments: tuple[str, ...], how: str
) -> None:
    assert_quiet_end(hooked([("import", module, how)]), tmp_path, *arguments)


@HOW
@pytest.mark.parametrize("module", first(1, ["textual.app", "fte_sniff.tui.app", "textual.pilot"]))
def test_the_terminal_is_as_it_was(hooked: Hooked, tmp_path: Path, module: str, how: str) -> None:
    with terminal(hooked([("import", module, how)]), tmp_path, "view", DECODE[1]) as screen:
        assert screen.ended() in (130, -signal.SIGINT)
        assert screen.is_as_it_was
    assert b"Traceback" not in screen.drawn
    assert b"KeyboardInterrupt" not in screen.drawn


@pytest.mark.parametrize(
    ("command", "number"),
    crossed(
        ["repair cut.mcap", "decode cut.mcap -o rows.csv"],
        [signal.SIGTERM, signal.SIGHUP, signal.SIGINT],
    ),
)
def test_signal_leaves_no_part_of_an_output(
    run, environment, tmp_path: Path, command: str, number: signal.Signals
) -> None:
    whole, cut = tmp_path / "whole.raw", tmp_path / "cut.mcap"
    whole.write_bytes(bytes.fromhex(FRAME) * 200_000)
    run("decode", whole, "-o", cut, "--start", "2026-01-31T12:00:00Z")
    os.truncate(cut, cut.stat().st_size - 100)
    whole.unlink()
    with started(environment, tmp_path, *command.split()) as process:
        wait_until(lambda: any(one.stat().st_size for one in tmp_path.glob(".fte-sniff-*.part")))
        process.send_signal(number)
        code, _, errors = ended(process)
    assert (code, errors) == (130 if number == signal.SIGINT else -number, "")
    assert list(tmp_path.iterdir()) == [cut]


CHECK = "F check clean.mcap --expect 'count(malformed) >= 0'"


@pytest.mark.parametrize("limit", first(2, [19, 24, *range(17, 40, 4)]))
@pytest.mark.parametrize(
    "command",
    [
        "F decode n*.mcap -o x.parquet --force",
        "F live sim:// --plain --count 3 -o x.mcap --force",
        f"{CHECK} --jobs 2",
    ],
)
def test_too_many_open_files_are_one_line(bash, limit: int, command: str) -> None:
    many = "for n in $(seq 40); do cp clean.mcap n$n.mcap; done"
    codes, _, errors = bash(f"{many}; (ulimit -n {limit}; {command})")
    assert codes in ("0", "3", "4")
    if codes != "0":
        *_, last = errors.splitlines()
        assert last.startswith("fte-sniff: ")
        assert "too many open files" in last.lower()
        assert "Traceback" not in errors


TWICE = """
import os, signal
from fte_sniff.cli.streams import interruptible
signal.signal(signal.SIGINT, signal.SIG_DFL)
with interruptible():
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        os.kill(os.getpid(), signal.SIGINT)
        print("removed", flush=True)
        os.kill(os.getpid(), signal.SIGINT)
        print("not reached", flush=True)
"""


def test_a_second_signal_does_not_keep_a_part_of_an_output_and_a_third_one_ends_at_once(
    environment: dict[str, str], tmp_path: Path
) -> None:
    done = Program().run((), b"", tmp_path, environment, TWICE)
    assert (done.output, done.code) == (b"removed\n", -signal.SIGINT)
