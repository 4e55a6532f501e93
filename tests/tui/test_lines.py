"""The title, the numbers, notices, the pane of details and the help as text."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich.cells import cell_len

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import FAULT_MEANINGS, PortEvent, PortEventKind, Row, spaced_hex
from fte_sniff.tui.help import help_text
from fte_sniff.tui.keys import SECTIONS
from fte_sniff.tui.notices import event_text
from fte_sniff.tui.panes.detail import Width, detail_text
from fte_sniff.tui.status_bar import Mode, StatusCounters, mode_of, status_text, title_text
from fte_sniff.tui.table.theme import DARK
from fte_sniff.tui.table.viewport import Viewport
from fte_sniff.tui.view_model import ViewModel

LIVE = FeedState("/dev/ttyUSB0", "/home/ana/captures/fte-sniff-20260131T120000Z.mcap")
NUMBERS = StatusCounters(
    rows=1_234_567,
    frames_per_s=1151.7,
    malformed=12,
    malformed_share=12 / 1_234_567,
    not_shown=0,
    place=1_234_567,
    following=True,
    below=0,
)


@pytest.mark.parametrize(
    ("state", "paused", "following", "mode"),
    [
        (LIVE, False, True, Mode.LIVE),
        (LIVE, False, False, Mode.SCROLLED),
        (LIVE, True, False, Mode.PAUSED),
        (replace(LIVE, waiting=True), False, True, Mode.WAITING),
        (replace(LIVE, waiting=True), False, False, Mode.SCROLLED),
        (replace(LIVE, running=False), False, False, Mode.ENDED),
        (replace(LIVE, live=False), False, False, Mode.LOADING),
        (replace(LIVE, live=False, running=False), False, False, Mode.FILE),
    ],
)
def test_the_mode_of_the_view(state: FeedState, paused: bool, following: bool, mode: Mode) -> None:
    assert mode_of(state, paused, following) is mode


@pytest.mark.parametrize("width", [0, 1, 10, 24, 40, 80, 200])
@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("title", ["p", "/dev/serial/by-id/usb-串口-if00-port0", "\x1b[31m[red]"])
def test_the_title_fills_its_width(width: int, mode: Mode, title: str) -> None:
    line = title_text(replace(LIVE, title=title, progress=0.42), mode, 12_345, width)
    assert line.isprintable()
    assert width < 24 or (cell_len(line) == width and mode in line)


def test_the_title_keeps_the_end_of_the_recordings_name() -> None:
    line = title_text(LIVE, Mode.LIVE, 0, 80)
    assert line.startswith(" fte-sniff  /dev/ttyUSB0  rec …")
    assert line.rstrip().endswith("120000Z.mcap  LIVE")


def test_the_title_tells_how_many_rows_wait() -> None:
    assert title_text(LIVE, Mode.PAUSED, 1234, 80).endswith(" PAUSED, 1,234 new ")


@pytest.mark.parametrize("width", [40, 60, 80])
def test_that_the_end_is_not_followed_is_told_at_every_width(width: int) -> None:
    assert title_text(LIVE, Mode.SCROLLED, 48_160, width).endswith(" SCROLLED +48,160 ")


@pytest.mark.parametrize("width", [40, 60, 71, 72, 80])
@pytest.mark.parametrize(("share", "shown"), [(1e-6, "<0."), (0.0512, "5.1"), (1.0, "100%")])
def test_the_malformed_are_told_at_every_width(width: int, share: float, shown: str) -> None:
    assert shown in status_text(replace(NUMBERS, malformed_share=share), width)


def test_the_numbers_at_forty_cells() -> None:
    assert status_text(NUMBERS, 40) == "1,234,567 rows     12 bad <0.1%  1,152/s"


def test_where_there_are_no_times_there_is_no_rate() -> None:
    for width in (40, 80):
        assert "/s" not in status_text(replace(NUMBERS, frames_per_s=None), width)


def test_the_numbers_at_eighty_cells() -> None:
    assert status_text(NUMBERS, 80).rstrip() == (
        "1,234,567 rows   1,152 frames/s      12 malformed <0.01%  row 1,234,567"
    )


@pytest.mark.parametrize("width", range(0, 120, 7))
def test_the_numbers_fill_their_width(width: int) -> None:
    assert len(status_text(replace(NUMBERS, not_shown=7), width)) == width


def test_the_numbers_stand_still_while_they_grow() -> None:
    lines = [
        status_text(replace(NUMBERS, rows=rows, frames_per_s=f), 80)
        for rows, f in [(0, 0.0), (999, 99.6), (1_000_000, 2304.0)]
    ]
    assert len({line.index("malformed") for line in lines}) == 1


def test_rows_that_came_too_fast_are_told() -> None:
    assert "7 line errors" in status_text(replace(NUMBERS, line_errors=7), 120)
    assert "7 too fast to show" in status_text(replace(NUMBERS, not_shown=7), 120)


def test_an_event_is_one_line_and_is_not_obeyed() -> None:
    event = PortEvent(1_769_860_800_000_000_000, "p\n", PortEventKind.FOUND_AGAIN, "\x1b[2J[b]x")
    assert event_text(event) == "12:00:00.000  p\\n found again: \\x1b[2J[b]x"


def test_the_details_show_every_byte_once(odd_rows: list[Row]) -> None:
    for row in odd_rows:
        text = detail_text(row, DARK, Width(200, bits=False)).plain
        shown = [line[2:50] for line in text.split("\n")[1:]]
        digits = "".join(
            pair for line in shown for pair in line.split("  ")[0].split() if len(pair) == 2
        )
        assert row.raw.hex().upper() in digits.replace(" ", "")


@pytest.mark.parametrize("width", [1, 20, 40, 79, 199])
def test_the_details_keep_to_their_room(odd_rows: list[Row], width: int) -> None:
    for row in odd_rows:
        for line in detail_text(row, DARK, Width(width, bits=True)).plain.split("\n"):
            assert cell_len(line) <= max(width, 15)


@pytest.mark.parametrize("width", [40, 79])
def test_the_details_cut_no_word(odd_rows: list[Row], width: int) -> None:
    for row in odd_rows:
        narrow, wide = (
            detail_text(row, DARK, Width(room, bits=True)).plain for room in (width, 400)
        )
        assert sorted(narrow.split()) == sorted(wide.split())


def test_every_line_of_noise_is_marked(odd_rows: list[Row]) -> None:
    text = detail_text(odd_rows[5], DARK, Width(79, bits=False)).plain
    name, *behind = text[text.index("! " + " " * 12 + "noise") :].split("\n")
    assert "noise" in name
    digits = [line[2:] for line in behind if line.startswith("! ")]
    assert bytes.fromhex("".join(digits)) == odd_rows[5].raw
    assert behind[: len(digits)] == [f"! {line}" for line in digits]


def test_the_details_tell_what_is_wrong_and_where(odd_rows: list[Row]) -> None:
    text = detail_text(odd_rows[3], DARK, Width(80, bits=False)).plain
    assert "! bad_tail: " in text
    assert "expected EE, found EF" in text
    assert spaced_hex(odd_rows[3].raw[5:9]) in text


def test_flags_are_told_bit_by_bit_where_there_is_room() -> None:
    from fte_sniff.protocol import KIND_BY_NAME, Frame, encode

    raw = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 5, "online": 0x0B})
    tight = detail_text(Frame("p", 0, raw, None), DARK, Width(80, bits=False)).plain
    roomy = detail_text(Frame("p", 0, raw, None), DARK, Width(80, bits=True)).plain
    assert "00001011" in tight
    assert "bit 2" not in tight
    assert "bit 2 is 0: motor 3" in roomy


@pytest.mark.parametrize("width", [30, 60, 80])
def test_the_help_has_every_key_and_every_fault(width: int) -> None:
    text = help_text(width).plain
    assert all(len(line) <= width for line in text.split("\n"))
    flat = " ".join(text.split())
    for _, keys in SECTIONS:
        for key in keys:
            assert f"{key.key_display} {' '.join(key.tooltip.split())}" in flat
    for fault in FAULT_MEANINGS:
        assert fault in flat


class Telling:
    """A feed of port events alone."""

    def __init__(self, *polls: list[PortEvent]) -> None:
        self._polls = list(polls)

    def poll(self) -> FeedUpdate:
        return FeedUpdate(LIVE, events=self._polls.pop(0))

    def stop(self) -> None:
        """Nothing goes on."""


def test_line_errors_are_summed_from_what_the_ports_told() -> None:
    first = PortEvent(1, "a", PortEventKind.LINE_ERROR, "2 framing", 2)
    second = PortEvent(2, "b", PortEventKind.LINE_ERROR, "3 break", 3)
    lost = PortEvent(3, "b", PortEventKind.OVERRUN, "900 bytes", 900)
    watched = ViewModel(Telling([first], [second, lost]), None, RowStore())
    watched.look(0)
    watched.look(1)
    assert watched.numbers(Viewport()).line_errors == 5
