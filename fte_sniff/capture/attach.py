"""See a port that another program holds: its system calls, by strace, as two wires on one clock.

    target --read, write--> device          the port itself is never opened here
      |
      strace --lines--> reader thread -> chunks: what it read (the port's wire), wrote (`host`)

strace only observes. If it ends, or this program ends in any way, the kernel lets the target go on.
Bytes of before the start are not seen, nor those that a program moves by mmap or io_uring. The time
of a byte is that of its system call: the start of a write, the return of a read. So rows have the
order of the calls at every baud, and a read returns later than its bytes were on the wire.
"""

from __future__ import annotations

import os
import re
import select
import shutil
import signal
import subprocess
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from fte_sniff.capture.bridge import HOST
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import Holder, holders_of, holders_text
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.reconnect import OpenedPort
from fte_sniff.capture.serial_port import DEFAULT_SETTINGS, ControlLine, PortSettings
from fte_sniff.capture.source import AS_ASKED, ChunkQueue, SourceEnd, ThreadedSource
from fte_sniff.errors import Joint, PortError, TranslatableText, listed, printable
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

_READS: Final = ("read", "readv")
_WRITES: Final = ("write", "writev")

LONGEST_CALL: Final = 65_536
"""Bytes of one system call that strace prints; those beyond are counted as lost."""

_STEP_S: Final = 0.01
_SETTLED_NS: Final = 50_000_000
"""How long ago a system call must be for its line to have come, on a machine with some load."""
_END_S: Final = 2.0
"""How long strace may take to let go of the target before it is killed."""
_MOST_SAID: Final = 1 << 16
"""Characters of strace's own messages that are kept."""
_PTRACE_SCOPE = Path("/proc/sys/kernel/yama/ptrace_scope")

LIMITS = TranslatableText(
    "times are those of system calls, not of the wire; mmap and io_uring are not seen"
)


@dataclass(frozen=True, slots=True)
class Call:
    """One system call of the target that moved bytes."""

    data: bytes
    written: bool
    """Whether the target wrote the bytes; otherwise it read them."""
    start_ns: int
    """When it began, nanoseconds since 1970 of the system's clock."""
    end_ns: int
    missing: int = 0
    """Bytes of it that strace did not print."""


_CALL = re.compile(
    r"(?P<pid>\d+) +(?P<time>\d+\.\d+) "
    r"(?:<\.\.\. (?P<resumed>\w+) resumed>|(?P<name>\w+)\()(?P<rest>.*)"
)
_DONE = re.compile(r"(?P<arguments>.*)\) += (?P<result>-?\d+|\?)(?: .*?)??(?: <(?P<took>[\d.]+)>)?")
_UNFINISHED = re.compile(r"(?P<arguments>.*?) *<(?:unfinished \.\.\.|detached \.\.\.)>")
_BYTES = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_NO_CALL = re.compile(r"\d+ +\d+\.\d+ (?:\+\+\+|---|<\?\?\?|\?\?\?\?|strace:).*")


class StraceLines:
    """Lines of strace to system calls; a call that others interrupt takes two lines."""

    def __init__(self) -> None:
        self._begun: dict[str, str] = {}
        """By process: the arguments of the call that it has not finished."""

    def call(self, line: str) -> Call | None:
        """The call of a line; None for one that moved no bytes, or is not finished.

        Raises ValueError for a line that is not of strace.
        """
        found = _CALL.fullmatch(line)
        if found is None:
            if _NO_CALL.fullmatch(line):
                return None
            raise ValueError(line)
        if unfinished := _UNFINISHED.fullmatch(found["rest"]):
            self._begun[found["pid"]] = unfinished["arguments"]
            return None
        done = _DONE.fullmatch(found["rest"])
        if done is None:
            raise ValueError(line)
        arguments = done["arguments"]
        if found["resumed"]:
            arguments = self._begun.pop(found["pid"], "") + arguments
        if done["result"] == "?" or int(done["result"]) <= 0:
            return None
        return _call(found, done, arguments)


def _call(found: re.Match[str], done: re.Match[str], arguments: str) -> Call:
    name, count = found["resumed"] or found["name"], int(done["result"])
    data = b"".join(bytes.fromhex(one.replace("\\x", "")) for one in _BYTES.findall(arguments))
    data = data[:count]
    stamp, took = _ns(found["time"]), _ns(done["took"] or "0")
    start, end = (stamp - took, stamp) if found["resumed"] else (stamp, stamp + took)
    return Call(data, name in _WRITES, start, end, count - len(data))


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

    def open(self, clock: Clock) -> AttachSource:
        """Attach to the programs that have the port open.

        Raises PortError, with the fix, if there are none or strace cannot watch them.
        """
        return AttachSource(self, Strace.on(self), clock)


