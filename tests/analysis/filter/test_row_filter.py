"""Filters: a table of filters with their rows, and random conditions against SQL logic."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from datetime import timedelta, timezone
from functools import cache

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import EXAMPLES, Alert, RowFilter
from fte_sniff.analysis.filter.terms import FILTER_HELP
from fte_sniff.protocol.columns import COLUMNS, ColumnType, record
from fte_sniff.protocol.items import Change, Gap, GapKind
from fte_sniff.protocol.rows import NO_ROWS, Row
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from tests.examples import examples
from tests.support.columns import rows_from
from tests.support.faults import frame_faults

NOON = 1_767_268_800_000_000_000
"""2026-01-01T12:00:00Z."""


def _frame(at: int, kind: str, **values: int) -> Row:
    raw = encode(KIND_BY_NAME[kind], values)
    return Row("/dev/ttyUSB0", at * 10, raw, NOON + at * 1_000_000_000, frame_faults(raw))


ROWS: dict[str, Row] = {
    "fast": _frame(0, "speed", motor=1, rpm=1000),
    "back": _frame(1, "speed", motor=2, rpm=-300),
    "pos": _frame(2, "position", motor=2, rpm=1000, pulses=10000),
    "mec": _frame(3, "mecanum", vx_cm_s=10, vy_cm_s=0, wz_mrad_s=-5),
    "reset": _frame(4, "reset"),
    "fb": _frame(5, "speed_feedback", motor=1, rpm=990, error=0x0F, online=0x0F),
    "pfb": _frame(6, "position_feedback", motor=4, pulses=-5, error=0, online=0x07),
    "flags": _frame(7, "speed_feedback", motor=3, rpm=0, error=0x10, online=0x1F),
    "unknown": Row("it's", 0, bytes.fromhex("AA0900000000000000EE"), NOON, (Fault.UNKNOWN_CMD,)),
    "noise": Row("it's", 10, b"\x00\x01\x02", None, (Fault.NOISE,), framed=False),
    "cut": Row(
        "it's",
        13,
        bytes.fromhex("55010103"),
        NOON + 90,
        (Fault.TRUNCATED, Fault.LINE_ERROR),
        framed=False,
    ),
}
FRAMES = {name for name, row in ROWS.items() if row.framed}
OK = FRAMES - {"flags", "unknown"}
WITH_RPM = {"fast", "back", "pos", "fb", "flags"}


def _wanted(text: str) -> set[str]:
    mask = RowFilter.parse(text).matches(rows_from(ROWS.values()))
    return {name for name, wanted in zip(ROWS, mask, strict=True) if wanted}


WANTED: list[tuple[str, set[str]]] = [
    # numbers
    ("motor = 1 AND rpm > 500", {"fast", "fb"}),
    ("motor == 1 && rpm > 995", {"fast"}),
    ("motor = 4 || rpm < 0", {"pfb", "back"}),
    ("NOT rpm > 500", {"back", "flags"}),
    ("!(rpm > 500)", {"back", "flags"}),
    ("motor <> 1", {"back", "pos", "pfb", "flags"}),
    ("motor != 1", {"back", "pos", "pfb", "flags"}),
    ("500 < rpm", {"fast", "pos", "fb"}),
    ("rpm BETWEEN -300 AND 0", {"back", "flags"}),
    ("rpm NOT BETWEEN -300 AND 0", {"fast", "pos", "fb"}),
    ("motor IN (3, 4)", {"pfb", "flags"}),
    ("motor NOT IN (1, 2)", {"pfb", "flags"}),
    ("rpm IN (989 + 1, 1.5, -300)", {"fb", "back"}),
    ("rpm NOT IN (motor, 1000)", {"back", "fb", "flags"}),
    ("rpm - 1 IN (989, 998 + motor)", {"fb", "fast"}),
    (f"motor IN ({', '.join(map(str, range(3, 250)))})", {"pfb", "flags"}),
    (" OR ".join(f"rpm = {rpm}" for rpm in range(900, 1001)), {"fb", "fast", "pos"}),
    (" AND ".join(f"rpm != {rpm}" for rpm in range(900, 1001)), {"back", "flags"}),
    ("rpm IS NULL AND motor IS NOT NULL", {"pfb"}),
    ("rpm = 990.0", {"fb"}),
    ("rpm > 9.9e2", {"fast", "pos"}),
    ("-rpm = 300", {"back"}),
    ("rpm + 10 = 1000", {"fb"}),
    ("rpm / 4 = 247.5", {"fb"}),
    ("rpm % 100 = 90", {"fb"}),
    ("pulses * 2 - 5 = 19995", {"pos"}),
    ("abs(rpm) = 300", {"back"}),
    ("coalesce(rpm, 7) = 7", set(ROWS) - WITH_RPM),
    ("rpm = motor - 300 - 1 - 1", {"back"}),
    ("motor / 2 * 2 / 2 = 0.5", {"fast", "fb"}),
    ("rpm + motor = -298", {"back"}),
    ("rpm / 0 > 1", set()),
    ("rpm / (motor - 2) < 0", {"fast", "fb"}),
    ("rpm / error >= 0", {"fb", "flags"}),
    ("rpm % (motor - 2) = 0", {"fast", "fb", "flags"}),
    ("RPM > 500 and Motor = 1", {"fast", "fb"}),
    ('"rpm" > 500 AND `motor` = 1', {"fast", "fb"}),
    ("motor = 1 OR motor = 2 AND rpm < 0", {"fast", "fb", "back"}),
    ("(motor = 1 OR motor = 2) AND rpm < 0", {"back"}),
    ("(rpm > 500) != (motor = 1)", {"pos"}),
    ("(rpm > 500) IS NOT TRUE", set(ROWS) - {"fast", "pos", "fb"}),
    ("(rpm > 500) IS FALSE", {"back", "flags"}),
    ("(rpm > 500) IS NULL", set(ROWS) - WITH_RPM),
    ("motor IS DISTINCT FROM 1", set(ROWS) - {"fast", "fb"}),
    ("rpm IS 990", {"fb"}),
    ("motor IS NOT DISTINCT FROM NULL", {"mec", "reset", "unknown", "noise", "cut"}),
    ("length < 10", {"noise", "cut"}),
    ("cmd = 9", {"unknown"}),
    # hex and bits
    ("error = 0x0F", {"fb"}),
    ("error = 0X0f", {"fb"}),
    ("online & 0x08 = 0", {"pfb"}),
    ("error & 0b1 != 0", {"fb"}),
    ("error | 0x01 = 0x11", {"flags"}),
    # words
    ("kind = 'speed'", {"fast", "back"}),
    ('kind = "speed"', {"fast", "back"}),
    ("kind = speed", {"fast", "back"}),
    ("'speed' = kind", {"fast", "back"}),
    ("kind = 'SPEED'", {"fast", "back"}),
    ("(kind) IN ('speed', \"position\", reset)", {"fast", "back", "pos", "reset"}),
    ("kind != 'speed'", OK - {"fast", "back"} | {"flags"}),
    ("kind IS DISTINCT FROM 'speed'", set(ROWS) - {"fast", "back"}),
    ("kind IS NULL", {"unknown", "noise", "cut"}),
    ("kind LIKE '%feedback'", {"fb", "pfb", "flags"}),
    ("kind NOT LIKE '%feedback'", {"fast", "back", "pos", "mec", "reset"}),
    ("kind ~ '^(re|me)'", {"mec", "reset"}),
    ("upper(kind) = 'RESET'", {"reset"}),
    ("direction = 'feedback'", {"fb", "pfb", "flags"}),
    ("status = 'ok'", OK),
    ("status <> 'ok'", set(ROWS) - OK),
    # words alone
    ("malformed", {"unknown", "noise", "cut"}),
    ("NOT malformed", set(ROWS) - {"unknown", "noise", "cut"}),
    ("suspect OR noise", {"flags", "noise"}),
    ("speed", {"fast", "back"}),
    ("NOT speed AND NOT malformed", OK - {"fast", "back"} | {"flags"}),
    ("feedback AND ok", {"fb", "pfb"}),
    ("malformed = FALSE AND control", OK - {"fb", "pfb"}),
    # faults
    ("faults = 'noise'", {"noise"}),
    ("faults = noise", {"noise"}),
    ("faults != 'noise'", set(ROWS) - {"noise"}),
    ("faults = 'line_error' AND faults = 'truncated'", {"cut"}),
    ("faults IN ('noise', 'truncated')", {"noise", "cut"}),
    ("faults NOT IN ('noise', 'truncated')", set(ROWS) - {"noise", "cut"}),
    ("faults LIKE '%trunc%'", {"cut"}),
    ("faults LIKE 'truncated,line_error'", {"cut"}),
    ("faults ~ 'unknown|noise'", {"unknown", "noise"}),
    ("faults IS NULL", OK),
    ("faults = ''", OK),
    ("faults IS NOT NULL", set(ROWS) - OK),
    ("faults <> ''", set(ROWS) - OK),
    # bytes
    ("raw LIKE 'AA01%'", {"fast", "back"}),
    ("raw LIKE 'aa 01 02%'", {"back"}),
    ("raw LIKE '%01 02%'", {"back", "noise"}),
    ("raw LIKE '%0102'", {"noise"}),
    ("raw LIKE '%01 _3%03'", set()),
    ("raw LIKE '55%_3'", {"cut"}),
    ("raw NOT LIKE 'aa%' AND raw ILIKE '%01%'", {"noise", "cut", "fb", "flags"}),
    ("raw = '00 01 02'", {"noise"}),
    ("raw IN ('000102', '55010103')", {"noise", "cut"}),
    ("raw ~ '^aa0[23]'", {"pos", "mec"}),
    ("raw !~ 'ee$'", {"noise", "cut"}),
    # port
    ("port = 'it''s'", {"unknown", "noise", "cut"}),
    ("port LIKE '%USB_'", set(ROWS) - {"unknown", "noise", "cut"}),
    ("port ILIKE '%usb%' AND reset", {"reset"}),
    ("lower(port) = '/dev/ttyusb0' AND reset", {"reset"}),
    ("port REGEXP 'USB[0-9]' AND reset", {"reset"}),
    ("port > '/dev/ttyUSB0' AND noise", {"noise"}),
    # time
    ("time = '2026-01-01T12:00:00Z'", {"fast", "unknown"}),
    ("time > '2026-01-01 12:00' AND time < '2026-01-01 12:00:01'", {"cut"}),
    ("time = '2026-01-01T12:00:00.00000009Z'", {"cut"}),
    ("time BETWEEN '2026-01-01T20:00:03+08:00' AND '2026-01-01T12:00:04'", {"mec", "reset"}),
    ("time IN ('2026-01-01T12:00:05Z', '2026-01-01T12:00:06Z')", {"fb", "pfb"}),
    ("time >= '2026-01-02'", set()),
    ("time < '1969-12-31'", set()),
    ("time IS NULL", {"noise"}),
    # a time of day: of any day
    ("time = '12:00'", {"fast", "unknown"}),
    ("time > '12:00:05'", {"pfb", "flags"}),
    ("'12:00:05' < time", {"pfb", "flags"}),
    ("time BETWEEN '12:00:03' AND '12:00:04'", {"mec", "reset"}),
    ("time BETWEEN '2026-01-01T12:00:03Z' AND '12:00:04'", {"mec", "reset"}),
    ("time IN ('12:00:05Z', '2026-01-01T12:00:06Z')", {"fb", "pfb"}),
    ("time IS DISTINCT FROM '12:00:00' AND speed", {"back"}),
    ("time >= '2026-01-01' AND time < '00:00:01'", set()),
    (f"time = {NOON + 90}", {"cut"}),
    # constants
    ("TRUE", set(ROWS)),
    ("1 = 2", set()),
    ("  \n motor = 4  ", {"pfb"}),
]


@pytest.mark.parametrize(("text", "names"), WANTED, ids=[text[:40] for text, _ in WANTED])
def test_a_filter_keeps_these_rows(text: str, names: set[str]) -> None:
    assert _wanted(text) == names


TOKENS = st.one_of(st.just("%"), st.text("019AF_", min_size=2, max_size=2))
"""Tokens of a byte pattern: any bytes, or one byte."""

RAWS = st.lists(
    st.sampled_from(bytes.fromhex("00 09 0A 10 19 90 99 9A A0 AA AF F0 FF")),
    min_size=1,
    max_size=16,
).map(bytes)


def _matches(tokens: Sequence[str], raw: bytes) -> bool:
    """Match a byte pattern byte by byte."""
    if not tokens:
        return not raw
    first, *rest = tokens
    if first == "%":
        return any(_matches(rest, raw[at:]) for at in range(len(raw) + 1))
    same = all(
        one in ("_", digit) for one, digit in zip(first, raw[:1].hex().upper(), strict=False)
    )
    return bool(raw) and same and _matches(rest, raw[1:])


@given(st.lists(TOKENS, max_size=6), st.lists(RAWS, min_size=1, max_size=6))
@example(["%", "AA", "01", "%"], [bytes.fromhex("AA 02 02 0A A0 10 00 00 00 EE")])
@example(["%", "FF", "FF", "%"], [bytes.fromhex("0F FF F0"), bytes.fromhex("00 FF FF 00")])
@example(["%", "01", "%", "01", "%"], [bytes.fromhex("00 10 01"), bytes.fromhex("01 01")])
def test_a_byte_pattern_matches_only_at_byte_boundaries(
    tokens: list[str], raws: list[bytes]
) -> None:
    rows = [Row("p", 0, raw, None, (Fault.NOISE,), framed=False) for raw in raws]
    wanted = RowFilter.parse(f"raw LIKE '{' '.join(tokens)}'")
    expected = [_matches(tokens, raw) for raw in raws]
    assert wanted.matches(rows_from(rows)).tolist() == expected


def test_the_help_names_every_field_and_its_examples_work() -> None:
    for column in COLUMNS:
        assert column.name in FILTER_HELP
        assert all(word in FILTER_HELP for word in column.words)
    assert max(map(len, FILTER_HELP.splitlines())) <= 79
    for text, _ in EXAMPLES:
        assert RowFilter.parse(text).text == text
        assert text in FILTER_HELP


# Random conditions, against SQLite

NUMBERS = [column.name for column in COLUMNS if column.type is ColumnType.INT]
VALUES = st.sampled_from(
    [*NUMBERS, "abs(rpm)", "-rpm", "coalesce(rpm, 7)", "rpm + motor", "pulses - rpm * 2"]
) | st.builds("{} {} {}".format, st.sampled_from(NUMBERS), st.sampled_from("&|"), st.just("15"))
SIGNS = st.sampled_from(["=", "==", "!=", "<>", "<", "<=", ">", ">=", "IS", "IS NOT"])
CONSTANTS = st.sampled_from(["-300", "0", "1", "2", "10", "1000", "0x0F", "1e3"])
CONDITIONS = st.recursive(
    st.one_of(
        st.builds("{} {} {}".format, VALUES, SIGNS, CONSTANTS | VALUES),
        st.builds("{} IS {}".format, VALUES, st.sampled_from(["NULL", "NOT NULL"])),
        st.builds("{} BETWEEN {} AND {}".format, VALUES, CONSTANTS, CONSTANTS),
        st.builds("{} NOT IN ({}, {})".format, VALUES, CONSTANTS, VALUES),
        st.builds(
            "kind {} '{}'".format,
            st.sampled_from(["=", "!=", "IS"]),
            st.sampled_from(sorted(KIND_BY_NAME)),
        ),
        st.builds("port LIKE '{}'".format, st.sampled_from(["/%usb_", "%s", "_"])),
    ),
    lambda inner: (
        st.builds("NOT ({})".format, inner)
        | st.builds("({}) {} {}".format, inner, st.sampled_from(["AND", "OR"]), inner)
        | st.builds("({}) IS {}".format, inner, st.sampled_from(["TRUE", "NOT FALSE", "NULL"]))
    ),
    max_leaves=6,
)


@cache
def database() -> sqlite3.Connection:
    """The rows as a table."""
    found = sqlite3.connect(":memory:")
    names = [*NUMBERS, "kind", "port"]
    found.execute(f"CREATE TABLE rows ({', '.join(names)})")
    values = [[record(row)[name] for name in names] for row in ROWS.values()]
    found.executemany(f"INSERT INTO rows VALUES ({', '.join('?' * len(names))})", values)
    return found


@examples(150)
@given(CONDITIONS)
def test_any_condition_has_the_rows_of_sqlite(text: str) -> None:
    expected = [found == 1 for (found,) in database().execute(f"SELECT {text} FROM rows")]
    own = text.replace("LIKE", "ILIKE")  # SQLite ignores the case
    assert RowFilter.parse(own).matches(rows_from(ROWS.values())).tolist() == expected


CHINA = timezone(timedelta(hours=8))


@pytest.mark.parametrize(
    "text",
    [
        "time = '2026-01-01 20:00:05' OR time = '20:00:06'",
        "time IN ('2026-01-01T12:00:05Z', '12:00:06Z')",
    ],
)
def test_time_without_a_zone_is_in_that_of_the_user(text: str) -> None:
    wanted = RowFilter.parse(text, CHINA).matches(rows_from(ROWS.values()))
    assert [name for name, one in zip(ROWS, wanted, strict=True) if one] == ["fb", "pfb"]


def test_an_alert_counts_every_row_and_signals_once_per_second() -> None:
    frames = [_frame(motor, "speed", motor=motor, rpm=1) for motor in (1, 2, 1)]
    alert = Alert(RowFilter.parse("motor = 1"))
    assert not alert.observe(rows_from(frames[1:2]), 0.0)
    assert not alert.observe(NO_ROWS, 0.0)
    assert [alert.observe(rows_from(frames), at_s) for at_s in (0.1, 0.5, 1.09, 1.11)] == [
        *(True, False, False, True)
    ]
    assert alert.count == 8
    assert alert.last == frames[2]


def test_stream_knows_the_frame_before_and_not_what_comes_later() -> None:
    rows = [_frame(at, "speed", motor=1, rpm=rpm) for at, rpm in enumerate((0, 600, 700, 0))]
    stream = RowFilter.parse("abs(rpm - previous(rpm)) > 500 OR unanswered").stream()
    assert [len(stream.select(rows_from([row]))) for row in rows] == [0, 1, 0, 1]
    gap = Change(0, Gap(GapKind.PORT))
    assert not len(stream.select(rows_from(rows[1:2]), [gap]))
