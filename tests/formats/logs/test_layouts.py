"""Layouts of many tools: exactly the bytes come back, or the log is refused with a reason."""

from __future__ import annotations

import random
import re
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pytest

from fte_sniff.errors import FteSniffError
from fte_sniff.formats.logs.evidence import EXTRACTORS
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.protocol import HEADERS, KINDS, Direction, FrameKind, Row, encode
from fte_sniff.session.log_rows import rows_of_log
from tests.formats.logs.layouts import LAYOUTS, ONE_LINE, Sent, clock, line
from tests.slow import crossed, first

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


def rows_of(content: bytes, options: LogOptions | None = None) -> tuple[list[Row], list[str]]:
    notes: list[str] = []
    reader = LogReader("log.txt", options, BytesIO(content))
    return [row for rows in rows_of_log(reader, notes.append) for row in rows], notes


def frames_of(log: Sequence[Sent]) -> dict[str, list[bytes]]:
    sent = {way: b"".join(one.data for one in log if one.way == way) for way in WAYS}
    return {
        way: [data[at : at + 10] for at in range(0, len(data), 10)] for way, data in sent.items()
    }


def found_in(rows: Sequence[Row]) -> dict[str, list[bytes]]:
    return {
        way: [
            row.raw
            for row in rows
            if row.framed and (row.raw[0] == HEADERS[Direction.CONTROL]) == (way == "tx")
        ]
        for way in WAYS
    }


@pytest.mark.parametrize("seed", first(1, [1, 0, 2, 3]))
@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_comes_back_exactly(name: str, seed: int) -> None:
    log = a_log(seed)
    rows, _ = rows_of(LAYOUTS[name](log).encode())
    assert found_in(rows) == frames_of(log)
    assert sum(len(row.raw) for row in rows) == sum(len(one.data) for one in log)


class Trickle(BytesIO):
    """A stream whose reads return a few bytes."""

    def __init__(self, content: bytes, size: int) -> None:
        super().__init__(content)
        self._few = size

    def read1(self, size: int | None = -1, /) -> bytes:
        return super().read(self._few)


@pytest.mark.parametrize(
    ("name", "size"),
    crossed(["CoolTerm", "Eltima", "Node-RED", "hexdump -C", "octal"], [1, 7, 1000]),
)
def test_the_way_a_file_is_split_changes_nothing(name: str, size: int) -> None:
    content = LAYOUTS[name](a_log(1, 60)).encode()
    whole, _ = rows_of(content)
    notes: list[str] = []
    reader = LogReader("log.txt", None, Trickle(content, size))
    rows = [row for rows in rows_of_log(reader, notes.append) for row in rows]
    assert {row.port: [] for row in rows} == {row.port: [] for row in whole}
    key = lambda row: (row.port, row.offset)  # noqa: E731
    assert sorted(rows, key=key) == sorted(whole, key=key)


MANY_LINES = [
    "CoolTerm", "hexdump -C", "candump", "DSView", "names", "Python repr", "JSON latin", "zeros",
    "MQTT base64", "usbmon", "Docklight", "Termite", "number before", "Java", "Swift", "Erlang",
    "percent", "octal", "record number", "long label", "checksum in words", "Eltima", "od",
    "journald", "Eclipse", "text beside", "words after bytes", "ESPHome, binary",
]  # fmt: skip
"""Layouts of the least and the most columns and words; the first ten are of all sorts."""