class AttachSource(ThreadedSource):
    """The chunks and events of both directions, ordered by time; iterate once."""

    _port: Strace
    _awaited = TranslatableText("waiting for a program that opens it")

    def __init__(self, wanted: Attachment, strace: Strace, clock: Clock) -> None:
        """Read a strace that watches the programs; it is ended at the end."""
        follows = wanted.reconnect and wanted.pid is None
        reopen = (lambda: OpenedPort(Strace.on(wanted), wanted.port)) if follows else None
        super().__init__(strace, wanted.port, ChunkQueue(*wanted.names), clock, reopen)
        self._names = wanted.names
        # What is known is the order of the system calls.
        self.uncertainty_ns = dict.fromkeys(wanted.names, 0)
        how = f"attached: {holders_text(strace.holders)}; {LIMITS}"
        self.capabilities = dict.fromkeys(wanted.names, how)
        self._lines, self._rest = StraceLines(), b""
        self._last_ns = dict.fromkeys(wanted.names, 0)
        """By wire: no later item may have an earlier time."""
        self._put(HOST, PortEventKind.OPENED, self._attached())
        self._start(f"watches {wanted.port}", self._attached())
        self._put_event(PortEventKind.WIRING, LIMITS)

    def _attached(self) -> TranslatableText:
        return TranslatableText("attached: {holders}", holders=holders_text(self._port.holders))

    def _read_until_lost(self) -> OSError | None:
        detached = False
        while (data := self._port.read()) is not None:
            self._put_lines(data)
            if not data:
                self._put_silence()
            if not detached and self._end_due():
                detached = True
                self._port.detach()
        if b'"' in self._rest:  # else a call that waits, and has moved no bytes
            self._put_unreadable(self._rest, TranslatableText("strace ended within a line"))
        code = self._port.close()
        error = None if detached else self._loss(code)
        self._put(HOST, PortEventKind.CLOSED, AS_ASKED if error is None else one_line(error))
        return error

    def _loss(self, code: int) -> OSError:
        """Why strace ended with an exit code, or by a signal."""
        if code < 0:
            name = signal.Signals(-code).name
            return OSError(TranslatableText("strace was ended by {signal}", signal=name))
        programs = listed(self._port.holders, Joint.AND)
        return ProcessLookupError(TranslatableText("{programs} ended", programs=programs))

    def _end_after(self, error: OSError) -> SourceEnd:
        # The port is not at fault where the program ended.
        return SourceEnd.STOPPED if isinstance(error, ProcessLookupError) else SourceEnd.LOST

    def _put_lines(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        ahead_ns = self._clock.system_ahead_ns()
        for line in lines:
            try:
                call = self._lines.call(line.decode("ascii"))
            except ValueError:
                self._put_unreadable(line, TranslatableText("a line of strace cannot be read"))
            else:
                if call is not None:
                    self._put_call(call, ahead_ns)

    def _put_call(self, call: Call, ahead_ns: int) -> None:
        wire = HOST if call.written else self.name
        t_ns = (call.start_ns if call.written else call.end_ns) - ahead_ns
        self._put_chunk(wire, t_ns, call.data)
        if call.missing:
            reason = TranslatableText("one system call moved more than strace prints")
            self._put_lost(wire, call.missing, reason)

    def _put_chunk(self, wire: str, t_ns: int, data: bytes) -> None:
        self._last_ns[wire] = t_ns = max(t_ns, self._last_ns[wire])
        self._items.put(Chunk(wire, t_ns, data, at_once=True))

    def _put_unreadable(self, line: bytes, reason: TranslatableText) -> None:
        """Report a line that is cut, on the wires whose bytes it may have had."""
        names = [self.name] * (b"read" in line) + [HOST] * (b"write" in line)
        for wire in names or self._names:
            self._put_lost(wire, 0, reason)

    def _put_lost(self, wire: str, count: int, reason: TranslatableText) -> None:
        detail = TranslatableText("{count} bytes were lost: {why}", count=count, why=reason)
        if not count:
            detail = TranslatableText("bytes may be lost: {why}", why=reason)
        self._put(wire, PortEventKind.OVERRUN, detail, count)

    def _put_event(self, kind: PortEventKind, detail: str) -> None:
        self._put(self.name, kind, detail)

    def _put(self, wire: str, kind: PortEventKind, detail: str, count: int = 0) -> None:
        self._last_ns[wire] = t_ns = self._clock.now_ns()
        self._items.put_event(PortEvent(t_ns, wire, kind, detail, count))

    def _put_silence(self) -> None:
        t_ns = self._clock.now_ns() - _SETTLED_NS
        if t_ns > max(self._last_ns.values()):
            for wire in self._names:
                self._put_chunk(wire, t_ns, b"")

    def _resume(self, opened: OpenedPort, away_s: float) -> None:
        self._port = opened.port
        self._lines, self._rest = StraceLines(), b""
        self._put(HOST, PortEventKind.OPENED, self._attached())
        self._put_event(PortEventKind.FOUND_AGAIN, self._attached())


def untouched(settings: PortSettings) -> PortSettings:
    """The settings of a port whose modem lines another program sets."""
    return replace(settings, dtr=ControlLine.LEAVE, rts=ControlLine.LEAVE)


class Strace:
    """A running strace; its lines come from `stream`."""

    def __init__(self, program: str, device: str, holders: list[Holder]) -> None:
        self.holders = holders
        read, write = os.pipe()
        pids = [word for holder in holders for word in ("-p", str(holder.pid))]
        try:
            self.process = subprocess.Popen(
                [
                    *(program, "-f", "-ttt", "-T", "-v", "-xx", "-s", str(LONGEST_CALL)),
                    *("-e", f"trace={','.join((*_READS, *_WRITES))}", "-e", "signal=none"),
                    *("-P", device, "-o", f"/dev/fd/{write}", *pids),
                ],
                pass_fds=[write],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env={**os.environ, "LC_ALL": "C"},
                start_new_session=True,  # a Ctrl-C ends the capture, which ends strace
            )
        except BaseException:
            os.close(read)
            raise
        finally:
            os.close(write)
        assert self.process.stderr is not None
        self.stream = read
        self.errors = self.process.stderr
        self._said = ""

    @classmethod
    def on(cls, wanted: Attachment) -> Strace:
        """Watch the programs that have the port open; raises PortError with the fix."""
        port = printable(wanted.port)
        program = shutil.which("strace")
        if program is None:
            raise PortError(
                "{port}: to attach, strace is needed: sudo apt install strace", port=port
            )
        holders = _holders(wanted, port)
        strace = cls(program, os.path.realpath(wanted.port), holders)
        strace.wait_until_attached(port)
        return strace

    def wait_until_attached(self, port: str) -> None:
        """Return once it watches all programs; raises PortError if it cannot."""
        while True:
            attached = self.said().count(" attached")
            code = self.process.poll()
            if attached >= len(self.holders):
                return
            if code is not None:
                self.said()
                self.close()
                raise PortError("{port}: {why}", port=port, why=_refusal(self.holders, self._said))
            select.select([self.errors], [], [], _STEP_S)

    def said(self) -> str:
        """All that strace wrote about itself."""
        while select.select([self.errors.fileno()], [], [], 0)[0]:
            more = os.read(self.errors.fileno(), 1 << 16)
            if not more:
                break
            self._said = (self._said + more.decode(errors="replace"))[-_MOST_SAID:]
        return self._said

    def read(self) -> bytes | None:
        """Lines that have come, in any pieces; empty after a while without any, None at the end."""
        if not select.select([self.stream], [], [], _STEP_S)[0]:
            self.said()
            return b""
        return os.read(self.stream, 1 << 16) or None

    def detach(self) -> None:
        """Let the target go; what was seen until then can still be read."""
        with suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGTERM)

    def close(self) -> int:
        """End strace; the target goes on. Returns its exit code, negative for a signal."""
        if self.stream >= 0:
            self.detach()
            try:
                self.process.wait(_END_S)
            except subprocess.TimeoutExpired:
                self.process.kill()  # the kernel lets the target go
                self.process.wait()
            os.close(self.stream)
            self.errors.close()
            self.stream = -1
        return self.process.returncode


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
    names = holders_text(holders)
    for holder in holders:
        if tracer := _tracer_of(holder.pid):
            return TranslatableText(
                "{holder} is watched by another debugger already (pid {tracer}); end that first",
                holder=holder,
                tracer=tracer,
            )
    if "Operation not permitted" in said:
        with suppress(OSError, ValueError):
            if int(_PTRACE_SCOPE.read_text()) > 0:
                return TranslatableText(
                    "{holders}, but ptrace_scope forbids to watch it: use sudo, or"
                    " sudo sysctl kernel.yama.ptrace_scope=0",
                    holders=names,
                )
        return TranslatableText(
            "{holders}, but this user may not watch it: use sudo", holders=names
        )
    last = printable(said.strip().splitlines()[-1]) if said.strip() else "no reason"
    return TranslatableText("strace ended: {why}", why=last)


def _tracer_of(pid: int) -> int | None:
    with suppress(OSError, ValueError):
        status = Path(f"/proc/{pid}/status").read_text()
        found = re.search(r"^TracerPid:\s+(\d+)$", status, re.MULTILINE)
        return int(found[1]) or None if found else None
    return None
