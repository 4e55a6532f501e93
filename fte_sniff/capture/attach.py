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

import os
import re
import select
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from fte_sniff.capture.bridge import HOST
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import Holder, holders_of, holders_text, is_terminal, open_files
from fte_sniff.capture.serial_port import DEFAULT_SETTINGS, PortSettings
from fte_sniff.capture.source import Connection, Item, Source
from fte_sniff.errors import Joint, PortError, TranslatableText, listed, printable
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

_READS: Final = ("read", "readv", "pread64", "preadv", "preadv2")
_WRITES: Final = ("write", "writev", "pwrite64", "pwritev", "pwritev2")
_UNSHOWN: Final = ("sendfile", "splice")
"""Calls whose bytes strace does not print."""

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


@dataclass(frozen=True, slots=True)
class Call:
    """One system call of the target that moved bytes."""

    data: bytes
    missing: int
    """The number of bytes behind `data` that strace did not print."""
    written: bool
    """Whether the target wrote the bytes; otherwise it read them."""
    start_ns: int
    """When it began, nanoseconds since 1970 of the system's clock."""
    end_ns: int
    name: str = ""


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
    written = name in _WRITES
    if name in _UNSHOWN:
        # sendfile(to, from, ...), but splice(from, ..., to, ...)
        printed = "".join(f"\\x{byte:02x}" for byte in os.fsencode(device))
        is_first = arguments.partition("<")[2].startswith(f"{printed}>")
        written = is_first is (name == "sendfile")
    start_ns = _ns(found["time"])
    shown = _PART.findall(arguments.partition('"...')[0] + '"')  # up to the first that is cut
    data = bytes.fromhex("".join(shown).replace("\\x", ""))[:count]
    end_ns = start_ns + _ns(found["took"])
    return Call(data, count - len(data), written, start_ns, end_ns, name)


def _ns(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))


@dataclass(frozen=True, slots=True)
class Attachment:
    """A port that other programs have open, and the strace that watches them."""

    port: str
    settings: PortSettings = DEFAULT_SETTINGS
    """Of the target; only the baud is used, for the load of the line."""
    pid: int | None = None
    """The process to watch; None for all that have the port open."""
    reconnect: bool = True
    """True to wait for the next program that opens the port, unless `pid` names one."""

    @property
    def names(self) -> tuple[str, ...]:
        """The wire from the controller, and the wire from the host program."""
        return (self.port, HOST)

    def open(self, clock: Clock) -> Source:
        """Attach to the programs that have the port open.

        Raises PortError, with the fix, if there are none or strace cannot watch them.
        """
        reconnect = self.reconnect and self.pid is None
        notes = [LIMITS]  # reported once, however often it is attached again
        return Source([partial(connect_strace, self, clock, notes)], clock, reconnect=reconnect)


def connect_strace(wanted: Attachment, clock: Clock, notes: list[TranslatableText]) -> Connection:
    """Watch the programs that have the port open; raises as `Attachment.open`."""
    opened_ns = clock.now_ns()  # before the first call that is seen
    port = printable(wanted.port)
    strace = Strace(_holders(wanted, port), os.path.realpath(wanted.port), port)
    calls = CallReader(wanted.names, strace, clock, notes, opened_ns)
    attached = TranslatableText("attached: {holders}", holders=holders_text(calls.strace.holders))
    return Connection(
        names=wanted.names,
        detail=attached,
        readers=(calls.items,),
        close=calls.close,
        finish=calls.finish,
        awaited=TranslatableText("waiting for a program that opens it"),
        opened_ns=opened_ns,
        # What is known is the order of the system calls.
        uncertainty_ns=dict.fromkeys(wanted.names, 0),
        capabilities=TranslatableText("{attached}; {limits}", attached=attached, limits=LIMITS),
    )


