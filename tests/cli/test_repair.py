"""`repair` keeps what is whole, says what is not, and touches nothing else."""

from pathlib import Path

import pytest

from fte_sniff.recording.reader import RecordingReader


def test_a_whole_file_is_left_alone(run, tmp_path: Path, samples: Path) -> None:
    done = run("repair", samples / "damaged.mcap", "-o", tmp_path / "x.mcap")
    assert (done.returncode, done.stdout) == (0, "")
    assert "is whole; there is nothing to repair" in done.stderr
    assert not (tmp_path / "x.mcap").exists()


def test_a_cut_file_is_mended_beside_it(run, tmp_path: Path, samples: Path) -> None:
    rows = list(RecordingReader(samples / "damaged.mcap"))
    cut = tmp_path / "cut.mcap"
    content = (samples / "damaged.mcap").read_bytes()[:20_000]
    cut.write_bytes(content)
    done = run("repair", "cut.mcap")
    assert done.returncode == 0
    assert "lost: bytes" in done.stderr
    assert "repaired into cut-repaired.mcap" in done.stderr
    assert cut.read_bytes() == content
    reader = RecordingReader(tmp_path / "cut-repaired.mcap")
    kept = list(reader)
    assert (reader.ending, reader.losses) == ("", ())
    assert 0 < len(kept) < len(rows)
    assert kept == rows[: len(kept)]
    again = run("repair", "cut.mcap")
    assert again.returncode == 4
    assert "cut-repaired.mcap exists already" in again.stderr
    assert run("repair", "cut.mcap", "--force").returncode == 0


def test_where_only_the_index_is_damaged_nothing_is_called_lost(
    run, tmp_path: Path, samples: Path
) -> None:
    whole = (samples / "damaged.mcap").read_bytes()
    count = RecordingReader(samples / "damaged.mcap").count
    (tmp_path / "cut.mcap").write_bytes(whole[:-10])
    done = run("repair", "cut.mcap")
    assert done.returncode == 0
    damaged, kept, last_line = done.stderr.splitlines()
    assert damaged.startswith("damaged: bytes ")
    assert damaged.endswith(", which held no rows")
    assert kept.startswith(f"kept all {count} rows and port events in ")
    assert last_line == "repaired into cut-repaired.mcap"
    assert "lost" not in done.stderr


def test_the_number_of_lost_rows_is_reported(run, tmp_path: Path, samples: Path) -> None:
    whole = bytearray((samples / "damaged.mcap").read_bytes())
    whole[21_000] ^= 0xFF
    (tmp_path / "x.mcap").write_bytes(whole)
    done = run("repair", "x.mcap")
    lost, kept, _ = done.stderr.splitlines()
    assert lost.startswith("lost: bytes ")
    missing = int(kept.rpartition("; ")[2].removesuffix(" are lost"))
    rows = [
        len(list(RecordingReader(path)))
        for path in (*(samples / "damaged.mcap", tmp_path / "x-repaired.mcap"),)
    ]
    assert missing == rows[0] - rows[1] > 0


@pytest.mark.parametrize(
    ("content", "code", "words"),
    [
        (b"", 4, "is empty"),
        (b"\x89MCAP0\r\n", 4, "no whole chunk"),
        (b"\x89MCA", 4, "no whole chunk"),
        (b"AA" * 99, 4, "not an MCAP recording"),
    ],
)
def test_where_nothing_is_left_nothing_is_written(
    run, tmp_path: Path, content: bytes, code: int, words: str
) -> None:
    (tmp_path / "x.mcap").write_bytes(content)
    done = run("repair", "x.mcap")
    assert done.returncode == code
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["x.mcap"]


@pytest.mark.parametrize("command", ["decode", "stats"])
def test_what_is_whole_behind_a_damaged_beginning_is_read(
    run, tmp_path: Path, samples: Path, command: str
) -> None:
    whole = (samples / "damaged.mcap").read_bytes()
    (tmp_path / "head of it.mcap").write_bytes(bytes(50) + whole[50:])
    done = run(command, "head of it.mcap")
    assert done.returncode == 0
    (warning,) = [line for line in done.stderr.splitlines() if "damaged" in line]
    assert "bytes of this recording are damaged" in warning
    assert "`fte-sniff repair 'head of it.mcap'` copies the undamaged rest" in warning
    if command == "decode":
        assert done.stdout == run("decode", samples / "damaged.mcap").stdout
    assert run("repair", "head of it.mcap").returncode == 0
    last_line = RecordingReader(tmp_path / "head of it-repaired.mcap")
    assert list(last_line) == list(RecordingReader(samples / "damaged.mcap"))


def test_the_damaged_file_is_never_the_output(run, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"damaged")
    (tmp_path / "link.mcap").symlink_to("x.mcap")
    for output in ("x.mcap", "link.mcap"):
        done = run("repair", "x.mcap", "-o", output, "--force")
        assert done.returncode == 2
        assert "the damaged file itself" in done.stderr
    assert (tmp_path / "x.mcap").read_bytes() == b"damaged"
