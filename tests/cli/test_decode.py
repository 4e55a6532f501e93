"""`decode`: files and standard input to every format, whole, filtered, limited, and summed up."""

import csv
import io
import json
from pathlib import Path

import pytest

from fte_sniff.protocol import COLUMN_BY_NAME


def jsonl(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


@pytest.mark.parametrize("name", ["clean", "damaged", "idle", "midstream"])
def test_recording_raw_and_hex_tell_the_same_rows(run, samples: Path, name: str) -> None:
    def rows(ending: str) -> list[dict]:
        done = run("decode", samples / f"{name}.{ending}", "--format", "jsonl")
        assert done.returncode == 0
        return [row | {"time": None, "port": None} for row in jsonl(done.stdout)]

    raw = rows("raw")
    assert (
        "".join(row["raw"] for row in raw) == (samples / f"{name}.raw").read_bytes().hex().upper()
    )
    assert rows("hex") == raw
    recorded = rows("mcap")
    assert "".join(row["raw"] for row in recorded) == "".join(row["raw"] for row in raw)
    if name == "clean":
        assert recorded == raw


def test_times_ports_and_order_come_from_the_recording(run, samples: Path) -> None:
    rows = jsonl(run("decode", samples / "clean.mcap", "--format", "jsonl").stdout)
    times = [row["time"] for row in rows]
    assert times == sorted(times)
    assert times[0].startswith("2026-01-31T12:00:00.")
    assert times[0].endswith("Z")
    assert {row["port"] for row in rows} == {"sim://?seed=1&rate=30&frames=1200"}


def test_csv_has_the_contract_as_its_header(run, samples: Path) -> None:
    text = run("decode", samples / "clean.raw", "--format", "csv").stdout
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == list(COLUMN_BY_NAME)
    assert rows[0]["time"] == ""


def test_filter_limit_and_summary(run, samples: Path) -> None:
    wanted = "motor = 1 AND kind = 'speed'"
    done = run("decode", samples / "clean.mcap", "--format", "jsonl", "--filter", wanted)
    rows = jsonl(done.stdout)
    assert rows
    assert {(row["motor"], row["kind"]) for row in rows} == {(1, "speed")}
    assert f"1,200 rows read, {len(rows)} written" in done.stderr
    few = run(
        "decode", samples / "clean.mcap", "--format", "jsonl", "--filter", wanted, "--limit=2"
    )
    assert jsonl(few.stdout) == rows[:2]
    none = run("decode", samples / "clean.mcap", "--format", "jsonl", "--limit", "0")
    assert none.stdout == ""


def test_summary_names_faults_and_the_time_covered(run, samples: Path) -> None:
    told = run("decode", samples / "damaged.mcap").stderr
    assert "malformed" in told
    assert "%" in told
    assert "s from 2026-01-31T12:00:0" in told
    assert "nothing malformed" in run("decode", samples / "clean.raw").stderr


def test_several_files_are_told_apart(run, samples: Path) -> None:
    done = run("decode", samples / "idle.raw", samples / "idle.hex")
    assert "idle.raw" in done.stdout
    assert "idle.hex" in done.stdout


@pytest.mark.parametrize("ending", ["mcap", "raw", "hex"])
def test_standard_input_is_recognised(run, samples: Path, ending: str) -> None:
    file = samples / f"idle.{ending}"
    done = run("decode", "-", "--format", "jsonl", stdin=file.read_bytes())
    expected = run("decode", file, "--format", "jsonl")
    assert [row["raw"] for row in jsonl(done.stdout)] == [
        row["raw"] for row in jsonl(expected.stdout)
    ]


def test_input_overrules_the_name(run, tmp_path: Path, samples: Path) -> None:
    (tmp_path / "bytes.txt").write_bytes((samples / "idle.raw").read_bytes())
    done = run("decode", "bytes.txt", "--input", "raw", "--format", "jsonl")
    assert len(jsonl(done.stdout)) == 12


def test_output_to_a_file(run, tmp_path: Path, samples: Path) -> None:
    done = run("decode", samples / "idle.raw", "--format", "csv", "-o", "rows.csv")
    assert done.stdout == ""
    assert (tmp_path / "rows.csv").read_text().count("\n") == 13
    again = run("decode", samples / "idle.raw", "-o", "rows.csv")
    assert again.returncode == 4
    assert "--force" in again.stderr
    forced = run("decode", samples / "idle.raw", "-o", "rows.csv", "--force")
    assert forced.returncode == 0
    assert (tmp_path / "rows.csv").read_text().count("\n") == 13


def test_a_file_cut_anywhere_is_decoded_to_its_end(run, tmp_path: Path, samples: Path) -> None:
    (tmp_path / "cut.raw").write_bytes((samples / "clean.raw").read_bytes()[:96])
    done = run("decode", "cut.raw", "--format", "jsonl")
    assert done.returncode == 0
    assert sum(row["length"] for row in jsonl(done.stdout)) == 96
    assert "cut.raw: ends in the middle of a frame (6 of 10 bytes)" in done.stderr
    whole = (samples / "clean.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    cut = run("decode", "cut.mcap", "--format", "jsonl")
    assert cut.returncode == 0
    assert "cut.mcap: " in cut.stderr
