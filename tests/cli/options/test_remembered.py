"""What the settings file says holds, options win, and what is chosen on the screen is kept."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from fte_sniff.cli.settings import read_settings
from tests.cli.conftest import SAMPLES
from tests.cli.terminals import terminal

CLEAN = str(SAMPLES / "clean.mcap")
DOTS = "sim://?seed=1&rate=500"
QUICK = ("--plain", "--no-record", "--count", "1")


def test_what_is_chosen_on_the_screen_holds_the_next_time(
    environment, settings_file: Path, tmp_path: Path
) -> None:
    settings_file.write_text('# mine\n[screen]\nlanguage = "en"\n')
    with terminal(environment, tmp_path, "view", CLEAN) as screen:
        screen.until("reset")
        screen.type("\x14")
        screen.until("theme textual-light")
        # Of the columns, the first is hidden.
        screen.type("C")
        screen.until("[x] time")
        screen.type(" \r")
        screen.type("q")
        assert screen.ended() == 0
    kept = read_settings(settings_file).screen
    assert kept.theme == "textual-light"
    assert kept.columns is not None
    assert "time" not in kept.columns
    assert kept.language == "en"
    assert "# mine" in settings_file.read_text()
    with terminal(environment, tmp_path, "view", CLEAN) as screen:
        screen.until("reset")
        screen.type("\x14")
        screen.until("theme contrast-dark")
        screen.type("q")
        assert screen.ended() == 0
    assert b"time UTC" not in screen.drawn


def test_nothing_chosen_writes_nothing(environment, settings_file: Path, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "view", CLEAN) as screen:
        screen.until("reset")
        screen.type("q")
        assert screen.ended() == 0
    assert not settings_file.exists()


def test_a_choice_that_cannot_be_kept_is_one_line(environment, tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    environment = environment | {"FTE_SNIFF_CONFIG": str(in_the_way / "config.toml")}
    with terminal(environment, tmp_path, "view", CLEAN, size=(200, 24)) as screen:
        screen.until("reset")
        screen.type("\x14")
        screen.until("theme textual-light")
        screen.type("q")
        assert screen.ended() == 0
    assert screen.drawn.count(b"are not saved") == 1
    assert b"Traceback" not in screen.drawn


@pytest.mark.parametrize(
    ("broken", "way_on"),
    [
        ("[screen", "starting without settings"),
        ("[colour]\n", "it is ignored"),
        ('[screen]\ntheme = "pink"\n', "it is ignored"),
    ],
)
@pytest.mark.parametrize("named", [False, True])
def test_what_is_wrong_in_a_settings_file_is_one_line_and_the_program_goes_on(
    run, settings_file: Path, tmp_path: Path, broken: str, way_on: str, named: bool
) -> None:
    file = tmp_path / "own.toml" if named else settings_file
    file.write_text(broken)
    done = run("live", DOTS, *QUICK, *(("--config", file) if named else ()))
    assert done.returncode == 0
    assert done.stdout.count("\n") == 2
    (line,) = (line for line in done.stderr.splitlines() if str(file) in line)
    assert line.startswith(f"fte-sniff: {file}")
    assert line.endswith(way_on)


def test_the_screen_tells_what_is_wrong_in_the_settings_file(
    environment, settings_file: Path, tmp_path: Path
) -> None:
    settings_file.write_text('[screen]\ntheme = "pink"\n')
    with terminal(environment, tmp_path, "view", CLEAN, size=(200, 24)) as screen:
        screen.until("theme in [screen] must be one of")
        screen.type("q")
        assert screen.ended() == 0


def test_ports_hold_beside_a_name_that_is_none(run, settings_file: Path) -> None:
    settings_file.write_text(f'[live]\nports = ["{DOTS}"]\nfoo = 1\n')
    done = run("live", *QUICK)
    assert done.returncode == 0
    assert "unknown name 'foo' in [live]" in done.stderr


@pytest.mark.parametrize("command", [("live", DOTS), ("bridge", DOTS), ("view", CLEAN)])
def test_an_absent_file_that_was_named_is_an_error(
    environment, tmp_path: Path, command: tuple[str, str]
) -> None:
    with terminal(environment, tmp_path, *command, "--config", "own.toml") as screen:
        assert screen.ended() == 4
    assert screen.drawn.count(b"\n") == 1
    assert b"own.toml" in screen.drawn


def test_live_opens_the_ports_of_the_settings(run, settings_file: Path) -> None:
    settings_file.write_text(f'[live]\nports = ["{DOTS}"]\n')
    done = run("live", *QUICK)
    assert done.returncode == 0
    assert done.stdout.count("\n") == 2


def test_live_without_a_port_says_where_to_get_one(run, settings_file: Path) -> None:
    done = run("live")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "fte-sniff ports" in done.stderr
    assert str(settings_file) in done.stderr


BAUD = """
import os, sys, termios
from fte_sniff.cli import main
try:
    main([*sys.argv[1:], "--plain", "--no-record", "--duration", "0.3"])
