from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.cli.settings import (
    PortDefaults,
    ScreenSettings,
    Settings,
    read_settings,
    save_screen,
    settings_path,
)
from fte_sniff.errors import FileError
from fte_sniff.tui.i18n import THEMES
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES

WHOLE = """
# mine
[screen]
theme = "textual-light"       # at noon
columns = ["time", "kind", "values"]
widths = { time = 15 }
language = "zh"

[live]
ports = ["/dev/ttyUSB0", "/dev/ttyUSB1"]

[port."/dev/ttyUSB0"]
baud = 57600
resolution = 500
gear-ratio = 30
"""

ONLY_X = Settings(by_port={"x": PortDefaults()})

names = st.sampled_from([*ORDER, VALUES])
screens = st.builds(
    ScreenSettings,
    theme=st.none() | st.sampled_from(THEMES),
    columns=st.none() | st.lists(names, min_size=1, unique=True).map(tuple),
    widths=st.none() | st.dictionaries(names, st.integers(LEAST, MOST), min_size=1),
    language=st.none() | st.sampled_from(["en", "zh"]),
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "fte-sniff" / "config.toml"


def written(file: Path, text: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")
    return file


def test_no_file_says_nothing(file: Path) -> None:
    assert read_settings(file) == Settings()


def test_everything_that_can_be_said(file: Path) -> None:
    settings = read_settings(written(file, WHOLE))
    assert settings.screen == ScreenSettings(
        "textual-light", ("time", "kind", "values"), {"time": 15}, "zh"
    )
    assert settings.ports == ("/dev/ttyUSB0", "/dev/ttyUSB1")
    assert settings.of_port("/dev/ttyUSB0") == PortDefaults(57_600, 500, 30.0)
    assert settings.of_port("/dev/ttyUSB9") == PortDefaults()


def test_a_port_is_found_by_another_of_its_names(file: Path, tmp_path: Path) -> None:
    device, lasting = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    lasting.symlink_to(device)
    settings = read_settings(written(file, f'[port."{lasting}"]\nbaud = 9600\n'))
    assert settings.of_port(str(device)).baud == 9600
    assert settings.of_port(str(lasting)).baud == 9600


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[screen]\ntheme = 3\n", "theme in [screen] must be one of textual-dark"),
        ('[screen]\ncolums = ["time"]\n', "did you mean columns?"),
        ('[screen]\ncolumns = ["moter"]\n', "columns in [screen] must be a list"),
        ('[screen]\ncolumns = ["time", "time"]\n', "different names"),
        ('[screen]\ntheme = "pink"\n', "theme in [screen] must be one of textual-dark"),
        ('[screen]\nlanguage = "tlh"\n', "language in [screen] must be one of en, zh, auto"),
        ("[screen]\nwidths = 3\n", "widths in [screen] must be a table of columns"),
        ("[screen]\nwidths = { time = 1 }\n", "with 3 to 200 cells each"),
        ("[screen]\nwidths = { moter = 9 }\n", "widths in [screen] must be a table of columns"),
        ("[screen]\ncolumns = [[]]\n", "columns in [screen] must be a list"),
        ("screen = 1\n", "[screen] must be a table"),
        ("port = 1\n", "[port] must be a table"),
        ('[port."x"]\nbaud = true\n', "baud in [port.x] must be a whole number"),
        ('[port."x"]\ngear-ratio = 0\n', "gear-ratio in [port.x] must be a number above 0"),
        ('[port."x"]\ngear-ratio = nan\n', "gear-ratio in [port.x] must be a number above 0"),
        ("[live]\nports = []\n", "ports in [live] must be a list of one or two ports"),
        ("[colour]\n", "unknown name 'colour'"),
    ],
)
def test_what_cannot_be_is_left_out_and_said(file: Path, text: str, says: str) -> None:
    settings = read_settings(written(file, text))
    (fault,) = settings.faults
    assert says in fault
    assert "\n" not in fault
    assert replace(settings, faults=()) in (Settings(), ONLY_X)


def test_what_is_right_beside_it_holds(file: Path) -> None:
    wrong = WHOLE.replace("[screen]", "[screen]\nfoo = 1").replace("57600", "0")
    settings = read_settings(written(file, f"{wrong}[colour]\n"))
    assert len(settings.faults) == 3
    whole = read_settings(written(file, WHOLE))
    assert (settings.screen, settings.ports) == (whole.screen, whole.ports)
    assert settings.by_port == {"/dev/ttyUSB0": PortDefaults(None, 500, 30)}


@pytest.mark.parametrize("text", ["[screen", "a = " + "[" * 5_000])
def test_what_is_no_toml_is_one_line(file: Path, text: str) -> None:
    with pytest.raises(FileError) as caught:
        read_settings(written(file, text))
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_are_one_line(file: Path) -> None:
    written(file, "").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileError, match="is not TOML"):
        read_settings(file)


def test_a_folder_in_its_place_is_one_line(file: Path) -> None:
    file.mkdir(parents=True)
    with pytest.raises(FileError, match="is a directory"):
        read_settings(file)


@given(first=screens, second=screens)
def test_what_is_kept_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, first: ScreenSettings, second: ScreenSettings
) -> None:
    file = tmp_path_factory.mktemp("settings") / "config.toml"
    for screen in (first, second):
        save_screen(file, screen)
        assert read_settings(file).screen == screen


def test_keeping_leaves_the_rest_as_it_was_written(file: Path) -> None:
    written(file, WHOLE)
    save_screen(file, ScreenSettings("textual-dark", ("time",), None, "zh"))
    text = file.read_text()
    assert "# mine" in text
    assert text.endswith(WHOLE[WHOLE.index("[live]") :])
    assert read_settings(file).ports == ("/dev/ttyUSB0", "/dev/ttyUSB1")
    assert list(file.parent.iterdir()) == [file]


def test_keeping_follows_a_link(file: Path, tmp_path: Path) -> None:
    real = written(tmp_path / "dotfiles" / "fte.toml", WHOLE)
    file.parent.mkdir()
    file.symlink_to(real)
    save_screen(file, ScreenSettings(theme="nord"))
    assert file.is_symlink()
    assert read_settings(real).screen.theme == "nord"


def test_what_is_broken_is_never_overwritten(file: Path) -> None:
    written(file, "[screen")
    with pytest.raises(FileError, match="is not TOML"):
        save_screen(file, ScreenSettings("nord"))
    assert file.read_text() == "[screen"


@pytest.mark.parametrize("text", ["screen = 1\n", 'screen = "dark"\n'])
def test_a_setting_in_place_of_a_table_is_left_alone(file: Path, text: str) -> None:
    written(file, text)
    with pytest.raises(FileError):
        save_screen(file, ScreenSettings("nord"))
    assert file.read_text() == text


def test_the_environment_names_another_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FTE_SNIFF_CONFIG", "/elsewhere/c.toml")
    assert settings_path() == Path("/elsewhere/c.toml")
    monkeypatch.delenv("FTE_SNIFF_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", "/xdg")
    assert settings_path() == Path("/xdg/fte-sniff/config.toml")
