"""Attacks on running programs: kills, faults of the disk, files taken away, fuzzed lines.

The bytes of the line are known, so what a recording must hold is known too: rows that join to
what was sent, from the first row to at least the bytes whose recording is promised.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import socket
import struct
import subprocess
import termios
import tty
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from random import Random
from time import monotonic, sleep

from fte_sniff.errors import FileError
from fte_sniff.protocol.spec import FRAME_LENGTH
from tests.support.columns import read_rows
from tests.support.recorded_rows import recorded_row
from tests.support.recording_kill import kill_one
from tests.torture.case import (
    BOUND_S,
    Case,
    PromiseError,
    Run,
    SkippedError,
    Started,
    promise,
)
from tests.torture.damage import VARIANTS, noisy_frame, numbered_frame, recording
from tests.torture.file_attacks import (
    ReadRow,
    check_killed,
    check_read_by_both,
    csv_rows,
    decoded,
    official_rows,
    utc_ns,
)

_STOPPED = re.compile(r"^recording stopped: .* is complete up to there \(([\d,]+) rows\)", re.M)
_NOT_RECORDED = re.compile(r"([\d,]+) rows from .* were not recorded")
_ROWS = re.compile(r"^([\d,]+) rows", re.M)
_PRINTED = re.compile(rb"^(\d{4}-\S+Z) +(\d+) .*\n", re.M)
"""Time and offset in a whole line of a row, of one wire."""


class Line:
    """A pseudo-terminal with a sender at the far end, and what was sent so far."""

    def __init__(self, random: Random, noisy: bool = False) -> None:
        self._random, self._noisy = random, noisy
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        os.set_blocking(self.far, False)
        self.device = os.ttyname(self.near)
        self.sent = bytearray()
        self._number = 0

    def send(self, seconds: float = 0.0, until: Callable[[], bool] = lambda: False) -> None:
        """Send frames for some time, or until something holds."""
        end = monotonic() + seconds
        while monotonic() < end and not until():
            frames = b""
            for _ in range(self._random.randrange(1, 12)):
                self._number += 1
                noisy = self._noisy
                frames += noisy_frame(self._random, self._number) if noisy else b""
                frames += numbered_frame(self._number)
            with suppress(BlockingIOError):
                self.sent += frames[: os.write(self.far, frames)]
            sleep(self._random.choice((0.002, 0.01, 0.03)))

    def send_until_shown(self, program: Started, noisy: bool = False) -> None:
        """Send whole frames until the program prints the first row."""
        self.send(BOUND_S, lambda: bool(program.output) or program.has_ended)
        self._noisy = noisy
        promise(program.output, f"nothing is shown\n{program.errors}")

    def drain(self) -> None:
        """Wait until the program has read everything."""
        until = monotonic() + BOUND_S
        while self._unread and monotonic() < until:
            sleep(0.01)
        promise(not self._unread, "the program does not read the line")

    @property
    def _unread(self) -> int:
        waiting = fcntl.ioctl(self.near, termios.FIONREAD, bytes(4))
        return int(struct.unpack("i", waiting)[0])

    def close(self) -> None:
        """Unplug the line."""
        os.close(self.far)
        os.close(self.near)


def check_stream(rows: list[ReadRow], sent: bytes, at_least: int) -> None:
    """Check that rows join to a span of what was sent, without a gap, up to `at_least` bytes."""
    joined = b"".join(bytes.fromhex(row.raw) for row in rows)
    ends = [0]
    for row in rows:
        promise(row.offset == ends[-1], f"a gap or an overlap at offset {row.offset:,}")
        ends.append(row.offset + len(row.raw) // 2)
    start = sent.find(joined)
    promise(start >= 0, "the rows are other bytes than were sent")
    end = start + len(joined)
    promise(end >= at_least, f"{at_least - end:,} bytes are missing at the end")


def check_times(printed: bytes, rows: list[ReadRow]) -> None:
    """Check that the rows of one wire were recorded with the times that were printed."""
    times = {row.offset: row.t_ns for row in rows}
    for time, offset in _PRINTED.findall(printed):
        recorded = times.get(int(offset), utc_ns(time.decode()))
        promise(recorded == utc_ns(time.decode()), f"{int(offset):,} was recorded at another time")


def _number(text: str) -> int:
    return int(text.replace(",", ""))


def wait_until(holds: Callable[[], bool], text: str) -> None:
    """Wait until something holds; a broken promise with this text if it does not."""
    until = monotonic() + BOUND_S
    while not holds():
        promise(monotonic() < until, text)
        sleep(0.05)


def rows_now(folder: Path, pattern: str = "x*.mcap") -> list[ReadRow]:
    """The rows that a reader finds now in files that are being written."""
    rows = []
    for path in sorted(folder.glob(pattern)):
        with suppress(FileError):
            found = read_rows(path, is_growing=True)
            rows += [ReadRow(r.port, r.offset, r.raw.hex().upper(), r.t_ns) for r in found]
    return rows


def await_recorded(case: Case, line: Line, folder: Path | None = None) -> int:
    """Wait until all that was sent is in the files; the number of its bytes."""
    last = line.sent[-FRAME_LENGTH:].hex().upper()

    def is_recorded() -> bool:
        rows = rows_now(folder or case.folder, "*.mcap")
        return "".join(row.raw for row in rows[-9:]).endswith(last)

    wait_until(is_recorded, f"{len(line.sent):,} bytes are not recorded")
    return len(line.sent)


def _files(case: Case) -> list[Path]:
    return sorted(case.folder.glob("x*.mcap"))


def _live(case: Case, line: Line, *options: str, **environment: str) -> Started:
    output = ("-o", "x.mcap", *options)
    return case.start("live", line.device, "--plain", *output, **environment)


def _rows_of_all(case: Case) -> list[ReadRow]:
    return [row for path in _files(case) for row in check_read_by_both(case, path)]


def kill_live(case: Case) -> None:
    """Kill a capture at any moment: the recording is whole up to the last flush."""
    line = Line(case.random)
    rotate = case.random.choice(((), (), ("--rotate", "100kB")))
    program = _live(case, line, *rotate)
    line.send_until_shown(program)
    line.send(case.random.uniform(0, 3))
    promised = await_recorded(case, line)
    line.send(case.random.uniform(0, 3))
    program.kill()
    rows = [row for path in _files(case) for row in check_killed(case, path)]
    check_stream(rows, bytes(line.sent), promised)
    check_times(program.output, rows)
    line.close()


def kill_recorder(case: Case) -> None:
    """Kill a writer at full speed: each row whose flush it reported is in its files."""
    random = case.random
    every_s = random.choice((0.0, 0.0, 0.05, 0.3))
    path, rotate = case.path("x.mcap"), random.random() < 0.5
    # Without a flush after each write, few rows come before the child ends by itself.
    rows = 0 if every_s else random.choice((0, 25_000))
    left = kill_one(path, every_s, random.uniform(0, 3), after_rows=rows, rotate=rotate)
    promise(not left.problem, left.problem)
    promise(not left.missing, f"{left.missing} of {left.flushed} flushed rows are missing")
    for row in rows_now(path.parent):
        made = recorded_row(row.port, row.offset // FRAME_LENGTH)
        promise(row.raw == made.raw.hex().upper(), f"other bytes at {row.offset:,}")
        promise(row.t_ns == made.t_ns, f"another time at {row.offset:,}")


def kill_bridge(case: Case) -> None:
    """Kill a bridge at any moment: the recording is whole, and each wire has its bytes."""
    line = Line(case.random)
    output = ("--plain", "-o", "x.mcap", "--link", "host")
    program = case.start("bridge", line.device, *output)
    line.send_until_shown(program)
    host = os.open(case.path("host"), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    written, end = bytearray(), monotonic() + case.random.uniform(0, 4)
    while monotonic() < end:
        frame = numbered_frame(1_000_000 + len(written))
        with suppress(BlockingIOError):
            written += frame[: os.write(host, frame)]
        with suppress(BlockingIOError):
            os.read(host, 1 << 16)
            os.read(line.far, 1 << 16)
        line.send(0.02)
    program.kill()
    os.close(host)
    rows = [row for path in _files(case) for row in check_killed(case, path)]
    check_stream([row for row in rows if row.port == line.device], bytes(line.sent), 0)
    check_stream([row for row in rows if row.port != line.device], bytes(written), 0)
    line.close()


def kill_conversion(case: Case) -> None:
    """Kill `decode -o` or `repair`: the input is as before, and the next run gives everything."""
    random = case.random
    source = case.path("source.mcap")
    data = recording(random.randrange(VARIANTS))
    source.write_bytes(data if random.random() < 0.5 else data[: len(data) * 2 // 3])
    before = source.read_bytes()
    command = random.choice(("decode", "decode", "repair"))
    outputs = ("x.mcap", "x.csv", "x.parquet", "x.jsonl") if command == "decode" else ("x.mcap",)
    words = (command, source, "-o", random.choice(outputs))
    program = case.start(*words)
    sleep(random.uniform(0, 1.2))
    program.kill()
    promise(source.read_bytes() == before, f"{words[0]} changed its input")
    for path in _files(case):
        official_rows(path)
    again = case.run(*words, "--force")
    promise(again.code == 0, f"{words[0]} --force after a kill\n{again.errors}")
    _, rows = decoded(case, source)
    if words[-1] == "x.mcap" and case.path("x.mcap").exists():
        kept = check_read_by_both(case, case.path("x.mcap"))
        promise(Counter(kept) == Counter(rows), f"{len(kept)} of {len(rows)} rows after a kill")


FAULTS = (
    *((call, effect) for call in ("write", "sync", "truncate") for effect in ("ENOSPC", "EIO")),
    ("write", "short"),
    ("sync", "delay"),
)
"""Calls that fail, and how; see faults.c."""


_SYNCED_S = 10.0
"""A capture waits for the disk once a second, and longer on a busy machine."""


def power_cut(case: Case) -> None:
    """Cut the power of a capture with a view: what was recorded before the last sync is kept.

    A capture with a view flushes with each batch of rows, and waits for the disk once a second. A
    library copies each file whenever it is synced: the copies are what the disk is sure to have.
    """
    line, disk = Line(case.random), case.folder.with_name("disk")
    disk.mkdir()
    program = _live(
        case,
        line,
        LD_PRELOAD=str(_faults_library(case)),
        FAULT_FOLDER=str(case.folder),
        FAULT_SYNCED=str(disk),
    )
    line.send_until_shown(program)
    promised = 0
    for _ in range(case.random.randrange(1, 4)):
        line.send(case.random.uniform(0.05, 1))
        await_recorded(case, line)
        began = monotonic()
        promised = await_recorded(case, line, disk)
        took = monotonic() - began
        promise(took < _SYNCED_S, f"a power cut would cost the rows of {took:.1f} s")
    line.send(case.random.uniform(0, 1.5))
    program.kill()
    copies = sorted(disk.glob("*.mcap"))
    rows = [row for path in copies for row in check_killed(case, path)]
    rows.sort(key=lambda row: row.offset)
    check_stream(rows, bytes(line.sent), promised)
    line.close()


def _faults_library(case: Case) -> Path:
    """The library of faults.c, compiled."""
    compiler = shutil.which("gcc")
    if compiler is None:
        raise SkippedError("gcc is missing, which compiles the library that makes writes fail")
    library = case.path("faults.so")
    source = Path(__file__).with_name("faults.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source], check=True)
    return library


def _faults(case: Case, most_first: int) -> dict[str, str]:
    """The environment of a program whose writes, syncs or truncations fail from some call on."""
    library = _faults_library(case)
    call, effect = case.random.choice(FAULTS)
    first = case.random.choice((0, 1, 2, case.random.randrange(most_first)))
    return {
        "LD_PRELOAD": str(library),
        "FAULT_FOLDER": str(case.folder),
        "FAULT_CALL": call,
        "FAULT_EFFECT": effect,
        "FAULT_FIRST": str(first),
        "FAULT_COUNT": str(case.random.choice((1, 3, 1_000_000))),
        "FAULT_DELAY_MS": str(case.random.choice((50, 400, 1500))),
    }


def faults_of_live(case: Case) -> None:
    """Let writes, syncs and truncations of a capture fail: rows are recorded or reported."""
    line = Line(case.random, noisy=False)
    faults = _faults(case, 80)
    program = _live(case, line, **faults)
    with suppress(PromiseError):
        line.send_until_shown(program)
    if program.has_ended:
        run = program.wait()
        promise(run.code == 4, f"exit code {run.code}\n{run.errors}")
        return
    line.send(case.random.uniform(0.5, 5))
    line.drain()
    program.interrupt()
    _check_accounted(case, program.wait(), bytes(line.sent))
    line.close()


def _check_accounted(case: Case, run: Run, sent: bytes) -> None:
    """Check that each row is in a file or in the number of rows that were not recorded."""
    rows = _rows_of_all(case)
    # What was sent before the port was open is nobody's.
    first = sent.index(bytes.fromhex(rows[0].raw)) if rows else len(sent)
    total = (len(sent) - first) // FRAME_LENGTH
    missed = _NOT_RECORDED.findall(run.errors)
    lost = sum(map(_number, missed))
    stated = sum(map(_number, _STOPPED.findall(run.errors.split("fte-sniff: ")[0])))
    promise(len(rows) >= stated, f"{len(rows)} rows are read, {stated} are reported\n{run.errors}")
    promise((run.code == 0) == (not missed), f"exit code {run.code}, {lost} rows not recorded")
    accounted = total <= len(rows) + lost
    promise(accounted, f"{total} rows: {len(rows)} are read, {lost} are reported\n{run.errors}")
    check_times(run.output, rows)
    if not lost:
        check_stream(rows, sent, len(sent))


_CONVERSIONS = (
    *(("decode", suffix) for suffix in ("mcap", "csv", "jsonl", "parquet")),
    ("repair", "mcap"),
    ("report", "html"),
)


def faults_of_conversion(case: Case) -> None:
    """Let writes of conversions fail: exit code 4, and the old file or none."""
    random = case.random
    data = recording(random.randrange(VARIANTS))
    source = case.path("source.mcap")
    command, suffix = random.choice(_CONVERSIONS)
    source.write_bytes(data if command != "repair" else data[: len(data) * 2 // 3])
    output = case.path(f"x.{suffix}")
    old = random.choice((None, b"old"))
    if old is not None:
        output.write_bytes(old)
    faults = _faults(case, 40)
    run = case.run(command, source, "-o", output, "--force", **faults)
    promise(run.code in (0, 4), f"exit code {run.code}\n{run.errors}")
    _, rows = decoded(case, source)
    if run.code == 4:
        left = output.read_bytes() if output.exists() else None
        promise(left == old, f"{command} left a part of {output.name}\n{run.errors}")
        promise(not list(case.folder.glob(".*.part")), f"{command} left a partial file")
    elif suffix in ("mcap", "csv"):
        found = check_read_by_both(case, output) if suffix == "mcap" else csv_rows(output)
        promise(Counter(found) == Counter(rows), f"{len(found)} of {len(rows)} rows")


def taken_away(case: Case) -> None:
    """Truncate, delete or move the file of a capture: it is reported, and the capture goes on."""
    line = Line(case.random)
    program = _live(case, line)
    line.send_until_shown(program)
    line.send(case.random.uniform(0.3, 2))
    path = case.path("x.mcap")
    match case.random.choice(("truncate", "truncate", "empty", "delete", "move")):
        case "truncate":
            os.truncate(path, case.random.randrange(path.stat().st_size))
        case "empty":
            os.truncate(path, 0)
        case "delete":
            path.unlink()
        case "move":
            path.rename(case.path("moved.mcap"))
    line.send(BOUND_S, lambda: bool(rows_now(case.folder, "x_*.mcap")) or program.has_ended)
    noticed = len(line.sent)
    has_ended = program.has_ended
    line.send(case.random.uniform(0, 2))
    line.drain()
    program.interrupt()
    run = program.wait()
    promise(run.code == 4, f"exit code {run.code}: the loss is not reported\n{run.errors}")
    promise(not has_ended, f"it ended\n{run.errors}")
    others = [other for other in _files(case) if other != path]
    rows = [row for other in others for row in check_read_by_both(case, other)]
    promise(rows, f"the capture did not go on in another file\n{run.errors}")
    joined = b"".join(bytes.fromhex(row.raw) for row in rows)
    promise(bytes(line.sent).endswith(joined), "the last rows are missing")
    since = len(line.sent) - len(joined)
    promise(since <= noticed, "rows since then are missing")
    check_times(run.output, rows)
    line.close()


def noisy_line(case: Case) -> None:
    """Send noise, cut and altered frames: each byte is in one row, in order, also on the disk.

    Rows that wait for a flush at the end are written then.
    """
    line = Line(case.random)
    program = _live(case, line)
    line.send_until_shown(program, noisy=True)
    line.send(case.random.uniform(0.2, 2))
    line.drain()
    program.interrupt()
    run = program.wait()
    promise(run.code == 0, f"exit code {run.code}\n{run.errors}")
    rows = _rows_of_all(case)
    check_stream(rows, bytes(line.sent), len(line.sent))
    shown = max(map(_number, _ROWS.findall(run.errors)), default=0)
    promise(shown == len(rows), f"{shown} rows are reported, {len(rows)} are in the file")
    check_times(run.output, rows)
    line.close()


def hostile_server(case: Case) -> None:
    """Connect to an RFC 2217 server that sends anything: a clear end."""
    random = case.random
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        scheme = random.choice(("rfc2217", "rfc2217", "socket"))
        output = ("--duration", "2", "--plain", "-o", "x.mcap")
        program = case.start("live", f"{scheme}://127.0.0.1:{port}", *output)
        server.settimeout(BOUND_S)
        client, _ = server.accept()
        with client, suppress(OSError):
            for _ in range(random.randrange(200)):
                client.sendall(_telnet(random))
                sleep(random.choice((0, 0, 0.01)))
            if random.random() < 0.5:
                client.shutdown(socket.SHUT_RDWR)
        run = program.wait()
    promise(run.code in (0, 3), f"exit code {run.code}\n{run.errors}")
    for path in _files(case):
        check_read_by_both(case, path)


def _telnet(random: Random) -> bytes:
    """A command, option, subnegotiation or data of a Telnet server, right or wrong."""
    iac, sb, se, port_option = 255, 250, 240, 44
    match random.randrange(6):
        case 0:
            return bytes((iac, random.randrange(236, 256), random.choice((0, 1, 3, port_option))))
        case 1:
            answer = bytes((random.choice((0, 1, 2, 99, 100, 101, 105, 106, 107, 112, 255)),))
            value = random.randbytes(random.choice((0, 1, 4, 9)))
            return bytes((iac, sb, port_option)) + answer + value + bytes((iac, se))
        case 2:
            return bytes((iac, sb)) + random.randbytes(random.choice((0, 3, 3_000)))
        case 3:
            return random.randbytes(random.randrange(40))
        case 4:
            return bytes((iac, se)) * random.randrange(4)
        case _:
            return numbered_frame(random.randrange(1_000))
