"""Every mistake of a user: one clear line, the documented exit code, nothing lost."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from contextlib import ExitStack
from pathlib import Path
from select import select

import pytest
from mcap.writer import Writer

from fte_sniff.cli.main import fte_sniff
from fte_sniff.errors import FileError
from tests.cli.processes import BOUND_S, first_output, started, wait_until, wire
from tests.recording.conftest import unprivileged


def refused(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert done.returncode == code, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("fte-sniff: ")
    for word in words:
        assert word in lines[0], lines[0]


def test_no_such_port(run) -> None:
    refused(run("live", "/dev/ttyNOPE"), 3, "/dev/ttyNOPE", "no such port")


def test_nothing_is_left_behind_where_the_port_cannot_be_opened(run, tmp_path: Path) -> None:
    run("live", "/dev/ttyNOPE")
    assert list(tmp_path.iterdir()) == []


def test_no_serial_port(run, tmp_path: Path) -> None:
    refused(run("live", tmp_path), 3, "directory, not a serial port")


def test_unknown_scheme(run) -> None:
    refused(run("live", "gopher://x"), 3, "gopher://", "sim://")


@pytest.mark.parametrize("query", ["rat=5", "drop=2", "seed=x", "rate=99999", "wire=up"])
def test_bad_simulation(run, query: str) -> None:
    refused(run("live", f"sim://?{query}"), 3, "sim://", query.split("=")[0])


def test_nobody_listens(run) -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        url = f"socket://127.0.0.1:{bound.getsockname()[1]}"
        refused(run("live", url), 3, "refused")


def test_a_busy_port(run, environment, tmp_path: Path) -> None:
    with wire() as (controller, name), started(environment, tmp_path, "live", name) as holder:
        first_output(holder, controller)
        refused(run("live", name), 3, name, "busy")


def test_a_recording_is_never_overwritten_unasked(run, tmp_path: Path) -> None:
    (tmp_path / "kept.mcap").write_bytes(b"precious")
    refused(run("live", "sim://", "-o", "kept.mcap", "--count", "3"), 4, "kept.mcap", "--force")
    assert (tmp_path / "kept.mcap").read_bytes() == b"precious"
    done = run("live", "sim://", "-o", "kept.mcap", "--count", "3", "--force")
    assert done.returncode == 0
    assert run("decode", "kept.mcap").stdout.count("\n") == 4


@pytest.mark.parametrize(
    ("output", "words"),
    [("none/x.mcap", ["none"]), (".", ["directory"]), ("/proc/x.mcap", ["/proc/x.mcap"])],
)
def test_a_recording_that_cannot_be_made(run, output: str, words: list[str]) -> None:
    refused(run("live", "sim://", "-o", output, "--count", "3"), 4, *words)


def test_a_bridge_records_no_other_form_either(run) -> None:
    done = run("bridge", "sim://?host=off", "-o", "a.parquet", "--count", "1")
    refused(done, 2, "a.parquet", "MCAP", "a.mcap")


@pytest.mark.parametrize("name", ["a", "a.recording", "a.MCAP"])
def test_other_names_of_recordings_are_the_users_affair(run, tmp_path: Path, name: str) -> None:
    assert run("live", "sim://", "-o", name, "--count", "3", "--plain").returncode == 0
    assert (tmp_path / name).read_bytes().startswith(b"\x89MCAP0")


@pytest.mark.parametrize("name", ["part.csv", "part.txt", "part.hex", "part.parquet"])
def test_an_error_in_the_middle_leaves_no_part_of_a_file(run, tmp_path: Path, name: str) -> None:
    frame = "AA 01 01 03 E8 00 00 00 00 EE\n"
    (tmp_path / "typo.log").write_text(5000 * frame + "AA 0G\n" + frame)
    refused(run("decode", "typo.log", "-o", name), 2, "typo.log")
    assert [path.name for path in tmp_path.iterdir()] == ["typo.log"]
    (tmp_path / name).write_bytes(b"precious")
    refused(run("decode", "typo.log", "-o", name, "--force"), 2, "typo.log")
    assert (tmp_path / name).read_bytes() == b"precious"


_KEPT = "holds the rows up to there"


@pytest.mark.parametrize(
    ("output", "left"),
    [
        (("-o", "part.csv"), f"part.csv {_KEPT}"),
        (("-o", "part.parquet"), "part.parquet was not written"),
        ((), f"standard output {_KEPT}"),
        (("--format", "jsonl"), f"standard output {_KEPT}"),
        (("-o", "-", "--format", "raw"), f"standard output {_KEPT}"),
    ],
)
def test_what_is_left_after_ctrl_c_is_reported(
    environment, tmp_path: Path, output: tuple[str, ...], left: str
) -> None:
    words = ("decode", "-", "--input", "hex", *output)
    with started(environment, tmp_path, *words, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        lines = 9000 * b"AA 01 01 03 E8 00 00 00 00 EE\n"
        # Nobody reads standard output, so a pipe has to hold what is written.
        process.stdin.write(lines if "part." in left else lines[:60_000])
        process.stdin.flush()
        assert process.stdout is not None
        if "part." in left:
            part = tmp_path / f"{output[1]}.part"
            wait_until(lambda: part.exists() and (part.stat().st_size or "not written" in left))
            process.stdin.write(lines)  # more than a pipe holds, so it is read
            process.stdin.flush()
        else:
            assert process.stdout.read(1)
        process.send_signal(signal.SIGINT)
        errors = process.communicate(timeout=BOUND_S)[1]
        assert process.returncode in (130, -signal.SIGINT)
    assert errors.decode() == f"fte-sniff: interrupted; {left}\n"
    kept = [path.name for path in tmp_path.iterdir()]
    assert kept == ["part.csv"] * ("part.csv" in left)
    for name in kept:
        assert (tmp_path / name).read_text().startswith("time,port,")


@pytest.mark.parametrize("source", ["-", "pipe"])
def test_ctrl_c_ends_the_wait_for_more_bytes(environment, tmp_path: Path, source: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    words = ("decode", source, "--filter", "rpm > 100")
    with started(environment, tmp_path, *words, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        with ExitStack() as opened:
            if source == "-":
                pipe = process.stdin
            else:
                pipe = opened.enter_context((tmp_path / "pipe").open("wb"))
            pipe.write(300 * b"AA 01 01 03 E8 00 00 00 00 EE\n")
            pipe.flush()
            assert os.read(process.stdout.fileno(), 1)
            while select([process.stdout], [], [], 0.5)[0]:  # until it waits
                assert os.read(process.stdout.fileno(), 65_536)
            process.send_signal(signal.SIGINT)
            wait_until(lambda: process.poll() is not None)
            assert process.returncode == 130


def test_a_command_that_is_nearly_right(run) -> None:
    refused(run("livee", "sim://"), 2, "No such command 'livee'", "Did you mean live?")
    refused(run("lvie", "sim://"), 2, "No such command 'lvie'", "Did you mean live?")
    refused(run("live", "--filtre", "sim://"), 2, "Did you mean", "'--filter'")
    assert "mean" not in run("quux").stderr
    assert "mean" not in run("live", "--theme", "sim://").stderr


@pytest.mark.parametrize(
    ("word", "suggested"),
    [
        ("record", "`fte-sniff live PORT`"),
        ("plot", "`fte-sniff report FILE -o report.html`"),
        ("plot", "`fte-sniff view FILE`"),
        ("convert", "`fte-sniff decode FILE`"),
    ],
)
def test_a_word_for_what_a_command_does_leads_to_it(run, word: str, suggested: str) -> None:
    refused(run(word, "a.mcap"), 2, f"No such command '{word}'", suggested)


def test_a_file_without_a_command_leads_to_view_and_decode(run, tmp_path: Path) -> None:
    (tmp_path / "my log.txt").write_text("AA")
    words = "`fte-sniff view 'my log.txt'`", "`fte-sniff decode 'my log.txt'`"
    refused(run("my log.txt"), 2, "my log.txt is a file", *words)


@pytest.mark.parametrize("port", ["/dev/ttyUSB7", "/dev/serial/by-id/usb-1", "COM3", "sim://"])
def test_a_port_without_a_command_leads_to_live(run, port: str) -> None:
    refused(run(port), 2, f"{port} is a port", f"`fte-sniff live {port}`")


@pytest.mark.parametrize("command", ["decode", "stats", "check"])
def test_a_device_where_a_file_is_read_leads_to_live(run, command: str, tmp_path: Path) -> None:
    leader, follower = os.openpty()
    try:
        name = os.ttyname(follower)
        (tmp_path / "wire").symlink_to(name)
        for port in (name, "wire", "/dev/ttyUSB7"):
            words = f"{port} is a port, not a file; `fte-sniff live {port}` captures it"
            refused(run(command, port), 2, words)
    finally:
        os.close(leader)
        os.close(follower)


def test_a_baud_rate_in_place_of_a_port_leads_to_the_option(run) -> None:
    refused(run("live", "sim://", "115200"), 2, "115200 is not a port", "--baud 115200")
    short = run("live", "sim://?rate=50", "-b", "9600", "--plain", "--count", "1", "--no-record")
    assert short.returncode == 0, short.stderr


def test_a_file_in_place_of_a_port_leads_to_view(run, samples: Path) -> None:
    path = samples / "clean.mcap"
    refused(run("live", path), 2, f"{path} is a file, not a port", f"`fte-sniff view {path}`")


@pytest.mark.parametrize("text", ["motor = 1", "rpm>500", "kind IS NULL"])
def test_a_filter_in_place_of_a_file_is_the_only_error(run, samples: Path, text: str) -> None:
    done = run("decode", text, samples / "clean.mcap")
    assert done.stdout == ""
    refused(done, 2, f"no such file: '{text}'", f"--filter '{text}'")


def test_a_file_may_be_named_like_a_filter(run, samples: Path, tmp_path: Path) -> None:
    (tmp_path / "motor = 1.mcap").write_bytes((samples / "clean.mcap").read_bytes())
    assert run("decode", "motor = 1.mcap", "--limit", "1").returncode == 0
    refused(run("decode", "a=b.mcap"), 4, "no such file")


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


def test_our_own_parquet_is_read_back(run, samples: Path) -> None:
    source = samples / "damaged.mcap"
    assert run("decode", source, "-o", "a.parquet").returncode == 0
    for options in (["--format", "csv"], ["--format", "csv", "--from", "+1s"], ["--limit", "3"]):
        there, back = run("decode", source, *options), run("decode", "a.parquet", *options)
        assert back.stdout == there.stdout
        assert back.returncode == 0
    piped = run("decode", "-", "--input", "parquet", stdin=b"PAR1")
    refused(piped, 2, "stdin: parquet is not read in sequence; name a file")


def test_an_invalid_time_is_reported_with_a_valid_one(run) -> None:
    refused(
        run("live", "sim://", "--duration", "1x"), 2, "'1x' is not a time; use for example 100ms"
    )


@pytest.mark.parametrize("command", ["decode", "stats", "view", "repair"])
def test_a_port_where_a_file_is_read_leads_to_live(run, command: str) -> None:
    words = "sim://?seed=1 is a port, not a file; `fte-sniff live` captures it"
    refused(run(command, "sim://?seed=1"), 2, words)


def test_view_refuses_standard_input(run, samples: Path) -> None:
    done = run("view", "-", stdin=(samples / "clean.mcap").read_bytes())
    refused(done, 2, "files only", "fte-sniff decode -")


def test_turns_that_lines_do_not_show_are_reported(run) -> None:
    words = ("live", "sim://", "--plain", "--no-record", "--count", "2", "--resolution", "500")
    done = run(*words)
    assert done.returncode == 0
    assert done.stderr.count("in pulses; only the screen shows turns") == 1


def test_two_wires_in_one_raw_file_are_reported(run, samples: Path) -> None:
    files = samples / "clean.mcap", samples / "damaged.mcap"
    done = run("decode", *files, "-o", "both.raw")
    assert done.returncode == 0
    assert done.stderr.count("both.raw: holds the bytes of 2 ports in one stream") == 1
    port = done.stderr.split('--filter "')[1].split('"')[0]
    alone = run("decode", *files, "-o", "one.raw", "--filter", port)
    assert "in one stream" not in alone.stderr


def test_output_and_no_record_contradict_each_other(run) -> None:
    refused(run("live", "sim://", "-o", "x.mcap", "--no-record"), 2, "-o", "--no-record")


@pytest.mark.parametrize("command", ["decode", "view", "stats"])
def test_unknown_options(run, command: str) -> None:
    refused(run(command, "--bogus", "x.raw"), 2, "--bogus", "--help")


def test_files_that_cannot_be_read(run, tmp_path: Path) -> None:
    refused(run("decode", "none.mcap"), 4, "none.mcap")
    refused(run("decode", "none.raw"), 4, "none.raw", "no such file")
    (tmp_path / "folder.mcap").mkdir()
    refused(run("decode", "folder.mcap"), 4, "folder.mcap", "directory")
    (tmp_path / "folder.raw").mkdir()
    refused(run("decode", "folder.raw"), 4, "folder.raw", "directory")


def test_an_unreadable_file(run, tmp_path: Path, environment) -> None:
    file = tmp_path / "secret.raw"
    file.write_bytes(b"\xaa")
    file.chmod(0)
    if os.access(file, os.R_OK):  # root reads everything; what root cannot read is in /proc
        refused(run("decode", "/proc/self/mem", "--input", "raw"), 4, "/proc/self/mem")
    else:
        refused(run("decode", "secret.raw"), 4, "secret.raw", "ermission")


@pytest.mark.parametrize("name", ["empty.raw", "empty.hex", "empty.mcap"])
def test_empty_files(run, tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    refused(run("decode", name), 4, name, "empty")


def test_no_mcap(run, tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"AA 01 01 03 E8 00 00 00 00 EE")
    refused(run("decode", "x.mcap"), 4, "x.mcap", "MCAP")


def test_an_mcap_without_our_topics(run, tmp_path: Path) -> None:
    with (tmp_path / "other.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic="/imu", message_encoding="json", schema_id=0)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"{}")
        writer.finish()
    refused(run("decode", "other.mcap"), 4, "other.mcap", "/imu")


def test_a_name_without_a_known_suffix(run, tmp_path: Path) -> None:
    (tmp_path / "capture.dat").write_bytes(b"\xaa\x00")
    refused(run("decode", "capture.dat"), 2, "capture.dat", "--input")


def test_no_hex_in_a_hex_file(run, tmp_path: Path) -> None:
    (tmp_path / "x.hex").write_text("AA 00\nzz\n")
    done = run("decode", "x.hex")
    refused(done, 2, "x.hex", "line 2, column 1")


def test_rows_before_the_fault_are_not_lost(run, tmp_path: Path) -> None:
    frames = "AA 00 00 00 00 00 00 00 00 EE\n" * 40
    (tmp_path / "x.hex").write_text(frames + "zz\n")
    done = run("decode", "x.hex")
    assert done.returncode == 2
    assert done.stdout.count("AA 00 00 00 00 00 00 00 00 EE") >= 38


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("moter = 1", ["moter", "motor"]),
        ("kind = 'sped'", ["sped", "speed"]),
        ("motor = ", ["filter"]),
        ("", ["filter"]),
    ],
)
@pytest.mark.parametrize("command", ["decode", "live"])
def test_bad_filters(run, samples: Path, tmp_path: Path, command, text, words) -> None:
    target = samples / "clean.raw" if command == "decode" else "sim://"
    refused(run(command, target, "--filter", text), 2, *words)
    assert list(tmp_path.iterdir()) == []


def test_view_needs_a_terminal(run, samples: Path) -> None:
    refused(run("view", samples / "clean.mcap"), 2, "terminal", "decode")


def test_escapes_in_names_are_shown_not_obeyed(run, tmp_path: Path, samples: Path) -> None:
    name = "a\x1b[31m[red].raw"
    (tmp_path / name).write_bytes((samples / "idle.raw").read_bytes())
    for form in ("table", "jsonl", "csv"):
        done = run("decode", name, name, "--format", form)
        assert done.returncode == 0
        assert "\x1b" not in done.stdout + done.stderr
        assert "[red]" in done.stdout
    refused(run("decode", "none\x1b[31m.raw"), 4, r"none\x1b[31m.raw")


@pytest.mark.parametrize(
    "arguments",
    [
        ["live", "sim://", "-o", ""],
        ["bridge", "sim://", "--link", ""],
        ["simulate", "--link", ""],
        ["decode", ""],
        ["decode", "-", "-o", ""],
        ["view", ""],
        ["repair", ""],
        ["repair", "x.mcap", "-o", ""],
    ],
)
def test_an_empty_name_is_reported_as_empty(run, arguments: list[str]) -> None:
    done = run(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert "the name is empty" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_folder_is_nothing_to_repair(run) -> None:
    done = run("repair", ".")
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("given", ["x", "1.5", ""])
def test_an_invalid_number_is_reported_in_plain_words(run, given: str) -> None:
    refused(run("decode", "x.mcap", "--limit", given), 2, f"'{given}' is not a whole number")
