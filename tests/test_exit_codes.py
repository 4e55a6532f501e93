"""An error in the program itself never looks like a verdict, and a shortage is one line."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from tests.cli.program import Ended, Program, plain_environment
from tests.slow import first

pytestmark = pytest.mark.program

SAMPLE = Path(__file__).parents[1] / "samples" / "clean.mcap"


def run_with(tmp_path: Path, before: str, *arguments: str) -> Ended:
    """Run the program; `before` is Python code that runs when `cli.main` is loaded."""
    code = "import sys, fte_sniff.cli.main\nmodule = sys.modules['fte_sniff.cli.main']\n"
    code += f"{before}\nfrom fte_sniff.__main__ import main\nmain()\n"
    return Program().run(list(arguments), b"", tmp_path, plain_environment(), code)


CHECK = ("check", str(SAMPLE), "--jobs", "1", "--expect", "count(malformed) == 0")


@pytest.mark.parametrize("kind", first(2, ["KeyError", "BaseException", "RecursionError"]))
def test_an_error_in_the_program_is_not_the_verdict_of_a_check(tmp_path: Path, kind: str) -> None:
    fail = f"def fail(*_): raise {kind}('odd')\nmodule.fte_sniff.invoke = fail"
    done = run_with(tmp_path, fail, *CHECK)
    assert done.code == 70
    assert "Traceback" in done.errors.decode(), "a report of the error needs it"
    last = done.errors.decode().splitlines()[-1]
    assert last.startswith(f"fte-sniff: internal error ({kind}: ")
    assert "report" in last


@pytest.mark.parametrize(
    "error",
    first(
        2,
        [
            "MemoryError()",
            "OSError(errno.ENOMEM, 'Cannot allocate memory')",
            "ImportError('libx.so: failed to map segment from shared object')",
            'RuntimeError("can\'t start new thread")',
        ],
    ),
)
def test_a_shortage_of_memory_is_one_line_and_no_verdict(tmp_path: Path, error: str) -> None:
    done = run_with(
        tmp_path,
        f"import errno\ndef fail(*_): raise {error}\nmodule.fte_sniff.invoke = fail",
        *CHECK,
    )
    assert done.code == 70
    assert done.errors.decode().startswith("fte-sniff: ")
    assert len(done.errors.decode().splitlines()) == 1
    assert "ulimit -v" in done.errors.decode()


@pytest.mark.parametrize("megabytes", first(2, [200, 300, 260, 280, 330]))
def test_a_low_limit_of_memory_is_not_a_verdict(tmp_path: Path, megabytes: int) -> None:
    limit = f"import resource\nresource.setrlimit(resource.RLIMIT_AS, ({megabytes} << 20,) * 2)"
    done = run_with(tmp_path, limit, *CHECK)
    assert (done.code, done.output) == (70, b"")
    assert len(done.errors.decode().splitlines()) == 1
    assert "out of memory" in done.errors.decode()


@pytest.mark.parametrize("code", first(1, [errno.EIO, errno.EAGAIN, errno.ECONNRESET]))
def test_an_error_of_the_system_without_a_file_is_not_put_down_to_standard_output(
    tmp_path: Path, code: int
) -> None:
    fail = f"import os\ndef fail(*_): raise OSError({code}, os.strerror({code}))\n"
    fail += "module.fte_sniff.invoke = fail"
    done = run_with(tmp_path, fail, *CHECK)
    assert done.code == 4
    assert len(done.errors.decode().splitlines()) == 1
    assert "standard output" not in done.errors.decode()


DEEP = "x = " + "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize(
    ("text", "code"), [(f"[[rule]]\n{DEEP}", 2), ("[[rule]]\nexpect = 7\n", 2)], ids=["deep", "odd"]
)
def test_rules_that_nest_without_end_are_one_line(tmp_path: Path, text: str, code: int) -> None:
    (tmp_path / "rules.toml").write_text(text)
    done = run_with(tmp_path, "", "check", str(SAMPLE), "--rules", "rules.toml")
    assert done.code == code, done.errors.decode()
    assert len(done.errors.decode().splitlines()) == 1
    assert "rules.toml" in done.errors.decode()
