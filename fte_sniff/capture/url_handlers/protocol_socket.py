"""`socket://`: pyserial's own, but without losing the first bytes.

On opening, pyserial discards what the server has sent since the connection was made: with a fast
server all of a short stream.
"""

from __future__ import annotations

from serial.urlhandler import protocol_socket


class SocketSerial(protocol_socket.Serial):
    """pyserial's socket port; the stream starts with the connection."""

    def reset_input_buffer(self) -> None:
        """Keep what has arrived: pyserial calls this on opening."""


Serial = SocketSerial
"""The name by which pyserial finds the class."""
