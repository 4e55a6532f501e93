import tempfile
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from fte_sniff.protocol import (
    HEADERS,
    KINDS,
    TAIL,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import RecordingWriter

PORTS = ("/dev/ttyUSB0", "loop://", "串口 \x1b[31m[bold]")
times = st.integers(0, 2**63 - 1) | st.integers(1000, 1020)
delays = st.none() | st.integers(-(2**63), 2**63 - 1)
offsets = st.integers(0, 2**63 - 1)
faults = st.lists(st.sampled_from(Fault), unique=True, max_size=4).map(tuple)


@st.composite
def frame_bytes(draw: st.DrawFn) -> bytes:
    if draw(st.booleans()):
        header = draw(st.sampled_from(list(HEADERS.values())))
        return bytes([header]) + draw(st.binary(min_size=8, max_size=8)) + bytes([TAIL])
    kind = draw(st.sampled_from(KINDS))
    values = {field.name: draw(st.integers(field.low, field.high)) for field in kind.fields}
    return encode(kind, values, draw(st.sampled_from(kind.cmds)))


orders = st.booleans()
frames = st.builds(
    Frame, st.sampled_from(PORTS), offsets, frame_bytes(), times, faults, delays, orders
)
damage = st.builds(
    Damage,
    st.sampled_from(PORTS),
    offsets,
    st.binary(min_size=1, max_size=40) | st.integers(1, 1024).map(lambda n: bytes(n)),
    times,
    faults,
    delays,
    orders,
)
events = st.builds(
    PortEvent,
    times,
    st.sampled_from(PORTS),
    st.sampled_from(PortEventKind),
    st.text(st.characters(codec="utf-8"), max_size=20),
    st.integers(0, 2**63),
)
Entry = Row | PortEvent


def _record(path: Path, batches: list[list[Entry]], ports: tuple[str, ...]) -> None:
    with RecordingWriter(path, [PortFacts(port) for port in ports]) as writer:
        for batch in batches:
            for entry in batch:
                if isinstance(entry, PortEvent):
                    writer.write_event(entry)
                else:
                    writer.write([entry])
            writer.flush()


def _told(entry: Entry) -> tuple[Entry, int | None, bool]:
    """An entry, and what rows leave out when they compare."""
    if isinstance(entry, PortEvent):
        return entry, None, False
    return entry, entry.read_delay_ns, entry.order_uncertain


@given(
    st.lists(st.lists(st.one_of(frames, damage, events), max_size=12), max_size=4),
    st.sampled_from([PORTS, PORTS[:1], ()]),
)
def test_what_goes_in_comes_out(batches: list[list[Entry]], ports: tuple[str, ...]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        _record(path, batches, ports)
        reader = RecordingReader(path)
        found = list(reader.entries())
        assert (reader.ending, reader.losses) == ("", ())
        with path.open("rb") as file:
            log_times = [
                message.log_time
                for _, _, message in make_reader(file, validate_crcs=True).iter_messages()
            ]
    given_entries = [entry for batch in batches for entry in batch]
    for port in PORTS:
        assert [_told(entry) for entry in found if entry.port == port] == [
            _told(entry) for entry in given_entries if entry.port == port
        ]
    assert log_times == sorted(log_times)
    assert len(log_times) == len(found)


def test_ports_that_interleave_are_put_in_order_of_time(tmp_path: Path) -> None:
    kind = KINDS[0]
    raw = encode(kind, {})
    left = [Frame("left", 10 * n, raw, 1000 + 20 * n) for n in range(5)]
    right = [Frame("right", 10 * n, raw, 1010 + 20 * n) for n in range(5)]
    path = tmp_path / "two.mcap"
    with RecordingWriter(path, [PortFacts("left"), PortFacts("right")]) as writer:
        writer.write(left)
        writer.write(right)
    found = list(RecordingReader(path))
    assert [row.t_ns for row in found] == list(range(1000, 1100, 10))
    with path.open("rb") as file:
        messages = [message for _, _, message in make_reader(file).iter_messages()]
    assert [m.log_time for m in messages] == [m.publish_time for m in messages]
    assert [m.log_time for m in messages] == list(range(1000, 1100, 10))


def test_a_row_that_comes_after_its_chunk_keeps_its_own_time(tmp_path: Path) -> None:
    raw = encode(KINDS[0], {})
    path = tmp_path / "late.mcap"
    with RecordingWriter(path, []) as writer:
        writer.write([Frame("a", 0, raw, 5000)])
        writer.flush()
        writer.write([Frame("b", 0, raw, 4000)])
    assert [row.t_ns for row in RecordingReader(path)] == [5000, 4000]
    with path.open("rb") as file:
        assert [m.log_time for _, _, m in make_reader(file).iter_messages()] == [5000, 5000]
