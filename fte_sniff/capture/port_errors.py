"""Why a port did not open, in one sentence with the way out.

It must not open anything; it looks at the error, the name and the device file.
"""

from __future__ import annotations

import errno
import grp
import os
import pkgutil
import pwd
import re
import stat
import termios
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import urlsplit

import serial

from fte_sniff.capture.discovery import have_open, holders_of
from fte_sniff.errors import PortError, TranslatableText, printable, reason_of

_GROUP_MAY = stat.S_IRGRP | stat.S_IWGRP


def way_in(device: str) -> str:
    """One line that tells how the present user can be let in, from the device's owner and mode."""
    try:
        facts = Path(device).stat()
        group = grp.getgrgid(facts.st_gid)
    except (OSError, KeyError):
        return TranslatableText("ask the machine's administrator")
    if group.gr_gid == 0 or facts.st_mode & _GROUP_MAY != _GROUP_MAY:
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
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return "$USER"


_SYSTEM = re.compile(
    r"(?:\[Errno (?P<number>\d+)\] (?P<reason>[^:]*)(?P<about>: .*)?"
    r"|\((?P<bare_number>\d+), '(?P<bare_reason>[^']*)'\))"
)
"""`[Errno 2] No such file or directory: '/dev/x'`, or as termios has it: `(5, 'Input/...')`."""

_WHOLE = {
    str(said): said
    for said in (
        TranslatableText(
            "device reports readiness to read but returned no data"
            " (device disconnected or multiple access on port?)"
        ),
        TranslatableText("device reports error (poll)"),
        TranslatableText("socket disconnected"),
        TranslatableText("Write timeout"),
        TranslatableText("Attempting to use a port that is not open"),
    )
}


def one_line(error: BaseException) -> str:
    """The error's own text on one line, with nothing that a terminal could obey."""
    if error.args and isinstance(error.args[0], TranslatableText):
        return error.args[0]
    return worded(printable(" ".join(str(error).split())))


def worded(text: str) -> str:
    """The same text, as a `TranslatableText` where its words are known."""
    if text in _WHOLE:
        return _WHOLE[text]
    if system := _SYSTEM.fullmatch(text):
        return _of_system(system) or text
    lead, colon, rest = text.partition(": ")
    why = worded(rest) if colon else rest
    if not isinstance(why, TranslatableText):
        return text
    if lead == "read failed":
        return TranslatableText("read failed: {why}", why=why)
    if lead == "write failed":
        return TranslatableText("write failed: {why}", why=why)
    if lead == "Could not configure port":
        return TranslatableText("Could not configure port: {why}", why=why)
    return text


def _of_system(found: re.Match[str]) -> TranslatableText | None:
    number = int(found["number"] or found["bare_number"])
    words = found["reason"] or found["bare_reason"] or ""
    reason = reason_of(OSError(number, words))
    if not isinstance(reason, TranslatableText) or reason != words:
        return None
    if found["about"]:
        about = found["about"].removeprefix(": ")
        return TranslatableText(
            "[Errno {number}] {reason}: {about}", number=number, reason=reason, about=about
        )
    return TranslatableText("[Errno {number}] {reason}", number=number, reason=reason)


_NETWORK_SCHEMES = ("socket", "rfc2217")
_OWN_TERMINAL = "/dev/tty"
_LOGGING = re.compile(r"[?&]logging=", re.IGNORECASE)
_NOT_SPOKEN = "does not seem to support RFC2217"
_MODULE_NEEDED = {"cp2110": "hid"}
_MODULE_PREFIX = "protocol_"


def known_schemes() -> list[str]:
    """The URL schemes that a port can have here, sorted: `loop`, `sim`, `socket`..."""
    found = {
        module.name.removeprefix(_MODULE_PREFIX)
        for package in serial.protocol_handler_packages
        for module in pkgutil.iter_modules(import_module(package).__path__)
        if module.name.startswith(_MODULE_PREFIX)
    }
    return sorted(
        scheme
        for scheme in found
        if scheme not in _MODULE_NEEDED or find_spec(_MODULE_NEEDED[scheme])
    )


def check_name(name: str) -> None:
    """Raise PortError where a name cannot be a port's before anything is opened."""
    scheme, mark, _ = name.partition("://")
    if not name.strip():
        raise PortError("a port has an empty name; {there}", there=_ports_there_are(""))
    if not mark:
        if "\0" not in name and os.path.realpath(name) == _OWN_TERMINAL:
            there = _ports_there_are("")
            raise PortError(
                "{port} is the terminal that this runs in, no port; {there}",
                port=printable(name),
                there=there,
            )
        return
    known = known_schemes()
    if scheme.lower() not in known:
        listed = ", ".join(f"{scheme}://" for scheme in known)
        raise PortError(
            "{port}: no such kind of port; known are {listed}", port=printable(name), listed=listed
        )
    if scheme.lower() in _NETWORK_SCHEMES and not _names_host_and_port(name):
        example = f"{scheme.lower()}://192.168.0.7:4001"
        raise PortError(
            "{port} names no host and TCP port: write it like {example}",
            port=printable(name),
            example=example,
        )
    if scheme.lower() == "spy" and "file=" not in name:
        raise PortError(
            "{port} would write over what is shown here: give it a file to "
            "write to, as spy:///dev/ttyUSB0?file=spy.txt",
            port=printable(name),
        )
    if _LOGGING.search(name):
        raise PortError(
            "{port} would write over what is shown here: leave logging out", port=printable(name)
        )


