"""The explanation of a row; its readings, against an enumeration of all segmentations."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import (
    HEADERS,
    KINDS,
    TAIL,
    Chunk,
    Damage,
    Fault,
    Frame,
    FrameKind,
    Framer,
    LineErrorMarker,
    Row,
    Rows,
    encode,
    spaced_hex,
)
from fte_sniff.protocol.dissect import (
    LONGEST,
    ExplainedField,
    Readings,
    SpanReader,
    SpanSegment,
    dissect,
    explain,
    explain_readings,
    is_doubtful,
    ranges_text,
    readings,
    with_readings,
)
from fte_sniff.protocol.framer.decoder import (
    after_certain_frame,
    after_silence,
    at_stream_start,
    in_long_noise,
)
from fte_sniff.protocol.framer.model import BOUNDARY, CLOSED, KNOWN, OPEN
from fte_sniff.protocol.rows import Reading
from fte_sniff.protocol.spec import FTE_FORMAT
from tests.examples import examples
from tests.protocol.framer.test_decoder import EXAMPLE, FRAME, PAGE
from tests.protocol.oracle import IS_HEADER, LINES, Oracle, frame_faults, noise_score
from tests.protocol.streams import imitating, raw_bytes, rows_of
from tests.support.columns import in_columns
from tests.support.faults import damaged_stream

BESIDE_THE_BYTES = {Fault.AMBIGUOUS, Fault.LINE_ERROR}
"""Faults that no byte of the row shows."""
TEXT, NO_TIME, BYTES = st.text(max_size=3), st.none(), st.binary(min_size=1, max_size=20)
FAULTS = st.lists(st.sampled_from(Fault), unique=True).map(tuple)
FRAMED = st.builds(
    lambda header, payload: bytes([header, *payload, TAIL]),
    st.sampled_from(list(HEADERS.values())),
    st.binary(min_size=8, max_size=8),
)


def frame(text: str) -> list[ExplainedField]:
    raw = bytes.fromhex(text)
    return dissect(Frame("p", 0, raw, None, frame_faults(raw)))


def damage(text: str, fault: Fault) -> list[ExplainedField]:
    return dissect(Damage("p", 0, bytes.fromhex(text), None, (fault,)))


def named(fields: list[ExplainedField], name: str) -> ExplainedField:
    (field,) = [field for field in fields if field.name == name]
    return field


@given(st.integers(0, 10_000), st.sampled_from(["ordinary", "hostile"]))
def test_each_byte_is_in_exactly_one_field(seed: int, payload: str) -> None:
    stream, _ = damaged_stream(seed, 12, 0.6, payload)
    framer = Framer("p")
    for row in framer.feed(Chunk("p", None, stream)) + framer.flush():
        fields = dissect(row)
        assert [offset for field in fields for offset in field.offsets] == list(range(len(row.raw)))
        for field in fields:
            assert field.raw == row.raw[field.offsets.start : field.offsets.stop]
        assert len(explain(row)) == len(row.faults)
        if isinstance(row, Damage):
            assert not any(field.value for field in fields)


def test_a_position_frame_field_by_field() -> None:
    fields = frame("AA 02 02 03 E8 00 00 27 10 EE")
    assert [(field.name, field.value) for field in fields] == [
        ("header", "control"),
        ("cmd", "2"),
        ("motor", "2"),
        ("rpm", "1000 RPM"),
        ("pulses", "10000 pulses"),
        ("tail", ""),
    ]


@pytest.mark.parametrize(
    ("text", "fault", "meanings"),
    [
        (
            "AA 01 02 03 E8 00 00 00 00 EF",
            Fault.BAD_TAIL,
            ["CMD: speed", "motor (driver) number", "target speed", "reserve", "tail"],
        ),
        ("AB 01 02 03 E8 00 00 00 00 EE", Fault.BAD_HEADER, ["CMD", "NUM", "not decoded", "tail"]),
        ("AA 77 02 03 E8 00 00 00 00 EF", Fault.BAD_TAIL, ["CMD", "NUM", "not decoded", "tail"]),
    ],
)
def test_a_frame_with_one_wrong_end_is_explained_as_far_as_it_is_known(
    text: str, fault: Fault, meanings: list[str]
) -> None:
    fields = damage(text, fault)
    assert [field.meaning for field in fields[1:]] == meanings
    assert [field.name for field in fields if field.fault] == [fault.value.removeprefix("bad_")]


def test_unused_bytes_are_distinguished() -> None:
    fields = frame("AA 00 07 00 00 00 00 00 00 EE")
    assert [(field.name, list(field.offsets)) for field in fields[2:4]] == [
        ("num", [2]),
        ("reserve", [3, 4, 5, 6, 7, 8]),
    ]


def test_flags_bit_by_bit_claim_no_more_than_is_known() -> None:
    fields = frame("55 01 01 03 E8 00 00 03 1D EE")
    error, online = named(fields, "error"), named(fields, "online")
    assert [bit.is_set for bit in error.bits] == [True, True] + [False] * 6
    assert all("unknown" in bit.meaning for bit in error.bits[:4])
    assert [bit.meaning.partition(" (")[0] for bit in online.bits[:4]] == [
        "motor 1 online",
        "motor 2 not online",
        "motor 3 online",
        "motor 4 online",
    ]
    assert all("assumption" in bit.meaning for bit in online.bits[:4])
    assert [bit.number for bit in online.bits if bit.is_set] == [0, 2, 3, 4]
    assert [bit.number for bit in online.bits if bit.is_raised] == [1, 4]
    assert {bit.meaning for bit in online.bits[4:]} == {"undefined"}
    assert online.fault is Fault.UNDEFINED_FLAGS


@pytest.mark.parametrize(
    ("text", "field", "fault", "note"),
    [
        ("AA 09 01 03 E8 00 00 27 10 EE", "cmd", Fault.UNKNOWN_CMD, "no CMD 09"),
        ("AA 02 00 03 E8 00 00 27 10 EE", "motor", Fault.BAD_MOTOR, "expected 1..4, found 0"),
        ("AA 01 01 03 E8 00 05 00 00 EE", "reserve", Fault.RESERVED_NONZERO, "found 00 05"),
    ],
)
def test_a_fault_in_a_frame_is_at_its_byte(text: str, field: str, fault: Fault, note: str) -> None:
    found = named(frame(text), field)
    assert found.fault is fault
    assert note in found.note


@pytest.mark.parametrize(
    ("text", "faults", "meaning", "note"),
    [
        ("AA 00 00 00 00 00 00 00 00 EE", (), "the protocol states no value", ""),
        ("AA 01 01 03 E8 FF FF FF FF EE", (), "the protocol states no value", ""),
        (
            "AA 01 01 03 E8 00 00 00 05 EE",
            (Fault.RESERVED_NONZERO,),
            "the protocol states no value",
            "expected 00 00 00 00 as on the rest of this line, found 00 00 00 05",
        ),
        ("55 01 01 03 E8 00 00 00 0F EE", (), "the protocol shows 00", ""),
        (
            "55 01 01 03 E8 00 01 00 0F EE",
            (Fault.RESERVED_NONZERO,),
            "the protocol shows 00",
            "expected 00 00 as in the protocol, found 00 01",
        ),
    ],
)
def test_the_reserve_is_explained_by_what_the_document_states(
    text: str, faults: tuple[Fault, ...], meaning: str, note: str
) -> None:
    row = Frame("p", 0, bytes.fromhex(text), None, faults)
    reserve = named(dissect(row), "reserve")
    assert meaning in reserve.meaning
    for line in explain(row):
        assert ("rest of this line" in line) == ("states no value" in meaning)
        assert ("which the protocol shows" in line) == ("protocol shows" in meaning)
    assert (reserve.fault, reserve.note) == (faults[0] if faults else None, note)


@pytest.mark.parametrize("speed", ["00 00", "00 0A", "FF F6", "00 EE", "80 00"])
def test_a_move_to_the_side_has_its_erratum_without_a_fault(speed: str) -> None:
    sideways = named(frame(f"AA 03 00 00 14 {speed} 00 00 EE"), "vy_cm_s")
    assert sideways.fault is None
    assert ("(erratum 3)" in sideways.note) == (speed != "00 00")


@pytest.mark.parametrize(
    ("text", "fault", "field", "note"),
    [
        ("AB 01 01 03 E8 00 00 00 00 EE", Fault.BAD_HEADER, "header", "AA or 55, found AB"),
        ("AA 01 01 03 E8 00 00 00 00 EF", Fault.BAD_TAIL, "tail", "expected EE, found EF"),
        ("AA B2", Fault.TRUNCATED, "payload", ""),
        ("AA", Fault.TRUNCATED, "missing", ""),
        ("AA EE", Fault.TRUNCATED, "missing", ""),
        ("AA 01 01 03 E8 00 00 12 34 00 00 EE", Fault.OVERLONG, "extra", ""),
        ("01 AA 03", Fault.NOISE, "noise", ""),
    ],
)
def test_damage_names_the_byte_at_fault(text: str, fault: Fault, field: str, note: str) -> None:
    found = named(damage(text, fault), field)
    assert found.fault is fault
    assert note in found.note


def test_missing_and_extra_bytes_are_located() -> None:
    missing = named(damage("AA 01 01 00 00 EE", Fault.TRUNCATED), "missing")
    assert (missing.offsets, missing.raw) == (range(5, 5), b"")
    assert "DATA[5] to DATA[8] missing" in missing.meaning
    extra = named(damage("AA 01 01 03 E8 00 00 12 34 00 00 EE", Fault.OVERLONG), "extra")
    assert extra.raw == b"\x12\x34"
    assert "2 bytes too many" in extra.meaning


@pytest.mark.parametrize("offset", range(2, 9))
@pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])
def test_truncated_frame_names_the_byte_that_would_continue_it(
    kind: FrameKind, offset: int
) -> None:
    whole = encode(kind, {one.name: 1 for one in kind.fields if one.legal_bits is None})
    byte = b"\x77"
    legal = FTE_FORMAT.legal_bytes(kind, dict.fromkeys(kind.open_reserve, 0))[offset]
    stream = whole * (KNOWN + 1) + whole[:offset] + byte + whole * 3
    framer = Framer("p")
    rows = [*framer.feed(Chunk("p", None, stream)), *framer.flush()]
    damaged = [(row.raw, row.faults) for row in rows if isinstance(row, Damage)]
    note = named(damage(whole[:offset].hex(), Fault.TRUNCATED), "missing").note
    if legal is None:
        assert damaged == [(whole[:offset] + byte, (Fault.TRUNCATED,))]
        assert note == ""
    else:
        assert damaged == [(whole[:offset], (Fault.TRUNCATED,)), (byte, (Fault.NOISE,))]
        is_reserve = offset in kind.open_reserve
        what = "is reserve: " if is_reserve else f"must be {ranges_text(legal)}: "
        assert note.startswith(f"DATA[{offset}] {what}")


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ([0], "00"),
        ([1, 3], "01 or 03"),
        (range(1, 5), "01-04"),
        ([0, 1, 2, 8, 10, 11], "00-02 or 08 or 0A-0B"),
    ],
)
def test_ranges_of_bytes_have_a_text(numbers: Iterable[int], text: str) -> None:
    assert ranges_text(bytes(numbers)) == text


@given(st.integers(0, 10_000), st.sampled_from(["ordinary", "hostile"]), st.booleans())
def test_the_explanation_shows_exactly_the_faults_of_the_row(
    seed: int, payload: str, line_error: bool
) -> None:
    stream, _ = damaged_stream(seed, 12, 0.6, payload)
    framer, marker = Framer("p"), LineErrorMarker()
    chunk = Chunk("p", None, stream, ((0, len(stream)),) if line_error else ())
    marker.observe(chunk)
    for row in marker.mark(in_columns(framer.feed(chunk), framer.flush())):
        shown = [field for field in dissect(row) if field.fault is not None]
        assert {field.fault for field in shown} == set(row.faults) - BESIDE_THE_BYTES
        assert all(field.note or field.meaning for field in shown if field.name != "noise")


@given(
    st.builds(Damage, TEXT, st.just(0), BYTES, NO_TIME, FAULTS)
    | st.builds(Frame, TEXT, st.just(0), FRAMED, NO_TIME, FAULTS)
)
def test_rows_of_other_programs_are_explained_by_their_faults_too(row: Row) -> None:
    fields = dissect(row)
    assert [offset for field in fields for offset in field.offsets] == list(range(len(row.raw)))
    assert {field.fault for field in fields} <= {None, *row.faults}
    assert [str(fault) for fault in row.faults] == [text.split(":")[0] for text in explain(row)]


@pytest.mark.parametrize(
    ("probability", "share"),
    [(1.0, ">99.99 %"), (0.99995, ">99.99 %"), (0.0909, "9.09 %"), (0.00004, "<0.01 %")],
)
def test_readings_are_explained_with_their_probabilities(probability: float, share: str) -> None:
    readings = (Reading("truncated AA 01 01", probability),)
    damaged = Damage("p", 0, bytes.fromhex("AA 01 01"), None, (Fault.TRUNCATED,), readings=readings)
    (reading,) = explain_readings(damaged)
    assert reading == f"probability {share}: truncated AA 01 01"


Segments = tuple[SpanSegment, ...]

EVERY = 10**9
"""More readings than a span has."""

lines = st.sampled_from(sorted(LINES)).map(LINES.__getitem__)
spans = st.one_of(
    st.lists(imitating, min_size=1, max_size=12).map(bytes),
    st.builds(
        lambda seed, cut: damaged_stream(seed, 3, 0.9, "hostile")[0][cut : cut + 13],
        st.integers(0, 10_000),
        st.integers(0, 8),
    ).filter(bool),
)
parts = st.tuples(st.floats(0, 1), st.floats(0, 1))
states = st.sampled_from([after_certain_frame, after_silence, at_stream_start, in_long_noise])


def part_of(data: bytes, part: tuple[float, float]) -> tuple[int, int]:
    """A part of the bytes that is not empty."""
    start = int(part[0] * (len(data) - 1))
    return start, start + 1 + int(part[1] * (len(data) - start - 1))


def segmentations(
    data: bytes, line: Oracle, at: int = 0, *, after_noise: bool = False
) -> Iterator[tuple[Segments, float]]:
    """Every segmentation of the bytes from `at` on, which ends between frames, with its score."""
    if at == len(data):
        yield (), 1.0
        return
    leaving = [(one.stop, False, one.score) for one in line.candidates(data, at)]
    if not after_noise:
        ends = (end for end in range(at + 1, len(data) + 1) if data[end : end + 1] in BREAKS)
        leaving += [(end, True, noise_score(end - at)) for end in ends]
    for stop, is_noise, score in leaving:
        for others, other_score in segmentations(data, line, stop, after_noise=is_noise):
            yield (SpanSegment(at, stop, is_noise), *others), score * other_score


BREAKS = (b"", *(bytes([header]) for header in IS_HEADER))


def enumerated(data: bytes, start: int, stop: int, line: Oracle) -> dict[Segments, float]:
    """The probability of each reading of some of the bytes, from all segmentations."""
    scores = defaultdict[Segments, float](float)
    for segments, score in segmentations(data, line):
        scores[tuple(one for one in segments if one.start < stop and one.stop > start)] += score
    total = sum(scores.values())
    return {reading: score / total for reading, score in scores.items()}


@examples(150)
@given(spans, parts, lines)
def test_readings_are_those_of_all_segmentations(
    data: bytes, part: tuple[float, float], line: Oracle
) -> None:
    start, stop = part_of(data, part)
    reader = SpanReader(line.tables, data, after_certain_frame(), BOUNDARY)
    found = {path.segments: path.score for path in reader.best(start, stop, EVERY)}
    expected = enumerated(data, start, stop, line)
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-12)
    first, *others = sorted(expected.values(), reverse=True)
    best = [path.score for path in reader.best(start, stop, 2)]
    assert best == pytest.approx([first, *others[:1]], rel=1e-6, abs=1e-12)


@examples(150)
@given(spans, parts, lines, states, st.sampled_from([OPEN, CLOSED, BOUNDARY]))
def test_the_probabilities_of_all_readings_add_up_to_1(
    data: bytes, part: tuple[float, float], line: Oracle, state: object, ending: int
) -> None:
    start, stop = part_of(data, part)
    reader = SpanReader(line.tables, data, state(), ending)
    found = reader.best(start, stop, EVERY)
    assert sum(path.score for path in found) == pytest.approx(1)
    own = reader.as_one_frame(start, stop)
    assert own is None or own in found


# Rows of streams


def segment_texts(reading: str) -> list[str]:
    return reading.split(" + ")


@pytest.mark.parametrize("payload", ["ordinary", "hostile"])
def test_the_first_reading_is_the_decision_of_the_framer(payload: str) -> None:
    rows = rows_of(FRAME * KNOWN + damaged_stream(3, 1500, 0.2, payload)[0])
    doubtful = [at for at, row in enumerate(rows) if is_doubtful(row.faults)]
    assert len(doubtful) > 200
    for at in doubtful:
        row, (first, *others) = rows[at], readings(rows, at)
        assert all(one.probability <= first.probability for one in others)
        digits = spaced_hex(row.raw)
        if row.faults == (Fault.NOISE,):
            names = {re.sub(" [0-9A-F]{2}.*", "", text) for text in segment_texts(first.reading)}
            assert names <= {"noise", "rest of a frame"}
        elif isinstance(row, Frame):
            assert first.reading.endswith(f" {digits}")
            assert (Fault.AMBIGUOUS in row.faults) <= (first.probability < 0.9995)
        else:
            assert first.reading == f"{row.faults[0]} {digits}"


def test_the_page_about_the_framer_shows_readings_of_its_example() -> None:
    rows = rows_of(FRAME * KNOWN + EXAMPLE + FRAME * 3)
    shown = "\n".join(
        f"{one.probability:.4f}  {one.reading}"
        for at in (KNOWN, KNOWN + 1)
        for one in readings(rows, at)
    )
    assert f"\n{shown}\n" in PAGE.read_text("utf-8")


def test_bytes_of_neighbouring_rows_are_in_brackets() -> None:
    rows = rows_of(EXAMPLE)
    other = readings(rows, 0)[1].reading
    assert other == "truncated AA 01 01 03 E8 (AA)"
    assert readings(rows, 1)[1].reading.startswith("truncated (AA 01 01 03 E8) AA + rest of")


def test_the_reserve_of_the_line_is_learned() -> None:
    frame = bytes.fromhex("AA 01 01 03 E8 12 34 56 78 EE")
    rows = rows_of(frame * 20 + frame[:8] + frame * 3)
    (learned, _), (unlearned, _) = readings(rows, 20), readings(rows[19:], 1)
    assert learned.reading == unlearned.reading == f"truncated {spaced_hex(frame[:8])}"
    assert learned.probability > unlearned.probability


def test_silence_separates_readings() -> None:
    first, second = EXAMPLE[:5], EXAMPLE[5:15]
    for pause_ns, is_joined in ((0, True), (50_000_000, False)):
        framer = Framer("p")
        rows = framer.feed(Chunk("p", 10**9, first))
        rows += framer.feed(Chunk("p", 10**9 + 10**6 + pause_ns, second)) + framer.flush()
        other = readings(rows, 0)[1].reading
        assert ("(AA)" in other) is is_joined


def test_a_gap_in_the_offsets_separates_readings() -> None:
    rows = rows_of(EXAMPLE)[:2]
    apart = [rows[0], Frame("p", 100, rows[1].raw, None, rows[1].faults)]
    assert "(AA)" in readings(rows, 0)[1].reading
    assert "(AA)" not in readings(apart, 0)[1].reading


@pytest.mark.parametrize("length", [LONGEST, LONGEST + 1, 1000])
def test_long_noise_has_no_readings(length: int) -> None:
    rows = rows_of(FRAME * 3 + b"\x12" * length + FRAME * 3)
    assert [len(row.raw) for row in rows[3:4]] == [length]
    assert bool(readings(rows, 3)) is (length <= LONGEST)


def test_noise_before_the_bytes_that_are_read_continues() -> None:
    noise = b"\x12" * 200
    rows = rows_of(FRAME * 3 + noise + FRAME[:4] + FRAME * 3)
    at = next(at for at, row in enumerate(rows) if row.faults == (Fault.TRUNCATED,))
    assert [len(row.raw) for row in rows[at - 1 : at]] == [len(noise)]
    first, second = readings(rows, at)
    assert first.reading == f"truncated {spaced_hex(FRAME[:4])}"
    assert "(12 12 12 12 12 12 … 12 12)" in second.reading


@given(raw_bytes)
def test_every_doubtful_row_of_any_stream_has_probabilities(stream: bytes) -> None:
    rows = rows_of(stream)
    for at, row in enumerate(rows):
        if is_doubtful(row.faults):
            found = readings(rows, at)
            assert bool(found) is (len(row.raw) <= LONGEST)
            assert len(found) <= 2
            assert all(0 <= one.probability <= 1 for one in found)
            assert sum(one.probability for one in found) <= 1.000001
            assert len({one.reading for one in found}) == len(found)


# The readings of all rows


def merged(rows: Sequence[Row], others: Sequence[Row]) -> list[Row]:
    """Rows of two ports in turn."""
    longest = max(len(rows), len(others))
    return [one for at in range(longest) for one in [*rows[at : at + 1], *others[at : at + 1]]]


@examples(20)
@given(st.integers(0, 1000), st.lists(st.integers(0, 150), max_size=6))
def test_batches_do_not_matter(seed: int, cuts: list[int]) -> None:
    own = rows_of(damaged_stream(seed, 40, 0.3, "hostile")[0])
    other = [Frame("q", row.offset, row.raw, None, row.faults) for row in rows_of(FRAME * len(own))]
    rows = Rows.from_rows(merged(own, other))
    places = [0, *sorted(min(cut, len(rows)) for cut in cuts), len(rows)]
    batches = [rows[start:stop] for start, stop in pairwise(places)]
    found = [row for batch in with_readings(batches) for row in batch]
    assert [(row.port, row.offset) for row in found] == [(row.port, row.offset) for row in rows]
    doubtful = {row.offset: readings(own, at) for at, row in enumerate(own)}
    for row in found:
        expected = doubtful[row.offset] if is_doubtful(row.faults) else None
        assert row.readings == expected


def test_rows_without_damage_do_not_wait() -> None:
    stage = Readings()
    assert len(stage.feed(Rows.from_rows(rows_of(FRAME * 5)))) == 5
    damaged = Rows.from_rows(rows_of(FRAME * 5 + EXAMPLE)[5:])
    assert len(stage.feed(damaged[:1])) == 0
    assert len(stage.feed(damaged[1:])) == 0
    assert len(stage.end()) == 3
