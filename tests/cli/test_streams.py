"""Standard streams that are closed, full, narrow, or left by their reader: one line or silence."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.cli.processes import PROGRAM, started

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
        timeout=60,
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
    f"F hex {FRAME} --format csv",
    f"F {ENCODE}",
    "F decode clean.mcap",
    "F decode clean.mcap --format csv",
    "F decode clean.mcap --filter help",
    "F stats clean.mcap",
    "F stats clean.mcap --format json",
    "F --help",
]


@pytest.mark.parametrize("command", WRITERS)
def test_a_closed_output_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} >&-")
    assert codes == "4"
    assert errors.count("\n") == 1
    assert "standard output is closed" in errors


@pytest.mark.parametrize("command", WRITERS)
def test_a_full_output_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} >/dev/full")
    assert codes == "4"
    assert errors.count("\n") == 1
    assert "disk is full; let it go somewhere else" in errors


@pytest.mark.parametrize("command", [*WRITERS, "F ports", "F doctor", "F decode clean.raw"])
def test_what_cannot_be_told_does_not_fail_what_is_done(bash, command: str) -> None:
    plain, expected, _ = bash(command)
    codes, output, _ = bash(f"{command} 2>/dev/full")
    assert (codes, output) == (plain, expected)


def test_help_that_cannot_be_told_ends_as_ever(bash) -> None:
    assert bash("F 2>/dev/full")[0] == bash("F")[0] == "2"


@pytest.mark.parametrize("blocks", [1, 5, 20])
@pytest.mark.parametrize("form", ["parquet", "mcap", "raw"])
def test_a_file_that_may_not_grow_is_one_line_and_leaves_nothing(
    bash, tmp_path: Path, blocks: int, form: str
) -> None:
    """Whatever writes the form, and wherever in the file it is refused."""
    before = sorted(path.name for path in tmp_path.iterdir())
    codes, _, errors = bash(
        f"(ulimit -f {blocks}; export PYTHONDONTWRITEBYTECODE=1; "
        f"F decode clean.mcap clean.mcap clean.mcap -o rows.{form})"
    )
    assert codes == "4", errors
    assert errors.count("\n") == 1
    assert errors.startswith("fte-sniff: rows.")
    assert "cannot be written: " in errors
    left = sorted(path.name for path in tmp_path.iterdir() if path.name != "codes")
    assert [name for name in left if name not in before] == []


@pytest.mark.parametrize("command", WRITERS)
def test_a_reader_that_leaves_ends_it_quietly(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} | true")
    assert codes in ("0 0", "0")
    assert "Traceback" not in errors
    assert "rror" not in errors


@pytest.mark.parametrize("form", ["table", "jsonl", "csv", "hex"])
@pytest.mark.parametrize("end", ["bin", "log"])
def test_the_head_of_many_bytes(bash, tmp_path: Path, form: str, end: str) -> None:
    frame = bytes.fromhex(FRAME)
    many = frame * 300_000 if end == "bin" else f"{FRAME}\n".encode() * 100_000
    (tmp_path / f"many.{end}").write_bytes(many)
    codes, output, errors = bash(f"F decode many.{end} --format {form} | head -3")
    assert codes == "0 0"
    assert output.count("\n") == 3
    assert errors == ""


@pytest.mark.parametrize("form", ["table", "jsonl", "csv"])
@pytest.mark.parametrize("way", ["raw", "hex"])
def test_rows_come_while_the_input_goes_on(
    environment: dict[str, str], tmp_path: Path, way: str, form: str
) -> None:
    frames = bytes.fromhex(FRAME) * 3 if way == "raw" else f"{FRAME}\n".encode() * 3
    arguments = ("decode", "-", "--format", form)
    with started(environment, tmp_path, *arguments, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for lines in (3 if form == "jsonl" else 4, 3):
            process.stdin.write(frames)
            process.stdin.flush()
            for _ in range(lines):
                assert process.stdout.readline()
        process.stdin.close()
        assert process.wait(60) == 0


def test_the_head_of_a_table(bash) -> None:
    codes, output, _ = bash("F decode clean.mcap | head -2")
    assert codes == "0 0"
    assert output.count("\n") == 2


def test_output_to_a_file_needs_no_standard_output(bash, tmp_path: Path) -> None:
    codes, _, errors = bash("F decode clean.mcap --format csv -o rows.csv >&-")
    assert codes == "0", errors
    assert (tmp_path / "rows.csv").read_text().count("\n") == 1201


@pytest.mark.parametrize("command", ["F hex -", "F decode -", "F decode - --input raw"])
def test_a_closed_input_is_one_line(bash, command: str) -> None:
    codes, _, errors = bash(f"{command} <&-")
    assert codes in ("2", "4")
    assert errors.count("\n") == 1


@pytest.mark.parametrize("form", ["table", "jsonl", "csv"])
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_names_that_the_output_cannot_spell(bash, tmp_path: Path, form: str, encoding: str) -> None:
    (tmp_path / "中文.raw").write_bytes(bytes.fromhex(FRAME))
    command = f"PYTHONIOENCODING={encoding} F decode 中文.raw 中文.raw --format {form}"
    codes, output, errors = bash(command)
    assert codes == "0", errors
    assert r"\u4e2d\u6587.raw" in output
