"""Owns passing bytes on between an open port and a host's end, both ways at once, until the end.

It must not know what becomes of the bytes besides, nor of a port's coming back.

    feedback thread:  port read -> time -> host program -> wires
    control thread:   host read -> port write -> wires
"""

from __future__ import annotations

import termios
import threading
from contextlib import suppress

import serial

from fte_sniff.capture.bridge.host_end import HostEnd
from fte_sniff.capture.bridge.outlet import outlet_of
from fte_sniff.capture.bridge.wires import HOST, Wires
from fte_sniff.capture.ports.opening import BAUD_RANGE
from fte_sniff.capture.ports.reading import reader_of
from fte_sniff.capture.ports.wording import one_line
from fte_sniff.errors import Said
from fte_sniff.protocol import PortEventKind


class Exchange:
    """One exchange, from an open port to its loss or to the end."""

    def __init__(self, port: serial.Serial, host: HostEnd, wires: Wires) -> None:
        """Make ready; nothing is passed on before `run`."""
        self._port = port
        self._host = host
        self._wires = wires
        self._read = reader_of(port)
        self._put = outlet_of(port)
        self._baud = port.baudrate
        self._lines = port.dtr, port.rts
        self._ending = False
        self._lost: OSError | None = None
        self._not_given = 0
        self._not_taken = 0

    def end(self) -> None:
        """Let `run` return once what has arrived until now is passed on; may be called anywhere."""
        self._ending = True

    def run(self) -> OSError | None:
        """Pass on until the end, or until the port is lost by the error that is returned.

        This thread carries feedback, another one control.
        """
        control = threading.Thread(target=self._carry_control, name="host to port", daemon=True)
        control.start()
        try:
            self._carry_feedback()
        except OSError as error:
            self._lost = self._lost or error
        self._ending = True
        control.join()
        self._tell_not_given()
        if self._not_taken:
            detail = Said(
                "{count} bytes of the host program: the port did not take them",
                count=self._not_taken,
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_taken)
        if self._host.present:
            self._wires.tell(HOST, PortEventKind.CLOSED, Said("the bridge hangs up"))
        return self._lost

    # From the port to the host program

    def _carry_feedback(self) -> None:
        while True:
            # Looked at before the read: what has arrived when the end is asked for is read yet.
            last = self._ending or self._wires.due
            data = self._read()
            t_ns = self._wires.now_ns()
            dropped = self._host.write(data)
            self._wires.read(t_ns, data)
            if dropped:
                self._drop(dropped)
            elif not self._host.behind:
                self._tell_not_given()
            if last:
                return

    def _drop(self, count: int) -> None:
        if not self._not_given:
            detail = Said(
                "the host program does not read: what comes for it is dropped, but kept here"
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
        self._not_given += count

    def _tell_not_given(self) -> None:
        if self._not_given:
            detail = Said(
                "{count} bytes were kept here, but not given to the host program",
                count=self._not_given,
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_given)
            self._not_given = 0

    # From the host program to the port

    def _carry_control(self) -> None:
        try:
            while True:
                last = self._ending
                present = self._host.present
                data = self._host.read()
                if self._host.present != present:
                    self._tell_of_presence(not present)
                if self._host.present:
                    self._follow_baud()
                self._put_all(data)
                if last:
                    return
        except (OSError, termios.error) as error:
            self._lost = self._lost or OSError(*error.args)
            self._ending = True

    def _put_all(self, data: bytes) -> None:
        if not data:
            self._wires.written(b"")
        while data:
            count = self._put(data)
            self._wires.written(data[:count])
            data = data[count:]
            if self._ending and not count:
                self._not_taken += len(data)
                return

    def _tell_of_presence(self, present: bool) -> None:
        kind = PortEventKind.OPENED if present else PortEventKind.CLOSED
        name = self._host.name
        if present:
            detail = Said("a host program opened {name}", name=name)
        else:
            detail = Said("a host program closed {name}", name=name)
        self._wires.tell(HOST, kind, detail)

    def _follow_baud(self) -> None:
        baud = self._host.baud()
        if baud == self._baud:
            return
        before, self._baud = self._baud, baud
        if not baud:
            self._set_lines(False, False)
            detail = Said("the host program hung up (0 baud): DTR and RTS are off")
            self._wires.tell(HOST, PortEventKind.BAUD_CHANGED, detail)
            return
        if not before:
            self._set_lines(*self._lines)
        try:
            if not BAUD_RANGE[0] <= baud <= BAUD_RANGE[1]:
                raise ValueError(f"it is out of range, {BAUD_RANGE[0]}..{BAUD_RANGE[1]}")
            self._port.baudrate = baud
        except (ValueError, OSError, termios.error) as error:
            detail = Said(
                "{baud} baud is refused by the port: {error}", baud=baud, error=one_line(error)
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
            return
        self._wires.pace(baud)

    def _set_lines(self, dtr: bool, rts: bool) -> None:
        # A port without such lines refuses; one that is lost is met by the next read.
        with suppress(OSError):
            self._port.dtr = dtr
        with suppress(OSError):
            self._port.rts = rts