finally:
    print(termios.tcgetattr(int(os.environ["NEAR"]))[4], file=sys.stderr)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the baud of a terminal")
@pytest.mark.parametrize(("option", "baud"), [((), 9600), (("--baud", "57600"), 57_600)])
def test_a_port_has_the_baud_of_the_settings_unless_an_option_says_otherwise(
    environment, settings_file: Path, tmp_path: Path, option: tuple[str, ...], baud: int
) -> None:
    import subprocess
    import termios

    from tests.cli.processes import BOUND_S, wire

    with wire() as (_, device):
        settings_file.write_text(f'[port."{device}"]\nbaud = 9600\n')
        with Path(device).open("rb", buffering=0) as near:
            done = subprocess.run(
                [sys.executable, "-c", BAUD, "live", device, *option],
                capture_output=True,
                text=True,
                timeout=BOUND_S,
                check=False,
                cwd=tmp_path,
                env=environment | {"NEAR": str(near.fileno())},
                pass_fds=[near.fileno()],
            )
    names = {9600: termios.B9600, 57_600: termios.B57600}
    assert done.stderr.splitlines()[-1] == str(names[baud])


def test_ports_of_which_the_settings_say_another_baud_each_need_an_option(
    run, settings_file: Path
) -> None:
    settings_file.write_text('[port."sim://?a"]\nbaud = 9600\n[port."sim://?b"]\nbaud = 19200\n')
    done = run("live", "sim://?a", "sim://?b")
    assert done.returncode == 2
    assert "--baud" in done.stderr


def test_turns_come_from_the_settings_of_the_port_in_a_recording(
    run, environment, settings_file: Path, tmp_path: Path
) -> None:
    first = json.loads(run("decode", CLEAN, "--limit", "1", "--format", "jsonl").stdout)
    settings_file.write_text(f'[port."{first["port"]}"]\nresolution = 500\ngear-ratio = 20\n')
    with terminal(environment, tmp_path, "view", CLEAN, size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("GM")
        screen.until(" turns")
        screen.type("q")
        assert screen.ended() == 0


@pytest.mark.parametrize(
    ("said", "options", "locale", "shows"),
    [
        ("", ("--lang", "zh"), "C.UTF-8", "帮助"),
        ("", (), "zh_CN.UTF-8", "帮助"),
        ('language = "zh"', (), "C.UTF-8", "帮助"),
        ('language = "zh"', ("--lang", "en"), "zh_CN.UTF-8", "Help"),
        ('language = "zh"', ("--lang", "auto"), "C.UTF-8", "Help"),
    ],
)
def test_the_screen_speaks_what_is_asked_for(
    environment,
    settings_file: Path,
    tmp_path: Path,
    said: str,
    options: tuple[str, ...],
    locale: str,
    shows: str,
) -> None:
    settings_file.write_text(f"[screen]\n{said}\n")
    environment = environment | {"LANG": locale}
    with terminal(environment, tmp_path, "view", CLEAN, *options) as screen:
        screen.until(shows)
        screen.type("q")
        assert screen.ended() == 0
