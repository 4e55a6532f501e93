"""Bytes in: serial ports, network ports, the bridge and the simulator.

Modules:

    bridge        Bridge command's source and set-up.
    bridge_io     Forward bytes both ways; chunks of the two wires; writing to the
                  port.
    chunk_queue   Bounded queue of chunks between reader thread and consumer.
    clock         Wall and monotonic clock; detects clock steps.
    diagnostics   Checks of machine, device and line for `doctor`.
    discovery     List serial ports and USB identities; who holds a port.
    multi_source  Several sources as one stream; one or two ports as one line.
    port_errors   Why a port did not open, in one sentence with the way out.
    port_source   The source that reads one port.
    pty           Pseudo-terminals and line speed of their host end.
    reconnect     Reopen a lost port with backoff.
    serial_port   Open, configure and read one serial port; driver latency.
    sim_model     Simulated controller, motors and host.
    sim_pty       Simulator behind a pseudo-terminal.
    simulation    Simulated byte stream with faults and its parameters.
    source        Source interface, thread base class, items of a source.
    uart_errors   Parity/framing/overrun marks (PARMRK) and counters.
    url_handlers  sim://, socket:// and rfc2217:// for pyserial.
"""

import serial

_HANDLERS = f"{__name__}.url_handlers"

if _HANDLERS not in serial.protocol_handler_packages:
    # Before pyserial's own: one of them is mended here.
    serial.protocol_handler_packages.insert(0, _HANDLERS)
