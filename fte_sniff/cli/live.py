"""`fte-sniff live`: capture a port, record it, and watch it."""

from __future__ import annotations

import os
import re
import sys
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.capturing import capture_options, run_capture
from fte_sniff.cli.completion import complete_port
from fte_sniff.cli.options import grouped_command
from fte_sniff.cli.settings import load_settings
from fte_sniff.errors import UsageError

if TYPE_CHECKING:
    from fte_sniff.capture.wiring import Way

_MOST_PORTS = 2


@grouped_command(name="live", short_help="Capture a port, record it and watch it.")
@click.argument("ports", nargs=-1, metavar="PORT [PORT]", shell_complete=complete_port)
@click.option(
    "--attach",
    is_flag=True,
    help="Do not open PORT: watch what the program that has it open reads and writes (Linux).",
)
@click.option(
    "--pid",
    type=click.IntRange(min=1),
    metavar="N",
    help="With --attach: the process, if several have it open.",
)
@click.option(
    "--share",
    is_flag=True,
    help="Read PORT although another program has it open, and leave its settings as they are: each "
    "byte goes to one of the two programs.",
)
@capture_options
def command(
    ports: tuple[str, ...],
    attach: bool,
    pid: int | None,
    share: bool,
    **options: Any,
) -> None:
    """Capture PORT, record it and watch it; a second PORT is the other wire.

    PORT is a device, or a URL that pyserial opens, such as socket://host:port, or sim://, a
    simulated host and controller (sim://?seed=1&rate=200&drop=0.01). Nothing is ever written to it.
    The recording goes to fte-sniff-<UTC time>.mcap in this folder; -o names another file,
    --no-record records nothing. The filter applies to the display only: all rows are recorded.
    A device or a server that is lost is waited for, and found again by its link, USB serial number
    or USB socket. A PORT that another program has open is refused; --attach and --share are for
    that. Without PORT, the ports of the settings are opened.

    --attach shows a PORT that another program holds, with strace: what that program writes is the
    wire `host`, what it reads is PORT. Times are those of its system calls.

    \b
    fte-sniff live /dev/ttyUSB0
    fte-sniff live /dev/ttyUSB0 /dev/ttyUSB1
    fte-sniff live sim:// --plain --count 20 --no-record
    fte-sniff live --attach /dev/ttyUSB0
    """
    settings = load_settings()
    ports = ports or settings.live.get("ports", ())
    if not ports:
        raise UsageError(
            "live needs a PORT: `fte-sniff ports` lists them; or name it in [live] of {path}: "
            'ports = ["/dev/ttyUSB0"]',
            path=settings.path,
        )
    for port in ports:
        _check_port(port)
    if len(ports) > _MOST_PORTS:
        raise UsageError(f"{len(ports)} ports: live takes one, or one for each of two wires")

    if pid is not None and not attach:
        raise UsageError("--pid works with --attach; add it")
    if attach and (sys.platform != "linux" or len(ports) > 1 or "://" in ports[0]):
        raise UsageError("--attach takes one device, on Linux; use a tap for others, or `bridge`")
    if attach and share:
        raise UsageError("--attach does not open PORT, so there is nothing to share: leave one out")

    way: Way = "attach" if attach else "read"
    run_capture(ports, settings, way=way, pid=pid, share=share, **options)


def _check_port(port: str) -> None:
    """Refuse a baud rate, a bare address or a file as a port; raises UsageError."""
    if port.isdecimal():
        raise UsageError(f"{port} is not a port; to set the bits per second, use --baud {port}")
    if re.fullmatch(r"[\w.-]+:\d+", port):
        raise UsageError(f"{port} is not a device; for a server in the network use socket://{port}")
    if os.path.isfile(port):  # noqa: PTH113 - False, and no error, where a folder is closed
        raise UsageError(f"{port} is a file, not a port; `fte-sniff view {port}` shows it")
