"""A small RFC 2217 server on a real terminal, which notes all that a client asks for.

client  <- data, IAC doubled ->  Server  <- bytes ->  terminal
        <- IAC commands      ->
"""

from __future__ import annotations

import os
import re
import select
import socket
import struct
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from tests.beside import Work, server_socket
from tests.support.speeds import set_speed

IAC, SB, SE = b"\xff", b"\xfa", b"\xf0"
_WILL, _WONT, _DO, _DONT = b"\xfb", b"\xfc", b"\xfd", b"\xfe"
_COM_PORT = b"\x2c"
_KNOWN = {b"\x00", b"\x03", _COM_PORT}
"""Options that are agreed to: binary, suppress go-ahead, and the port's control."""
_ANSWERS = {_WILL: (_DO, _DONT), _DO: (_WILL, _WONT)}
SET_BAUDRATE, SET_DATASIZE, SET_CONTROL, PURGE = 1, 2, 5, 12
_ANSWER_OFFSET = 100

DTR_ON, DTR_OFF, RTS_ON, RTS_OFF = 8, 9, 11, 12
"""What SET_CONTROL carries."""

_TOKEN = re.compile(
    rb"\xff\xff|\xff\xfa((?:[^\xff]|\xff\xff)*)\xff\xf0|\xff([\xfb-\xfe])(.)|[^\xff]+", re.DOTALL
)


class Server:
    """Serves one client at a time on 127.0.0.1, until it is closed."""

    def __init__(self, terminal: str) -> None:
        self._port = os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._listening = server_socket()
        self.url = f"rfc2217://127.0.0.1:{self._listening.getsockname()[1]}"
        self.data = b""
        """All bytes that clients sent for the line."""
        self.controls: list[int] = []
        """All that clients asked of the modem lines and the flow control."""
        self.bauds: list[int] = []
        self.clients = 0
        self.greeting = b""
        """What it sends to a client unasked."""
        self.answers: dict[int, bytes | None] = {}
        """What it answers to a command instead of the value asked for; None for nothing."""
        self._ending, self._hang_up = os.pipe()
        self._work = Work(self._run)

    def hang_up(self) -> None:
        """Die: the client's connection and the listening socket are closed."""
        os.write(self._hang_up, b"!")
        self._work.ended()

    def close(self) -> None:
        self.hang_up()
        for descriptor in (self._port, self._ending, self._hang_up):
            os.close(descriptor)

    def _run(self) -> None:
        with self._listening:
            while not self._comes(self._listening.fileno()):
                client, _ = self._listening.accept()
                self.clients += 1
                with client, suppress(ConnectionError):
                    client.sendall(self.greeting)
                    self._serve(client)

    def _comes(self, *descriptors: int) -> bool:
        """Wait for one of them; whether the end has come."""
        ready, _, _ = select.select([*descriptors, self._ending], [], [])
        return self._ending in ready

    def _serve(self, client: socket.socket) -> None:
        held = b""
        while not self._comes(client.fileno(), self._port):
            if select.select([self._port], [], [], 0)[0]:
                with suppress(BlockingIOError):
                    client.sendall(os.read(self._port, 4096).replace(IAC, IAC + IAC))
            if select.select([client], [], [], 0)[0]:
                data = client.recv(4096)
                if not data:
                    return
                held = self._take(client, held + data)

    def _take(self, client: socket.socket, data: bytes) -> bytes:
        at = 0
        while token := _TOKEN.match(data, at):
            at = token.end()
            if token[1] is not None:
                self._obey(client, token[1].replace(IAC + IAC, IAC))
            elif token[2]:
                self._agree(client, token[2], token[3])
            else:
                sent = token[0].replace(IAC + IAC, IAC)
                self.data += sent
                os.write(self._port, sent)
        return data[at:]

    def _agree(self, client: socket.socket, wish: bytes, option: bytes) -> None:
        if wish in _ANSWERS:
            yes, no = _ANSWERS[wish]
            client.sendall(IAC + (yes if option in _KNOWN else no) + option)

    def _obey(self, client: socket.socket, about: bytes) -> None:
        if about[:1] != _COM_PORT:
            return
        command, value = about[1], about[2:]
        if command == SET_BAUDRATE:
            (baud,) = struct.unpack("!I", value)
            self.bauds.append(baud)
            set_speed(self._port, baud)
        elif command == SET_CONTROL:
            self.controls.append(value[0])
        elif command == PURGE:
            termios.tcflush(self._port, termios.TCIFLUSH)
        value = self.answers.get(command, value)
        if value is not None:
            client.sendall(answer_to(command, value))


def answer_to(command: int, value: bytes) -> bytes:
    """A server's answer to a command, as it is sent."""
    content = _COM_PORT + bytes([command + _ANSWER_OFFSET]) + value
    return IAC + SB + content.replace(IAC, IAC + IAC) + IAC + SE


@contextmanager
def serving(terminal: str) -> Iterator[Server]:
    """A server in front of a terminal."""
    server = Server(terminal)
    try:
        yield server
    finally:
        server.close()
