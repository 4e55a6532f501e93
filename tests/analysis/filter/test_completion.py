from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.completion import completions
from fte_sniff.analysis.filter.terms import EXAMPLES
from fte_sniff.protocol import COLUMN_BY_NAME, Direction, Fault, Status

CLOCK, TIME = "'12:00:00.250'", "'2026-01-31T12:00:00.250000007Z'"


@pytest.mark.parametrize(
    ("text", "start", "choices"),
    [
        ("time > ", 7, (CLOCK, TIME)),
        ("time > '", 7, (CLOCK, TIME)),
        ("time > '12:0", 7, (CLOCK,)),
        ("time > '2026-01-3", 7, (TIME,)),
        ("time IN ('12:00:05', '2026", 21, (TIME,)),
        ("time BETWEEN '1", 13, ()),
        ("port > '1", 7, ()),
    ],
)
def test_a_time_goes_on_with_the_one_to_go_by(
    text: str, start: int, choices: tuple[str, ...]
) -> None:
    found = completions(text, t_ns=1_769_860_800_250_000_007)
    assert (found.start, found.choices) == (start, choices)


@pytest.mark.parametrize(
    ("text", "start", "choices"),
    [
        ("mo", 0, ("motor",)),
        ("MO", 0, ("motor",)),
        ("motor = 1 AND rp", 14, ("rpm",)),
        ("motor = 1 && (rp", 14, ("rpm",)),
        ("NOT malf", 4, ("malformed",)),
        ("motor = 1 o", 10, ("OR",)),
        ("motor = 1 ", 10, ("AND", "OR")),
        ("rpm > vx", 6, ("vx_cm_s",)),
        ("motor betw", 6, ("BETWEEN",)),
        ("port li", 5, ("LIKE",)),
        ("status = ", 9, tuple(f"'{word}'" for word in Status)),
        ("status = 'su", 9, ("'suspect'",)),
        ('status = "su', 9, ("'suspect'",)),
        ("status != mal", 10, ("'malformed'",)),
        ("direction NOT IN ('control', ", 29, tuple(f"'{word}'" for word in Direction)),
        ("faults IN (", 11, tuple(f"'{word}'" for word in Fault)),
        ("faults = 'noi", 9, ("'noise'",)),
        ("port = 'x", 7, ()),
        ("motor; mo", 9, ()),
        ("'unfinished mo", 14, ()),
        ("", 0, (*COLUMN_BY_NAME, "NOT")),
    ],
)
def test_a_word_goes_on(text: str, start: int, choices: tuple[str, ...]) -> None:
    found = completions(text)
    assert (found.start, found.choices[: len(choices) or None]) == (start, choices)


def test_the_word_before_the_cursor_goes_on() -> None:
    assert completions("mo = 1 AND rpm > 5", 2).choices == ("motor",)


@given(st.text(max_size=20) | st.sampled_from([text for text, _ in EXAMPLES]), st.integers(-3, 60))
def test_any_text_can_be_asked(text: str, cursor: int) -> None:
    found = completions(text, cursor)
    assert 0 <= found.start <= len(text)
