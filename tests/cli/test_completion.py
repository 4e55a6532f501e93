"""Completion in real shells, and what the program offers them."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from fte_sniff.protocol.columns import COLUMNS
from tests.cli.conftest import SAMPLES
from tests.cli.terminals import controlling_terminal, terminal

pytestmark = pytest.mark.tool

SHELLS = {
    "bash": (["bash", "--norc", "--noprofile", "-i"], 'eval "$(fte-sniff completion bash)"'),
    "zsh": (
        ["zsh", "-f", "-i"],
        'autoload -Uz compinit && compinit -u -D && eval "$(fte-sniff completion zsh)"',
    ),
    "fish": (["fish", "--no-config", "-i"], "fte-sniff completion fish | source"),
}
"""How each shell is started without the user's settings, and how it loads the script."""

TYPED = (
    ("fte-sniff decode sub\tin\t--forma\tcsv --filter mecan\t\n", ",mecanum,"),
    ("fte-sniff liv\tsi\t --plain --no-record --count 1\n", "1 row"),
)
"""What is typed, with tabs, and what it prints if each tab completes the word."""


@pytest.mark.parametrize("shell", SHELLS)
def test_tab_completes(environment: dict[str, str], tmp_path: Path, shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    program, load = SHELLS[shell]
    folder = tmp_path / "work"
    (folder / "subfolder").mkdir(parents=True)
    shutil.copy(SAMPLES / "clean.hex", folder / "subfolder/inner.hex")
    here = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    own = environment | {"PATH": here, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    with terminal(
        own, folder, program=program, session=controlling_terminal, size=(200, 50)
    ) as screen:
        screen.type(f"{load}; echo rea''dy\n")
        screen.until("ready")
        for keys, shown in TYPED:
            screen.type(keys)
            screen.until(shown)
        screen.type("exit\n")
        screen.ended()


@pytest.fixture
def offered(run, environment: dict[str, str]):
    """What the program offers for the last word, as its type and its text."""

    def offered(*words: str) -> list[str]:
        environment["_FTE_SNIFF_COMPLETE"] = "bash_complete"
        environment["COMP_WORDS"] = "\n".join(["fte-sniff", *words])
        environment["COMP_CWORD"] = str(len(words))
        done = run()
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.splitlines()

    return offered


@pytest.mark.parametrize("command", ["decode", "repair", "stats", "view"])
def test_the_shell_completes_files(offered, command: str) -> None:
    assert offered(command, "folder/a") == ["file,folder/a"]
    assert offered(command, "~no-such-user/") == ["file,~no-such-user/"]


def test_words_of_a_filter_are_offered(offered) -> None:
    assert offered("live", "--filter", "mot") == ["plain,motor", "plain,motor_hint"]
    assert offered("live", "--filter", "'motor = 1 AND rp") == ["plain,motor = 1 AND rpm"]
    assert offered("stats", "--filter", "\"kind = 'me") == ["plain,kind = 'mecanum'"]
    fields = offered("decode", "--filter", "")
    assert [f"plain,{column.name}" for column in COLUMNS] == fields[: len(COLUMNS)]
    assert offered("decode", "--filter", "help", "--lim") == ["plain,--limit"]


def test_nothing_is_offered_after_an_unknown_command(offered) -> None:
    assert offered("lvie", "x") == [""]


def test_ports_are_offered(offered) -> None:
    for command in ("live", "bridge", "doctor"):
        assert "plain,sim://" in offered(command, "")
