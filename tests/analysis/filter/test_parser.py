"""Filter errors: each names the mistake, its position and a fix on one line; none crashes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import polars as pl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.analysis.filter.compiler import chain, combine
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import MistakeError, Term, TermType
from fte_sniff.errors import FilterError
from fte_sniff.protocol import COLUMNS, Fault, Row
from fte_sniff.protocol.rows import Rows
from tests.examples import examples

MISTAKES: list[tuple[str, tuple[str, ...]]] = [
    # names
    ("moto = 1", ("unknown name 'moto'", "character 1", "did you mean motor?")),
    ("rpm > 1 AND moto = 1", ("character 13", "-->moto = 1", "did you mean motor?")),
    ("1 = moto", ("character 5", "did you mean motor?")),
    ("xyzzy = 1", ("unknown name 'xyzzy'", "the fields are time, port")),
    ("t.rpm = 1", ("'.' has no meaning in a filter", "the field alone")),
    ("'motor' = 1", ("'motor' is a text, not a field", "did you mean motor?", "no quotes")),
    ('"moto" = 1', ("'moto' is a text, not a field", "did you mean motor?")),
    ("'motor' = 'rpm'", ("two texts are compared", "without single quotes")),
    ("nois OR truncated", ("unknown name 'nois'", "did you mean noise?")),
    ("port = COM3", ("unknown name 'COM3'", "in quotes: 'COM3'")),
    ("speed > 500", ("speed is a name", "character 1", "did you mean rpm?")),
    ("500 < Position", ("Position is a name", "character 7", "did you mean pulses?")),
    ("rotation > 3", ("unknown name 'rotation'", "did you mean wz_mrad_s?")),
    ("noise > 3", ("noise is a name", "a name is a condition: write noise alone")),
    ("motor = noise", ("motor is a number, noise is a name", "compare it, as in motor = 1")),
    # words
    ("kind = 'sped'", ("kind is never 'sped'", "character 8", "did you mean speed?")),
    ("kind = 'speed_fb'", ("kind is never 'speed_fb'", "did you mean speed_feedback?")),
    ("kind = 'position fb'", ("did you mean position_feedback?",)),
    ("kind != sped", ("kind is never 'sped'", "did you mean speed?")),
    ("kind IN ('speed', 'positon')", ("'positon'", "character 19", "did you mean position?")),
    ("'sped' = kind", ("kind is never 'sped'",)),
    ("(kind) IS DISTINCT FROM 'sped'", ("kind is never 'sped'",)),
    ("kind = 'xyzzy'", ("it is one of reset, speed, position",)),
    ("status = 'okay'", ("status is never 'okay'", "did you mean ok?")),
    ("status = 'noise'", ("it is a word of faults: faults = 'noise'",)),
    ("direction = 'feedbak'", ("direction is never", "did you mean feedback?")),
    ("faults = 'noize'", ("faults is never 'noize'", "did you mean noise?")),
    ("faults IN ('noise', 'trunc')", ("faults is never 'trunc'", "did you mean truncated?")),
    ("'noise' IN faults", ("IN needs a list", "in brackets")),
    ("'noise' = ANY(faults)", ("'ANY' is not a function", "name one, as in faults = 'noise'")),
    ("starts_with(raw, 'AA')", ("not a function of a filter", "there are abs, coalesce, lower")),
    ("faults = 'noise,truncated'", ("faults = 'noise' AND faults = 'truncated'",)),
    ("kind > 'speed'", ("kind has no order",)),
    ("faults > 'noise'", ("faults has no order", "faults = 'noise'")),
    # types
    ("rpm > 'abc'", ("rpm is a number", "character 7", "without quotes")),
    ("rpm = '500'", ("write a number, without quotes",)),
    ("rpm IN (1, 'a')", ("character 12", "without quotes")),
    ("kind = 5", ("kind is a word, 5 is a number", "kind = 'reset'")),
    ("port = 5", ("port is a text, 5 is a number",)),
    ("rpm = port", ("rpm is a number, port is a text",)),
    ("raw = 0xAA01", ("raw LIKE 'AA01%'",)),
    ("raw = 'hello'", ("'hello' is not hex",)),
    ("raw LIKE '%A%'", ("'%A%' has half a byte", "_ for any digit")),
    ("raw LIKE 'AA%0'", ("'AA%0' has half a byte",)),
    ("raw LIKE '%xyz%'", ("'%xyz%' is not hex",)),
    ("rpm LIKE '5%'", ("LIKE needs a text, and rpm is a number",)),
    ("port LIKE rpm", ("LIKE needs a pattern in quotes",)),
    ("port ~ '['", ("no regular expression", "unclosed character class")),
    ("time > 'yesterday'", ("'yesterday' is not a time", "2026-01-31T12:00:00.5Z")),
    ("time > '2026-02-30'", ("is not a time",)),
    ("time > '24:00'", ("'24:00' is not a time", "'12:00:05' for that time of any day")),
    ("time > 12", ("12 would be a time before the year 2000", "'12:00:05' for that time of any")),
    ("12.5 <= time", ("12.5 would be a time before the year 2000", "write UTC as")),
    ("time = -1", ("-1 would be a time before the year 2000",)),
    ("time IN (1769860800000000000, 5)", ("5 would be a time before",)),
    ("time BETWEEN 10 AND 20", ("10 would be a time before",)),
    ("12 IS DISTINCT FROM time", ("12 would be a time before",)),
    ("time > 2 * 60", ("this value would be a time before",)),
    ("time > 12:00:05", ("there is no ':'", "time > '12:00:05'")),
    (
        "time BETWEEN '23:59' AND '00:01'",
        ("'23:59' is later in the day", "time >= '23:59' OR time <= '00:01'"),
    ),
    ("time > '9999-01-01'", ("is not a time",)),
    ("time LIKE '2026%'", ("LIKE needs a text, and time is a time",)),
    ("rpm = NULL", ("nothing equals NULL", "IS NULL")),
    ("motor + 1", ("no condition", "compare it")),
    ("motor", ("motor is a number, no condition", "motor = 1")),
    ("faults", ("faults = 'noise'", "faults IS NOT NULL")),
    ("'abc'", ("no condition",)),
    ("motor = 1 OR 2", ("2 is a number, no condition", "character 14")),
    ("kind + 1 = 2", ("'+' joins numbers", "kind is a word")),
    ("-port = 1", ("'-' needs a number",)),
    # what looks beyond one row
    ("SUM(rpm) > 5", ("'SUM' is not a function", "one row at a time")),
    ("rpm > avg(rpm)", ("one row at a time",)),
    ("rpm > (SELECT 1)", ("'SELECT' is out of place", "one row at a time")),
    ("EXISTS (SELECT 1)", ("one row at a time",)),
    ("row_number() OVER () > 1", ("one row at a time",)),
    ("read_csv('/etc/passwd') = 1", ("not a function of a filter", "there are abs, coalesce")),
    ("abs(rpm, 1) > 5", ("abs takes another number of values", "abs(rpm) > 500")),
    ("previous(abs(rpm)) > 5", ("previous takes one field of a frame", "write one of motor, ")),
    ("previous(offset) > 5", ("previous takes one field of a frame", "write one of motor, ")),
    ("motor (1)", ("a sign is missing",)),
    # writing
    ("", ("it is empty", "motor = 1 AND rpm > 500")),
    (" \t\n", ("it is empty",)),
    ("rpm =", ("ends too soon", "character 6")),
    ("rpm > 500 AND", ("ends too soon",)),
    ("(rpm > 5", ("a ')' is missing",)),
    ("rpm > 5)", ("')' is out of place", "character 8")),
    ("rpm > 500 motor = 1", ("'motor' is out of place", "AND or OR")),
    ("rpm > 500 AS x", ("'AS' is out of place",)),
    ("WHERE motor = 1", ("the condition alone",)),
    ("1 < rpm < 5", ("'<' is out of place", "join comparisons with AND")),
    ("motor = 1 & rpm > 5", ("a single & joins bits",)),
    ("rpm => 5", ("'=>' is not an operator", "write >=")),
    ("rpm =< 5", ("'=<' is not an operator", "write <=")),
    ("rpm IS 5", ("NULL, TRUE or FALSE after IS",)),
    ("rpm IN 5", ("IN needs a list", "IN (1, 2)")),
    ("rpm IN ()", ("the list after IN is empty",)),
    ("rpm BETWEEN 1", ("write BETWEEN low AND high",)),
    ("rpm = 5;", ("leave out the ';'",)),
    ("rpm > 500rpm", ("'500rpm' is not a number", "without a unit")),
    ("error = 0x0G", ("'0x0G' is not a number",)),
    ("rpm > 1_000", ("is not a number",)),
    ("rpm > 99999999999999999999", ("too large",)),
    ("rpm > 1e999", ("too large",)),
    ("rpm ^ 1 = 1", ("use & and | for bits",)),
    ("kind = 'speed", ("this quote is never closed",)),
    ('kind = "speed', ("this quote is never closed",)),
    ("kind = \u2018speed\u2019", ("plain single quotes",)),
    ("motor \uff1d 1", ("full-width character",)),
    ("CASE WHEN motor = 1 THEN TRUE END", ("AND, OR and NOT",)),
    ("port = '\udc80'", ("not valid Unicode",)),
    ("rpm > 5 \x1b[31m", (r"\x1b",)),
    # size
    ("(" * 10_000 + "motor = 1" + ")" * 10_000, ("characters are too many",)),
    ("(" * 100 + "motor = 1" + ")" * 100, ("nested too deeply",)),
    ("NOT " * 500 + "noise", ("nested too deeply",)),
    ("-" * 500 + "1 = 1", ("nested too deeply",)),
    ("abs(" * 200 + "rpm", ("nested too deeply",)),
    ("motor = 1 OR " * 300 + "noise", ("are too many", "BETWEEN")),
    ("port = '" + "x" * 9_000 + "'", ("characters are too many",)),
]


def _short(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode()[:40]


@pytest.mark.parametrize(
    ("text", "fragments"), MISTAKES, ids=[_short(text) for text, _ in MISTAKES]
)
def test_a_mistake_is_reported_with_its_position_and_a_fix(
    text: str, fragments: tuple[str, ...]
) -> None:
    with pytest.raises(FilterError) as caught:
        RowFilter.parse(text)
    message = str(caught.value)
    assert message.isprintable()
    assert message.startswith("filter: ")
    assert len(message) < 500
    for fragment in fragments:
        assert fragment in message


@pytest.mark.parametrize(
    "text",
    [
        " OR ".join(["motor = 1"] * 149),
        f"motor IN ({', '.join(map(str, range(290)))})",
        "+ ".join(["rpm"] * 290) + " > 5",
        "(" * 25 + "motor = 1" + ")" * 25,
        "NOT " * 17 + "noise",
        "(" * 16 + "rpm" + " / motor)" * 7 + " % 2)" * 9 + " = 1",
        "abs(" * 17 + "rpm" + ")" * 17 + " = 1",
        "coalesce(rpm, " * 16 + "1" + ")" * 16 + " = 1",
    ],
    ids=_short,
)
def test_filters_within_the_limits_work(text: str) -> None:
    assert len(RowFilter.parse(text).mask(row_frame(Rows.of(ROWS)))) == len(ROWS)


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
        mask = wanted.mask(row_frame(Rows.of(ROWS)))
        assert len(mask) == len(ROWS)
        assert mask.null_count() == 0
        assert set(wanted.expression.meta.root_names()) == wanted.names
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


NUMBERS = st.recursive(
    st.sampled_from(["rpm", "motor", "error", "0", "1", "-5", "1.5", "0xFF"])
    | st.integers(-(2**63), 2**63 - 1).map(str)
    | st.floats(allow_nan=False, allow_infinity=False).map(str),
    lambda inner: (
        st.builds("({} {} {})".format, inner, st.sampled_from("+-*/%&|"), inner)
        | st.builds("(- {})".format, inner)
        | st.builds("abs({})".format, inner)
        | st.builds("coalesce({}, {})".format, inner, inner)
    ),
    max_leaves=6,
)


@given(NUMBERS, st.sampled_from(["=", "<", ">=", "IS DISTINCT FROM"]), NUMBERS)
def test_any_arithmetic_computes_or_is_explained(left: str, sign: str, right: str) -> None:
    _parses_or_explains(f"{left} {sign} {right}")


@given(count=st.integers(1, 600), operator=st.sampled_from(["AND", "OR"]))
def test_chain_keeps_its_order_and_stays_shallow(count: int, operator: str) -> None:
    parts = [Term(TermType.TRUTH, n, "c", pl.col(f"c{n}")) for n in range(count)]
    joined = chain(parts, operator)
    assert joined.expr.meta.root_names() == [f"c{n}" for n in range(count)]
    assert _depth(joined.expr) <= count.bit_length() + 1


def _depth(expr: pl.Expr) -> int:
    inputs = [] if expr.meta.is_column() else expr.meta.pop()
    return 1 + max(map(_depth, inputs), default=0)


def test_combined_term_has_the_columns_of_all_and_the_position_of_the_first() -> None:
    parts = [
        Term(TermType.NUMBER, 7, "a", pl.col("rpm"), names=frozenset(["rpm"])),
        Term(TermType.NUMBER, 3, "b", pl.col("pulses"), names=frozenset(["pulses"])),
    ]
    made = combine(pl.col("rpm") + pl.col("pulses"), parts, ["motor"], TermType.NUMBER)
    assert (made.start, made.type) == (3, TermType.NUMBER)
    assert made.names == {"rpm", "pulses", "motor"}


LARGEST = {
    "brackets": "(" * 24 + "rpm" + " + 1)" * 24 + " = 1",
    "not": "NOT " * 24 + "noise",
    "sum": " + ".join(["rpm"] * 298) + " = 1",
    "list": f"({' + '.join(['rpm'] * 100)}) IN ({', '.join(['1'] * 100)})",
    "list of sums": f"({' + '.join(['rpm'] * 60)}) IN ({', '.join(['motor'] * 230)})",
    "chain": " OR ".join(["motor = 1"] * 150),
}


@pytest.mark.parametrize("text", LARGEST.values(), ids=LARGEST)
def test_largest_filters_are_computed_in_any_thread(text: str) -> None:
    with ThreadPoolExecutor(1) as threads:
        other = threads.submit(RowFilter.parse, text).result()
    assert (
        RowFilter.parse(text)
        .mask(row_frame(Rows.of(ROWS)))
        .equals(other.mask(row_frame(Rows.of(ROWS))))
    )


@pytest.mark.parametrize("length", [1, 199, 200, 201, 5000])
def test_only_a_text_of_more_than_200_characters_is_cut(length: int) -> None:
    text = str(MistakeError(0, "x" * length).error(""))
    assert text.count("x") == min(length, 200)
    assert ("x... at" in text) == (length > 200)
