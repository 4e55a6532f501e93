"""Bytes in: serial ports, network ports, the bridge and the simulator.

Modules:

    attach        See a port that another program holds, by strace.
    bridge        Forward bytes between a pseudo-terminal and a port, and capture both.
    clock         Monotonic clock tied to UTC; detects clock steps.
    discovery     List serial ports; who holds a port; adapters without driver.
    lasting_name  The name by which a lost port is found again.
    line_errors   Line errors of a UART, as its driver counts them.
    player        Play recorded bytes into a pseudo-terminal.
    port_errors   Why a port cannot be opened: one sentence with the fix.
    port_source   Connect ports that are only read; other programs at the same port.
    serial_port   Open, configure, read and write one port; driver latency.
    silence       Detect a wire on which nothing comes, or no frame.
    simulation    Simulated motors, controller, host and line with faults; parameters.
    source        Connections; their reader threads, and one queue of chunks and events.
    url_handlers  URL schemes for pyserial, and what differs between them.
    wiring        Which ports a capture opens, and how.
"""

import serial

_HANDLERS = f"{__name__}.url_handlers"

if _HANDLERS not in serial.protocol_handler_packages:
    # Before pyserial's own handlers: two of them are replaced here.
    serial.protocol_handler_packages.insert(0, _HANDLERS)
