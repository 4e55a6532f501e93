"""The bytes of runs: by pieces, as by a search for each unit."""

from __future__ import annotations

import re

from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.formats.logs import forms
from fte_sniff.formats.logs.forms import EXTRACTORS, Extractor
from fte_sniff.formats.logs.times import beside_times, masked
from tests.examples import examples
from tests.formats.logs.test_property import FORMS

EXTRACTOR_BY_NAME = {one.name: one for one in EXTRACTORS}


def searched(extractor: Extractor, text: bytes) -> list[bytes]:
    """The bytes of the runs in a text, in which nothing is known of another."""
    forms._bytes_of_runs.cache_clear()
    forms._bytes_of_codes.cache_clear()
    return [run.data for run in extractor.runs(text)]


@given(
    st.sampled_from(sorted(EXTRACTOR_BY_NAME)),
    st.sampled_from(sorted(FORMS)),
    st.lists(st.binary(min_size=1, max_size=12), min_size=2, max_size=8),
    st.lists(st.tuples(st.integers(0, 60), st.sampled_from(" ,-;\\[]<>x01AFz\"'")), max_size=3),
)
@examples(300)
def test_bytes_of_a_run_do_not_depend_on_the_runs_before_it(
    name: str, form: str, texts: list[bytes], mistakes: list[tuple[int, str]]
) -> None:
    extractor = EXTRACTOR_BY_NAME[name]
    written = [bytearray(FORMS[form](data).encode()) for data in texts]
    for at, character in mistakes:
        written[-1][at % len(written[-1]) : at % len(written[-1]) + 1] = character.encode()
    alone = [searched(extractor, bytes(text)) for text in written]
    assert [[run.data for run in extractor.runs(bytes(text))] for text in written] == alone


def test_separators_that_are_also_signs_are_no_borders_of_pieces() -> None:
    extractor = EXTRACTOR_BY_NAME["decimal, semicolons or dashes"]
    texts = [b"170-1-2-3", b"170--1-2", b"170-1--2", b"1;-5;3"]
    alone = [searched(extractor, text) for text in texts]
    assert [[run.data for run in extractor.runs(text)] for text in texts] == alone
    assert alone[0] == [bytes([170, 1, 2, 3])]


def test_escaped_backslashes_are_no_borders_of_pieces() -> None:
    extractor = EXTRACTOR_BY_NAME["quoted escapes"]
    texts = [rb"'\xaa\x01'", rb"'\\xaa\x01'", rb"'\x01\\'", rb"'a\\\\b'"]
    assert [[run.data for run in extractor.runs(text)] for text in texts] == [
        [b"\xaa\x01"], [rb"\xaa" + b"\x01"], [b"\x01\\"], [rb"a\\b"],
    ]  # fmt: skip


def test_a_text_with_codes_is_found_as_by_a_search_at_each_character() -> None:
    code = forms._unnamed(forms._CODES["w"]).encode()
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
@examples(1000)
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
