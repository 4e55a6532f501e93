"""Runs of bytes in a text, in each form of writing them."""

from __future__ import annotations

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.formats.logs import evidence
from fte_sniff.formats.logs.evidence import EXTRACTORS
from fte_sniff.formats.logs.times import beside_times, masked
from tests.examples import examples
from tests.formats.logs.test_property import FORMS

EXTRACTOR_BY_NAME = {one.name: one for one in EXTRACTORS}


@pytest.mark.parametrize(
    ("name", "text", "data"),
    [
        ("decimal, semicolons or dashes", "170-1-2-3", [170, 1, 2, 3]),
        ("decimal, semicolons or dashes", "170--1-2", [170, 255, 2]),
        ("decimal, semicolons or dashes", "1;-5;3", [1, 251, 3]),
        ("hex pairs, cells", "<td>AA</td><td>01</td>", [0xAA, 1]),
        ("hex digits", "0xAA01", [0xAA, 1]),
        ("hex words, little endian", "01AA 0201", [0xAA, 1, 1, 2]),
        ("quoted escapes", r"'\xaa\x01'", b"\xaa\x01"),
        ("quoted escapes", r"'\\xaa\x01'", rb"\xaa" + b"\x01"),
        ("quoted escapes", r"'\x01\\'", b"\x01\\"),
        ("quoted escapes", r"'a\\\\b'", rb"a\\b"),
    ],
)
def test_bytes_of_a_run_are_those_of_its_units(
    name: str, text: str, data: bytes | list[int]
) -> None:
    assert [run.data for run in EXTRACTOR_BY_NAME[name].runs(text.encode())] == [bytes(data)]


def test_a_text_with_codes_is_found_as_by_a_search_at_each_character() -> None:
    code = evidence._unnamed(evidence._CODES["w"]).encode()
    word = rb"(?:(?!%b)[!-~])*+" % code
    slow = rb"(?<![!-~])(?:%b%b(?:(?:(?!%b)[ -~])*+%b)*+%b)" % (word, code, code, code, word)
    text = b" x[AA]y [01 [0x02]<NUL>{5b} a(b) [c]d [EE]\n[hello [AA]\n(5)[5B][[5D]]"
    fast = EXTRACTOR_BY_NAME["text with codes in brackets"].pattern
    assert re.findall(slow, text) == [one[0] for one in re.finditer(fast, text)]


TIMES = (
    "2026-01-31 12:00:00.123",
    "12:00:00",
    "31.01.2026 1:02:03",
    "Jan 31 12:00:00",
    "PM 1:00:00",
)
"""Of lines, in several forms."""
BESIDE = (
    "AA",
    " BB",
    "-5",
    ",12",
    ".5",
    ":07",
    "0x1F",
    "cafe 12",
    "took 7 us",
    "[",
    "] ",
    "T",
    "é",
    "\\n",
)


@given(
    st.sampled_from(sorted(EXTRACTOR_BY_NAME)),
    st.lists(
        st.lists(
            st.one_of(
                st.sampled_from(TIMES + BESIDE),
                st.builds(
                    lambda form, data: FORMS[form](data),
                    st.sampled_from(sorted(FORMS)),
                    st.binary(min_size=1, max_size=3),
                ),
            ),
            max_size=5,
        ).map("".join),
        min_size=1,
        max_size=4,
    ),
)
@example("base64", ["2026-01-31 12:00:00.123cafe 12"])
@example("base64", ["nQ==Jan 31 12:00:00"])
@example("base64", ["1632026-01-31 12:00:00.123"])
@example("x before each byte", ["12:00:00,120x1F"])
@examples(400)
def test_lines_with_runs_beside_their_time_are_found_without_hiding_it(
    name: str, lines: list[str]
) -> None:
    extractor = EXTRACTOR_BY_NAME[name]
    text = "\n".join(line.replace("\n", " ") for line in lines).encode()
    found = {
        text.count(b"\n", 0, one.start()) for one in beside_times(extractor.pattern).finditer(text)
    }
    with_runs = {text.count(b"\n", 0, run.start) for run in extractor.runs(masked(text))}
    assert with_runs <= found
