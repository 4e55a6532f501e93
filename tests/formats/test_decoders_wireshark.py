"""Wireshark's tshark shows every field of every row of a pcapng file as `decode` does."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from fte_sniff.errors import FileError
from fte_sniff.formats.decoders import wireshark_dissector
from fte_sniff.formats.pcapng import COMMENT, PcapngWriter
from fte_sniff.protocol.columns import COLUMNS, record
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KINDS, VALUE_FIELDS, Fault, encode
from tests.recording.conftest import some_rows
from tests.support.tools import needs

FIELDS = {
    "time": "frame.time_epoch",
    "port": "frame.interface_name",
    **{
        column.name: f"fte.{column.name}"
        for column in COLUMNS
        if column.name in {field.name for field in VALUE_FIELDS}
        or column.name in {"direction", "kind", "cmd", "status", "faults", "raw"}
    },
}
"""What Wireshark calls the columns that it shows."""


class Tshark:
    """tshark with the dissector, in a home of its own."""

    def __init__(self, home: Path) -> None:
        self._environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home)}
        self._script = home / "fte.lua"
        self._script.write_text(wireshark_dissector())

    def run(self, *words: str | Path) -> list[str]:
        done = subprocess.run(
            ["tshark", "-X", f"lua_script:{self._script}", *words],
            env=self._environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert "Lua" not in done.stderr
        return done.stdout.splitlines()

    def fields(self, file: Path, *names: str) -> list[list[str]]:
        wanted = [word for name in names for word in ("-e", name)]
        lines = self.run("-r", file, "-T", "fields", "-E", "occurrence=a", *wanted)
        return [line.split("\t") for line in lines]

    def count(self, file: Path, wanted: str) -> int:
        return len(self.run("-r", file, "-Y", wanted, "-T", "fields", "-e", "frame.number"))


@pytest.fixture
def tshark(tmp_path: Path) -> Tshark:
    return Tshark(tmp_path)


def written(folder: Path, rows: Sequence[Row], bauds: dict[str, int] | None = None) -> Path:
    path = folder / "rows.pcapng"
    with path.open("wb") as file:
        PcapngWriter(file, bauds or {}).write(rows)
    return path


def shown(row: Row) -> list[str]:
    """The fields of a row in the form of tshark."""
    values = record(row) | {"faults": ",".join(row.faults), "raw": row.raw.hex()}
    assert row.t_ns is not None
    seconds, ns = divmod(row.t_ns, 10**9)
    values["time"] = f"{seconds}.{ns:09}"
    flags = {field.name for field in VALUE_FIELDS if field.legal_bits is not None}
    values |= {name: f"0x{values[name]:02x}" for name in flags if values[name] is not None}
    return ["" if (value := values[name]) is None else str(value) for name in FIELDS]


def two_wires() -> list[Row]:
    rows = some_rows(300) + some_rows(300, "端口 2")
    return sorted(rows, key=lambda row: row.t_ns or 0)


def every_byte_of_the_heads() -> list[Row]:
    """A frame of each kind with every motor and ONLINE byte; faults as the framer finds them."""
    rows: list[Row] = []
    for kind in KINDS:
        values = {f.name: f.default if f.default is not None else 1 for f in kind.fields}
        for byte in range(256):
            raw, faults = bytearray(encode(kind, values)), []
            for field in kind.fields:
                if field.fault is not None:
                    raw[field.start] = byte
                    faults += [] if field.is_legal(byte) else [field.fault]
            ordered = tuple(fault for fault in Fault if fault in faults)
            rows.append(Row("a", 10 * len(rows), bytes(raw), 10**18 + len(rows), ordered))
    return rows


@needs("tshark")
@pytest.mark.parametrize("make", [two_wires, every_byte_of_the_heads])
def test_every_field_of_every_row_equals_decode(tmp_path: Path, tshark: Tshark, make) -> None:
    rows = make()
    found = tshark.fields(written(tmp_path, rows), *FIELDS.values())
    assert found == [shown(row) for row in rows]


@needs("tshark")
def test_fields_can_be_filtered_and_faults_are_expert_infos(tmp_path: Path, tshark: Tshark) -> None:
    rows = some_rows(500)
    file = written(tmp_path, rows)
    records = [record(row) for row in rows]
    fast = [r for r in records if r["motor"] == 2 and r["rpm"] is not None and r["rpm"] > 100]
    assert tshark.count(file, "fte.motor == 2 && fte.rpm > 100") == len(fast) > 0
    faulty = [row for row in rows if row.faults]
    assert tshark.count(file, "_ws.expert") == len(faulty) > 0
    ambiguous = [row for row in rows if Fault.AMBIGUOUS in row.faults]
    assert tshark.count(file, "fte.fault.ambiguous") == len(ambiguous) > 0


@needs("tshark")
def test_direction_comment_and_speed_of_the_line_are_in_the_file(
    tmp_path: Path, tshark: Tshark
) -> None:
    rows = two_wires()
    file = written(tmp_path, rows, {rows[0].port: 9600})
    found = tshark.fields(file, "frame.packet_flags_direction", "frame.comment")
    directions = {None: "0x00000000", "feedback": "0x00000001", "control": "0x00000002"}
    for (flags, comment), row in zip(found, rows, strict=True):
        assert int(flags, 16) == int(directions[record(row)["direction"]], 16)
        assert comment == (COMMENT + ",".join(row.faults) if row.faults else "")
    facts = subprocess.run(["capinfos", file], capture_output=True, text=True, check=True).stdout
    assert "File timestamp precision:  nanoseconds (9)" in facts
    assert "Speed = 9600" in facts
    assert facts.count("Name = ") == 2


@needs("tshark")
def test_bytes_of_another_capture_are_dissected_frame_by_frame(
    tmp_path: Path, tshark: Tshark
) -> None:
    """A datagram of several frames with damage between them, with "Decode As"."""
    frames = [row.raw for row in some_rows(6)]
    payload = frames[0] + b"\x01\x02" + frames[1] + frames[2] + b"\xaa"
    dump = "".join(f"{at:06x} {payload[at]:02x}\n" for at in range(len(payload)))
    file = tmp_path / "udp.pcap"
    subprocess.run(
        ["text2pcap", "-q", "-u", "5000,5001", "-", file], input=dump, text=True, check=True
    )
    words = ("-d", "udp.port==5001,fte", "-r", file, "-T", "fields", "-e", "fte.raw")
    assert tshark.run(*words) == [
        ",".join([frames[0].hex(), "0102", *map(bytes.hex, frames[1:3]), "aa"])
    ]


def test_a_row_without_a_time_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"'a', offset 7, has no time since 1970.*another format"):
        written(tmp_path, [Row("a", 7, b"\x01", None, (Fault.NOISE,), framed=False)])
