"""Copies, files, news in the status line, terminals, and what Textual does not document."""

from __future__ import annotations

import os
import re
from pathlib import Path
from threading import Thread

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.ansi import AnsiDecoder
from rich.color import ColorSystem
from rich.style import Style

from fte_sniff.protocol.items import Change, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.spec import Status
from fte_sniff.recording.reader import Recording
from fte_sniff.tui import terminal
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.painter import DARK, LIGHT, Palette
from fte_sniff.tui.terminal import TimedOutput, condensed
from tests.tui.conftest import (
    NOON_NS,
    PORT,
    ListFeed,
    lines,
    page,
    play,
    press,
    settle,
    speed_rows,
    until,
)
from tests.waiting import BOUND_S, wait_until


def test_a_copy_is_in_a_file_and_the_screen_says_where(
    feed: ListFeed, folders: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    feed.give(speed_rows(5))

    async def scenario(app: SniffApp) -> None:
        await press(app, "G Y")
        assert (folders / "fte-sniff" / "copied.txt").read_text() == "AA 01 01 00 04 00 00 00 00 EE"
        assert "copied.txt: AA 01 01" in " ".join(page(app).split())
        monkeypatch.setenv("TMUX", "/tmp/tmux-0/default,1,0")
        await press(app, "g v down y")
        assert "tmux passes it on with `set -g set-clipboard on`" in " ".join(page(app).split())
        assert (folders / "fte-sniff" / "copied.txt").read_text().count("\n") == 2

    play(feed, scenario, (160, 24))


def test_shown_rows_are_saved(feed: ListFeed, tmp_path: Path) -> None:
    feed.give(speed_rows(40))

    async def scenario(app: SniffApp) -> None:
        await press(app, "f 'motor = 1' enter w ctrl+u 'a.csv' enter")
        await until(app, "saved 10 rows to")
        assert len((tmp_path / "a.csv").read_text().splitlines()) == 11
        await press(app, "w ctrl+u 'a.pdf' enter")
        assert app.line.question is not None

    play(feed, scenario)


def test_a_saved_recording_names_the_gaps_between_its_rows(feed: ListFeed, tmp_path: Path) -> None:
    rows = speed_rows(40)
    feed.give(rows)
    feed.changes = [Change(20, Gap(GapKind.NOT_SHOWN, reason="too slow"))]

    async def scenario(app: SniffApp) -> None:
        await press(app, "w ctrl+u 'a.mcap' enter")
        await until(app, "saved 40 rows to")

    play(feed, scenario)
    (gap,) = Recording(tmp_path / "a.mcap").gaps()
    assert gap.reason == "too slow"
    assert (gap.start_ns, gap.end_ns) == ((rows[19].t_ns or 0) + 1, (rows[20].t_ns or 0) - 1)


def test_a_lost_port_stays_in_the_status_line_until_esc_also_when_it_is_back(
    feed: ListFeed,
) -> None:
    feed.give(speed_rows(5))

    async def scenario(app: SniffApp) -> None:
        feed.emit(PortEvent(NOON_NS, PORT, PortEventKind.LOST, "unplugged"))
        await settle(app)
        assert "! 12:00:00.000  /dev/ttyUSB0 lost: unplugged" in page(app)
        await press(app, "d")
        assert "changed" not in page(app) or "highlighted" in page(app)
        await press(app, "down")
        assert "lost: unplugged" in page(app)
        await press(app, "escape")
        assert "! 12:00" not in page(app)
        feed.emit(PortEvent(NOON_NS, PORT, PortEventKind.LOST, "again"))
        feed.emit(PortEvent(NOON_NS, PORT, PortEventKind.FOUND_AGAIN, ""))
        await settle(app)
        assert "! 12:00:00.000  /dev/ttyUSB0 found again" in page(app)
        await press(app, "escape")
        assert "! 12:00" not in page(app)
        for port, why in (("a", "gone; " * 30), ("b", "gone; " * 30)):
            feed.emit(PortEvent(NOON_NS, port, PortEventKind.LOST, why))
        await settle(app)
        (line,) = (one for one in lines(app) if one.startswith(" ! "))
        assert line.rstrip().endswith("gone… (esc: 1 more)")
        assert app.status.size.height == 1
        assert "gone; " * 29 + "gone" in str(app.status.tooltip)

    play(feed, scenario)


def test_the_end_of_a_capture_is_reported(feed: ListFeed) -> None:
    async def scenario(app: SniffApp) -> None:
        await press(app, "q")
        assert "to stop recording" in page(app)
        feed.end("the port is gone")
        await settle(app)
        assert "ended: the port is gone" in page(app)
        assert "ENDED" in page(app)
        assert "to stop recording" not in page(app)
        app._began_ns -= 60 * 10**9  # a minute later
        app.show_state()
        await settle(app)
        assert "recorded 0:00:0" in lines(app)[0]

    play(feed, scenario)


def test_output_is_slow_for_as_long_as_its_last_frame_took() -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as far, os.fdopen(writing, "w", encoding="utf-8") as near:
        output = TimedOutput(near)
        assert not output.is_slow
        output.write("x" * 1_000_000)
        frame = Thread(target=output.flush)
        frame.start()
        wait_until(lambda: output.is_slow)
        assert len(far.read(1_000_000)) == 1_000_000
        frame.join(BOUND_S)
        wait_until(lambda: not output.is_slow)


COLOURS = st.none() | st.sampled_from(["#96a0ac", "#121212", "color(9)", "red"])
FLAGS = st.sampled_from([None, True])
STYLES = st.builds(
    Style, color=COLOURS, bgcolor=COLOURS, bold=FLAGS, dim=FLAGS, underline=FLAGS, reverse=FLAGS
)
TEXTS = st.sampled_from(["  ", "a", "a ", "\n\x1b[3;1H", "\x1b[7;80H"])


@given(st.lists(st.tuples(STYLES, TEXTS), min_size=8, max_size=8))
def test_condensed_frame_looks_the_same(segments: list[tuple[Style, str]]) -> None:
    frame = "".join(
        text if "\x1b" in text else style.render(text, color_system=ColorSystem.TRUECOLOR)
        for style, text in segments
    )
    assert seen(condensed(frame)) == seen(frame)
    assert len(condensed(frame)) <= len(frame)


def seen(frame: str) -> list[object]:
    """Moves, characters, and what a terminal shows of their styles; blanks have no colour."""
    found, style = list[object](), Style.null()
    for codes, move, character in re.findall(r"\x1b\[([\d;]*)m|(\n|\x1b\[\d+;\d+H)|(.)", frame):
        if move:
            found.append(move)
        elif character:
            is_ground = character == " " and not (style.underline or style.reverse)
            found.append((character, style.bgcolor if is_ground else style))
        else:
            text = AnsiDecoder()
            text.style = style
            list(text.decode(f"\x1b[{codes}m"))
            style = text.style
    return found


def test_only_one_module_uses_what_textual_does_not_document() -> None:
    folder = Path(terminal.__file__).parent
    private = ("_driver._", "_compositor", "_writer_thread", "._exit", "_key_thread")
    found = {
        path.name
        for path in folder.glob("*.py")
        if any(name in path.read_text("utf-8") for name in private)
    }
    assert found == {"terminal.py"}


def luminance(color: str) -> float:
    """Relative luminance of `#rrggbb`, by WCAG 2."""
    parts = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    bright, dark = sorted((luminance(one), luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(("palette", "ground"), [(DARK, "#1e1e1e"), (LIGHT, "#e0e0e0")])
def test_every_text_is_readable(palette: Palette, ground: str) -> None:
    for style in (palette.muted, palette.good, palette.raised, palette.signs):
        assert style.color is not None
        assert contrast(style.color.name, ground) >= 4.5
    for status in (Status.SUSPECT, Status.MALFORMED):
        color = palette.statuses[status].color
        assert color is not None
        assert contrast(color.name, ground) >= 4.5
