"""See a port that another program holds: its system calls, by strace, as two wires on one clock.

    target --read, write--> device          the port itself is never opened here
      |
      strace --lines--> reader -> chunks: what it read (the port's wire), wrote (`host`)

strace only observes. If it ends, or this program ends in any way, the kernel lets the target go on.
Bytes of before the start are not seen, nor those that a program moves by mmap or io_uring; those of
sendfile and splice are only counted. The time of a byte is that of its system call: the start of a
write, the return of a read. So rows have the order of the calls at every baud, and a read returns
later than its bytes were on the wire.
"""

from __future__ import annotations

import errno
import os
import re
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Final, NamedTuple

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import Holder, holders_of, holders_text, is_terminal, open_files
from fte_sniff.capture.port_errors import port_error
from fte_sniff.capture.source import HOST, Connection, Received
from fte_sniff.errors import Joint, PortError, TranslatableText, listed, printable
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind

_WRITES: Final = {
    **dict.fromkeys(("read", "readv", "pread64", "preadv", "preadv2"), False),
    **dict.fromkeys(("write", "writev", "pwrite64", "pwritev", "pwritev2"), True),
    "sendfile": None,
    "splice": None,
}
"""The calls that are watched, and whether they write; None for one between two files, whose bytes
strace does not print."""

LONGEST_PART: Final = 2**20
"""Bytes of each buffer of a system call that strace prints; what follows is counted as lost."""

_STEP_S: Final = 0.01
_SETTLED_NS: Final = 50_000_000
"""How long ago a system call must be for its line to have come, on a machine with some load."""
_LOOK_EVERY_S: Final = 0.05
"""Time between two looks at which port the target has open."""
_END_S: Final = 2.0
"""How long strace may take to let go of the target before it is killed."""

LIMITS: Final = TranslatableText(
    "times are those of system calls, not of the wire; mmap and io_uring are not seen"
)


class Call(NamedTuple):
    """One system call of the target that moved bytes."""

    name: str
    written: bool
    """Whether the target wrote the bytes; otherwise it read them."""
    t_ns: int
    """When it began to write, or has read; nanoseconds since 1970 of the system's clock."""
    data: bytes
    missing: int = 0
    """The number of bytes behind `data` that strace did not print."""


_CALL = re.compile(
    r"(?:\[pid +\d+\] |\d+ +)?(?P<time>\d+\.\d+) (?P<name>\w+)"
    r"\((?P<arguments>.*)\) += (?P<result>\d+)"
    r"(?: .*?)?? <(?P<took>[\d.]+)>"
)
_PART = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_NO_CALL = re.compile(r"(?:strace: |(?:\[pid +\d+\] |\d+ +)?\d+\.\d+ (?:\+\+\+|---|strace:)).*")


def call_of(line: str, device: str) -> Call | None:
    """The call of a line of strace; None for one that moved no bytes of the device.

    Raises ValueError for a line that is not of strace.
    """
    found = _CALL.fullmatch(line)
    if found is None:
        if _NO_CALL.fullmatch(line):
            return None
        raise ValueError(line)
    name, arguments, count = found["name"], found["arguments"], int(found["result"])
    if not count:
        return None
    written = _WRITES.get(name)
    if written is None:
        # sendfile(to, from, ...), but splice(from, ..., to, ...)
        printed = "".join(f"\\x{byte:02x}" for byte in os.fsencode(device))
        is_first = arguments.partition("<")[2].startswith(f"{printed}>")
        written = is_first is (name == "sendfile")
    t_s = Decimal(found["time"]) + (0 if written else Decimal(found["took"]))
    shown = _PART.findall(arguments.partition('"...')[0] + '"')  # up to the first that is cut
    data = bytes.fromhex("".join(shown).replace("\\x", ""))[:count]
    return Call(name, written, int(t_s * 1_000_000_000), data, count - len(data))


def connect_strace(port: str, pid: int | None, clock: Clock) -> Connection:
    """Watch the programs that have a port open, or one of them; raises as `Strace`."""
    strace = Strace(port, _holders(port, pid), clock)
    return Connection(
        names=(port, HOST),
        detail=TranslatableText("attached: {holders}", holders=holders_text(strace.holders)),
        readers=(strace.items,),
        close=strace.close,
        place=listed(strace.holders),
        # What is known is the order of the system calls.
        uncertainty_ns=dict.fromkeys((port, HOST), 0),
    )


