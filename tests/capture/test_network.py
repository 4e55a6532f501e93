"""Ports behind a network: a real RFC 2217 server on a real terminal, and a plain socket."""

import random
import socket
import struct

import pytest
import serial

from fte_sniff.capture.bridge import Bridge, speed_of
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_source import open_source
from fte_sniff.capture.serial_port import ControlLine, PortSettings, open_port
from fte_sniff.capture.source import SourceEnd
from fte_sniff.errors import PortError
from fte_sniff.protocol import Chunk, PortEvent
from tests.beside import Work, server_socket
from tests.rfc2217_server import (
    DTR_OFF,
    DTR_ON,
    RTS_OFF,
    RTS_ON,
    SET_BAUDRATE,
    SET_CONTROL,
    SET_DATASIZE,
    answer_to,
    serving,
)
from tests.slow import crossed
from tests.waiting import BOUND_S

CLOCK = Clock.tied()


@pytest.fixture
def server(pty):
    with serving(pty.device) as made:
        yield made


def taken(source, count):
    """The bytes of a source until so many have come; then it is stopped."""
    found = b""
    for item in source:
        found += item.data if isinstance(item, Chunk) else b""
        if len(found) >= count:
            source.stop()
    return found


def test_every_byte_of_the_far_line_arrives(server, pty):
    sent = random.Random(1).randbytes(100_000) + bytes(range(256)) + b"\xff" * 1000
    with open_source(server.url, PortSettings(), CLOCK) as source:
        Work(pty.send, sent)
        assert taken(source, len(sent)) == sent
    assert source.end is SourceEnd.STOPPED
    assert server.data == b""


@pytest.mark.parametrize("baud", [9600, 115200, 250_000, 3_000_000])
def test_the_servers_port_has_the_baud_that_was_asked_for(server, pty, baud):
    open_port(server.url, PortSettings(baud)).close()
    assert speed_of(pty.near) == baud


@pytest.mark.parametrize("dtr", [ControlLine.ON, ControlLine.OFF])
@pytest.mark.parametrize("rts", [ControlLine.ON, ControlLine.OFF])
def test_dtr_and_rts_are_as_asked_for_and_never_anything_else(server, dtr, rts):
    with open_source(server.url, PortSettings(dtr=dtr, rts=rts), CLOCK) as source:
        source.stop()
        list(source)
    asked = {DTR_ON if dtr is ControlLine.ON else DTR_OFF, RTS_ON if rts == "on" else RTS_OFF}
    assert {c for c in server.controls if c in (DTR_ON, DTR_OFF, RTS_ON, RTS_OFF)} == asked
    assert server.data == b""


def test_a_server_that_dies_is_a_lost_port_after_all_that_came(server, pty, until):
    source = open_source(server.url, PortSettings(), CLOCK)
    sent = random.Random(2).randbytes(5000)
    pty.send(sent)
    until(lambda: source.bytes_read == len(sent))
    server.hang_up()
    items = list(source)
    assert b"".join(item.data for item in items if isinstance(item, Chunk)) == sent
    assert [item.kind.value for item in items if isinstance(item, PortEvent)] == ["opened", "lost"]
    assert "hung up" in items[-1].detail
    assert source.end is SourceEnd.LOST


def test_a_server_that_does_not_speak_rfc2217_is_refused():
    with server_socket() as listening:
        url = f"rfc2217://127.0.0.1:{listening.getsockname()[1]}"

        def speak():
            client, _ = listening.accept()
            with client:
                client.sendall(b"\xff\xfa" + b"x" * 10_000)
                while client.recv(4096):  # what is left unread would end it as if it were no server
                    pass

        speaker = Work(speak)
        with pytest.raises(PortError, match="does not speak RFC 2217"):
            open_port(url)
        speaker.ended()


def test_answers_that_nobody_asked_for_mean_nothing(server, pty):
    server.greeting = b"".join(
        answer_to(command, value) for command in range(156) for value in (b"", b"\xff\x00\x00\x01")
    )
    with open_source(server.url, PortSettings(), CLOCK) as source:
        pty.send(b"bytes")
        assert taken(source, 5) == b"bytes"


OPTIONS = {SET_BAUDRATE: "baudrate", SET_DATASIZE: "datasize", SET_CONTROL: "control"}


@pytest.mark.parametrize(("command", "answer"), crossed([*OPTIONS], [None, b"\x63\x63\x63\x63"]))
def test_a_server_that_refuses_an_option_is_one_line_that_names_it(server, command, answer):
    server.answers[command] = answer
    with pytest.raises(PortError, match=f"the server refuses {OPTIONS[command]};") as refused:
        open_port(server.url)
    assert "dict_values" not in str(refused.value)


def test_a_server_that_hangs_up_at_once_is_distinguished_from_an_absent_one():
    with server_socket() as listening:
        url = f"rfc2217://127.0.0.1:{listening.getsockname()[1]}"

        def hang_up():
            client, _ = listening.accept()
            client.recv(1)
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()

        server = Work(hang_up)
        with pytest.raises(PortError, match="does not speak RFC 2217"):
            open_port(url)
        server.ended()


def test_a_socket_is_bridged_both_ways():
    with server_socket() as listening:
        url = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        bridge = Bridge(url).open(CLOCK)
        client, _ = listening.accept()
        with client, bridge, serial.Serial(bridge.device, 115200, timeout=BOUND_S) as host:
            host.write(b"there")
            assert client.recv(5, socket.MSG_WAITALL) == b"there"
            client.sendall(b"back")
            assert host.read(4) == b"back"


def test_an_rfc2217_port_is_bridged_both_ways_and_its_baud_follows(server, pty, until):
    with (
        Bridge(server.url).open(CLOCK) as bridge,
        serial.Serial(bridge.device, 19200, timeout=BOUND_S) as host,
    ):
        host.write(b"\xfe\xff\xff\x00")
        until(lambda: server.data == b"\xfe\xff\xff\x00")
        until(lambda: speed_of(pty.near) == 19200)
        pty.send(b"\xffback")
        assert host.read(5) == b"\xffback"