class CallReader:
    """The system calls of a strace as chunks of both wires, ordered by time."""

    def __init__(
        self,
        names: tuple[str, ...],
        strace: Strace,
        clock: Clock,
        notes: list[TranslatableText],
        opened_ns: int,
    ) -> None:
        """Read a strace that watches the programs, and take the notes to report first."""
        self._names, self.strace, self._clock, self._notes = names, strace, clock, notes
        self._rest = b""
        self._opened_ns = opened_ns
        self._look_s = 0.0
        self._is_new = True
        self._is_finishing = False

    def items(self) -> Iterator[Item]:
        """What the lines of strace report that have come.

        Raises EOFError when the target has ended, OSError when strace was ended.
        """
        if self._is_new:
            self._is_new = False
            holders = holders_text(self.strace.holders)
            yield PortEvent(self._opened_ns, HOST, PortEventKind.OPENED, holders)
        while self._notes:
            note = self._notes.pop()
            yield PortEvent(self._opened_ns, self._names[0], PortEventKind.WIRING, note)
        if self._is_finishing:
            while data := self.strace.read(_END_S):
                yield from self._items(data)
            return
        before_ns = self._clock.now_ns()
        data = self.strace.read()
        if data is None:
            raise self._loss()
        yield from self._items(data)
        if not data:
            # A call that ended by then has been read, also where this program was held up since.
            for name in self._names:
                yield Chunk(name, before_ns - _SETTLED_NS, b"", at_once=True)
            yield from self._followed()

    def finish(self) -> None:
        """Let the target go; the next `items` are all that was seen until then."""
        self._is_finishing = True
        self.strace.detach()

    def close(self) -> Iterator[Item]:
        """End strace, and report what may be missing."""
        self.strace.close()
        if self._rest:
            reason = TranslatableText("bytes may be lost: strace ended within a line")
            yield from self._unreadable(self._rest, reason)
        yield self._event(HOST, PortEventKind.CLOSED, TranslatableText("no longer attached"))

    def _loss(self) -> EOFError | OSError:
        code = self.strace.close()
        if code < 0:
            name = signal.Signals(-code).name
            return OSError(TranslatableText("strace was ended by {signal}", signal=name))
        programs = listed(self.strace.holders, Joint.AND)
        return EOFError(TranslatableText("{programs} ended", programs=programs))

    def _items(self, data: bytes) -> Iterator[Item]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        ahead_ns = self._clock.system_ahead_ns()
        for line in lines:
            try:
                call = call_of(line.decode("ascii"), self.strace.device)
            except ValueError:
                reason = TranslatableText("bytes may be lost: a line of strace cannot be read")
                yield from self._unreadable(line, reason)
            else:
                yield from self._of_call(call, ahead_ns) if call is not None else ()

    def _of_call(self, call: Call, ahead_ns: int) -> Iterator[Item]:
        name = self._names[call.written]
        t_ns = (call.start_ns if call.written else call.end_ns) - ahead_ns
        yield Chunk(name, t_ns, call.data, at_once=True)
        if call.missing:
            detail = TranslatableText(
                "{count} bytes were lost: strace does not show all that {call} moves",
                count=call.missing,
                call=call.name,
            )
            yield self._event(name, PortEventKind.OVERRUN, detail, call.missing)

    def _unreadable(self, line: bytes, reason: TranslatableText) -> Iterator[Item]:
        """Report a line that is cut, on the wires whose bytes it may have had."""
        names = [self._names[0]] * (b"read" in line) + [HOST] * (b"write" in line)
        for name in names or self._names:
            yield self._event(name, PortEventKind.OVERRUN, reason)

    def _followed(self) -> Iterator[Item]:
        """Watch the port that the target has opened in place of this one, if it has."""
        if time.monotonic() < self._look_s:
            return
        self._look_s = time.monotonic() + _LOOK_EVERY_S
        device = self.strace.moved_to()
        if device is None:
            return
        opened_ns = self._clock.now_ns()
        # A program has one watcher at a time.
        self.strace.close()
        try:
            self.strace = Strace(self.strace.holders, device, self._names[0])
        except PortError as error:
            raise OSError(error.message) from error
        self._rest = b""
        detail = TranslatableText(
            "{programs} opened {device} instead, which is watched now",
            programs=listed(self.strace.holders, Joint.AND),
            device=device,
        )
        yield PortEvent(opened_ns, self._names[0], PortEventKind.FOUND_AGAIN, detail)

    def _event(self, name: str, kind: PortEventKind, detail: str, count: int = 0) -> PortEvent:
        return PortEvent(self._clock.now_ns(), name, kind, detail, count)


