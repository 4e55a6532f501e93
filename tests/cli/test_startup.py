"""Commands start with what they need: `hex` and `encode` at once, screens with their first rows."""

import signal
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from fte_sniff.cli.main import COMMANDS
from tests.beside import running
from tests.cli.conftest import ROOT, SAMPLES
from tests.cli.processes import BOUND_S
from tests.slow import first

pytestmark = pytest.mark.program

HEAVY = ("polars", "textual", "asyncio", "mcap", "google.protobuf", "rich", "serial")


def _heavy_modules(
    environment: dict[str, str], arguments: list[str], heavy: tuple[str, ...] = HEAVY
) -> tuple[str, str]:
    """What a command prints, and the heavy modules that it has loaded."""
    program = (
        "import sys\nfrom fte_sniff.cli import main\n"
        f"try: main({arguments!r})\nexcept SystemExit as end: assert not end.code\n"
        f"print([name for name in {heavy!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True
    )
    return done.stdout, done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["hex", "AA 02 02 03 E8 00 00 27 10 EE"],
        ["hex", "AA0202", "--format", "table"],
        ["encode", "speed", "--motor", "1", "--rpm", "5"],
    ],
    ids=" ".join,
)
def test_nothing_heavy_is_imported(environment, arguments: list[str]) -> None:
    printed, loaded = _heavy_modules(environment, arguments)
    assert printed
    assert loaded == "[]"


def test_help_of_every_command(run) -> None:
    listed = run("--help").stdout
    for name in COMMANDS:
        assert name in listed
        done = run(name, "--help")
        assert done.returncode == 0
        assert done.stdout.startswith(f"Usage: fte-sniff {name}")


def test_nothing_is_loaded_before_ctrl_c_is_seen_to() -> None:
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); before = set(sys.modules);"
        " import fte_sniff.__main__; print(sorted(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", program, str(ROOT)],
        capture_output=True,
        text=True,
        check=True,
        timeout=BOUND_S,
    )
    assert done.stdout.strip() == "['fte_sniff', 'fte_sniff.__main__']"


def test_ctrl_c_while_it_loads_is_not_a_traceback(environment, tmp_path: Path) -> None:
    # A library that takes for ever to load, in the place of the first that is loaded.
    (tmp_path / "click.py").write_text("print('loading', flush=True)\ninput()\n")
    with running(
        [sys.executable, "-m", "fte_sniff", "live", "sim://"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**environment, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"loading\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=BOUND_S)
    assert process.returncode == -signal.SIGINT
    assert errors == b""


POISON = "with open({marker!r}, 'a') as file:\n    file.write(__name__ + '\\n')\n"


@pytest.mark.parametrize(
    "arguments",
    first(
        3,
        [
            ["live", "sim://", "--plain", "--count", "3", "--filter", "motor = 1"],
            ["decode", str(SAMPLES / "damaged.mcap"), "--filter", "motor = 1", "-o", "x.parquet"],
            ["doctor"],
            ["live", "sim://", "--plain", "--count", "3"],
            ["bridge", "sim://?host=off", "--plain", "--count", "3"],
            ["stats", str(SAMPLES / "damaged.mcap"), "--format", "json"],
        ],
    ),
    ids=" ".join,
)
def test_no_code_of_the_working_folder_runs(
    environment, tmp_path: Path, tmp_path_factory, arguments: list[str]
) -> None:
    """Each library has a namesake there."""
    marker = tmp_path_factory.mktemp("marker") / "executed"
    script = marker.with_name("fte-sniff")
    script.write_text("from fte_sniff.__main__ import main\nmain()\n")
    for name in {*sys.stdlib_module_names, *third_party()}:
        (tmp_path / f"{name}.py").write_text(POISON.format(marker=str(marker)))
    done = subprocess.run(
        [sys.executable, script, *arguments],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=environment,
        cwd=tmp_path,
        timeout=BOUND_S,
        check=False,
    )
    assert not marker.exists(), marker.read_text()
    assert done.returncode in (0, 1) if arguments == ["doctor"] else not done.returncode, done


def third_party() -> set[str]:
    return {name for name in packages_distributions() if name.isidentifier()} - {"fte_sniff"}
