"""Errors of opening a port: one sentence with the cause and the fix."""

from __future__ import annotations

import errno
import os
import re
import stat
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from urllib.parse import urlsplit

import serial

from fte_sniff.capture.discovery import Holder, holders_of, holders_text
from fte_sniff.capture.url_handlers import is_network, scheme_of
from fte_sniff.errors import REASONS, PortError, TranslatableText, listed, printable
from fte_sniff.platform import POSIX, TerminalError

if POSIX:
    import grp
    import pwd

_OWN_TERMINAL = "/dev/tty"
_NO_RFC2217 = "does not seem to support RFC2217"
_REFUSED = re.compile(r"(?:option '|[ [])(\w+)(?:'|:(?!ACTIVE)\w+)")
"""An option that an RFC 2217 server refuses, or does not answer to, in pyserial's text."""
_WINDOWS_ERROR = re.compile(r"could not open port .*: \w+Error\((\d+), ")
"""The system's error number in pyserial's text on Windows."""
_FORBIDDEN, _BUSY = {errno.EACCES, errno.EPERM}, {errno.EBUSY, errno.EAGAIN}
_REFUSALS = _FORBIDDEN | _BUSY
_HANDLER_PREFIX = "protocol_"


class RefusedError(PortError):
    """The port is there, but it cannot be opened: another program holds it, or it is forbidden."""


def busy_error(port: str, device: str, holders: Sequence[Holder]) -> RefusedError:
    """The error for a port that other programs have open, with both fixes."""
    return RefusedError("{port}{what}", port=port, what=_busy(device, holders))


def _busy(device: str, holders: Sequence[Holder]) -> TranslatableText:
    return TranslatableText(
        " is busy: {holders}; watch that program with `fte-sniff live --attach {port}`, or read the"
        " port all the same with --share",
        holders=holders_text(holders),
        port=device,
    )


def check_name(name: str) -> None:
    """Raise PortError if a name cannot be a port's; opens nothing."""
    if not name.strip():
        raise PortError("a port has an empty name; {there}", there=_existing_ports(""))
    if "://" in name:
        _check_url(name, scheme_of(name))
    elif "\0" not in name and os.path.realpath(name) == _OWN_TERMINAL:
        raise PortError(
            "{port} is the terminal that this runs in, no port; {there}",
            port=printable(name),
            there=_existing_ports(""),
        )


def _check_url(url: str, scheme: str) -> None:
    port, known = printable(url), known_schemes()
    if scheme not in known:
        schemes = listed(f"{scheme}://" for scheme in known)
        raise PortError(
            "{port}: no such kind of port; known are {listed}", port=port, listed=schemes
        )
    if is_network(url) and not _has_host_and_port(url):
        example = f"{scheme}://192.168.0.7:4001"
        raise PortError(
            "{port} names no host and TCP port: write it like {example}", port=port, example=example
        )


def known_schemes() -> list[str]:
    """The URL schemes that can be opened here, sorted: `loop`, `sim`, `socket`..."""
    folders = [
        folder
        for package in serial.protocol_handler_packages
        for folder in import_module(package).__path__
    ]
    names = (module.name for module in iter_modules(folders))
    return sorted(
        {name.removeprefix(_HANDLER_PREFIX) for name in names if name.startswith(_HANDLER_PREFIX)}
    )


def _has_host_and_port(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return bool(parts.hostname and parts.port)
    except ValueError:
        return False


def port_error(name: str, device: str | None, error: BaseException) -> PortError:
    """The PortError for an error on opening; `device` is the device file, None for URLs."""
    for known in (error, error.__cause__):
        if isinstance(known, PortError):
            return known
    named, number = printable(name), _errno_of(error)
    scheme, rest = scheme_of(name), name.partition("://")[2]
    bare = printable(f"socket://{re.split('[/?#]', rest)[0]}")
    reason: str | None = None
    if _NO_RFC2217 in str(error):
        # pyserial's own text ends with a dump of the telnet options.
        reason = TranslatableText(
            "the server does not speak RFC 2217; if it sends plain bytes, open {bare}",
            bare=bare,
        )
    elif scheme == "rfc2217" and (refused := _REFUSED.findall(str(error))):
        reason = TranslatableText(
            "the server refuses {options}; set them on the server itself, and open {bare}",
            options=listed(refused),
            bare=bare,
        )
    elif scheme == "rfc2217" and number in (errno.ECONNRESET, errno.EPIPE):
        reason = TranslatableText(
            "the server hung up: it does not speak RFC 2217, or serves another client"
        )
    if reason is not None:
        return PortError("{port} cannot be opened: {why}", port=named, why=reason)
    what = None if device is None else _device_problem(device, number)
    if what is None:
        # pyserial's text repeats the name. For an unknown option in a URL it says nothing useful.
        reason = one_line(error, without=f"port {named}: ")
        if isinstance(error, LookupError):
            reason = TranslatableText("its options cannot be read")
        what = TranslatableText(" cannot be opened: {why}", why=reason)
        if is_network(name):
            what = TranslatableText(
                " cannot be opened: {why}; does a server listen there?", why=reason
            )
    kind = RefusedError if device is not None and number in _REFUSALS else PortError
    return kind("{port}{what}", port=named, what=what)


def _device_problem(device: str, number: int | None) -> str | None:
    if number == errno.ENOENT:
        return TranslatableText(": no such port; {there}", there=_existing_ports(device))
    if number in _FORBIDDEN:
        return TranslatableText(": no permission; {fix}", fix=permission_fix(device))
    if number in _BUSY:
        return _busy(device, holders_of(device))
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ENOTDIR):
        there = _existing_ports(device)
        if Path(device).is_file():
            there = TranslatableText("`fte-sniff view {file}` shows a recording", file=device)
        return TranslatableText(
            " is {what}, not a serial port; {there}", what=_file_type(device), there=there
        )
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


def _existing_ports(requested: str) -> str:
    # Imported only on errors: it searches /sys.
    from serial.tools.list_ports import comports

    near = Path("/dev") / requested
    if requested and "/" not in requested and near.is_char_device():
        return TranslatableText("did you mean {near}?", near=near)
    devices = sorted(port.device for port in comports())
    if devices:
        return TranslatableText("there are: {devices}", devices=listed(devices))
    return TranslatableText(
        "none is plugged in ('fte-sniff ports' lists them; sim:// is a simulated one)"
    )


def _file_type(device: str) -> str:
    try:
        mode = Path(device).stat().st_mode
    except OSError:
        return TranslatableText("a path without a device")
    kinds = {
        stat.S_IFDIR: TranslatableText("a directory"),
        stat.S_IFREG: TranslatableText("a file"),
        stat.S_IFIFO: TranslatableText("a pipe"),
        stat.S_IFCHR: TranslatableText("another kind of device"),
    }
    return kinds.get(stat.S_IFMT(mode), TranslatableText("something else"))


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
        return TranslatableText(
            "its group {group} may not use it: let a group in with a "
            'udev rule, SUBSYSTEM=="tty", GROUP="dialout", MODE="0660"',
            group=group.gr_name,
        )
    user = _user()
    if user in group.gr_mem and group.gr_gid not in os.getgroups():
        return TranslatableText(
            "{user} is in the group {group}, but not since this login: log in again",
            user=user,
            group=group.gr_name,
        )
    return TranslatableText(
        "it belongs to the group {group}: sudo usermod -aG {group} {user}, then log in again",
        group=group.gr_name,
        user=user,
    )


def _user() -> str:
    assert POSIX
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return "$USER"


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
