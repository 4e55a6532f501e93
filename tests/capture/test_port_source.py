"""Several sources as one: simulated lines and real pseudo-terminals on one time line."""

import itertools
import os
import signal
import threading

import pytest

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import PortGroup, PortSource, open_source
from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.simulation import Simulation, SimulationParameters
from fte_sniff.capture.source import ChunkQueue, SourceEnd
from fte_sniff.errors import PortError, UsageError
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind
from tests.beside import Work, held, server_socket

CLOCK = Clock.tied()


@pytest.fixture
def source_of():
    """Open sources; all are closed in the end."""
    sources = []

    def opens(name, **settings):
        source = open_source(name, PortSettings(**settings), CLOCK)
        sources.append(source)
        return source

    yield opens
    for source in sources:
        source.close()


def data_of(items):
    return b"".join(item.data for item in items if isinstance(item, Chunk))


def events_of(items):
    return [item.kind.value for item in items if isinstance(item, PortEvent)]


def bytes_taken(items, count, source=None):
    """Items until so many bytes have come; then their source is stopped."""
    source = source or items
    got = 0
    for item in items:
        yield item
        got += len(item.data) if isinstance(item, Chunk) else 0
        if got >= count:
            source.stop()


def test_all_that_comes_is_yielded_in_order_between_opened_and_closed(pty, source_of):
    source = source_of(pty.device)
    sent = os.urandom(20_000)
    Work(pty.send, sent)
    items = list(bytes_taken(source, len(sent)))
    assert data_of(items) == sent
    assert events_of(items) == ["opened", "closed"]
    assert isinstance(items[0], PortEvent)
    assert isinstance(items[-1], PortEvent)
    assert {item.port for item in items} == {pty.device}
    assert source.end is SourceEnd.STOPPED
    assert pty.arrived() == b""


def test_items_carry_the_clocks_time_and_it_never_falls(pty, source_of):
    before_ns = CLOCK.now_ns()
    source = source_of(pty.device)
    pty.send(b"x" * 100)
    times = [item.t_ns for item in bytes_taken(source, 100)]
    assert times == sorted(times)
    assert before_ns <= times[0] <= times[-1] <= CLOCK.now_ns()


@pytest.mark.parametrize("name", ["pty", "sim://?host=off&rate=1", "loop://"])
def test_silence_is_reported_about_every_ten_milliseconds(pty, source_of, name):
    source = source_of(pty.device if name == "pty" else name)
    source.stop_at(CLOCK.now_ns() + 60 * 10**9)
    beats = (item for item in source if isinstance(item, Chunk))
    # A busy machine makes any beat late, but none early.
    gaps_ms = ((b.t_ns - a.t_ns) / 1e6 for a, b in itertools.pairwise(beats))
    timely = list(itertools.islice((gap for gap in gaps_ms if gap < 30), 10))
    assert len(timely) == 10
    assert min(timely) > 5


def test_an_unplugged_port_ends_with_lost_after_all_that_was_read(pty, source_of, until):
    source = source_of(pty.device)
    sent = os.urandom(3000)
    pty.send(sent)
    taken = bytearray()
    items = iter(source)
    until(lambda: taken.extend(data_of([next(items)])) or len(taken) == len(sent))
    pty.send(b"last words")
    # Not before they were read: what the system has not handed over, it drops with the line.
    until(lambda: source.bytes_read == len(sent) + 10)
    pty.unplug()
    rest = list(items)
    assert bytes(taken) + data_of(rest) == sent + b"last words"
    assert events_of(rest) == ["lost"]
    assert isinstance(rest[-1], PortEvent)
    assert source.end is SourceEnd.LOST
    assert list(source) == []


def test_a_server_that_sends_and_hangs_up_loses_nothing(source_of):
    sent = os.urandom(300_000)

    def serve(server):
        connection, _ = server.accept()
        with connection:
            connection.sendall(sent)

    with server_socket() as server:
        Work(serve, server)
        items = list(source_of(f"socket://127.0.0.1:{server.getsockname()[1]}"))
    assert data_of(items) == sent
    assert events_of(items) == ["opened", "lost"]


