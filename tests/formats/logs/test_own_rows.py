"""What this program wrote, it reads back: each row with its bytes and at the time that it had."""

from __future__ import annotations

import io
import random
from datetime import UTC, timedelta, timezone, tzinfo
from itertools import accumulate
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.writers import OutputFormat, row_writer
from fte_sniff.protocol import KIND_BY_NAME, Chunk, Fault, Framer, Row, encode
from fte_sniff.session.log_rows import rows_of_log
from tests.examples import examples
from tests.support.columns import fed

FORMS = (OutputFormat.TABLE, OutputFormat.CSV, OutputFormat.JSONL)
BEGIN_NS = 1_769_860_800_000_000_001


def written(rows: list[Row], form: OutputFormat, *, ports: bool = False, zone: tzinfo = UTC) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=ports, zone=zone)
    writer.write(rows)
    writer.close()
    return stream.getvalue()


def read_back(text: str) -> list[Row]:
    notes: list[str] = []
    reader = LogReader("again", stream=io.BytesIO(text.encode()))
    rows = [row for rows in rows_of_log(reader, notes.append) for row in rows]
    assert notes == []
    return rows


def reported(rows: list[Row]) -> list[tuple[bytes, int | None]]:
    return [(row.raw, row.t_ns) for row in rows]


def frame(name: str, **values: int) -> bytes:
    return encode(KIND_BY_NAME[name], values)


FRAMES = st.sampled_from(
    [
        frame("reset"),
        frame("speed", motor=1, rpm=-1000),
        frame("position", motor=4, rpm=-32768, pulses=-(2**31)),
        frame("mecanum", vx_cm_s=-1, vy_cm_s=0, wz_mrad_s=5),
        frame("speed_feedback", motor=2, rpm=7, error=0, online=15),
        frame("position_feedback", motor=3, pulses=-(2**31), error=255, online=255),
    ]
)
GAPS = st.sampled_from([0, 1, 86_806, 868_060, 5_000_000, 10**9])
"""Also shorter than a frame takes: rows of one read may have been reported as of one time."""


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("ports", [False, True])
@given(
    steps=st.lists(st.tuples(FRAMES, GAPS), min_size=1, max_size=12),
    timed=st.booleans(),
    zone=st.sampled_from([UTC, ZoneInfo("Asia/Shanghai"), timezone(-timedelta(hours=9.5))]),
)
@examples(20)
def test_rows_come_back_at_their_times(
    form: OutputFormat, ports: bool, steps: list[tuple[bytes, int]], timed: bool, zone: tzinfo
) -> None:
    times = list(accumulate((gap for _, gap in steps), initial=BEGIN_NS))
    rows: list[Row] = [
        Row("a name  with spaces", 10 * at, raw, times[at] if timed else None)
        for at, (raw, _) in enumerate(steps)
    ]
    assert reported(read_back(written(rows, form, ports=ports, zone=zone))) == reported(rows)


@pytest.mark.parametrize("form", FORMS)
def test_damage_comes_back_with_each_byte(form: OutputFormat) -> None:
    rows: list[Row] = [
        Row("p", 0, bytes(range(256)) * 4, BEGIN_NS, (Fault.NOISE,), framed=False),
        Row("p", 1024, b"\x10", BEGIN_NS + 10**9, (Fault.NOISE,), framed=False),
        Row("p", 1025, frame("reset"), BEGIN_NS + 2 * 10**9),
    ]
    text = written(rows, form)
    assert b"".join(row.raw for row in read_back(text)) == b"".join(row.raw for row in rows)
    times = {row.t_ns for row in read_back(text)}
    assert {row.t_ns for row in rows} <= times


@pytest.mark.parametrize("form", FORMS)
def test_a_row_without_a_time_has_none_among_others(form: OutputFormat) -> None:
    rows: list[Row] = [
        Row("p", 0, frame("reset"), BEGIN_NS),
        Row("p", 10, frame("reset"), None),
        Row("p", 20, frame("reset"), BEGIN_NS + 5),
    ]
    assert reported(read_back(written(rows, form))) == reported(rows)


