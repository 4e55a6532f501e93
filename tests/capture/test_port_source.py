"""Ports that are read: simulated lines, servers and real pseudo-terminals, one or two at a time."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import termios
from itertools import chain
from pathlib import Path

import pytest

from fte_sniff.capture import port_source as module
from fte_sniff.capture.serial_port import open_port
from fte_sniff.capture.simulation import Simulation, SimulationParameters
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import PortError, UsageError
from fte_sniff.protocol.items import Chunk
from tests.beside import Work, held, running, server_socket, state_of
from tests.capture.seen import CLOCK, Seen, opened
from tests.waiting import wait_until


def test_all_that_comes_is_yielded_in_order_and_nothing_is_written(pty) -> None:
    sent = os.urandom(20_000)
    with Seen(opened(pty.device)) as seen:
        Work(pty.send, sent)
        seen.wait(lambda s: len(s.data()) == len(sent))
    assert seen.data() == sent
    assert seen.kinds() == ["opened", "closed"]
    assert {item.port for item in seen.items} == {pty.device}
    assert seen.source.lost is None
    assert pty.arrived() == b""


def test_server_that_sends_and_hangs_up_loses_nothing() -> None:
    sent = os.urandom(300_000)

    def serve(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            connection.sendall(sent)

    with server_socket() as server:
        Work(serve, server)
        seen = Seen(opened(f"socket://127.0.0.1:{server.getsockname()[1]}"))
        seen.ended()
    assert seen.data() == sent
    assert seen.kinds() == ["opened", "lost"]


def test_server_is_asked_whether_it_is_still_there() -> None:
    with server_socket() as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}")
        connection = port._socket
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 5
        port.close()


def test_simulated_port_is_read_to_its_end_and_no_frame_is_cut() -> None:
    seen = Seen(opened("sim://?seed=2&rate=1000&frames=100&drop=0.2&noise=0.2"))
    seen.ended()
    asked = SimulationParameters(seed=2, rate=1000, frames=100, drop=0.2, noise=0.2)
    assert seen.data() == b"".join(item.data for item in Simulation(asked))
    assert seen.kinds() == ["opened", "lost"]
    assert "hung up" in seen.events()[-1].detail
    whole = Seen(opened("sim://?seed=2&frames=40"))
    whole.ended()
    assert {len(chunk.data) % 10 for chunk in whole.chunks()} == {0}


def test_consumer_that_breaks_off_leaves_all_ports_free(new_pty) -> None:
    ptys = [new_pty(), new_pty()]
    items = iter(opened(*(pty.device for pty in ptys)))
    next(items)
    items.close()  # type: ignore[attr-defined]
    for pty in ptys:
        open_port(pty.device).close()


def test_time_of_the_end_is_kept_though_nobody_takes_what_comes(pty) -> None:
    source = opened(pty.device)
    pty.send(b"in time")
    with source:
        while source.waiting < 7:
            pass
        source.stop_at(CLOCK.now_ns())
        while not source.is_over:
            pass
    assert source.waiting == 7
    items = chain.from_iterable(source)
    assert [one.data for one in items if isinstance(one, Chunk) and one.data] == [b"in time"]


def test_all_of_two_ports_comes_and_that_of_each_in_order_of_time(new_pty) -> None:
    one, two = new_pty(), new_pty()
    with Seen(opened(one.device, two.device)) as seen:
        for number in range(300):
            (two if number % 3 else one).send(bytes([number % 256]) * 7)
        seen.wait(lambda s: len(s.data()) == 2100)
    for pty, numbers in ((one, range(0, 300, 3)), (two, [n for n in range(300) if n % 3])):
        assert seen.data(pty.device) == b"".join(bytes([n % 256]) * 7 for n in numbers)
        assert seen.times(pty.device) == sorted(seen.times(pty.device))
        assert seen.kinds(pty.device) == ["opened", "closed"]
    assert set(seen.source.uncertainty_ns) == {one.device, two.device}


def test_port_can_be_named_once_only_however_it_is_spelled(pty, tmp_path) -> None:
    with pytest.raises(UsageError, match="named twice"):
        Wiring(("sim://", "sim://"))
    (tmp_path / "link").symlink_to(pty.device)
    with pytest.raises(PortError, match="is busy: this or another program has it open"):
        opened(pty.device, str(tmp_path / "link"))


# Other programs at the port


def test_port_that_another_program_holds_is_refused_with_both_fixes(pty) -> None:
    with held(pty.near) as other:
        before = pty.attributes()
        with pytest.raises(PortError) as refused:
            opened(pty.device)
        assert pty.attributes() == before
    message = str(refused.value)
    assert f"sleep (pid {other.pid}) has it open" in message
    assert f"`fte-sniff live --attach {pty.device}`" in message
    assert "--share" in message


MAKER = """
import os, sys, time, tty
far, near = os.openpty()
tty.setraw(near)
if sys.argv[1] == "forks" and os.fork() == 0:
    time.sleep(600)
print(os.ttyname(near), flush=True)
sys.stdin.readline()
os.write(far, b"from the maker")
time.sleep(600)
"""


@pytest.mark.parametrize("forks", ["forks", "alone"])
def test_maker_of_a_pseudo_terminal_does_not_count(forks: str) -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with running(["python3", "-c", MAKER, forks], start_new_session=True, **pipes) as maker:
        device = maker.stdout.readline().decode().strip()
        try:
            with Seen(opened(device)) as seen:
                maker.stdin.write(b"\n")
                maker.stdin.flush()
                seen.wait(lambda s: s.data() == b"from the maker")
            assert seen.kinds() == ["opened", "closed"]
        finally:
            os.killpg(maker.pid, signal.SIGKILL)


def test_shared_port_is_read_with_its_settings_and_its_bytes_left_alone(pty) -> None:
    attributes = pty.attributes()
    attributes[4] = attributes[5] = termios.B57600
    attributes[0] |= termios.IXON
    termios.tcsetattr(pty.near, termios.TCSANOW, attributes)
    before = pty.attributes()
    pty.send(b"that waits ")
    with held(pty.near) as other, Seen(opened(pty.device, share=True)) as seen:
        event = seen.wait_for("shared")
        pty.send(b"and that comes")
        seen.wait(lambda s: s.data() == b"that waits and that comes")
        assert pty.attributes() == before
    assert pty.attributes() == before
    expected = f"sleep (pid {other.pid}) has it open too, and may take bytes away"
    assert event.detail == expected


def test_program_that_opens_the_port_later_is_reported_once(pty, monkeypatch) -> None:
    """Under any name: the first one becomes another program while it has the port open."""
    monkeypatch.setattr(module, "_SEARCH_EVERY_S", 0.1)
    monkeypatch.setattr(module, "_SEARCH_SHARE", 1.0)
    with Seen(opened(pty.device)) as seen:
        seen.wait(lambda s: len(s.items) > 10)
        assert seen.kinds() == ["opened"]
        with held(pty.near, "sh", "-c", "kill -STOP $$; exec sleep infinity") as first:
            assert f"(pid {first.pid})" in seen.wait_for("shared").detail
            wait_until(lambda: state_of(first.pid) == "T")
            first.send_signal(signal.SIGCONT)
            wait_until(lambda: "sleep" in Path(f"/proc/{first.pid}/comm").read_text())
            with held(pty.near) as second:
                # Until it is started, the process has the name of this one.
                assert f"(pid {second.pid}) has" in seen.wait_for("shared", 2).detail
                assert f"(pid {first.pid})" not in seen.events()[-1].detail
    assert seen.kinds() == ["opened", "shared", "shared", "closed"]
