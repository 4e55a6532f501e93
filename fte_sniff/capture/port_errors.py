"""Errors of opening a port: one sentence with the cause and the fix."""

from __future__ import annotations

import errno
import re
import stat
from pathlib import Path

from fte_sniff.capture.discovery import holders_of, holders_text
from fte_sniff.capture.url_handlers import SCHEMES, is_network, scheme_of
from fte_sniff.errors import REASONS, PortError, TranslatableText, listed, printable
from fte_sniff.platform import POSIX, TerminalError

if POSIX:
    import grp

_WINDOWS_ERROR = re.compile(r"could not open port .*: \w+Error\((\d+), ")
"""The system's error number in pyserial's text on Windows."""
_FORBIDDEN, _BUSY = {errno.EACCES, errno.EPERM}, {errno.EBUSY, errno.EAGAIN}


class RefusedError(PortError):
    """The port is there, but it cannot be opened: another program holds it, or it is forbidden."""


def check_name(name: str) -> None:
    """Raise PortError if a name cannot be a port's; opens nothing."""
    if not name.strip():
        raise PortError("a port has an empty name; {there}", there=_existing_ports())
    if (scheme := scheme_of(name)) and scheme not in SCHEMES:
        schemes = listed(f"{known}://" for known in SCHEMES)
        raise PortError(
            "{port}: no such kind of port; known are {listed}", port=printable(name), listed=schemes
        )
    if is_network(name) and not re.search(r"://[^/:]+:\d", name):
        example = f"{scheme}://192.168.0.7:4001"
        raise PortError(
            "{port} names no host and TCP port: write it like {example}",
            port=printable(name),
            example=example,
        )


def port_error(name: str, device: str | None, error: BaseException) -> PortError:
    """The PortError for an error on opening; `device` is the device file, None for URLs."""
    for known in (error, error.__cause__):
        if isinstance(known, PortError):
            return known
    named, number = printable(name), _errno_of(error)
    is_option = isinstance(error, LookupError)
    refusals = None, errno.ECONNRESET, errno.EPIPE
    if scheme_of(name) == "rfc2217" and number in refusals and not is_option:
        # pyserial's own text may end with a dump of the telnet options.
        bare = printable(f"socket://{re.split('[/?#]', name.partition('://')[2])[0]}")
        return PortError(
            "{port} cannot be opened: the server refuses its settings, serves another client, or"
            " does not speak RFC 2217; if it sends plain bytes, open {bare}",
            port=named,
            bare=bare,
        )
    what = None if device is None else _device_problem(device, number)
    if what is None:
        # pyserial's text repeats the name. For an unknown option in a URL it says nothing useful.
        unread = TranslatableText("its options cannot be read")
        reason = unread if is_option else one_line(error, without=f"port {named}: ")
        what = TranslatableText(" cannot be opened: {why}", why=reason)
        if is_network(name):
            what = TranslatableText("{what}; does a server listen there?", what=what)
    kind = RefusedError if device is not None and number in _FORBIDDEN | _BUSY else PortError
    return kind("{port}{what}", port=named, what=what)


def _device_problem(device: str, number: int | None) -> str | None:
    if number == errno.ENOENT:
        return TranslatableText(": no such port; {there}", there=_existing_ports())
    if number in _FORBIDDEN:
        return TranslatableText(": no permission; {fix}", fix=permission_fix(device))
    if number in _BUSY:
        return TranslatableText(
            " is busy: {holders}; watch that program with `fte-sniff live --attach {port}`, or read"
            " beside it with --share, which may take bytes from it",
            holders=holders_text(holders_of(device)),
            port=device,
        )
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ENOTDIR):
        return TranslatableText(" is not a serial port; {there}", there=_existing_ports())
    if number in (errno.EIO, errno.ENXIO, errno.ENODEV):
        return TranslatableText(
            ": no hardware answers there, or it was just unplugged; check the plug"
        )
    return None


def _errno_of(error: BaseException) -> int | None:
    """The system's error number; pyserial sometimes leaves it only in the error's context."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    if windows := _WINDOWS_ERROR.search(str(error)):
        # It refuses a port that another program has open; it has no permissions for ports.
        number = int(windows[1])
        return errno.EBUSY if number == errno.EACCES else number
    cause = error if isinstance(error, TerminalError) else error.__context__
    if isinstance(cause, TerminalError) and cause.args and isinstance(cause.args[0], int):
        return cause.args[0]
    return cause.errno if isinstance(cause, OSError) else None


def _existing_ports() -> str:
    # Imported only on errors: it searches /sys.
    from serial.tools.list_ports import comports

    devices = sorted(port.device for port in comports())
    if devices:
        return TranslatableText("there are: {devices}", devices=listed(devices))
    return TranslatableText(
        "none is plugged in ('fte-sniff ports' lists them; sim:// is a simulated one)"
    )


_ASK = TranslatableText("ask the machine's administrator")
_GROUP_ACCESS = stat.S_IRGRP | stat.S_IWGRP


def permission_fix(device: str) -> str:
    """How the present user gets access to a device, by its owner and mode; one line."""
    if not POSIX:
        return _ASK
    try:
        facts = Path(device).stat()
        group = grp.getgrgid(facts.st_gid)
    except (OSError, KeyError):
        return _ASK
    if group.gr_gid == 0 or facts.st_mode & _GROUP_ACCESS != _GROUP_ACCESS:
        return _ASK
    return TranslatableText(
        "it belongs to the group {group}: sudo usermod -aG {group} $USER, then log in again",
        group=group.gr_name,
    )


# Texts of the system, made translatable

_SYSTEM = re.compile(r"\[Errno (\d+)\] |\((\d+), '")
"""`[Errno 2] No such file or directory: '/dev/x'`, or in termios form: `(5, 'Input/...')`."""


def one_line(error: BaseException, without: str = "") -> str:
    """The error's cause on one line: the system's reason alone, if it is a known one.

    Other texts are as they are, but `without` this and what is before it.
    """
    if error.args and isinstance(error.args[0], TranslatableText):
        return error.args[0]
    text = printable(" ".join(str(error).split()))
    for found in _SYSTEM.finditer(text):
        reason = REASONS.get(int(found[1] or found[2]), "")
        if reason and text.startswith(reason, found.end()):
            return reason
    return (text.rpartition(without)[2] if without else text).removeprefix("read failed: ")