@pytest.mark.parametrize("form", FORMS)
def test_the_last_moment_there_is(form: OutputFormat) -> None:
    (row,) = read_back(written([Row("p", 0, frame("reset"), 2**63 - 1)], form))
    assert row.t_ns is not None
    assert 2**63 - 10**6 < row.t_ns < 2**63


def test_rows_of_a_table_need_no_heading() -> None:
    rows: list[Row] = [Row("p", 10, frame("reset"), BEGIN_NS)]
    _, line = written(rows, OutputFormat.TABLE).splitlines()
    assert reported(read_back(line)) == reported(rows)


@pytest.mark.parametrize(
    ("form", "keep", "said"),
    [
        (OutputFormat.TABLE, 99, "line 3: this row of fte-sniff's table is cut or damaged; pass"),
        (OutputFormat.JSONL, 99, "line 2: this row of fte-sniff's JSON lines is cut or damaged"),
    ],
)
def test_what_is_cut_is_called_so(form: OutputFormat, keep: int, said: str) -> None:
    rows: list[Row] = [Row("p", 0, frame("speed", motor=1, rpm=9), BEGIN_NS)] * 2
    whole = written(rows, form)
    cut = whole[: whole.rindex("\n", 0, -1) + keep]
    with pytest.raises(InputTextError) as caught:
        read_back(cut)
    assert said in str(caught.value)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("right", "wrong"), [("2026-01-31T", "2026-13-31T"), ("000000001Z", "000000001+99:00")]
)
def test_impossible_time_is_one_line(form: OutputFormat, right: str, wrong: str) -> None:
    text = written([Row("p", 0, frame("reset"), BEGIN_NS)], form)
    assert right in text
    with pytest.raises(InputTextError, match=r"this row of fte-sniff's .* is cut or damaged"):
        read_back(text.replace(right, wrong))


@pytest.mark.parametrize("form", [OutputFormat.CSV, OutputFormat.JSONL])
def test_rows_keep_the_ports_that_they_name(form: OutputFormat) -> None:
    rows: list[Row] = [
        Row("a", 0, frame("reset"), BEGIN_NS),
        Row("b", 0, frame("speed", motor=1, rpm=9), BEGIN_NS + 10**6),
        Row("a", 10, frame("reset"), BEGIN_NS + 2 * 10**6),
    ]
    assert read_back(written(rows, form, ports=True)) == rows


class OneLineAtATime(io.BytesIO):
    """Text that comes line by line, as over a pipe."""

    def read1(self, _size: int | None = -1) -> bytes:
        return self.readline()


def damaged_rows(seed: int, count: int) -> list[Row]:
    """Rows of a line with damage and pauses."""
    chance, framer = random.Random(seed), Framer("again")
    rows, t_ns = list[Row](), BEGIN_NS
    for number in range(count):
        data = frame("speed_feedback", motor=number % 4 + 1, rpm=chance.randrange(2**15))
        if chance.random() < 0.1:
            data = data[: chance.randrange(1, 10)] + bytes(chance.choices(data, k=number % 3))
        t_ns += chance.choice([900_000, 1_000_000, 5_000_000, 30_000_000])
        rows += fed(framer, Chunk("again", t_ns, data))
    return rows + list(framer.finish())


def test_the_reads_of_own_rows_change_nothing() -> None:
    """Also where a pause decides which reading of damage is the best."""
    for seed in range(2):
        text = written(damaged_rows(seed, 1500), OutputFormat.CSV)
        reader = LogReader("again", stream=OneLineAtATime(text.encode()))
        slowly = [row for rows in rows_of_log(reader) for row in rows]
        assert [(row, row.faults) for row in read_back(text)] == [
            (row, row.faults) for row in slowly
        ]