class Strace:
    """A running strace; its lines come from its standard error, as do its messages."""

    def __init__(self, holders: list[Holder], device: str, port: str) -> None:
        """Watch programs at a device; `port` is its name in errors.

        Raises PortError, with the fix, if strace is not installed or cannot watch them.
        """
        program = shutil.which("strace")
        if program is None:
            raise PortError(
                "{port}: to attach, strace is needed: sudo apt install strace", port=port
            )
        self.holders, self.device = holders, device
        self._terminals = _terminals_of(holders)
        """Ports that the programs had open at the start."""
        pids = [word for holder in holders for word in ("-p", str(holder.pid))]
        traced = ",".join((*_READS, *_WRITES, *_UNSHOWN))
        self._process = subprocess.Popen(
            [
                *("strace", "-f", "-y", "-ttt", "-T", "-v", "-xx", "-s", str(LONGEST_PART)),
                # With a status, a call has one line, which is printed when it has returned.
                *("-e", f"trace={traced}", "-e", "signal=none", "-e", "status=successful"),
                *("-P", device, *pids),
            ],
            executable=program,
            bufsize=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env={**os.environ, "LC_ALL": "C"},
            start_new_session=True,  # a Ctrl-C ends the capture, which ends strace
        )
        self._first = b""
        self._first = self._read_until_attached(port)

    def _read_until_attached(self, port: str) -> bytes:
        """What was printed until all programs are watched; raises PortError if they cannot be."""
        data = b""
        while data.count(b" attached") < len(self.holders):
            more = self.read()
            if more is None:
                self.close()
                why = _refusal(self.holders, data.decode(errors="replace"))
                raise PortError("{port}: {why}", port=port, why=why)
            data += more
        return data

    def moved_to(self) -> str | None:
        """The port that the programs have opened since the start, if they have left this one."""
        now = _terminals_of(self.holders)
        if self.device in now and Path(self.device).exists():
            return None
        return next(iter(sorted(now - self._terminals)), None)

    def read(self, wait_s: float = _STEP_S) -> bytes | None:
        """Lines that have come, in any pieces; empty after a while without any, None at the end."""
        if self._first:
            first, self._first = self._first, b""
            return first
        assert self._process.stderr is not None
        if not select.select([self._process.stderr], [], [], wait_s)[0]:
            return b""
        return self._process.stderr.read(1 << 16) or None

    def detach(self) -> None:
        """Let the target go; what was seen until then can still be read."""
        with suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)

    def close(self) -> int:
        """End strace; the target goes on. Returns its exit code, negative for a signal."""
        self.detach()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()  # the kernel lets the target go
            self._process.wait()
        assert self._process.stderr is not None
        self._process.stderr.close()
        return self._process.returncode


def _terminals_of(holders: list[Holder]) -> set[str]:
    """The names of the serial ports and pseudo-terminals that programs have open."""
    return {name for one in holders for name in open_files(one.pid) if is_terminal(name)}


def _holders(wanted: Attachment, port: str) -> list[Holder]:
    """The programs to watch; raises PortError if there are none."""
    if not Path(wanted.port).exists():
        raise PortError("{port}: no such port; `fte-sniff ports` lists them", port=port)
    holders = holders_of(wanted.port)
    if wanted.pid is not None:
        named = [holder for holder in holders if holder.pid == wanted.pid]
        if not named:
            raise PortError(
                "process {pid} does not have {port} open; {holders}",
                pid=wanted.pid,
                port=port,
                holders=holders_text(holders),
            )
        return named
    if not holders:
        raise PortError(
            "no program that this user may watch has {port} open; start the program first, or use"
            " sudo for that of another user",
            port=port,
        )
    return holders


def _refusal(holders: list[Holder], said: str) -> TranslatableText:
    """Why strace cannot watch a program, and the fix."""
    if "Operation not permitted" in said:
        return TranslatableText(
            "{holders}, but this user may not watch it, or a debugger does already: use sudo, or"
            " end the debugger",
            holders=holders_text(holders),
        )
    last = printable(said.strip().splitlines()[-1]) if said.strip() else "no reason"
    return TranslatableText("strace ended: {why}", why=last)