def test_a_simulated_port_is_read_to_its_end(source_of):
    items = list(source_of("sim://?seed=2&rate=1000&frames=100&drop=0.2&noise=0.2"))
    asked = SimulationParameters(seed=2, rate=1000, frames=100, drop=0.2, noise=0.2)
    assert data_of(items) == b"".join(item.data for item in Simulation(asked))
    assert events_of(items) == ["opened", "lost"]
    assert "unplugged" in items[-1].detail


def test_a_simulated_frame_is_never_cut_into_two_chunks(source_of):
    items = list(source_of("sim://?seed=2&rate=200&frames=40"))
    lengths = [len(item.data) for item in items if isinstance(item, Chunk) and item.data]
    assert sum(lengths) == 400
    # Frames come together only where the machine stalls for a while.
    assert all(length % 10 == 0 for length in lengths)


def test_what_loops_back_is_read(source_of):
    port = open_port("loop://")
    source = PortSource(port, "loop", CLOCK)
    port.write(bytes(range(256)))
    assert data_of(bytes_taken(source, 256)) == bytes(range(256))


def test_stop_from_another_thread_yields_what_had_arrived(pty, source_of):
    source = source_of(pty.device)
    pty.send(b"just in time")
    Work(source.stop)
    items = list(source)
    assert data_of(items) == b"just in time"
    assert events_of(items) == ["opened", "closed"]


def test_stop_from_a_signal_handler_ends_a_consumer_that_waits(pty, source_of):
    source = source_of(pty.device)
    before = signal.signal(signal.SIGUSR1, lambda *_: source.stop())
    try:
        items = []
        for item in source:
            items.append(item)
            if len(items) == 3:
                os.kill(os.getpid(), signal.SIGUSR1)
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert events_of(items) == ["opened", "closed"]
    assert source.end is SourceEnd.STOPPED


def test_closing_ends_the_thread_and_frees_the_port(pty):
    for _ in range(3):
        with open_source(pty.device, PortSettings(), CLOCK) as source:
            source.stop()
            source.stop()
        source.close()
        assert data_of(source) == b""
    assert not [t for t in threading.enumerate() if t.name.startswith("reads")]


def test_a_consumer_that_breaks_off_leaves_the_port_free(pty):
    source = open_source(pty.device, PortSettings(), CLOCK)
    items = iter(source)
    assert next(items).kind is PortEventKind.OPENED
    items.close()
    open_port(pty.device).close()


def test_an_overrun_is_reported_where_it_happened_and_reading_goes_on(pty, until):
    source = PortSource(
        open_port(pty.device), "slow", CLOCK, queue=ChunkQueue("slow", capacity=2000)
    )
    pty.send(b"a" * 1000)
    until(lambda: source.bytes_read == 1000)
    pty.send(b"c" * 3000)
    until(lambda: source.bytes_read == 4000)
    items = iter(source)
    reported = []
    while reported[-1:] != [b"a"]:
        reported += told_by(next(items))
    # There is room again, and what is sent now is kept.
    pty.send(b"b" * 10)
    reported += itertools.chain.from_iterable(
        told_by(item) for item in bytes_taken(items, 10, source)
    )
    assert [word for word in reported if word != b"c"] == [
        "opened",
        b"a",
        "overrun",
        b"b",
        "closed",
    ]


def test_the_time_of_the_end_is_kept_though_nobody_takes_what_comes(pty, until):
    source = PortSource(open_port(pty.device), "slow", CLOCK)
    pty.send(b"in time")
    until(lambda: source.bytes_read == 7)
    source.stop_at(CLOCK.now_ns())
    until(lambda: source.end is SourceEnd.STOPPED)
    assert source.waiting == 7
    assert [told_by(item) for item in source] == [["opened"], [b"i"], ["closed"]]


