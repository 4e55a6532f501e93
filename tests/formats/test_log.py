"""Logs of other programs: exactly the bytes come back, or the log is refused with a reason."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from datetime import date, timedelta, timezone
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.errors import FileError, FteSniffError, InputTextError
from fte_sniff.formats import log_text
from fte_sniff.formats.known_files import refuse_known
from fte_sniff.formats.log import Log
from fte_sniff.formats.log_text import is_text
from fte_sniff.formats.log_times import LogOptions
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import HEADERS, KINDS, Direction, FrameKind, byte_time_ns, encode
from fte_sniff.session.framing import rows_of_chunks, timed
from tests.examples import examples
from tests.formats.layouts import LAYOUTS, Sent, clock, escaped, spaced

WAYS = ("tx", "rx")
FOREIGN = (
    "port opened", "Packet 10", "0x3ffb4280", "Dead", "frame 12", "115200", "00-1A-2B-3C-4D-5E",
    "", "baud 115200, 8N1", "--- end ---", "I have 3 AA batteries", "temperature 23.5",
)  # fmt: skip
"""Lines of other programs; none is read as bytes."""


def frame_of(kind: FrameKind, rng: random.Random) -> bytes:
    values = {}
    for field in kind.fields:
        if field.name == "motor":
            values[field.name] = rng.randint(1, 4)
        elif field.legal_bits is None:
            values[field.name] = rng.randint(field.low, field.high)
        else:
            values[field.name] = rng.choice([0, 1, 15])
    return encode(kind, values)


def a_log(seed: int, frames: int = 30) -> list[Sent]:
    """Frames of both directions, with odd seeds some in two pieces."""
    rng, ms, log = random.Random(seed), 43_200_000, list[Sent]()
    for _ in range(frames):
        kind = rng.choice(KINDS)
        raw, way = frame_of(kind, rng), "tx" if kind.direction is Direction.CONTROL else "rx"
        ms += rng.randint(3, 40)
        cut = rng.randint(1, 9) if seed % 2 and rng.random() < 0.2 else 0
        if cut:
            log.append(Sent(raw[:cut], way, ms))
            ms += 2
        log.append(Sent(raw[cut:], way, ms))
    return log


def rows_of(content: bytes | str, options: LogOptions | None = None) -> tuple[list[Row], list[str]]:
    """The rows of a log, and what is noted about it."""
    notes = list[str]()
    data = content.encode() if isinstance(content, str) else content
    log = Log("log.txt", options, BytesIO(data))
    batches = rows_of_chunks(log.chunks(), notes.append)
    rows = [row for rows in batches for row in rows]
    return rows, [*notes, *log.notes(), *log.clock.notes()]


def frames_of(log: Sequence[Sent]) -> dict[str, list[bytes]]:
    sent = {way: b"".join(one.data for one in log if one.way == way) for way in WAYS}
    return {
        way: [data[at : at + 10] for at in range(0, len(data), 10)] for way, data in sent.items()
    }


def found_in(rows: Sequence[Row]) -> dict[str, list[bytes]]:
    control = HEADERS[Direction.CONTROL]
    frames = [row.raw for row in rows if row.framed]
    return {way: [raw for raw in frames if (raw[0] == control) == (way == "tx")] for way in WAYS}


def size_of(parts: Sequence[Sent] | Sequence[Row]) -> int:
    return sum(len(one.data if isinstance(one, Sent) else one.raw) for one in parts)


# Layouts


@pytest.mark.parametrize("name", LAYOUTS)
def test_long_log_gives_what_its_first_lines_give(name: str) -> None:
    log = a_log(1, 120)
    while LAYOUTS[name](log).count("\n") < 300:  # 200 decide how it is read
        log *= 2
    rows, _ = rows_of(LAYOUTS[name](log))
    assert found_in(rows) == frames_of(log)
    assert size_of(rows) == size_of(log)


class Trickle(BytesIO):
    """A stream whose reads return a few bytes."""

    def __init__(self, content: bytes, size: int) -> None:
        super().__init__(content)
        self._few = size

    def read1(self, size: int | None = -1, /) -> bytes:
        return super().read(self._few)


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize("name", ["CoolTerm", "Eltima", "hexdump -C", "octal"])
def test_reads_of_a_stream_change_nothing(name: str, size: int) -> None:
    content = LAYOUTS[name](a_log(1, 60)).encode()
    expected, _ = rows_of(content)
    chunks = Log("log.txt", None, Trickle(content, size)).chunks()
    rows = [row for rows in rows_of_chunks(chunks, lambda _: None) for row in rows]
    key = lambda row: (row.port, row.offset)  # noqa: E731
    assert sorted(rows, key=key) == sorted(expected, key=key)


# Layouts of users that were once read wrong


def test_times_of_a_full_line_are_not_too_dense() -> None:
    log = [one._replace(ms=43_200_000 + at) for at, one in enumerate(a_log(0, 300))]
    for layout in ("Arduino", "CoolTerm"):
        _, notes = rows_of(LAYOUTS[layout](log))
        assert not any("dense" in note for note in notes)


def test_record_numbers_above_the_bytes_are_not_bytes() -> None:
    log = a_log(0, 40)
    text = "Legend: \n  > - A write operation occurred.\n  < - A read operation occurred.\n"
    for at, one in enumerate(log, 2):
        sign = ">" if one.way == "tx" else "<"
        text += f"{at:<7}{sign} {len(one.data)} uint8 values.\n       {spaced(one.data)}\n"
    rows, _ = rows_of(text)
    assert size_of(rows) == size_of(log)
    assert {(row.port, row.raw[0]) for row in rows} == {("log.txt:tx", 0xAA), ("log.txt:rx", 0x55)}


@pytest.mark.parametrize("form", ["FFFD", "EF BF BD", "\ufffd"])
def test_bytes_that_a_program_replaced_are_named(form: str) -> None:
    lines = (
        " ".join(form if byte >= 0x80 else f"{byte:02X}" for byte in one.data) for one in a_log(0)
    )
    with pytest.raises(InputTextError, match=r"replaced bytes from 80 on.* so they are lost"):
        rows_of("\n".join(lines))


# Lines and runs


def test_garbled_direction_beside_a_clean_one_is_kept() -> None:
    control = frame_of(KINDS[1], random.Random(1)).hex(" ")
    rows, _ = rows_of(f"TX: {control}\nRX: 55 01 13 37 77 88 99\n" * 10)
    assert sum(len(row.raw) for row in rows if row.port == "log.txt:rx") == 70


def test_lane_that_comes_later_is_read_from_its_first_frame_on() -> None:
    log = a_log(0, 300)
    text = "".join(
        f"{'early' if at < 250 else 'later'} {spaced(one.data)}\n" for at, one in enumerate(log)
    )
    rows, _ = rows_of(text)
    assert size_of(rows) == size_of(log)


@pytest.mark.parametrize(
    "form",
    ["12:00:00 TX: {a}; RX: {f}", '{{"tx": "{a}", "rx": "{f}"}}', "<tx>{a}</tx><rx>{f}</rx>"],
)
def test_all_runs_of_a_line_are_read(form: str) -> None:
    a, f = (frame_of(kind, random.Random(1)) for kind in (KINDS[1], KINDS[4]))
    rows, _ = rows_of(f"{form.format(a=spaced(a), f=spaced(f))}\n" * 20)
    assert found_in(rows) == {"tx": [a] * 20, "rx": [f] * 20}
    assert {row.port for row in rows} == {"log.txt:tx", "log.txt:rx"}
    rows, _ = rows_of(f'["{spaced(a)}", "{spaced(f)}", "{spaced(a)}"]\n' * 20)
    assert [row.raw for row in rows] == [a, f, a] * 20


def test_characters_beside_escapes_are_not_lost_without_a_note() -> None:
    frames = [one.data for one in a_log(0)]
    lines = ("".join(chr(b) if 64 < b < 91 else f"\\{b:02X}" for b in raw) for raw in frames)
    rows, notes = rows_of("\n".join(lines))
    assert {row.raw for row in rows if row.framed} <= set(frames)
    assert any(note.startswith("lines without bytes: 19, for example ") for note in notes)


def test_bytes_that_each_line_has_beside_its_frame_are_left_out_with_a_note() -> None:
    log = a_log(0)
    text = "".join(f"RX: 07 {spaced(one.data)} {sum(one.data) & 255:02X}\n" for one in log)
    rows, notes = rows_of(text)
    assert size_of(rows) == size_of(log)
    assert any("such as a length or a checksum, are left out" in note for note in notes)


def test_damage_in_a_line_is_a_malformed_row() -> None:
    lines = [f"RX: {spaced(one.data)}" for one in a_log(0)]
    lines[9] = "RX: 55 01 04 03 E8 00 00 O0 0F EE"
    rows, _ = rows_of("\n".join(lines))
    assert sum(row.framed for row in rows) == 29
    assert b"".join(row.raw for row in rows if not row.framed).hex() == "55010403e80000"


def test_few_bytes_in_frames_are_reported() -> None:
    text = "".join(f"RX: {one.data.hex(' ')}\n" for one in a_log(0))
    _, notes = rows_of(text + "RX: 01 02 03 04 05 06 07 08 09 10 11 12\n" * 200)
    assert any(note.startswith("log.txt: only 11% of the bytes are in frames") for note in notes)
    _, notes = rows_of(text)
    assert not any("in frames" in note for note in notes)


# Times


def one_time(text: str, **options: object) -> str | None:
    """The time of a row beside a text."""
    rows, _ = rows_of(f"{text} 55 01 01 03 E8 00 00 00 0F EE\n", LogOptions(**options))  # type: ignore[arg-type]
    return None if rows[0].t_ns is None else iso_time(rows[0].t_ns)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2026-01-31T14:03:22.5Z", "2026-01-31T14:03:22.5"),
        ("2026/01/31 14:03:22,123456789", "2026-01-31T14:03:22.123456789"),
        ("2026-01-31 14:03:22+08:00", "2026-01-31T06:03:22.0"),
        ("2026年1月31日 14:03:22", "2026-01-31T14:03:22.0"),
        ("31.01.2026 14:03:22", "2026-01-31T14:03:22.0"),
        ("31/01/2026 02:03:22 PM", "2026-01-31T14:03:22.0"),
        ("01/31/26 2:03:22 p.m.", "2026-01-31T14:03:22.0"),
        ("Sat Jan 31 14:03:22.5 2026", "2026-01-31T14:03:22.5"),
        ("31-Jan-2026 14:03:22", "2026-01-31T14:03:22.0"),
        ("Jan 31 14:03:22", "2026-01-31T14:03:22.0"),
        ("01-31 14:03:22.123:", "2026-01-31T14:03:22.123"),
        ("下午 02:03:22", "2026-02-01T14:03:22.0"),
        ("12:03:22 AM", "2026-02-01T00:03:22.0"),
        ("14:03:22:123", "2026-02-01T14:03:22.123"),
        ("20260131140322.123", "2026-01-31T14:03:22.123"),
        ("20260131_140322", "2026-01-31T14:03:22.0"),
        ("20260131-140322.5", "2026-01-31T14:03:22.5"),
        ("time:14:03:22.5 data:", "2026-02-01T14:03:22.5"),
        ("31/01/2026, 14:03:22node:", "2026-01-31T14:03:22.0"),
        ("t=43250ms", "1970-01-01T00:00:43.25"),
        ("+43.25 s", "1970-01-01T00:00:43.25"),
        ("1769868202.25", "2026-01-31T14:03:22.25"),
        ("1769868202123", "2026-01-31T14:03:22.123"),
        ("1769868202123456789", "2026-01-31T14:03:22.123456789"),
        ("[   43.123456]", "1970-01-01T00:00:43.123456"),
    ],
)
def test_time_is_read(text: str, expected: str) -> None:
    found = one_time(text, day=date(2026, 2, 1))
    assert found is not None
    assert found.startswith(expected)
    assert set(found[len(expected) :]) <= {"0", "Z"}


@pytest.mark.parametrize(
    "text", ["55:01:02:03", "v1.234.567", "192.168.1.100", "31/02/2026", "5.25"]
)
def test_what_is_not_a_time_gives_none(text: str) -> None:
    assert one_time(text) is None


def test_date_zone_and_start_are_given_by_the_user() -> None:
    zone = timezone(timedelta(hours=8))
    assert (
        one_time("14:03:22", day=date(2026, 1, 31), zone=zone) == "2026-01-31T06:03:22.000000000Z"
    )
    assert one_time("[0.250000]", start_ns=10**18) == "2001-09-09T01:46:40.250000000Z"
    assert one_time("2/8/2026 12:00:00", day=date(2026, 2, 8)) == "2026-02-08T12:00:00.000000000Z"
    assert one_time("2/8/2026 12:00:00", day=date(2026, 8, 2)) == "2026-08-02T12:00:00.000000000Z"


def test_what_times_lack_is_noted() -> None:
    frame = "55 01 01 03 E8 00 00 00 0F EE"
    for text, note in (
        ("14:03:22", "its times have no date; "),
        ("Jan 31 14:03:22", "its times have no year; "),
        ("2/8/2026 14:03:22", "such as 2/8/2026, are read "),
        ("2026-01-31 14:03:22", "its times name no zone"),
        ("[0.250000]", "its times count seconds from a start"),
    ):
        _, notes = rows_of(f"{text} {frame}\n")
        assert any(note in one for one in notes)
    _, notes = rows_of(f"2026-01-31T14:03:22Z {frame}\n")
    assert not notes


@pytest.mark.parametrize("name", ["log_20260131.txt", "robot-2026-01-31 7.log"])
def test_date_in_the_name_of_a_file_is_that_of_its_times(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text(
        "".join(f"{time} 55 01 01 03 E8 00 00 00 0F EE\n" for time in ("23:59:59", "0:00:01"))
    )
    log = Log(str(path))
    (chunk, *_) = log.chunks()
    assert iso_time(chunk.t_ns or 0).startswith("2026-01-31T23:59:59")
    assert any("the file's name gives 2026-01-31" in note for note in log.clock.notes())


def test_times_of_day_pass_midnight() -> None:
    log = [
        one._replace(ms=(86_390_000 + 1000 * at) % 86_400_000) for at, one in enumerate(a_log(0))
    ]
    rows, _ = rows_of(LAYOUTS["Arduino"](log), LogOptions(day=date(2026, 1, 31)))
    assert iso_time(rows[-1].t_ns or 0).startswith("2026-02-01T00:00:19")
    assert all(b.t_ns - a.t_ns == 10**9 for a, b in pairwise(rows))  # type: ignore[operator]


def test_clock_that_was_set_back_is_noted() -> None:
    log = a_log(0)
    back = [*log[:20], *(one._replace(ms=one.ms - 5000) for one in log[20:])]
    rows, notes = rows_of(LAYOUTS["Arduino"](back))
    assert any(
        "times that step back, are missing, or not between 1970 and 2262: 1;" in n for n in notes
    )
    times = [row.t_ns or 0 for row in rows]
    assert times == sorted(times)


def test_time_above_holds_for_the_lines_below() -> None:
    log = a_log(1)
    rows, _ = rows_of(LAYOUTS["Eltima"](log), LogOptions(day=date(2026, 1, 31)))
    starts = {"tx": list[int](), "rx": list[int]()}
    for way in WAYS:
        times = [one.ms for one in log if one.way == way for _ in one.data]
        starts[way] = times[::10]
    midnight = 1_769_817_600_000
    for row in rows:
        assert (row.t_ns or 0) // 10**6 - midnight == starts[row.port[-2:]].pop(0)


def test_times_of_a_program_that_starts_and_ends_are_not_those_of_the_bytes() -> None:
    stamped = "[14:03:21.248] monitor v2\n[14:03:21.253] connected\n{}\n[14:03:25.595] closed\n"
    rows, _ = rows_of(stamped.format(spaced(b"".join(one.data for one in a_log(0)))))
    assert {row.t_ns for row in rows} == {None}


@pytest.mark.parametrize(("unit", "scale"), [("s", 10**9), ("ms", 10**6), ("us", 1000), ("ns", 1)])
def test_unit_of_times_is_that_of_their_heading(unit: str, scale: int) -> None:
    frame = frame_of(KINDS[4], random.Random(1))
    text = "".join(f"{at},{7000 + 20 * at},{byte:02X}\n" for at, byte in enumerate(frame * 3))
    rows, _ = rows_of(f"Id,Time [{unit}],Value\n{text}", LogOptions(start_ns=10**18))
    assert [row.raw for row in rows] == [frame] * 3
    assert [row.t_ns for row in rows] == [10**18 + at * scale for at in (7000, 7200, 7400)]


# Plain hex


@pytest.mark.parametrize(
    "text",
    ["AA0102", "aa 01 02", "AA,01,02", "0xAA 0x01 0x02", "AAh 01h 02h", "{0xAA, 0x01, 0x02};",
     "\\xAA\\x01\\x02", "$AA $01 $02", "AA:01:02", "AA-01-02", "AA 01 # 55\n02"],
)  # fmt: skip
def test_plain_hex_is_read_in_any_style(text: str) -> None:
    rows, _ = rows_of(text)
    assert b"".join(row.raw for row in rows).hex() == "aa0102"


def test_mistake_in_plain_hex_is_named_after_the_rows_before_it() -> None:
    frame = "55 01 01 03 E8 00 00 00 0F EE\n"
    log = Log("x.hex", None, BytesIO((frame * 300 + "55 O1\n").encode()))
    rows = list[Row]()
    batches = rows_of_chunks(log.chunks(), lambda _: None)
    with pytest.raises(InputTextError, match=r"x\.hex: not hex: 'O' in line 301, column 4"):
        rows.extend(row for some in batches for row in some)
    assert len(rows) == 300


def test_very_long_line_is_read_if_it_is_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_text, "LONGEST_LINE", 600)
    monkeypatch.setattr(log_text, "_BLOCK", 200)
    frame = frame_of(KINDS[4], random.Random(1))
    rows, _ = rows_of(" ".join([spaced(frame)] * 200))
    assert [row.raw for row in rows] == [frame] * 200
    with pytest.raises(FileError, match=r"a line longer than .* that is not plain hex"):
        rows_of("opened\n" + f"Recv: {spaced(frame)} " * 200)


def test_bytes_without_times_follow_each_other_at_the_baud() -> None:
    frame = spaced(frame_of(KINDS[4], random.Random(1)))
    for text in (f"{frame}\n" * 50, f"RX: {frame}\n" * 50):
        chunks = timed(Log("x.txt", None, BytesIO(text.encode())).chunks(), 10**18, 9600)
        rows = [row for rows in rows_of_chunks(chunks, lambda _: None, 9600) for row in rows]
        times = [row.t_ns or 0 for row in rows]
        assert all(b - a == 10 * byte_time_ns(9600) for a, b in pairwise(times))


# Text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "gb18030"])
def test_encodings_are_recognised(encoding: str) -> None:
    log = a_log(0)
    text = LAYOUTS["XCOM"](log)
    rows, _ = rows_of(text.encode(encoding))
    assert found_in(rows) == frames_of(log)
    assert {row.port for row in rows} == {"log.txt:tx", "log.txt:rx"}
    assert is_text(text.encode(encoding))


def test_block_of_nul_is_skipped_and_reported() -> None:
    log = a_log(0)
    lines = LAYOUTS["Arduino"](log).encode().splitlines(keepends=True)
    rows, notes = rows_of(b"".join([*lines[:9], bytes(5000), *lines[9:]]))
    assert found_in(rows) == frames_of(log)
    assert (
        "lines without bytes: 1, for example '# skipped NUL bytes, as a power cut leaves them'"
        in notes
    )


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (bytes(range(32)), "no frames in lines 1 to 2; no bytes in any form; --input-regex"),
        (
            (b"12:00:00 rx data \xaa\x01\x02\n") * 40,
            "it holds no text, or its program replaced bytes from 80 on",
        ),
        (b"It was the best of times\n" * 40, "no frames in lines 1 to 40; no bytes in any"),
    ],
)
def test_text_without_bytes_is_refused_with_a_reason(content: bytes, error: str) -> None:
    with pytest.raises(FteSniffError, match=re.escape(error)):
        rows_of(content)


def test_refused_log_names_the_best_two_forms_with_two_lines_each() -> None:
    text = "".join(f"{at % 7 + 20} 30 40 50 99 0x{at:04x}\n" for at in range(300, 340))
    with pytest.raises(InputTextError) as refused:
        rows_of(f"data {text}")
    assert "it could be read as hex pairs (200 bytes, " in str(refused.value)
    assert " or as " in str(refused.value)
    assert str(refused.value).count("40 50 99") == 4


NOTHING = {
    "prose": "It was the best of times, it was the worst of times\n" * 200,
    "source": "def f(a, b=0xAA):\n    return a + b  # 10 of 20\n" * 100,
    "MAC addresses": "00:1a:2b:3c:4d:5e\n" * 50,
    "dates": "2026-01-31 12:00:05\n" * 50,
    "UUIDs": "id 0a0525f3-cd50-2a71-4705-c97ca87930cc\n" * 50,
    "floats": "0.718209,604.182408,-0.723621\n" * 50,
}


@pytest.mark.parametrize("name", NOTHING)
def test_text_without_frames_has_no_frames(name: str) -> None:
    try:
        rows, _ = rows_of(NOTHING[name])
    except InputTextError:
        return
    assert not any(row.framed for row in rows)


@pytest.mark.parametrize(
    ("first", "what"),
    [
        ("time,port,offset,length\n", "CSV, a result"),
        ('{"time":null,"port":"x","offset":0}\n', "JSON lines, a result"),
        ("time   port  offset   kind   values   raw   faults\n", "a table, a result"),
    ],
)
def test_own_results_are_refused_with_what_to_do(first: str, what: str) -> None:
    with pytest.raises(FileError, match=f"wrote as {what}, .*; name the recording"):
        refuse_known("log.txt", f"{first}1,2,3\n".encode())


# Any writer

Writer = Callable[[bytes], str]


def _each(form: str, separator: str = " ") -> Writer:
    return lambda data: separator.join(form.format(byte) for byte in data)


WRITERS: dict[str, Writer] = {
    **{
        f"{form} {separator!r}": _each(form, separator)
        for form in ("{:02X}", "{:02x}")
        for separator in (" ", "  ", "\t", ",", ", ", ":", "-", ";", "|", " | ", "_", "/", ".")
    },
    **{
        f"{form} {separator!r}": _each(form, separator)
        for form in ("0x{:02X}", "0x{:02x}", "0x{:x}", "${:02X}", "%{:02X}", "&H{:02X}")
        for separator in (" ", ",", ", ")
    },
    "digits": bytes.hex,
    "0x and digits": lambda data: f"0x{data.hex()}",
    "\\x": _each("\\x{:02x}", ""),
    "\\": _each("\\{:02X}", ""),
    "h": _each("{:02X}h"),
    "unpadded": _each("{:x}"),
    "brackets": _each("[{:02X}]", ""),
    "angles": _each("<{:02x}>", ""),
    "quotes": _each('"0x{:02x}"', ", "),
    "decimal": _each("{}"),
    "decimal, commas": _each("{}", ", "),
    "padded decimal": _each("{:3d}"),
    "octal": _each("{:03o}"),
    "binary": _each("{:08b}"),
    "repr": repr,
    "C string": lambda data: f'"{escaped(data)}"',
    "octal escapes": lambda data: '"' + "".join(f"\\{byte:03o}" for byte in data) + '"',
    "JSON": lambda data: f"[{','.join(map(str, data))}]",
}
WORDS = [
    tuple(words.split("/"))
    for words in (
        "TX/RX", "tx/rx", "send/recv", "Sent/Received", "WRITE/READ", "out/in", "发送/接收",
        "发/收", "→/←", "-->/<--", ">>/<<", "host/device", "request/response", "onWrite/onRead",
        "COM3/COM4", "ttyUSB0/ttyUSB1", "fte.cmd/fte.state",
    )
]  # fmt: skip
PREFIXES = (
    "{time} {word}: ", "[{time}] {word} ", "[{time}][{word}] ", "{word} {time} ", "{time},{word},",
    "{time}\t{word}\t", "{word}: ", "{word} ", "#{n} {time} {word} ", "{time} {word} len={size} ",
    "D/Serial({n}): {word} {time} ", "{time} | {word} | ", "<{time} {word}> ",
)  # fmt: skip
TIMES: dict[str, Callable[[int], str]] = {
    "ms": clock,
    "ISO": lambda ms: f"2026-01-31T{clock(ms)}",
    "seconds": lambda ms: f"2026-01-31 {clock(ms, 0)}",
    "month": lambda ms: f"Jan 31 {clock(ms)}",
    "day first": lambda ms: f"31/01/2026 {clock(ms)}",
    "comma": lambda ms: clock(ms).replace(".", ","),
    "epoch": lambda ms: f"{1_769_817_600 + ms / 1000:.3f}",
    "none": lambda ms: "",
}


@given(
    st.sampled_from(sorted(WRITERS)),
    st.sampled_from(WORDS),
    st.sampled_from(PREFIXES),
    st.sampled_from(sorted(TIMES)),
    st.integers(0, 10**6),
    st.lists(st.sampled_from([*FOREIGN, "über 5 µs", "电机 2 停止"]), max_size=40),
)
@example("${:02X} ' '", WORDS[0], "#{n} {time} {word} ", "ISO", 0, ["--- end ---"])
@examples(60)
def test_frames_of_any_writer_come_back_exactly(
    writer: str, words: tuple[str, ...], prefix: str, time: str, seed: int, foreign: list[str]
) -> None:
    log, lines = a_log(seed, 40), list[str]()
    for n, one in enumerate(log):
        word = words[WAYS.index(one.way)]
        begin = prefix.format(time=TIMES[time](one.ms), word=word, n=n, size=len(one.data))
        lines.append(begin + WRITERS[writer](one.data))
    rng = random.Random(seed)
    for text in foreign:
        lines.insert(rng.randint(0, len(lines)), text)
    rows, notes = rows_of("\n".join(lines))
    assert found_in(rows) == frames_of(log), notes
    assert size_of(rows) == size_of(log), notes
    assert all(row.t_ns is not None for row in rows) == (time != "none" and "{time}" in prefix)


@pytest.mark.parametrize("year", ["0001", "1969", "2263", "9999"])
def test_a_time_that_rows_cannot_have_is_reported(year: str) -> None:
    frame = "55 01 01 03 E8 00 00 00 0F EE"
    lines = [f"2026-01-31 00:00:01 RX: {frame}", *[f"{year}-01-01 00:00:02 RX: {frame}"] * 3]
    rows, notes = rows_of("\n".join(lines))
    assert {row.t_ns for row in rows} == {1_769_817_601_000_000_000}
    assert any("or not between 1970 and 2262: 3; rows keep" in note for note in notes)
