"""The screen as its users meet it: in a terminal, through `live` and `view`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.cli.conftest import SAMPLES
from tests.cli.terminals import terminal


@pytest.mark.parametrize("size", [(40, 10), (80, 24), (200, 60)])
def test_live_shows_rows_and_leaving_says_where_the_recording_lies(
    run, environment, tmp_path: Path, size: tuple[int, int]
) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", size=size) as screen:
        screen.until("speed_feedback" if size[0] > 128 else "speed fb")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn
    (recording,) = tmp_path.glob("*.mcap")
    assert f"recorded to {recording.name}".encode() in screen.drawn
    assert run("decode", recording).stdout.count("\n") > 1


def test_ctrl_c_and_a_bounded_capture_end_it_too(environment, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", "--no-record") as screen:
        screen.until("speed fb")
        screen.type("\x03")
        assert screen.ended() == 0
    with terminal(
        environment, tmp_path, "live", "sim://", "--count", "9", "-o", "x.mcap"
    ) as screen:
        assert screen.ended() == 0
    assert b"recorded to x.mcap" in screen.drawn


def test_standard_error_in_a_file_is_no_part_of_the_screen(environment, tmp_path: Path) -> None:
    told = tmp_path / "err.log"
    arguments = ("live", "sim://?rate=500", "-o", "x.mcap")
    with terminal(environment, tmp_path, *arguments, errors=told) as screen:
        screen.until("speed fb")
        assert told.read_bytes() == b""
        screen.type("q")
        assert screen.ended() == 0
    count, where = told.read_text().splitlines()
    assert re.fullmatch(r"[0-9,]+ rows, nothing malformed, \d+\.\d{3} s from \S+Z", count)
    assert where == "recorded to x.mcap"
    assert b"recorded to" not in screen.drawn


def test_no_color(environment, tmp_path: Path) -> None:
    environment = environment | {"NO_COLOR": "1"}
    with terminal(environment, tmp_path, "live", "sim://?drop=0.3", "--no-record") as screen:
        screen.until("truncated")
        screen.type("q")
        assert screen.ended() == 0
    assert b"\x1b[38;2" not in screen.drawn


def test_a_port_that_is_lost_stays_on_the_screen_until_the_user_leaves(
    environment, tmp_path: Path
) -> None:
    port = "sim://?rate=500&frames=40"
    with terminal(environment, tmp_path, "live", port, "--no-record", size=(200, 60)) as screen:
        screen.until("was lost")
        screen.type("q")
        assert screen.ended() == 3


def test_a_killed_screen_leaves_a_file_that_opens(run, environment, tmp_path: Path) -> None:
    with terminal(environment, tmp_path, "live", "sim://?rate=500", "-o", "x.mcap") as screen:
        screen.until("speed fb")
        screen.process.kill()
    assert run("decode", "x.mcap").returncode == 0


@pytest.mark.parametrize("name", ["clean.mcap", "damaged.raw", "midstream.hex"])
def test_view_shows_files(environment, tmp_path: Path, name: str) -> None:
    with terminal(environment, tmp_path, "view", str(SAMPLES / name), size=(200, 60)) as screen:
        screen.until("speed_feed")
        screen.type("q")
        assert screen.ended() == 0
    assert b"Traceback" not in screen.drawn


@pytest.mark.parametrize(
    ("language", "words"), [("en", "! the file is damaged: it is cut"), ("zh", "文件已损坏")]
)
def test_view_shows_that_a_file_is_damaged(
    environment, tmp_path: Path, language: str, words: str
) -> None:
    whole = (SAMPLES / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    options = ("view", "cut.mcap", "--lang", language)
    with terminal(environment, tmp_path, *options, size=(200, 60)) as screen:
        screen.until(words)
        screen.type("q")
        assert screen.ended() == 0


def test_view_tells_what_cannot_be_read_before_the_screen_opens(
    environment, tmp_path: Path
) -> None:
    with terminal(environment, tmp_path, "view", "none.mcap") as screen:
        assert screen.ended() == 4
    assert screen.drawn.count(b"\n") == 1
    assert b"none.mcap: there is no such file" in screen.drawn


def test_hex_takes_a_frame_apart_in_the_width_of_the_terminal(environment, tmp_path: Path) -> None:
    frame = "AA 02 02 03 E8 00 00 27 10 EE"
    with terminal(environment, tmp_path, "hex", frame, size=(60, 24)) as screen:
        assert screen.ended() == 0
    text = screen.drawn.decode()
    assert "\x1b[1m" in text
    assert "10000 pulses" in text
