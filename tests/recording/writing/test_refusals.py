import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from fte_sniff.errors import FileError
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.reader import RecordingReader
from tests.recording.privilege import unprivileged


def _mcap(path: Path, topics: list[str], encoding: str = "json") -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("x", "jsonschema", b"{}")
        for topic in topics:
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 5, b"{}", 5)
        writer.finish()


def _refusal(path: Path) -> str:
    with pytest.raises(FileError) as caught:
        list(RecordingReader(path))
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    assert text.isprintable()
    return text


def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "hex.mcap").write_text("AA 01 01 03 E8 00 00 00 00 EE\n")
    (tmp_path / "short.mcap").write_bytes(b"\x89MCA")
    (tmp_path / "short.raw").write_bytes(b"\xaa")
    assert "no such file" in _refusal(tmp_path / "absent.mcap")
    assert "is a directory" in _refusal(tmp_path)
    assert "is empty" in _refusal(tmp_path / "empty.mcap")
    assert "--input raw or --input hex" in _refusal(tmp_path / "hex.mcap")
    assert "--input raw or --input hex" in _refusal(tmp_path / "short.raw")
    assert "cut after 4 bytes" in _refusal(tmp_path / "short.mcap")


def test_a_file_that_may_not_be_read(tmp_path: Path) -> None:
    path = tmp_path / "secret.mcap"
    path.touch()
    path.chmod(0)
    with unprivileged():
        assert "no permission to read" in _refusal(path)


def test_an_mcap_of_someone_else_is_told_with_its_topics(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    _mcap(path, ["/tf", "/odom", "/evil\x1b[31m", *(f"/t{n:02}" for n in range(20))])
    text = _refusal(path)
    assert "'/odom'" in text
    assert "'/evil\\x1b[31m'" in text
    assert "and 13 more" in text


def test_an_mcap_of_someone_else_without_a_summary(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    _mcap(path, ["/tf"])
    path.write_bytes(path.read_bytes()[:-20])
    assert "it has '/tf'" in _refusal(path)


def test_an_mcap_with_nothing_in_it_has_no_topics(tmp_path: Path) -> None:
    path = tmp_path / "nothing.mcap"
    _mcap(path, [])
    assert "no topics at all" in _refusal(path)


def test_our_topics_in_another_encoding(tmp_path: Path) -> None:
    path = tmp_path / "json.mcap"
    _mcap(path, ["/fte/control/motor1"])
    assert "/fte/control/motor1 is 'json'; fte-sniff reads protobuf" in _refusal(path)


def test_a_pipe_is_read_as_often_as_wanted(
    tmp_path: Path, recorded: tuple[Path, list[Row], list[PortEvent]]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    content = recorded[0].read_bytes()
    feeder = threading.Thread(target=pipe.write_bytes, args=(content,))
    feeder.start()
    reader = RecordingReader(pipe)
    feeder.join(timeout=60)
    assert list(reader) == recorded[1]
    assert list(reader) == recorded[1]
    assert list(reader.events()) == recorded[2]
    assert (reader.ending, reader.losses) == ("", ())


def test_rows_come_before_the_file_is_read_to_its_end(
    tmp_path: Path, make_rows: Callable[..., list[Row]]
) -> None:
    from fte_sniff.recording.writer import RecordingWriter

    path = tmp_path / "long.mcap"
    rows = make_rows(6000)
    with RecordingWriter(path, []) as writer:
        for start in range(0, 6000, 100):
            writer.write(rows[start : start + 100])
            writer.flush()
    reader = RecordingReader(path)
    coming = iter(reader)
    first = next(coming)
    os.truncate(path, path.stat().st_size // 2)
    found = [first, *coming]
    assert found == rows[: len(found)]
    assert 100 < len(found) < 6000
    assert (reader.ending, reader.losses) != ("", ())
