"""`socket://`: pyserial's own, but without losing the first bytes.

On opening, pyserial discards what the server has sent since the connection was made: with a fast
server all of a short stream.
"""

from __future__ import annotations

from serial.urlhandler import protocol_socket


class SocketSerial(protocol_socket.Serial):
    """pyserial's socket port; the stream starts with the connection."""

    _opening = False

    def open(self) -> None:
        """Connect; raises SerialException as pyserial does."""
        self._opening = True
        try:
            super().open()
        finally:
            self._opening = False

    def reset_input_buffer(self) -> None:
        """Discard what has arrived and was not read, but never on opening."""
        if not self._opening:
            super().reset_input_buffer()


Serial = SocketSerial
"""The name by which pyserial finds the class."""
