"""Attacks by files: damaged, cut, hostile and fuzzed recordings, logs, raw bytes and settings."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.torture.case import ROOT, Case, PromiseError, Run, promise
from tests.torture.damage import (
    BOMBS,
    PORTS,
    VARIANTS,
    damaged,
    recording,
    repeated_index,
    with_bomb,
)


class ReadRow(NamedTuple):
    """A row, however it was read."""

    port: str
    offset: int
    raw: str
    """Its bytes, hex."""
    t_ns: int | None


SCAN = """
import sys, warnings, fte_sniff
warnings.simplefilter("ignore")
try:
    print(fte_sniff.scan(sys.argv[1]).collect().height)
except fte_sniff.FteSniffError as error:
    print(f"fte-sniff: {error}", file=sys.stderr)
    sys.exit(error.exit_code)
"""


def csv_rows(path: Path) -> list[ReadRow]:
    """The rows of a CSV file that the program wrote."""
    with path.open(newline="") as stream:
        return [
            ReadRow(row["port"], int(row["offset"]), row["raw"], utc_ns(row["time"]))
            for row in csv.DictReader(stream)
        ]


def utc_ns(text: str) -> int | None:
    """Nanoseconds since 1970 of a row's time; None without one."""
    return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64)) if text else None


def decoded(case: Case, *paths: Path, limited: bool = True) -> tuple[Run, list[ReadRow]]:
    """The rows that `decode` reads."""
    table = case.path(f"{paths[0].name}.csv")
    run = case.run("decode", *paths, "--format", "csv", "-o", table, "--force")
    if limited:
        case.check_limits(run, f"decode {paths[0].name}")
    return run, csv_rows(table) if run.code == 0 else []


def official_rows(path: Path) -> list[ReadRow]:
    """The rows that the `mcap` package reads, with all checksums checked."""
    rows = []
    try:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            for _schema, channel, message, row in reader.iter_decoded_messages():
                if channel.topic != "/fte/port":
                    port, raw = channel.metadata["port"], row.raw.hex().upper()
                    # A row with a time before the last one states it.
                    t_ns = row.time_ns if row.HasField("time_ns") else message.log_time
                    rows.append(ReadRow(port, row.offset, raw, t_ns))
    except Exception as error:
        raise PromiseError(f"the mcap package refuses {path.name}: {error!r}") from error
    return rows


def check_read_by_both(case: Case, path: Path) -> list[ReadRow]:
    """Check that `decode` and the `mcap` package read the same rows, and return them."""
    run, rows = decoded(case, path)
    promise(run.code == 0, f"decode refuses {path.name}\n{run.errors}")
    promise(Counter(official_rows(path)) == Counter(rows), f"{path.name}: other rows in mcap")
    return rows


def check_killed(case: Case, path: Path) -> list[ReadRow]:
    """The rows that the `mcap` package reads of a file whose writer was killed.

    `decode` reads them too, and may read more: rows of the write that the kill interrupted.
    """
    run, rows = decoded(case, path)
    promise(run.code == 0, f"decode refuses {path.name}\n{run.errors}")
    official = official_rows(path)
    promise(rows[: len(official)] == official, f"{path.name}: decode reads other rows than mcap")
    return official


def _original(case: Case) -> bytes:
    return recording(case.random.randrange(VARIANTS))


def _true_rows(case: Case, data: bytes) -> list[ReadRow]:
    path = case.path("whole.mcap")
    path.write_bytes(data)
    return official_rows(path)


def _numbered(rows: list[ReadRow]) -> list[ReadRow]:
    """The rows of a file that lost the names of its ports: the first one is `port 1`."""
    names = {name: f"port {number}" for number, name in enumerate(PORTS, 1)}
    return [row._replace(port=names[row.port]) for row in rows]


def check_damaged(case: Case, data: bytes, true_rows: list[ReadRow]) -> list[ReadRow]:
    """Check what every command does with a damaged recording; the rows that `decode` reads.

    No row is invented, `repair` keeps each row that `decode` reads, and the repaired file opens in
    the `mcap` package.
    """
    path, repaired = case.path("damaged.mcap"), case.path("repaired.mcap")
    path.write_bytes(data)
    _, rows = decoded(case, path)
    recorded = Counter(true_rows).keys() | Counter(_numbered(true_rows)).keys()
    invented = Counter(rows).keys() - recorded
    promise(not invented, f"decode reads rows that were never recorded: {sorted(invented)[:3]}")
    mended = case.run_limited("repair", path, "-o", repaired)
    if rows:
        promise(mended.code == 0, f"repair refuses what decode reads\n{mended.errors}")
    kept = check_read_by_both(case, repaired) if repaired.exists() else rows
    lost = Counter(rows) - Counter(kept)
    promise(not lost, f"repair keeps {len(kept)} rows, decode reads {len(rows)}")
    if case.random.random() < 0.3:
        case.run_limited("stats", path)
        case.run_limited("report", path, "-o", case.path("x.html"), "--force")
        case.run_limited("check", path, "--expect", "count(malformed) >= 0")
        case.check_limits(case.start_python("-c", SCAN, path).wait(), f"scan {path.name}")
    return rows


def mutate(case: Case) -> None:
    """Flip, overwrite, remove and repeat bytes of a recording, or cut it at any byte."""
    random, data = case.random, _original(case)
    is_cut = random.random() < 0.3
    altered = data[: random.randrange(len(data))] if is_cut else damaged(random, data)
    check_damaged(case, altered, _true_rows(case, data))


def bomb(case: Case) -> None:
    """A small recording that claims or unpacks to a lot; its intact rows are still read."""
    data = recording(case.random.randrange(VARIANTS))
    true_rows = _true_rows(case, data)
    name = case.random.choice((*BOMBS, "repeated index"))
    if name == "repeated index":
        hostile = repeated_index(case.random, data)
    else:
        hostile = with_bomb(case.random, data, BOMBS[name](case.random))
    if len(hostile) >= 1_000_000:
        return
    rows = check_damaged(case, hostile, true_rows)
    lost = Counter(true_rows) - Counter(rows)
    promise(not lost, f"bomb of {name}: {len(rows)} of {len(true_rows)} intact rows are read")


def fuzz_logs(case: Case) -> None:
    """Decode damaged hex logs and pasted text."""
    random = case.random
    sample = random.choice(sorted(ROOT.glob("samples/*.hex")))
    text = damaged(random, sample.read_bytes())
    path = case.path(f"log.{random.choice(('hex', 'txt', 'log'))}")
    path.write_bytes(text[: random.randrange(1, 40_000)])
    case.run_limited("decode", path, "--format", "csv", "-o", case.path("log.csv"))


def fuzz_bytes(case: Case) -> None:
    """Decode raw bytes: the rows are the bytes, each once and in order."""
    random = case.random
    sample = random.choice(sorted(ROOT.glob("samples/*.raw")))
    data = damaged(random, sample.read_bytes() + random.randbytes(random.randrange(400)))
    path = case.path("bytes.raw")
    path.write_bytes(data)
    run, rows = decoded(case, path)
    promise(run.code == 0, f"raw bytes are refused\n{run.errors}")
    promise(b"".join(bytes.fromhex(row.raw) for row in rows) == data, "the rows are other bytes")
    ends = [row.offset + len(row.raw) // 2 for row in rows]
    promise([0, *ends[:-1]] == [row.offset for row in rows] or not rows, "offsets have gaps")
