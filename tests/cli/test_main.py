"""Every mistake of a user: one clear line, the documented exit code, nothing lost."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from pathlib import Path
from select import select

import pytest
from mcap.writer import Writer

from fte_sniff.cli.main import fte_sniff
from fte_sniff.errors import FileError
from tests.cli.processes import BOUND_S, started, wait_until
from tests.recording.conftest import unprivileged
from tests.slow import crossed


def refused(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert done.returncode == code, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("fte-sniff: ")
    for word in words:
        assert word in lines[0], lines[0]


def test_nobody_listens(run) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        url = f"socket://127.0.0.1:{bound.getsockname()[1]}"
        refused(run("live", url), 3, "refused")


@pytest.mark.parametrize("name", ["part.csv", "part.txt", "part.hex", "part.parquet"])
def test_an_error_in_the_middle_leaves_no_part_of_a_file(run, tmp_path: Path, name: str) -> None:
    frame = "AA 01 01 03 E8 00 00 00 00 EE\n"
    (tmp_path / "typo.log").write_text(5000 * frame + "AA 0G\n" + frame)
    refused(run("decode", "typo.log", "-o", name), 2, "typo.log")
    assert [path.name for path in tmp_path.iterdir()] == ["typo.log"]
    (tmp_path / name).write_bytes(b"precious")
    refused(run("decode", "typo.log", "-o", name, "--force"), 2, "typo.log")
    assert (tmp_path / name).read_bytes() == b"precious"


@pytest.mark.parametrize("output", [("-o", "part.csv"), ("-o", "part.parquet"), ()])
def test_ctrl_c_leaves_no_part_of_a_file(
    environment, tmp_path: Path, output: tuple[str, ...]
) -> None:
    words = ("decode", "-", "--input", "hex", *output)
    with started(environment, tmp_path, *words, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.write(2000 * b"AA 01 01 03 E8 00 00 00 00 EE\n")
        process.stdin.flush()
        if output:
            wait_until(lambda: any(tmp_path.iterdir()))
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=BOUND_S)[1]
        assert process.returncode in (130, -signal.SIGINT)
    assert (errors, [*tmp_path.iterdir()]) == (b"", [])


def test_ctrl_c_ends_the_wait_for_more_bytes(environment, tmp_path: Path) -> None:
    words = ("decode", "-", "--filter", "rpm > 100")
    with started(environment, tmp_path, *words, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(300 * b"AA 01 01 03 E8 00 00 00 00 EE\n")
        process.stdin.flush()
        assert os.read(process.stdout.fileno(), 1)
        while select([process.stdout], [], [], 0.5)[0]:  # until it waits
            assert os.read(process.stdout.fileno(), 65_536)
        process.send_signal(signal.SIGINT)
        wait_until(lambda: process.poll() is not None)
        assert process.returncode == 130


@pytest.mark.parametrize("command", ["decode", "stats"])
@pytest.mark.usefixtures("capsys")
def test_a_file_without_permission_ends_with_4(tmp_path: Path, samples: Path, command: str) -> None:
    secret, folder = tmp_path / "secret.mcap", tmp_path / "closed"
    secret.write_bytes((samples / "clean.mcap").read_bytes())
    folder.mkdir()
    # Now all modules are loaded, wherever they are.
    fte_sniff.main([command, str(secret)], standalone_mode=False)
    secret.chmod(0)
    folder.chmod(0)
    try:
        for path in (secret, folder / "a.raw"):
            with unprivileged(), pytest.raises(FileError, match="no permission to read it"):
                fte_sniff.main([command, str(path)], standalone_mode=False)
    finally:
        folder.chmod(0o700)
    assert FileError.exit_code == 4


def test_an_mcap_without_our_topics(run, tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic="/imu", message_encoding="json", schema_id=0)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"{}")
        writer.finish()
    refused(run("decode", "other.mcap"), 4, "other.mcap", "/imu")


RULE = "count(malformed)>=0"


@pytest.mark.parametrize(
    ("suffix", "words"),
    crossed(
        ["raw", "hex", "mcap"],
        [
            "stats FILE",
            "stats FILE --format json",
            "findings FILE",
            "findings FILE --format json",
            f"check FILE --expect {RULE} --format json",
            "compare FILE FILE --format json",
            "decode FILE --format csv",
            "decode FILE --format jsonl",
            "decode FILE -o out.parquet",
            "report FILE -o out.html",
        ],
    ),
)
def test_name_that_is_not_utf8_has_one_form(
    run, samples: Path, tmp_path: Path, words: str, suffix: str
) -> None:
    if words.startswith("report"):
        pytest.importorskip("bokeh")
    name = os.fsdecode(b"caf\xe9." + suffix.encode())
    (tmp_path / name).write_bytes((samples / f"damaged.{suffix}").read_bytes())
    done = run(*(name if word == "FILE" else word for word in words.split()))
    shown = done.stdout + done.stderr
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "caf" not in shown.replace(f"caf\\udce9.{suffix}", "").replace(
        f"caf\\\\udce9.{suffix}", ""
    )
    if words.startswith("stats"):
        assert f"udce9.{suffix}" in shown
