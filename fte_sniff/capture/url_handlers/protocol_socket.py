"""Owns `socket://` as fte-sniff opens it: pyserial's own, but without losing the first bytes.

It must not do more than that. pyserial throws away on opening whatever the server has sent since
the connection was made, all of a short stream if the server is quick.
"""

from __future__ import annotations

from serial.urlhandler import protocol_socket


class Serial(protocol_socket.Serial):
    """pyserial's socket port; the stream begins where the connection begins."""

    _opening = False

    def open(self) -> None:
        """Connect; raises SerialException as pyserial does."""
        self._opening = True
        try:
            super().open()
        finally:
            self._opening = False

    def reset_input_buffer(self) -> None:
        """Forget what has arrived and was not read, but never on opening."""
        if not self._opening:
            super().reset_input_buffer()
