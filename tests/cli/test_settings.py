"""The settings file: valid values hold, options override them, choices on the screen are saved."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.time_text import LOCAL
from fte_sniff.cli.settings import Settings, read_settings
from fte_sniff.i18n import THEMES
from fte_sniff.tui.cells import ORDER
from fte_sniff.tui.options import Choices
from tests.cli.conftest import SAMPLES
from tests.cli.processes import wire
from tests.cli.terminals import terminal
from tests.slow import first

WHOLE = """
# mine
[screen]
language = "zh"               # at noon

[live]
ports = ["/dev/ttyUSB0", "/dev/ttyUSB1"]
zone = "local"
reconnect = false

[port."/dev/ttyUSB0"]
baud = 57600
resolution = 500
gear-ratio = 30
"""

ONLY_X = Settings(port={"x": {}})

choices = st.builds(
    Choices,
    st.none() | st.sampled_from(THEMES),
    st.none() | st.lists(st.sampled_from(ORDER), min_size=1, unique=True).map(tuple),
    st.none() | st.sampled_from(["en", "zh"]),
    st.dictionaries(st.text(), st.text()).map(lambda found: tuple(found.items())),
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "fte-sniff" / "config.toml"


def written(file: Path, text: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return file


def test_all_settings_are_read(file: Path) -> None:
    settings = read_settings(written(file, WHOLE))
    assert settings.screen == {"language": "zh"}
    ports = ("/dev/ttyUSB0", "/dev/ttyUSB1")
    assert settings.live == {"ports": ports, "zone": LOCAL, "reconnect": False}
    whole = {"baud": 57_600, "resolution": 500, "gear-ratio": 30.0}
    assert settings.of_port("/dev/ttyUSB0") == whole
    assert settings.of_port("/dev/ttyUSB9") == {}


def test_a_port_is_found_by_another_of_its_names(file: Path, tmp_path: Path) -> None:
    device, lasting = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    lasting.symlink_to(device)
    settings = read_settings(written(file, f'[port."{lasting}"]\nbaud = 9600\n'))
    assert settings.of_port(str(device))["baud"] == 9600
    assert settings.of_port(str(lasting))["baud"] == 9600


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[screen]\nlanguage = 3\n", "language in [screen]: '3' is not one of 'en', 'zh'"),
        ('[screen]\ntheme = "nord"\n', "in [screen]; use one of language"),
        ('[live]\nports = "a"\n', "ports in [live]: 'a' is not a list"),
        ("screen = 1\n", "screen must be a table"),
        ("port.x = 1\n", "port.x must be a table"),
        ('[port."x"]\nbaud = [1]\n', "baud in [port.x]: "),
        ('[port."x"]\nbaud = 9600.5\n', "baud in [port.x]: '9600.5' is not a valid integer"),
        ("[live]\nzone = []\n", "zone in [live]: "),
        ('[port."x"]\ngear-ratio = 0\n', "gear-ratio in [port.x]: 0.0 is not in the range x>0"),
        ('[port."x"]\ngear-ratio = nan\n', "gear-ratio in [port.x]: nan is not a number"),
        ("[live]\nnetwork = 3\n", "network in [live]: '3' is not a valid boolean"),
        ("[live]\nreconnect = []\n", "reconnect in [live]: "),
        ("[live]\nzone = 8.5\n", "zone in [live]: '8.5' is not a time zone"),
        ("[colour]\n", "unknown name 'colour'; use one of screen, live, port"),
    ],
)
def test_an_invalid_setting_is_left_out_and_reported(file: Path, text: str, says: str) -> None:
    settings = read_settings(written(file, text))
    (fault,) = settings.trouble
    assert says in fault
    assert "\n" not in fault
    assert replace(settings, trouble=(), path=Path()) in (Settings(), ONLY_X)


def test_what_is_right_beside_it_holds(file: Path) -> None:
    wrong = WHOLE.replace("[screen]", "[screen]\nfoo = 1").replace("57600", "0")
    settings = read_settings(written(file, f"{wrong}[colour]\n"))
    assert len(settings.trouble) == 3
    whole = read_settings(written(file, WHOLE))
    assert (settings.screen, settings.live) == (whole.screen, whole.live)
    assert settings.port == {"/dev/ttyUSB0": {"resolution": 500, "gear-ratio": 30}}


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", "[screen]\n# 电机".encode("gbk")])
def test_bytes_that_are_not_utf_8_are_one_line(file: Path, content: bytes) -> None:
    written(file, "").write_bytes(content)
    (trouble,) = read_settings(file).trouble
    assert "is not UTF-8; save the file as UTF-8" in trouble


def test_a_byte_order_mark_is_read(file: Path) -> None:
    written(file, "").write_bytes("\ufeff[screen]\r\nlanguage = 'zh'\r\n".encode())
    assert read_settings(file).screen["language"] == "zh"


@pytest.mark.parametrize("text", ["x = " + "[" * 100_000, "zone =\n"])
def test_what_is_not_a_settings_file_is_one_line(file: Path, text: str) -> None:
    (trouble,) = read_settings(written(file, text)).trouble
    assert "is not TOML: " in trouble
    assert str(file) in trouble


@given(choices)
def test_what_is_chosen_holds(tmp_path_factory: pytest.TempPathFactory, choices: Choices) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        Settings().keep(choices)
        assert Settings().choices == choices
        assert Settings({"language": "zh"}).language() == (choices.language or "zh")


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b"\xff", b"[" * 100_000, b'{"theme": 1, "columns": ["x"], "filters": 3}'],
)
def test_invalid_choices_are_ignored(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: bytes
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "fte-sniff").mkdir()
    (tmp_path / "fte-sniff/screen.json").write_bytes(content)
    assert Settings().choices == Choices()


CLEAN = str(SAMPLES / "clean.mcap")


def test_choices_that_cannot_be_stored_are_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(in_the_way))
    Settings().keep(Choices(theme="nord"))
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("the choices of the screen are not saved: ")
    assert str(in_the_way) in line


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only a pty of Linux has a baud")
@pytest.mark.parametrize(("option", "baud"), [([], 9600), (["--baud", "57600"], 57_600)])
def test_a_port_has_the_baud_of_the_settings_unless_an_option_overrides_it(
    run, environment, settings_file: Path, option: list[str], baud: int
) -> None:
    import termios

    with wire() as (_, device), Path(device).open("rb", buffering=0) as near:
        settings_file.write_text(f'[port."{device}"]\nbaud = 9600\n')
        words = ("--plain", "--no-record", "--duration", "0.3")
        assert run("live", device, *words, *option).returncode == 0
        speed = termios.tcgetattr(near)[4]
    assert speed == {9600: termios.B9600, 57_600: termios.B57600}[baud]


def test_ports_with_different_bauds_in_the_settings_need_an_option(
    run, settings_file: Path
) -> None:
    settings_file.write_text('[port."sim://?a"]\nbaud = 9600\n[port."sim://?b"]\nbaud = 19200\n')
    done = run("live", "sim://?a", "sim://?b")
    assert done.returncode == 2
    assert "--baud" in done.stderr


def test_turns_come_from_the_settings_of_the_port(file: Path) -> None:
    settings = read_settings(written(file, WHOLE))
    assert settings.pulses_per_turn(("/dev/ttyUSB0",)) == 500 * 30
    assert settings.pulses_per_turn(("/dev/ttyUSB9",)) is None


@pytest.mark.parametrize(
    ("said", "options", "locale", "shows"),
    first(
        2,
        [
            ('language = "zh"', (), "C.UTF-8", "帮助"),
            ('language = "zh"', ("--lang", "en"), "zh_CN.UTF-8", "Help"),
            ("", ("--lang", "zh"), "C.UTF-8", "帮助"),
            ("", (), "zh_CN.UTF-8", "帮助"),
            ('language = "zh"', ("--lang", "auto"), "C.UTF-8", "Help"),
        ],
    ),
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
        screen.type("Q")
        assert screen.ended() == 0