@pytest.mark.parametrize(
    ("name", "foreign"),
    first(
        10, [(name, (at + odd) % 2 == 0) for odd in (1, 0) for at, name in enumerate(MANY_LINES)]
    ),
)
def test_many_lines_at_once_are_as_one_by_one(
    name: str, foreign: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    layouts = LAYOUTS | {
        "names": line("{t} [{name}] {TX}: {spaced}"),
        "zeros": line("2024-03-05 {t}000 {TX} {json}"),
    }
    lines = layouts[name](a_log(3, 700)).splitlines()
    rng = random.Random(1)
    for _ in range(300 if foreign and name not in ("od", "hexdump -C", "DSView") else 0):
        lines.insert(rng.randrange(1, len(lines)), rng.choice(FOREIGN))
    content = "\n".join(lines).encode()
    options = LogOptions(start_ns=10**18)
    at_once, notes = rows_of(content, options)
    monkeypatch.setattr("fte_sniff.formats.logs.layout._COLUMNAR", 10**9)
    one_by_one, same = rows_of(content, options)
    at_once.sort(key=lambda row: (row.port, row.offset))
    one_by_one.sort(key=lambda row: (row.port, row.offset))
    assert at_once == [replace(a, t_ns=b.t_ns) for a, b in zip(one_by_one, at_once, strict=True)]
    times = zip(at_once, one_by_one, strict=True)
    assert all(abs((a.t_ns or 0) - (b.t_ns or 0)) <= 1_000_000 for a, b in times)
    assert notes == same


@pytest.mark.parametrize("form", ["port {} {}", "ch-{}: {}", "{} us COM{}: {}", "{1} channel {0}"])
def test_lines_that_differ_in_the_number_of_a_port_are_of_different_streams(form: str) -> None:
    frames = [frame_of(kind, random.Random(1)).hex(" ") for kind in (KINDS[1], KINDS[4])]
    lines = [
        form.format(*[1000 + number] * (form.count("{") - 2), port + 1, frames[port])
        for number in range(600)
        for port in (0, 1)
    ]
    rows, _ = rows_of("\n".join(lines).encode())
    assert [row.raw.hex(" ") for row in rows] == frames * 600
    assert len({(row.port, row.raw[0]) for row in rows}) == len({row.port for row in rows}) == 2


@pytest.mark.parametrize("wrong", ["O0", "0O", "0"])
def test_a_mistake_in_a_byte_is_a_gap_and_makes_no_frame_of_two_lines(wrong: str) -> None:
    one = "55 01 04 03 E8 00 00 00 0F EE"
    lines = [f"RX: {one}"] * 9
    lines[4:6] = [f"RX: 55 01 04 03 E8 00 00 {wrong} 0F EE", "RX: 00 0F EE"]
    rows, notes = rows_of("\n".join(lines).encode())
    assert [row.raw.hex(" ").upper() for row in rows if row.framed] == [one] * 7
    assert f"log.txt: line 5 leaves out bytes: '{wrong} 0F EE'" in notes


def test_two_readings_are_shown_by_what_differs() -> None:
    one = "55 01 01 03 E8 00 00 00 0F EE"
    lines = [*[one] * 6, "55 01 04 03 E8 00 00 O0 0F EE", "5501 02 03 E8 0000 00 0F EE", one]
    text = "".join(f"[{number}] RX: {line}\n" for number, line in enumerate(lines))
    with pytest.raises(FteSniffError, match="two readings are as good") as refused:
        rows_of(text.encode())
    examples = re.findall(r"\(for example (.*?)\)", str(refused.value))
    assert len(set(examples)) == 2


@pytest.mark.parametrize("wrong", [":1", "#1", "G1", "1"])
def test_a_line_with_a_wrong_character_is_read_up_to_there(wrong: str) -> None:
    one = frame_of(KINDS[1], random.Random(1)).hex(" ").upper()
    lines = [f"RX: {one}"] * 9
    lines[4] = f"RX: {one[:6]}{wrong}{one[8:]}"
    rows, _ = rows_of("\n".join(lines).encode())
    assert sum(row.framed for row in rows) >= 8
    assert sum(len(row.raw) for row in rows) > 80


@pytest.mark.parametrize("tail", ["", "..", " ...", " +6 more"])
def test_words_of_a_heading_are_not_bytes_of_the_lines_below_it(tail: str) -> None:
    log = a_log(0)
    rows, _ = rows_of(
        "".join(
            f"{'Sent' if one.way == 'tx' else 'Received'} {len(one.data)} bytes:\n"
            f"\t{one.data.hex(' ')}{tail if at % 5 == 0 else ''}\nfd 3 ok\n"
            for at, one in enumerate(log)
        ).encode()
    )
    assert found_in(rows) == frames_of(log)
    assert sum(len(row.raw) for row in rows) == sum(len(one.data) for one in log)


@pytest.mark.parametrize("words", ["PC -> ctrl/ctrl -> PC", "Write Request/Read Request"])
def test_labels_that_separate_streams_are_better_than_a_lone_one(words: str) -> None:
    log = a_log(1)
    way = dict(zip(WAYS, words.split("/"), strict=True))
    rows, _ = rows_of("".join(f"{way[one.way]}: {one.data.hex(' ')}\n" for one in log).encode())
    assert found_in(rows) == frames_of(log)
    assert len({row.port for row in rows}) == 2


def test_headings_without_a_time_are_not_lines_without_one() -> None:
    log = a_log(0)
    lines = [
        f"way {one.way}\n12:00:0{at % 10}.5 {one.data.hex(' ')}\n" for at, one in enumerate(log)
    ]
    _, notes = rows_of("".join(lines).encode())
    assert not any("a time; that of" in note for note in notes)


@pytest.mark.parametrize("count", [1, 3, 9, 20])
def test_network_addresses_among_numbered_lines_are_not_bytes(count: int) -> None:
    log = a_log(1)
    lines = ONE_LINE["number before"](log).splitlines()
    for at in range(count):
        lines.insert(2 * at + 1, "00-1A-2B-3C-4D-5E")
    rows, notes = rows_of("\n".join(lines).encode())
    assert found_in(rows) == frames_of(log)
    assert sum(len(row.raw) for row in rows) == sum(len(one.data) for one in log)
    assert any("no bytes" in note for note in notes)


def test_characters_beside_backslash_codes_of_labview_are_bytes() -> None:
    f = frame_of(KINDS[4], random.Random(1))
    text = "".join(chr(b) if 0x20 < b < 0x7F and b != 0x5C else f"\\{b:02X}" for b in f)
    assert text[0] == "U"
    rows, _ = rows_of(f"12:00:01.500 Read {text}\n".encode() * 9)
    assert [row.raw for row in rows] == [f] * 9


def test_every_form_names_its_programs() -> None:
    assert all(extractor.tools for extractor in EXTRACTORS)
    assert len({extractor.name for extractor in EXTRACTORS}) == len(EXTRACTORS)


def test_a_frame_that_the_other_direction_interrupts_is_whole() -> None:
    a, f = (frame_of(kind, random.Random(1)) for kind in (KINDS[1], KINDS[4]))
    lines = [f"TX: {a[:4].hex(' ')}", f"RX: {f.hex(' ')}", f"TX: {a[4:].hex(' ')}"] * 5
    rows, _ = rows_of("\n".join(lines).encode())
    assert found_in(rows) == {"tx": [a] * 5, "rx": [f] * 5}
    assert {row.port for row in rows} == {"log.txt:tx", "log.txt:rx"}
    assert [row.offset for row in rows if row.port.endswith("tx")] == [0, 10, 20, 30, 40]


@pytest.mark.parametrize(("tx", "rx"), [(">", "<"), (">>", "<<"), ("-->", "<--")])
def test_arrows_separate_directions_though_all_else_is_plain_hex(tx: str, rx: str) -> None:
    log = a_log(3)
    lines = [f"{tx if sent.way == 'tx' else rx} {sent.data.hex(' ')}" for sent in log]
    rows, _ = rows_of("\n".join(lines).encode())
    assert found_in(rows) == frames_of(log)
    assert {row.port for row in rows} == {"log.txt:rx", "log.txt:tx"}


def test_a_garbled_direction_beside_a_clean_one_is_kept() -> None:
    a = frame_of(KINDS[1], random.Random(1)).hex(" ")
    text = f"TX: {a}\nRX: 55 01 13 37 77 88 99\n" * 10
    rows, _ = rows_of(text.encode())
    assert sum(len(row.raw) for row in rows if row.port == "log.txt:rx") == 70


NOTHING = {
    "prose": "It was the best of times, it was the worst of times\n" * 200,
    "source": "def f(a, b=0xAA):\n    return a + b  # 10 of 20\n" * 100,
    "MAC addresses": "00:1a:2b:3c:4d:5e\n" * 50,
    "dates": "2026-01-31 12:00:05\n" * 50,
    "UUIDs": "0a0525f3-cd50-2a71-4705-c97ca87930cc\n" * 50,
    "floats": "0.718209,604.182408,-0.723621\n" * 50,
}


@pytest.mark.parametrize("name", NOTHING)
def test_a_text_without_frames_is_refused_with_the_known_forms(name: str) -> None:
    with pytest.raises(FteSniffError, match=r"no frames found in [\d,]+ lines, in any form"):
        rows_of(NOTHING[name].encode())


@pytest.mark.parametrize("separator", ["", " "])
def test_random_hex_is_refused_as_chance(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "random.hex"
    data, text = random.Random(1).randbytes(1_500_000), ""
    for at in range(0, len(data), 32):
        text += f"{data[at : at + 32].hex(separator) if separator else data[at : at + 32].hex()}\n"
    path.write_text(text)
    with pytest.raises(FteSniffError, match=r"no frames found in [\d,]+ lines, in any form"):
        list(rows_of_log(LogReader(str(path)), lambda note: None))
    name = "hex pairs" if separator else "hex digits"
    rows = [
        row
        for rows in rows_of_log(LogReader(str(path), LogOptions(form=name)), lambda note: None)
        for row in rows
    ]
    assert b"".join(row.raw for row in rows) == data
    assert sum(row.framed and not row.faults for row in rows) <= 3


def test_plain_hex_whose_first_bytes_are_not_frames_is_read(tmp_path: Path) -> None:
    data = bytes(5000) + frame_of(KINDS[1], random.Random(1)) * 2000
    path = tmp_path / "idle.hex"
    path.write_text(data.hex(" "))
    rows = [row for rows in rows_of_log(LogReader(str(path)), lambda note: None) for row in rows]
    assert b"".join(row.raw for row in rows) == data
    assert sum(row.framed for row in rows) >= 1999


def test_an_empty_and_a_binary_file_are_refused() -> None:
    with pytest.raises(FteSniffError, match="is empty"):
        rows_of(b"")
    with pytest.raises(FteSniffError, match="holds no text; if it holds raw bytes"):
        rows_of(random.Random(1).randbytes(4000))


def test_a_form_and_a_regular_expression_locate_the_bytes() -> None:
    a = frame_of(KINDS[1], random.Random(1))
    text = f"12:00:01.5|host|{a.hex(' ')}|99\n" * 3
    pattern = re.compile(r"(?P<time>[^|]+)\|(?P<dir>\w+)\|(?P<data>[^|]+)")
    rows, _ = rows_of(text.encode(), LogOptions(pattern=pattern))
    assert [row.raw for row in rows] == [a] * 3
    assert all(row.t_ns for row in rows)
    pattern = re.compile(r"(?P<dir>\w+). (?P<data>.*)")
    rows, _ = rows_of(
        f"[1] 收： {a.hex(' ')}\n[2] 收： {a.hex()}\n".encode(), LogOptions(pattern=pattern)
    )
    assert [row.raw for row in rows] == [a] * 2
    with pytest.raises(FteSniffError, match="--input-regex matches none of 3 lines"):
        rows_of(text.encode(), LogOptions(pattern=re.compile("no (?P<data>.*)")))
    rows, _ = rows_of(b"x: 55 01 13 37\n" * 9, LogOptions(pattern=re.compile("x: (?P<data>.*)")))
    assert sum(len(row.raw) for row in rows) == 36
    with pytest.raises(FteSniffError, match="unknown form 'hexpairs'"):
        rows_of(text.encode(), LogOptions(form="hexpairs"))
    rows, _ = rows_of(text.encode(), LogOptions(form="hex pairs, spaces"))
    assert [row.raw for row in rows] == [a] * 3


@pytest.mark.parametrize(("base", "form"), [("o", "{:06o}"), ("o", "{:04x}"), ("x", "{:04x}")])
def test_the_byte_that_fills_the_last_word_of_a_dump_is_not_data(base: str, form: str) -> None:
    data = b"".join(sent.data for sent in a_log(2)) + b"\xaa\x01\x01"
    words = [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]
    lines = [
        f"{2 * at:07{base}} {' '.join(map(form.format, words[at : at + 8]))}"
        for at in range(0, len(words), 8)
    ]
    rows, _ = rows_of("\n".join([*lines, f"{len(data):07{base}}", ""]).encode())
    assert b"".join(row.raw for row in rows) == data


def test_no_frame_goes_on_where_a_dump_leaves_out_lines() -> None:
    lines = LAYOUTS["hexdump -C"](a_log(2)).splitlines()
    rows, _ = rows_of("\n".join([*lines[:3], "*", *lines[3:]]).encode())
    starts = [row.offset for row in rows]
    assert 48 in starts, "the gap is a boundary between rows"


def test_lines_that_a_dump_leaves_out_are_reported() -> None:
    lines = LAYOUTS["hexdump -C"](a_log(2)).splitlines()
    _, notes = rows_of("\n".join([*lines[:6], "*", *lines[6:]]).encode())
    assert "log.txt: line 7 leaves out bytes: '*'" in notes


def test_lines_around_a_very_long_one_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fte_sniff.formats.logs.text.LONGEST_LINE", 3000)
    monkeypatch.setattr("fte_sniff.formats.logs.text.BLOCK_BYTES", 1000)
    one = frame_of(KINDS[1], random.Random(1)).hex(" ")
    for after in (0, 1, 100):
        content = f"x: {one}\n" * 100 + f"x: {one} " * 500 + "\n" + f"x: {one}\n" * after
        rows, notes = rows_of(content.encode())
        assert len(rows) == 100 + after
        assert any("line 101 exceeds" in note for note in notes)


@pytest.mark.parametrize("name", ["Saleae 2", "two columns"])
def test_two_channels_of_an_analyser_are_two_ports(name: str) -> None:
    log = a_log(1)
    rows, _ = rows_of(LAYOUTS[name](log).encode())
    bytes_of = {
        port: b"".join(row.raw for row in rows if row.port == port)
        for port in sorted({row.port for row in rows})
    }
    sent = {way: b"".join(one.data for one in log if one.way == way) for way in WAYS}
    assert sorted(bytes_of.values()) == sorted(sent.values())
    assert len(bytes_of) == 2
    times = [row.t_ns for row in rows if row.t_ns is not None]
    assert len(times) == len(rows)
    assert times == sorted(times)


@pytest.mark.parametrize("foreign", ["0x3ffb4280", "port opened"])
def test_an_arrow_behind_a_prefix_is_not_part_of_plain_hex(foreign: str) -> None:
    log = a_log(0)
    arrow = {"tx": "-->", "rx": "<--"}
    lines = [f"[] {arrow[one.way]} {' '.join(f'${b:02X}' for b in one.data)}" for one in log]
    rows, _ = rows_of("\n".join([*lines[:9], foreign, *lines[9:]]).encode())
    assert found_in(rows) == frames_of(log)
    assert sum(len(row.raw) for row in rows) == sum(len(one.data) for one in log)


RECORDS = {
    "JSON": '{{"t": {seconds}, "dir": "{way}", "hex": "{digits}"}}',
    "JSON, the bytes first": '{{"hex":"{digits}","dir":"{way}","time":"2026-01-31T{clock}"}}',
    "XML": '<frame time="2026-01-31 {clock}" way="{way}">{pairs}</frame>',
    "text": "[2026-01-31 {clock}] {way}: {pairs};",
    "base64": '{{"time":"2026-01-31T{clock}","{way}":"{base64}"}}',
}


@pytest.mark.parametrize(("name", "between"), crossed([*RECORDS], [", ", ",", " "]))
def test_records_in_one_line_are_as_in_lines_of_their_own(name: str, between: str) -> None:
    records = [
        RECORDS[name].format(
            seconds=1769817600 + one.ms / 1000,
            clock=clock(one.ms),
            way=one.way,
            digits=one.data.hex(),
            pairs=one.data.hex(" "),
            base64=b64encode(one.data).decode(),
        )
        for one in a_log(seed=4, frames=400)
    ]
    one_line, lines = (rows_of(joint.join(records).encode()) for joint in (between, "\n"))
    assert len(lines[0]) == 400
    assert one_line == lines


@pytest.mark.parametrize(
    ("before", "frame", "frames"),
    [("dump: ", "{data}", 2200), ('{"port": "COM3", "frames": [', '"{data}"', 300)],
)
def test_many_frames_in_one_line_are_all_read(before: str, frame: str, frames: int) -> None:
    log = [one.data for one in a_log(seed=2, frames=frames)]
    texts = ", ".join(frame.format(data=data.hex(" ").upper()) for data in log)
    rows, notes = rows_of(f"{before}{texts}]\n".encode())
    assert [row.raw for row in rows] == log
    assert not [note for note in notes if "looks like bytes" in note]


@pytest.mark.parametrize("separator", [",", " ", ";"])
@pytest.mark.parametrize("form", ["{number}{separator}{data}", "{data}{separator}{number}"])
def test_a_counter_beside_decimal_bytes_is_never_one_of_them(form: str, separator: str) -> None:
    log = a_log(seed=2, frames=1200)
    text = "".join(
        form.format(number=at, separator=separator, data=separator.join(map(str, one.data))) + "\n"
        for at, one in enumerate(log)
    )
    foreign = "[main] loop 1234 us" if separator == " " else "12 34 56"
    rows, notes = rows_of(f"{text}{foreign}\n".encode())
    assert [row.raw for row in rows] == [one.data for one in log]
    assert not [note for note in notes if "looks like bytes" in note]


def test_an_address_is_not_reported_as_bytes_and_other_bytes_are_shown() -> None:
    dump = "".join(f"{at * 10:08x}: {one.data.hex(' ')}\n" for at, one in enumerate(a_log(seed=2)))
    assert rows_of(dump.encode())[1] == []
    _, notes = rows_of((dump + "sensor raw: 01 02 03 04 05\n").encode())
    assert len(notes) == 2
    assert "is not read: '01 02 03 04 05'" in notes[0]


C, R = "AA 01 01 03 E8 00 00 00 00 EE", "55 01 01 03 E8 00 00 00 0F EE"


@pytest.mark.parametrize(
    "form",
    [
        "10:00:00.{n};{C};{R}",
        "10:00:00.{n} TX: {C}; RX: {R}",
        "<t>10:00:00.{n}</t><tx>{C}</tx><rx>{R}</rx>",
        '{{"t":"10:00:00.{n}","msgs":[{{"tx":"{C}"}},{{"rx":"{R}"}}]}}',
        "10:00:00.{n} [TX] ({C}) [RX] ({R})",
        "Time,TX,RX\n10:00:00.{n},{C},{R}",
    ],
)
def test_one_time_is_that_of_all_bytes_of_its_line(form: str) -> None:
    rows, _ = rows_of("\n".join(form.format(n=n, C=C, R=R) for n in range(8)).encode())
    assert [row.raw.hex(" ").upper() for row in rows] == [C, R] * 8
    assert [(row.t_ns or 0) // 10**8 % 10 for row in rows] == [n for n in range(8) for _ in "CR"]
    assert len({row.port for row in rows}) == 2


def test_a_number_is_left_out_only_in_the_lane_that_has_it() -> None:
    rows, _ = rows_of((f"TX: 0A {C}\nRX: {R}\nRX: {R}\n" * 9).encode())
    assert [row.raw.hex(" ").upper() for row in rows] == [C, R, R] * 9
