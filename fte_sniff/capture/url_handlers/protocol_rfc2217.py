"""`rfc2217://`: pyserial's own, but with no byte lost, and no answer that ends its thread.

pyserial discards what has arrived when the connection fails, and its reading thread ends with an
answer that was not requested.
"""

from __future__ import annotations

import queue
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from serial import rfc2217
from serial.serialutil import PortNotOpenError, SerialException


class Rfc2217Serial(rfc2217.Serial):
    """pyserial's RFC 2217 port; bytes that came before the connection failed can be read."""

    _socket: socket.socket | None
    _thread: threading.Thread | None
    _read_buffer: queue.Queue[bytes | None]
    _rfc2217_options: dict[str, Any]

    def close(self) -> None:
        """Close the connection, also one that the server has closed already."""
        connection = self._socket
        super().close()
        if connection is not None:
            # pyserial does not close the socket if its shutdown fails.
            connection.close()

    def read(self, size: int = 1) -> bytes:
        """What has arrived, up to `size` bytes, waiting for the first one for `timeout` seconds.

        After a failed connection, raises SerialException once all that came before was read.
        """
        if not self.is_open:
            raise PortNotOpenError
        # Before the bytes are taken, so that none come behind the end.
        is_alive = self._thread is not None and self._thread.is_alive()
        data = b""
        with suppress(queue.Empty):
            # The end of the connection is in the queue too, as None.
            data += self._read_buffer.get(timeout=self.timeout if is_alive else 0) or b""
            while len(data) < size:
                data += self._read_buffer.get_nowait() or b""
        if not data and not is_alive:
            raise SerialException("the server has hung up")
        return data

    def _telnet_read_loop(self) -> None:
        """Read until the connection fails; the end of what never began is a failure too."""
        with suppress(TypeError):
            _read_loop(self)

    def _telnet_process_subnegotiation(self, content: bytes) -> None:
        options = self._rfc2217_options.values()
        answered = [option for option in options if option.ack_option == content[1:2]]
        if all(option.state == rfc2217.REQUESTED for option in answered):
            _process_subnegotiation(self, content)


_read_loop: Callable[[rfc2217.Serial], None] = vars(rfc2217.Serial)["_telnet_read_loop"]
_process_subnegotiation: Callable[[rfc2217.Serial, bytes], None]
_process_subnegotiation = vars(rfc2217.Serial)["_telnet_process_subnegotiation"]

Serial = Rfc2217Serial
"""The name by which pyserial finds the class."""