def told_by(item):
    """An event's kind, or the first byte of a chunk that has one."""
    if isinstance(item, PortEvent):
        return [item.kind.value]
    return [item.data[:1]] if item.data else []


def test_another_program_at_the_port_is_pointed_out(pty, source_of):
    with held(pty.near) as other:
        detail = next(iter(source_of(pty.device))).detail
    assert detail.startswith("115200 baud 8N1, DTR off, RTS off; ")
    assert f"sleep (pid {other.pid}) has it open too" in detail


def opened(*names, reconnect=True):
    return PortGroup(names, PortSettings(), reconnect=reconnect).open(CLOCK)


def data_from(items, port):
    return b"".join(i.data for i in items if isinstance(i, Chunk) and i.port == port)


def kinds_of(items, port):
    return [i.kind for i in items if isinstance(i, PortEvent) and i.port == port]


def test_all_of_two_ports_comes_and_that_of_each_in_order_of_time(new_pty):
    one, two = new_pty(), new_pty()
    source = opened(one.device, two.device)
    items, sent = [], {one.device: b"", two.device: b""}
    turns = itertools.cycle([one, one, two])
    for item in source:
        items.append(item)
        if sum(map(len, sent.values())) < 3000:
            pty = next(turns)
            piece = bytes([len(items) % 256]) * 7
            pty.send(piece)
            sent[pty.device] += piece
        elif all(data_from(items, device) == whole for device, whole in sent.items()):
            source.stop()
    for device, whole in sent.items():
        times = [item.t_ns for item in items if item.port == device]
        assert times == sorted(times)
        assert data_from(items, device) == whole
        assert kinds_of(items, device) == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert source.end is SourceEnd.STOPPED


def test_one_that_is_lost_for_good_ends_all(pty):
    items = []
    with opened("sim://?frames=20&rate=1000", pty.device) as source:
        items += source
    assert kinds_of(items, pty.device) == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert items[-1].kind in (PortEventKind.LOST, PortEventKind.CLOSED)
    assert source.end is SourceEnd.LOST
    assert list(source) == []


def test_one_that_comes_back_ends_none(new_pty, tmp_path):
    going, staying, again = new_pty(), new_pty(), new_pty()
    link = tmp_path / "link"
    link.symlink_to(going.device)
    source = opened(str(link), staying.device)
    items = []
    for item in source:
        items.append(item)
        if len(items) == 10:
            link.unlink()
            going.unplug()
        elif isinstance(item, PortEvent) and item.kind is PortEventKind.LOST:
            staying.send(b"still here")
            link.symlink_to(again.device)
        elif isinstance(item, PortEvent) and item.kind is PortEventKind.FOUND_AGAIN:
            source.stop()
    assert data_from(items, staying.device) == b"still here"
    assert source.end is SourceEnd.STOPPED


def test_if_one_cannot_be_opened_none_stays_open(pty):
    with pytest.raises(PortError, match="no such port"):
        opened(pty.device, "/dev/ttyNOPE")
    open_port(pty.device).close()


def test_a_consumer_that_breaks_off_leaves_all_free(new_pty):
    ptys = [new_pty(), new_pty()]
    items = iter(opened(*(pty.device for pty in ptys)))
    next(items)
    items.close()
    for pty in ptys:
        open_port(pty.device).close()


def test_each_port_is_as_uncertain_as_it_is(pty):
    with opened(pty.device, "loop://") as source:
        assert set(source.uncertainty_ns) == {pty.device, "loop://"}


def test_a_port_can_be_named_once_only_however_it_is_spelled(tmp_path):
    with pytest.raises(UsageError, match="named twice"):
        PortGroup(("sim://", "sim://"))
    (tmp_path / "one").touch()
    (tmp_path / "link").symlink_to("one")
    for other in (tmp_path / "link", f"{tmp_path}/./one"):
        with pytest.raises(UsageError, match="named twice"):
            PortGroup((str(tmp_path / "one"), str(other)))
