"""Filter errors: each names the mistake, its position and a fix on one line; none crashes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.errors import FilterError
from fte_sniff.protocol.columns import COLUMNS
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Fault
from tests.examples import examples
from tests.support.columns import rows_from

MISTAKES: list[tuple[str, int, str]] = [
    ("moto = 1", 1, "unknown name 'moto'"),
    ("rpm > 1 AND moto = 1", 13, "-->moto = 1"),
    ("1 = moto", 5, "did you mean motor?"),
    ("xyzzy = 1", 1, "unknown name 'xyzzy'"),
    ("t.rpm = 1", 2, ""),
    ("'motor' = 1", 1, ""),
    ('"moto" = 1', 1, ""),
    ("nois OR truncated", 1, "unknown name 'nois'"),
    ("port = COM3", 8, "unknown name 'COM3'"),
    ("speed > 500", 1, ""),
    ("500 < Position", 7, ""),
    ("rotation > 3", 1, "unknown name 'rotation'"),
    ("noise > 3", 1, ""),
    ("motor = noise", 9, ""),
    ("kind = 'sped'", 8, "kind is never 'sped'"),
    ("kind = 'speed_fb'", 8, "kind is never 'speed_fb'"),
    ("kind != sped", 9, "did you mean speed?"),
    ("kind IN ('speed', 'positon')", 19, "'positon'"),
    ("'sped' = kind", 1, "kind is never 'sped'"),
    ("(kind) IS DISTINCT FROM 'sped'", 25, "kind is never 'sped'"),
    ("kind = 'xyzzy'", 8, ""),
    ("status = 'okay'", 10, "status is never 'okay'"),
    ("status = 'noise'", 10, ""),
    ("direction = 'feedbak'", 13, "direction is never"),
    ("faults = 'noize'", 10, "faults is never 'noize'"),
    ("faults IN ('noise', 'trunc')", 21, "faults is never 'trunc'"),
    ("'noise' IN faults", 12, ""),
    ("'noise' = ANY(faults)", 11, ""),
    ("starts_with(raw, 'AA')", 1, ""),
    ("faults = 'noise,truncated'", 10, ""),
    ("kind > 'speed'", 8, "kind has no order"),
    ("faults > 'noise'", 10, "faults has no order"),
    ("rpm > 'abc'", 7, "rpm is a number"),
    ("rpm = '500'", 7, ""),
    ("rpm IN (1, 'a')", 12, "without quotes"),
    ("kind = 5", 1, ""),
    ("port = 5", 1, ""),
    ("rpm = port", 1, ""),
    ("raw = 0xAA01", 1, ""),
    ("raw = 'hello'", 7, ""),
    ("raw LIKE '%A%'", 10, ""),
    ("raw LIKE 'AA%0'", 10, ""),
    ("raw LIKE '%xyz%'", 10, ""),
    ("rpm LIKE '5%'", 1, ""),
    ("port LIKE rpm", 11, "LIKE needs a pattern in quotes"),
    ("port ~ '['", 1, "regex parse error"),
    ("time > 'yesterday'", 8, ""),
    ("time > '2026-02-30'", 8, "is not a time"),
    ("time > '24:00'", 8, "'12:00:05Z' for that time of any day"),
    ("time > 12:00:05", 10, ""),
    ("time > '9999-01-01'", 8, "is not a time"),
    ("time LIKE '2026%'", 1, ""),
    ("rpm = NULL", 7, ""),
    ("motor + 1", 1, "compare it"),
    ("motor", 1, "motor = 1"),
    ("faults", 1, ""),
    ("'abc'", 1, ""),
    ("motor = 1 OR 2", 14, ""),
    ("kind + 1 = 2", 1, ""),
    ("-port = 1", 1, ""),
    ("SUM(rpm) > 5", 1, ""),
    ("rpm > avg(rpm)", 7, ""),
    ("rpm > (SELECT 1)", 8, ""),
    ("EXISTS (SELECT 1)", 1, ""),
    ("row_number() OVER () > 1", 1, ""),
    ("read_csv('/etc/passwd') = 1", 1, ""),
    ("abs(rpm, 1) > 5", 1, "abs(rpm) > 500"),
    ("previous(abs(rpm)) > 5", 1, ""),
    ("previous(offset) > 5", 1, ""),
    ("motor (1)", 1, ""),
    ("", 1, "a field or a value is missing"),
    (" \t\n", 4, "a field or a value is missing"),
    ("rpm =", 6, ""),
    ("rpm > 500 AND", 14, ""),
    ("(rpm > 5", 9, "a ')' is missing"),
    ("rpm > 5)", 8, ""),
    ("rpm > 500 motor = 1", 11, "AND or OR"),
    ("rpm > 500 AS x", 11, ""),
    ("WHERE motor = 1", 1, ""),
    ("1 < rpm < 5", 9, "AND or OR"),
    ("motor = 1 & rpm > 5", 17, ""),
    ("rpm => 5", 6, ""),
    ("rpm =< 5", 6, ""),
    ("rpm IN 5", 8, ""),
    ("rpm IN ()", 9, ""),
    ("rpm BETWEEN 1", 14, ""),
    ("rpm = 5;", 8, ""),
    ("rpm > 500rpm", 7, ""),
    ("error = 0x0G", 9, ""),
    ("rpm > 1_000", 7, ""),
    ("rpm > 99999999999999999999", 7, "too large"),
    ("rpm > 1e999", 7, "too large"),
    ("rpm > " + "9" * 400, 7, "too large"),
    ("rpm ^ 1 = 1", 5, ""),
    ("kind = 'speed", 8, ""),
    ('kind = "speed', 8, ""),
    ("kind = \u2018speed\u2019", 8, ""),
    ("motor \uff1d 1", 7, ""),
    ("CASE WHEN motor = 1 THEN TRUE END", 1, ""),
    ("port = '\udc80'", 8, "this has no meaning"),
    ("rpm > 5 \x1b[31m", 9, "\\x1b"),
    ("(" * 10_000 + "motor = 1" + ")" * 10_000, 601, "too long"),
    ("(" * 100 + "motor = 1" + ")" * 100, 27, "nested too deeply"),
    ("NOT " * 500 + "noise", 105, "nested too deeply"),
    ("-" * 500 + "1 = 1", 27, "nested too deeply"),
    ("abs(" * 200 + "rpm", 105, "nested too deeply"),
    ("motor = 1 OR " * 300 + "noise", 1951, "too long"),
]
"""Mistakes, each with the position of the character that the message names, and a part of it."""


def _short(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode()[:40]


@pytest.mark.parametrize(
    ("text", "at", "part"), MISTAKES, ids=[_short(text) for text, _, _ in MISTAKES]
)
def test_mistake_is_reported_with_its_position(text: str, at: int, part: str) -> None:
    with pytest.raises(FilterError) as caught:
        RowFilter.parse(text)
    message = str(caught.value)
    assert message.isprintable()
    assert message.startswith("filter: ")
    assert f" at character {at} of " in message
    assert len(message) < 500
    assert part in message


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("pulses * pulses > 1e17", [False, False, False]),
        ("rpm * 1e300 > 1", [True, False, False]),
        ("rpm * 9223372036854775807 > 0", [True, False, False]),
        ("-9223372036854775807 - rpm < 0", [True, False, False]),
        ("(rpm * 9223372036854775807 & 1) IS NULL", [True, True, True]),
        ("abs(rpm) * 1000000000000 = 1000000000000000", [True, False, False]),
    ],
)
def test_arithmetic_does_not_wrap(text: str, rows: list[bool]) -> None:
    assert RowFilter.parse(text).matches(rows_from(ROWS)).tolist() == rows


ROWS: list[Row] = [
    Row("port", 0, bytes.fromhex("AA010103E800000000EE"), 5),
    Row("port", 10, bytes.fromhex("550204FFFFFFFF1F2FEE"), None, (Fault.UNDEFINED_FLAGS,)),
    Row("port", 20, b"\xff" * 16, None, (Fault.NOISE,), framed=False),
]

PIECES = st.sampled_from(
    [
        *(column.name for column in COLUMNS),
        *(
            "'noise'",
            "'speed'",
            '"speed"',
            "''",
            "'%'",
            "'AA'",
            "'2026-01-01'",
            "'12:00:05'",
            "'['",
            "speed",
        ),
        *("0", "1", "-5", "0x0F", "1.5", "9223372036854775807", "1e308", "NULL", "TRUE", "FALSE"),
        *("=", "!=", "<", ">=", "+", "-", "*", "/", "%", "&", "|", "~", "!~", "&&", "||", "!"),
        *("AND", "OR", "NOT", "IN", "IS", "BETWEEN", "LIKE", "ILIKE", "DISTINCT FROM", "ANY"),
        *("(", ")", ",", "abs(", "coalesce(", "upper(", "starts_with(", "SUM(", "SELECT", "CASE"),
    ]
)


def _parses_or_explains(text: str) -> None:
    try:
        wanted = RowFilter.parse(text)
    except FilterError as error:
        message = str(error)
    else:
        message = ""
        assert len(wanted.matches(rows_from(ROWS))) == len(ROWS)
    assert message == "" or message.isprintable()


@given(st.text(st.characters(), max_size=60))
@example("\ud800")
@example("'\x00'")
@example("kind LIKE '\\'")
@example("port ~ '(a{900}){900}'")
def test_any_text_parses_or_is_explained(text: str) -> None:
    _parses_or_explains(text)


@examples(150)
@given(st.lists(PIECES, max_size=14).map(" ".join))
def test_any_words_parse_or_are_explained(text: str) -> None:
    _parses_or_explains(text)


LARGEST = {
    "brackets": "(" * 24 + "rpm" + " + 1)" * 24 + " = 1",
    "not": "NOT " * 24 + "noise",
    "sum": " + ".join(["rpm"] * 298) + " = 1",
    "division": "(" * 16 + "rpm" + " / motor)" * 7 + " % 2)" * 9 + " = 1",
    "divisors": "1 / (" * 24 + "rpm" + ")" * 24 + " = 1",
    "nulls": "(" * 24 + "rpm = 1" + ") IS TRUE" * 24,
    "functions": "coalesce(abs(" * 8 + "rpm" + "), 1)" * 8 + " = 1",
    "list of sums": f"({' + '.join(['rpm'] * 60)}) IN ({', '.join(['motor'] * 230)})",
    "chain": " OR ".join(["motor = 1"] * 150),
}


@pytest.mark.parametrize("text", LARGEST.values(), ids=LARGEST)
def test_largest_filters_are_computed_in_any_thread(text: str) -> None:
    with ThreadPoolExecutor(1) as threads:  # whose stack is small
        found = threads.submit(lambda: RowFilter.parse(text).matches(rows_from(ROWS))).result()
    assert len(found) == len(ROWS)