def refusal(name: str, device: str | None, error: BaseException) -> PortError:
    """What an error on opening means.

    Args:
        name: as the user gave it.
        device: the device file behind it, None where there is none (URLs).
        error: what pyserial or the system raised.
    """
    if isinstance(error.__cause__, PortError):
        return error.__cause__
    named = printable(name)
    if _NOT_SPOKEN in str(error):
        # pyserial's own words go on with a dump of the options that it asked for.
        bare = f"socket://{urlsplit(name).netloc}"
        told = TranslatableText(
            "what answers there does not speak RFC 2217; where it sends bare bytes, open {bare}",
            bare=printable(bare),
        )
        return PortError("{port} cannot be opened: {why}", port=named, why=told)
    hung_up = _errno_of(error) in (errno.ECONNRESET, errno.EPIPE)
    if hung_up and name.lower().startswith("rfc2217://"):
        told = TranslatableText(
            "the server hung up: it does not speak RFC 2217, or serves somebody else"
        )
        return PortError("{port} cannot be opened: {why}", port=named, why=told)
    what = None if device is None else _what_of_device(device, _errno_of(error))
    if what is None:
        # pyserial repeats the name in its own words; once is enough. Where it stumbles over options
        # that it does not know, its words say nothing.
        why = worded(one_line(error).rpartition(f"port {named}: ")[2])
        if isinstance(error, LookupError):
            why = TranslatableText("its options cannot be read")
        what = TranslatableText(" cannot be opened: {why}", why=why)
        if name.partition("://")[0].lower() in _NETWORK_SCHEMES:
            what = TranslatableText(
                " cannot be opened: {why}; does a server listen there?", why=why
            )
    return PortError("{port}{what}", port=named, what=what)


def _names_host_and_port(url: str) -> bool:
    try:
        parts = urlsplit(url)
        return bool(parts.hostname and parts.port)
    except ValueError:
        return False


def _what_of_device(device: str, number: int | None) -> str | None:
    if number == errno.ENOENT:
        return TranslatableText(": no such port; {there}", there=_ports_there_are(device))
    if number in (errno.EACCES, errno.EPERM):
        return TranslatableText(": no permission; {way_in}", way_in=way_in(device))
    if number in (errno.EBUSY, errno.EAGAIN):
        return TranslatableText(
            " is busy: {holders}; close that first", holders=have_open(holders_of(device))
        )
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL, errno.ENOTDIR):
        return TranslatableText(
            " is no serial port but {what}; {there}",
            what=_file_type(device),
            there=_ports_there_are(device),
        )
    if number in (errno.EIO, errno.ENXIO, errno.ENODEV):
        return TranslatableText(
            ": no hardware answers there, or it was just unplugged; check the plug"
        )
    return None


def _errno_of(error: BaseException) -> int | None:
    """The system's error number, which pyserial at times leaves to the error's context alone."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    cause = error if isinstance(error, termios.error) else error.__context__
    if isinstance(cause, termios.error) and cause.args and isinstance(cause.args[0], int):
        return cause.args[0]
    return cause.errno if isinstance(cause, OSError) else None


def _ports_there_are(asked: str) -> str:
    # Looks through /sys, which is for the unlucky path alone.
    from serial.tools.list_ports import comports

    near = Path("/dev") / asked
    if asked and "/" not in asked and near.is_char_device():
        return TranslatableText("did you mean {near}?", near=near)
    devices = sorted(port.device for port in comports())
    if devices:
        return TranslatableText("there are: {devices}", devices=", ".join(devices))
    return TranslatableText(
        "none is plugged in ('fte-sniff ports' lists them; sim:// is a simulated one)"
    )


def _file_type(device: str) -> str:
    try:
        mode = Path(device).stat().st_mode
    except OSError:
        return TranslatableText("no device either")
    kinds = {
        stat.S_IFDIR: TranslatableText("a directory"),
        stat.S_IFREG: TranslatableText("a file"),
        stat.S_IFIFO: TranslatableText("a pipe"),
        stat.S_IFCHR: TranslatableText("another kind of device"),
    }
    return kinds.get(stat.S_IFMT(mode), TranslatableText("something else"))
