"""Layouts in which something else looks like the bytes, the direction or the time of a line."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import date
from io import BytesIO, StringIO
from string import ascii_lowercase

import pytest

from fte_sniff.errors import FteSniffError, InputTextError
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.formats.writers import CsvWriter
from fte_sniff.protocol import HEADERS, Direction, Row
from tests.formats.logs.layouts import Layout, Sent, clock, line, shown, spaced
from tests.formats.logs.test_layouts import a_log, found_in, frames_of, rows_of
from tests.slow import first

BYTE_MS = 0.087
DAY_MS = 86_400_000
RANDOM = random.Random(3)
NAMES = ["".join(RANDOM.choices(ascii_lowercase, k=RANDOM.randint(3, 9))) for _ in range(500)]


def character(byte: int) -> str:
    return shown(bytes([byte])).replace(" ", ".")


def bytewise(form: str, decode: Callable[[int], str] = character) -> Layout:
    """A line for each byte, with its character."""

    def layout(log: Sequence[Sent]) -> str:
        return "".join(
            form.format(
                n=at,
                b=byte,
                c=decode(byte),
                TX=one.way.upper(),
                since=one.ms / 1000 - 43000 + at * BYTE_MS / 1000,
            )
            + "\n"
            for one in log
            for at, byte in enumerate(one.data)
        )

    return layout


def with_names(form: str) -> Layout:
    """A line for each frame, with names that are different in most lines."""

    def layout(log: Sequence[Sent]) -> str:
        return "".join(
            form.format(
                t=clock(one.ms),
                TX=one.way.upper(),
                spaced=spaced(one.data),
                hex=one.data.hex(),
                name=NAMES[at * 7 % 500],
                other=NAMES[at * 11 % 500],
                us=at * 13 % 977,
                small=at % 7,
            )
            + "\n"
            for at, one in enumerate(log)
        )

    return layout


def latin(byte: int) -> str:
    return chr(byte) if 0x20 <= byte < 0x7F or byte > 0xA0 else "."


CHARACTERS = {
    "decimal in brackets": bytewise("Recv: {c} ({b})", latin),
    "decimal in brackets, both ways": bytewise("{TX}: {c} ({b})"),
    "hex in brackets": bytewise("Recv: {c} ({b:02X})"),
    "hex before": bytewise("{b:02X} {c}"),
    "0x before": bytewise("got 0x{b:02x} '{c}'"),
    "decimal and 0x": bytewise("byte {b} 0x{b:02X}"),
    "tabs": bytewise("{b}\t{b:02X}\t{c}"),
    "assembler": bytewise("{b:02X}h {b:3d} {c}"),
    "index": bytewise("rx[{n}] = {c} = 0x{b:02X}"),
    "Arduino": bytewise("{c}, dec: {b}, hex: {b:X}, oct: {b:o}, bin: {b:b}"),
    "CSV": bytewise("{since:.6f},{TX},{c},0x{b:02X}"),
    "index and decimal": bytewise("{n}: {c} {b}"),
}
NAMED = {
    "in brackets": with_names("{t} [{name}] {TX}: {spaced}"),
    "before a colon": with_names("{t} {name}: {spaced}"),
    "two names": with_names("{name} {other} {TX} {hex}"),
    "foreign lines": with_names(
        "{t} [{name}] {TX}: {spaced}\n{t} [{other}] {name} took {us} us and {small} ms"
    ),
    "threads": with_names("2024-03-05 {t} [pool-{small}] DEBUG c.a.{name} - {TX} {spaced}"),
}
TWICE = {
    "two names": line("[{t}] {TX} raw={lower} payload={lower}"),
    "JSON": line('{{"t": {ms}, "received": "{hex}", "sent_on": "{hex}"}}'),
    "JSON with a direction": line('{{"dir": "{tx}", "request": "{lower}", "data": "{lower}"}}'),
    "two forms": line("{tx} {spaced} {json}"),
    "copied": line("read {lower} wrote {lower} to queue"),
    "XML": line("<f><in>{lower}</in><out>{lower}</out></f>"),
    "two cases": line("{tx}: {lower} | input {spaced}"),
}


@pytest.mark.parametrize("seed", first(1, [1, 0, 2]))
@pytest.mark.parametrize("name", CHARACTERS)
def test_a_character_beside_a_byte_is_not_a_byte(name: str, seed: int) -> None:
    log = a_log(seed, 60 if seed < 2 else 400)
    rows, _ = rows_of(CHARACTERS[name](log).encode())
    assert found_in(rows) == frames_of(log)


@pytest.mark.parametrize("seed", first(1, [1, 0, 2]))
@pytest.mark.parametrize("name", NAMED)
def test_lines_with_names_that_no_other_has_are_read(name: str, seed: int) -> None:
    log = a_log(seed, 60 if seed < 2 else 400)
    rows, notes = rows_of(NAMED[name](log).encode())
    assert found_in(rows) == frames_of(log)
    assert not any("is not read" in note for note in notes)


def test_numbers_that_are_as_good_as_the_bytes_are_reported() -> None:
    log = a_log(1, 60)
    text = bytewise("byte = {c}, {b}, 0x{b:02X}")(log)
    with pytest.raises(InputTextError, match="two readings are as good"):
        rows_of(text.encode())


@pytest.mark.parametrize("seed", first(1, [1, 0, 2]))
@pytest.mark.parametrize("name", TWICE)
def test_bytes_that_a_record_has_twice_are_read_once(name: str, seed: int) -> None:
    log = a_log(seed, 60)
    rows, notes = rows_of(TWICE[name](log).encode())
    assert found_in(rows) == frames_of(log)
    assert not any("other way" in note for note in notes)


@pytest.mark.parametrize(
    "form",
    [
        "Mar  5 {s} host fte[12]: {spaced}",
        "{t} Writing to log: {spaced}",
        "pc/uart {t} data {spaced}",
        "{t} controller.cpp:42 {spaced}",
        "{t} input.c: {spaced}",
        "{t} RX {spaced}",
        "{t} > {spaced}",
        "<tr><td>{t}</td><td>{spaced}</td></tr>",
        '<log t="{t}"><d>{spaced}</d></log>',
        "<data/>{spaced}<data>",
    ],
)
def test_a_lone_word_that_frames_contradict_is_not_a_direction(form: str) -> None:
    log = a_log(0, 60)
    rows, notes = rows_of(line(form)(log).encode())
    assert found_in(rows) == frames_of(log)
    assert {row.port for row in rows} == {"log.txt"}
    assert not any("other way" in note for note in notes)


@pytest.mark.parametrize(("swapped", "words"), [(True, "are swapped"), (False, "no direction")])
def test_wires_are_swapped_only_if_both_directions_agree(swapped: bool, words: str) -> None:
    ways = {"tx": "RX", "rx": "TX"} if swapped else {"tx": "RX", "rx": "RX"}
    log = a_log(0, 60)
    text = "".join(f"{ways[one.way]}: {one.data.hex(' ')}\n" for one in log)
    if not swapped:
        text = f"TX: {log[0].data.hex(' ')}\n" * 9 + text
    _, notes = rows_of(text.encode())
    assert any("go the other way" in note and words in note for note in notes)


TIMES = {
    "milliseconds after a space": "{s} {f} {TX} {spaced}",
    "the same with a date": "2024-03-05 {s} {f} {TX}: {spaced}",
    "the same in brackets": "[{s} {f}] {spaced}",
    "the same with a unit": "{s} {f}ms {spaced}",
    "a counter after a time": "{t} {k} {tx} {spaced}",
    "seconds and microseconds since 1970": "2024-03-05 {s} {unix:.6f} {tx} {spaced}",
    "seconds, and a clock": "2024-03-05 {s} {t} {tx} {spaced}",
    "a finer one after the bytes": "2024-03-05 {s} {tx} {spaced} @{t}",
    "JSON in a line of a logger": '{s} INFO {{"ts": {unix_ms}, "{tx}": "{hex}"}}',
    "below": "{tx}: {spaced}\n  at {t}\n",
    "below, without a blank line": "{tx}: {spaced}\n[{t}]",
    "below, with a rule": "{tx}\n{spaced}\n2024-03-05 {t}\n---------",
    "last in JSON": ' {{\n  "dir": "{tx}",\n  "data": "{hex}",\n  "time": "2024-03-05T{t}Z"\n }},',
    "last in YAML": "- dir: {tx}\n  hex: {lower}\n  time: 2024-03-05T{t}",
    "above": "{t}\n{tx}: {spaced}",
    "above, with a blank line": "at {t}\n{tx}: {spaced}\n",
}
SINCE = {
    "seconds since a start": "[{s}] [{since:>12}] {tx} {spaced}",
    "milliseconds since a start": "{s} +{since_ms}ms {tx} {spaced}",
}


def timed(form: str, log: Sequence[Sent]) -> str:
    return "".join(
        form.format(
            s=clock(one.ms, 0),
            t=clock(one.ms),
            f=f"{one.ms % 1000:03}",
            k=100 + at,
            tx=one.way,
            TX=one.way.upper(),
            spaced=spaced(one.data),
            lower=one.data.hex(" "),
            hex=one.data.hex(),
            unix=1_709_596_800 + one.ms / 1000,
            unix_ms=1_709_596_800_000 + one.ms,
            since=f"{one.ms / 1000 - 43000:.6f}",
            since_ms=one.ms - 43_000_000,
        )
        + "\n"
        for at, one in enumerate(log)
    )


def errors_ms(log: Sequence[Sent], rows: Sequence[Row]) -> list[float]:
    """By how much the times of frames are later than those of the lines where they begin."""
    errors = []
    for way, direction in (("tx", Direction.CONTROL), ("rx", Direction.FEEDBACK)):
        lines = [one for one in log if one.way == way]
        begins = [one.ms for one in lines for byte in one.data if byte is not None]
        own = [row for row in rows if row.framed and row.raw[0] == HEADERS[direction]]
        errors += [(row.t_ns or 0) / 1e6 % DAY_MS - begins[row.offset] for row in own]
    return errors


@pytest.mark.parametrize("seed", first(1, [0, 2, 4]))
@pytest.mark.parametrize("name", TIMES)
def test_the_finest_time_of_a_record_is_that_of_its_bytes(name: str, seed: int) -> None:
    log = [one._replace(way="tx") for one in a_log(seed, 60)]
    log = [one for one in log if one.data[0] == HEADERS[Direction.CONTROL]]
    rows, _ = rows_of(timed(TIMES[name], log).encode(), LogOptions(day=date(2024, 3, 5)))
    assert len(rows) == len(log)
    assert {(row.t_ns or 0) // (DAY_MS * 10**6) for row in rows} == {19787}
    assert max(map(abs, errors_ms(log, rows))) <= 1.1


@pytest.mark.parametrize("name", SINCE)
def test_a_coarse_time_shows_what_a_fine_one_counts_from(name: str) -> None:
    log = [one._replace(way="tx") for one in a_log(0, 60)]
    log = [one for one in log if one.data[0] == HEADERS[Direction.CONTROL]]
    rows, _ = rows_of(timed(SINCE[name], log).encode(), LogOptions(day=date(2024, 3, 5)))
    errors = errors_ms(log, rows)
    assert max(errors) - min(errors) <= 1.1
    assert max(map(abs, errors)) <= 1001, "the coarse time has whole seconds"


def test_times_below_bytes_hold_across_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fte_sniff.formats.logs.text.BLOCK_BYTES", 1000)
    log = [one._replace(way="tx") for one in a_log(0, 400)]
    log = [one for one in log if one.data[0] == HEADERS[Direction.CONTROL]]
    rows, _ = rows_of(timed(TIMES["below"], log).encode(), LogOptions(day=date(2024, 3, 5)))
    assert [row.raw for row in rows] == [one.data for one in log]
    assert max(map(abs, errors_ms(log, rows))) <= 1.1


@pytest.mark.parametrize(("frames", "others", "share"), [(60, 600, "8%"), (4000, 2000, "62%")])
def test_few_frames_after_a_sample_are_reported(frames: int, others: int, share: str) -> None:
    text = "".join(f"RX: {one.data.hex(' ')}\n" for one in a_log(0, frames))
    other = "RX: 01 02 03 04 05 06 07 08 09 10 11 12\n" * others
    _, notes = rows_of((text + other).encode())
    assert [note for note in notes if f"log.txt: only {share} of the bytes read are in" in note]
    _, notes = rows_of(text.encode())
    assert not any("in frames" in note for note in notes)


def explained(content: bytes) -> list[str]:
    lines, reader = list[str](), LogReader("log.txt", None, BytesIO(content))
    with suppress(FteSniffError):
        lines.extend(reader.explain())
    return lines


def test_rows_of_the_program_are_explained_as_such() -> None:
    written = StringIO()
    CsvWriter(written).write([Row("p", 0, bytes.fromhex(CONTROL), 0)])
    assert explained(written.getvalue().encode()) == ["rows that fte-sniff wrote as CSV"]


def test_an_explanation_marks_bytes_and_time_of_two_lines() -> None:
    text = (
        f"[2026-01-31 12:00:01.5] TX: {CONTROL}\n" * 9
        + f"[2026-01-31 12:00:02.5] RX: {FEEDBACK}\n" * 9
    )
    shown = explained(text.encode())
    assert f"for example [>>2026-01-31 12:00:01.5<<] TX: >>{CONTROL}<<" in shown
    assert f"    bytes {CONTROL}, time 2026-01-31T12:00:01.500000000Z, stream tx" in shown
    assert f"    bytes {FEEDBACK}, time 2026-01-31T12:00:02.500000000Z, stream rx" in shown


def test_an_explanation_of_a_line_of_many_frames_is_short() -> None:
    shown = explained(f"dump: {', '.join([CONTROL] * 200)}\n".encode())
    (example,) = [line for line in shown if line.startswith("for example dump: ")]
    assert example.count(f">>{CONTROL}<<") == 4
    assert len(example) < 400
    assert len(shown) < 30


CONTROL = "AA 01 01 03 E8 00 00 00 00 EE"
FEEDBACK = "55 01 01 03 E8 00 00 00 0F EE"


@pytest.mark.parametrize(
    ("content", "advice"),
    [
        (b"10, 20, 30, 170, 1, 1, 0\n" * 40, '--form "decimal, commas" reads them anyway'),
        (b"".join(b"%02X\n" % (at * 7 % 256) for at in range(400)), '--form "hex pairs, spaces"'),
        (
            b"".join(b"%d,%02X\n" % (at, at % 256) for at in range(400)),
            '--form "hex pairs, spaces"',
        ),
        (b"12:00:00 data " + bytes.fromhex(CONTROL) + b"\n", "holds no text"),
        ((b"12:00:00 rx data " + bytes.fromhex(CONTROL) + b"\n") * 40, "as characters among text"),
        (b"12:00:00 rx \xef\xbf\xbd\1\xef\xbf\xbd\n" * 40, "so they are lost"),
        (b"It was the best of times\n" * 40, "the most byte-like line is"),
    ],
)
def test_the_advice_for_a_refused_log_fits_what_is_in_it(content: bytes, advice: str) -> None:
    with pytest.raises(FteSniffError) as refused:
        rows_of(content)
    assert advice in str(refused.value)


def test_an_explanation_of_a_refused_log_shows_the_candidates_and_why_they_lost() -> None:
    shown = explained(b"10, 20, 30, 170, 1, 1, 0\n" * 40)
    assert (
        shown[0] == 'candidate 1: "decimal, commas", 280 bytes in 1 lane, 0 frames: no whole frame'
    )
    assert len(shown) == 3
    equal = explained(bytewise("byte = {c}, {b}, 0x{b:02X}")(a_log(1, 60)).encode())
    assert sum(line.endswith("it is as good as another") for line in equal) >= 2


def sigrok_trace(log: Sequence[Sent]) -> str:
    """What sigrok-cli writes with --protocol-decoder-jsontrace."""
    events = [
        f'{{"ph": "{ph}", "ts": {us}.000000, "pid": "uart-1", "tid": "{one.way.upper()}",'
        f' "name": "{byte:02X}"}}'
        for one in log
        for at, byte in enumerate(one.data)
        for ph, us in zip(
            "BE", ((one.ms - 43_199_000) * 1000 + at * 87 + end for end in (0, 70)), strict=True
        )
    ]
    return '{"traceEvents": [\n' + ",\n".join(events) + "\n]}\n"


def test_begin_and_end_of_a_byte_in_a_trace_of_sigrok_are_one_byte() -> None:
    log = a_log(0, 400)
    rows, _ = rows_of(sigrok_trace(log).encode(), LogOptions(start_ns=10**18))
    assert found_in(rows) == frames_of(log)
    for row in rows:
        at = [one.ms for one in log if one.data == row.raw]
        assert any(abs((row.t_ns or 0) - 10**18 - (ms - 43_199_000) * 10**6) < 10**5 for ms in at)


@pytest.mark.parametrize("rate", [1_000_000, 24_000_000])
def test_sample_numbers_are_times_by_the_samplerate(rate: int) -> None:
    log = a_log(0, 60)
    text = "".join(
        f"{begin}-{begin + 70 * rate // 10**6} uart-1: {byte:02X}\n"
        for one in log
        for at, byte in enumerate(one.data)
        for begin in [((one.ms - 43_199_000) * 1000 + at * 87) * rate // 10**6]
    )
    rows, _ = rows_of(text.encode(), LogOptions(start_ns=10**18, samplerate=rate))
    begins = [(one.ms - 43_199_000) * 10**6 for one in log]
    assert [row.raw for row in rows] == [one.data for one in log]
    times = zip(rows, begins, strict=True)
    assert all(abs((row.t_ns or 0) - 10**18 - begin) < 10**5 for row, begin in times)


def of_both_wires(log: Sequence[Sent]) -> list[tuple[int, int]]:
    """Microseconds and value of each byte; feedback begins with the control frame before it."""
    sent, before = list[tuple[int, int]](), log[0]
    for one in log:
        ms = before.ms if (one.way, before.way) == ("rx", "tx") else one.ms
        us = (ms - 43_199_000) * 1000 + (5 if one.way == "rx" else 0)
        sent += [(us + at * 87, byte) for at, byte in enumerate(one.data)]
        before = one
    return sorted(sent)


@pytest.mark.parametrize("seed", first(2, [0, 1, 2, 4, 5, 6]))
@pytest.mark.parametrize("form", ["uart-1: {b:02X}", "{us}-{end} uart-1: {b:02X}"])
def test_frames_separate_the_bytes_of_two_wires_in_turn(form: str, seed: int) -> None:
    log = a_log(seed, 300)
    sent = of_both_wires(log)
    text = "".join(form.format(us=us, end=us + 70, b=byte) + "\n" for us, byte in sent)
    rows, notes = rows_of(text.encode(), LogOptions(start_ns=10**18))
    assert found_in(rows) == frames_of(log)
    assert {row.port for row in rows} == {"log.txt:rx", "log.txt:tx"}
    assert any("of two wires" in note for note in notes)
    at_once = [row.t_ns for row in rows if row.port == "log.txt:tx"]
    assert at_once == sorted(at_once, key=lambda ns: ns or 0)


def test_random_bytes_are_not_those_of_two_wires() -> None:
    data = random.Random(1).randbytes(3000) + bytes.fromhex(CONTROL)
    with pytest.raises(FteSniffError, match="no frames found"):
        rows_of("".join(f"uart-1: {byte:02X}\n" for byte in data).encode())