class Strace:
    """A running strace, whose lines are chunks of both wires; they come from its standard error."""

    def __init__(self, port: str, holders: list[Holder], clock: Clock) -> None:
        """Watch programs; raises PortError, with the fix, if strace cannot."""
        self._names, self.holders, self._clock = (port, HOST), holders, clock
        self._look_s = 0.0
        self._watch(os.path.realpath(port))

    def _watch(self, device: str) -> None:
        self._device, self._terminals = device, _terminals_of(self.holders)
        self._process = _started(self._names[0], self.holders, device)
        self._rest = b""
        """What was printed after the last whole line."""
        while self._rest.count(b" attached") < len(self.holders):
            more = self._read()
            if more is None:
                said = self._rest.decode(errors="replace")
                tuple(self.close())
                raise _refusal(self._names[0], self.holders, said)
            self._rest += more

    def items(self) -> Iterator[Received]:
        """What the lines report that have come.

        Raises EOFError when the target has ended, OSError when strace was ended.
        """
        before_ns = self._clock.now_ns()
        data = self._read()
        if data is None:
            raise self._loss()
        yield from self._items(data)
        if not data:
            # A call that ended by then has been read, also where this program was held up since.
            for name in self._names:
                yield Chunk(name, before_ns - _SETTLED_NS, b"", at_once=True)
            yield from self._followed()

    def close(self) -> Iterator[Received]:
        """Let the target go; returns all that was seen until then."""
        self._process.terminate()
        while data := self._read(_END_S):
            yield from self._items(data)
        yield from self._items(b"\n")  # a line that is cut
        self._ended()
        assert self._process.stderr is not None
        self._process.stderr.close()

    def _read(self, wait_s: float = _STEP_S) -> bytes | None:
        """What was printed; empty after a while without any, None at the end."""
        assert self._process.stderr is not None
        if not select.select([self._process.stderr], [], [], wait_s)[0]:
            return b""
        return self._process.stderr.read(1 << 16) or None

    def _ended(self) -> int:
        """Wait for the end; returns the exit code, negative for a signal."""
        try:
            return self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()  # the kernel lets the target go
            return self._process.wait()

    def _loss(self) -> EOFError | OSError:
        code = self._ended()
        if code < 0:
            name = signal.Signals(-code).name
            return OSError(TranslatableText("strace was ended by {signal}", signal=name))
        programs = listed(self.holders, Joint.AND)
        return EOFError(TranslatableText("{programs} ended", programs=programs))

    def _items(self, data: bytes) -> Iterator[Received]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        ahead_ns = self._clock.system_ahead_ns()
        for line in filter(None, lines):
            try:
                call = call_of(line.decode("ascii"), self._device)
            except ValueError:
                detail = TranslatableText("bytes may be lost: a line of strace cannot be read")
                for name in self._names:
                    yield self._event(name, PortEventKind.OVERRUN, detail)
            else:
                yield from self._of_call(call, ahead_ns) if call is not None else ()

    def _of_call(self, call: Call, ahead_ns: int) -> Iterator[Received]:
        name = self._names[call.written]
        yield Chunk(name, call.t_ns - ahead_ns, call.data, at_once=True)
        if call.missing:
            detail = TranslatableText(
                "{count} bytes were lost: strace does not show all that {call} moves",
                count=call.missing,
                call=call.name,
            )
            yield self._event(name, PortEventKind.OVERRUN, detail, call.missing)

    def _followed(self) -> Iterator[Received]:
        """Watch the port that the target has opened in place of this one, if it has."""
        if time.monotonic() < self._look_s:
            return
        self._look_s = time.monotonic() + _LOOK_EVERY_S
        now = _terminals_of(self.holders)
        new = sorted(now - self._terminals)
        if not new or (self._device in now and Path(self._device).exists()):
            return
        yield from self.close()  # a program has one watcher at a time
        try:
            self._watch(new[0])
        except PortError as error:
            raise OSError(error.message) from error
        detail = TranslatableText(
            "{programs} opened {device} instead, which is watched now",
            programs=listed(self.holders, Joint.AND),
            device=new[0],
        )
        yield self._event(self._names[0], PortEventKind.FOUND_AGAIN, detail)

    def _event(self, name: str, kind: PortEventKind, detail: str, count: int = 0) -> PortEvent:
        return PortEvent(self._clock.now_ns(), name, kind, detail, count)


def _started(name: str, holders: list[Holder], device: str) -> subprocess.Popen[bytes]:
    """Start strace for some programs and one device; `name` is the port's in errors."""
    program = shutil.which("strace")
    if program is None:
        raise PortError(
            "{port}: to attach, strace is needed: sudo apt install strace", port=printable(name)
        )
    pids = [word for holder in holders for word in ("-p", str(holder.pid))]
    try:
        return subprocess.Popen(
            [
                *("strace", "-f", "-y", "-ttt", "-T", "-v", "-xx", "-s", str(LONGEST_PART)),
                # With a status, a call has one line, which is printed when it has returned.
                *("-e", f"trace={','.join(_WRITES)}", "-e", "signal=none"),
                *("-e", "status=successful", "-P", device, *pids),
            ],
            executable=program,
            bufsize=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "LC_ALL": "C"},
            start_new_session=True,  # a Ctrl-C ends the capture, which ends strace
        )
    except OSError as error:
        raise _refusal(name, holders, str(error)) from error


def _terminals_of(holders: list[Holder]) -> set[str]:
    """The names of the serial ports and pseudo-terminals that programs have open."""
    return {name for one in holders for name in open_files(one.pid) if is_terminal(name)}


def _holders(port: str, pid: int | None) -> list[Holder]:
    """The programs to watch; raises PortError if there are none."""
    if not is_terminal(port):
        number = errno.ENOTTY if os.path.exists(port) else errno.ENOENT  # noqa: PTH110
        raise port_error(port, port, OSError(number, ""))
    holders = holders_of(port)
    if named := [holder for holder in holders if pid in (None, holder.pid)]:
        return named
    if pid is not None:
        raise PortError(
            "process {pid} does not have {port} open; {holders}",
            pid=pid,
            port=printable(port),
            holders=holders_text(holders),
        )
    raise PortError(
        "no program that this user may watch has {port} open; start the program first, or use"
        " sudo for that of another user",
        port=printable(port),
    )


def _refusal(name: str, holders: list[Holder], said: str) -> PortError:
    """Why strace cannot watch a program, and the fix."""
    last = printable(said.strip().splitlines()[-1]) if said.strip() else "no reason"
    why = TranslatableText("strace ended: {why}", why=last)
    if "Operation not permitted" in said:
        why = TranslatableText(
            "{holders}, but this user may not watch it, or a debugger does already: use sudo, or"
            " end the debugger",
            holders=holders_text(holders),
        )
    return PortError("{port}: {why}", port=printable(name), why=why)
