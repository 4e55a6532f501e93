"""`hex` and `encode` start at once: they import nothing heavy."""

import subprocess
import sys

import pytest

HEAVY = ("numpy", "polars", "textual", "asyncio", "mcap", "google.protobuf", "rich", "serial")


@pytest.mark.parametrize(
    "arguments",
    [
        ["hex", "AA 02 02 03 E8 00 00 27 10 EE"],
        ["hex", "AA0202", "--format", "jsonl"],
        ["hex", "AA0202", "--format", "csv"],
        ["hex", "AA0202", "--format", "table"],
        ["encode", "speed", "--motor", "1", "--rpm", "5"],
    ],
    ids=" ".join,
)
def test_nothing_heavy_is_imported(environment, arguments: list[str]) -> None:
    program = (
        "import sys\nfrom fte_sniff.cli import main\n"
        f"try: main({arguments!r})\nexcept SystemExit as end: assert not end.code\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout
    assert done.stderr.strip() == "[]"


def test_help_of_every_command(run) -> None:
    listed = run("--help").stdout
    for name in ("live", "view", "decode", "hex", "encode", "simulate", "ports"):
        assert name in listed
        done = run(name, "--help")
        assert done.returncode == 0
        assert done.stdout.startswith(f"Usage: fte-sniff {name}")
    assert run("--version").stdout.startswith("fte-sniff, version ")


@pytest.mark.parametrize("arguments", [[], ["encode"]])
def test_no_command_prints_the_help(run, arguments: list[str]) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert "Commands:\n" in done.stderr
