"""Heads of lines: what was read before makes them quicker, and no other."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st

from fte_sniff.formats.logs.line_head import Heads, head_of

FRONTS = [
    "",
    " ",
    "[INFO] ",
    "[ros2_control-1] ",
    "I (1) fte: ",
    "COM3 ",
    "/dev/ttyUSB0: ",
    "Incoming raw data at ",
    "RX ",
    "# ",
    "(",
]
TIMES = [
    "[14:03:22.123]",
    "[14:03:22]",
    "<14:03:22>",
    "[2026-01-31 10:15:02.123]",
    "2026-01-31 10:15:02,123",
    "2026-01-31T10:15:02Z",
    "2026-01-31 10:15:02.5 PM",
    "10:15:02.123",
    "10:15:02:123",
    "10:15:02",
    "10:15",
    "2026-01-31",
    "2026/01/31 10:15",
    "1769860802.123",
    "[1769860800.123456789]",
    "(0.123)",
    "[25:61:61.1]",
]
WORDS = [
    "",
    " ",
    "收←◆",
    "发→◇",
    " TX",
    " TX:",
    "TX:",
    " RX: ",
    "# RECV HEX>",
    " - INFO - TX: ",
    " [base]:",
    " RX [10]:",
    " RX 12 bytes",
    " TX: 2   ",
    " RX :10\t",
    "->",
    " -",
    "-",
    "R:",
    " DATA",
    " ERROR",
    " =",
    "收到10字节",
    " x = ",
]
PAIRS = ["AA 01 01 03 E8", "55", "AA", "10  AA 01", "12 34", "da ta", "01", " 02\t03 ", "AA 01 # x"]
lines = st.builds(
    "".join,
    st.tuples(*map(st.sampled_from, (FRONTS, TIMES, WORDS, PAIRS))),
)


@settings(max_examples=500, deadline=None)
@given(st.lists(st.tuples(lines, st.booleans()), min_size=2, max_size=8))
def test_a_head_is_the_same_whatever_was_read_before(taken: list[tuple[str, bool]]) -> None:
    heads = Heads()
    for line, timed in taken:
        found = heads.of(line, timed=timed)
        assert replace(found, pairs=False) == head_of(line, timed=timed)


words = st.tuples(st.sampled_from(TIMES), st.text("RTX:>-[]() #=1aAB收◆.", max_size=5))


@settings(max_examples=500, deadline=None)
@given(words, st.lists(st.sampled_from(PAIRS), min_size=2, max_size=5))
def test_nor_with_any_words(front: tuple[str, str], pairs: list[str]) -> None:
    heads = Heads()
    for some in pairs:
        line = "".join((*front, some))
        found = heads.of(line, timed=True)
        assert replace(found, pairs=False) == head_of(line, timed=True)


def test_what_is_like_the_last_is_known_to_have_pairs_alone() -> None:
    heads = Heads()
    assert not heads.of("[14:03:22.123]收←◆AA 01").pairs
    assert heads.of("[14:03:23.456]收←◆55 02").pairs
    assert not heads.of("[14:03:23.456]收←◆55 02 # or not").pairs
