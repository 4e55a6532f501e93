"""Ports behind a network: a real RFC 2217 server on a real terminal, and a plain socket."""

import random
import socket
import struct

import pytest
import serial

from fte_sniff.capture.serial_port import PortSettings, open_port
from fte_sniff.capture.wiring import Wiring
from fte_sniff.errors import PortError
from tests.beside import Work, server_socket
from tests.capture.seen import CLOCK, Seen, opened
from tests.rfc2217_server import (
    SET_BAUDRATE,
    SET_CONTROL,
    SET_DATASIZE,
    answer_to,
    serving,
)
from tests.slow import crossed
from tests.support.speeds import speed_of
from tests.waiting import BOUND_S


@pytest.fixture
def server(pty):
    with serving(pty.device) as made:
        yield made


def test_every_byte_of_the_far_line_arrives(server, pty):
    sent = random.Random(1).randbytes(50_000) + bytes(range(256)) + b"\xff" * 1000
    with Seen(opened(server.url)) as seen:
        Work(pty.send, sent)
        seen.wait(lambda s: len(s.data()) == len(sent))
    assert seen.data() == sent
    assert seen.source.lost is None
    assert server.data == b""


@pytest.mark.parametrize("baud", [9600, 115200, 250_000, 3_000_000])
def test_the_servers_port_has_the_baud_that_was_asked_for(server, pty, baud):
    open_port(server.url, PortSettings(baud)).close()
    assert speed_of(pty.near) == baud


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


def test_an_end_without_a_beginning_is_one_line(server):
    server.greeting = b"\xff\xf0"
    with pytest.raises(PortError, match="does not speak RFC 2217"):
        open_port(server.url)


def test_answers_that_nobody_asked_for_mean_nothing(server, pty):
    server.greeting = b"".join(
        answer_to(command, value) for command in range(156) for value in (b"", b"\xff\x00\x00\x01")
    )
    with Seen(opened(server.url)) as seen:
        pty.send(b"bytes")
        seen.wait(lambda s: s.data() == b"bytes")


OPTIONS = SET_BAUDRATE, SET_DATASIZE, SET_CONTROL


@pytest.mark.parametrize(("command", "answer"), crossed([*OPTIONS], [None, b"\x63\x63\x63\x63"]))
def test_a_server_that_refuses_an_option_is_one_line(server, command, answer):
    server.answers[command] = answer
    with pytest.raises(PortError, match="the server refuses its settings, ") as refused:
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


def test_an_rfc2217_port_is_bridged_both_ways(server, pty, until):
    with (
        Wiring([server.url], way="bridge").open(CLOCK) as bridge,
        serial.Serial(bridge.device, 19200, timeout=BOUND_S) as host,
    ):
        host.write(b"\xfe\xff\xff\x00")
        until(lambda: server.data == b"\xfe\xff\xff\x00")
        assert speed_of(pty.near) == 115200
        pty.send(b"\xffback")
        assert host.read(5) == b"\xffback"
