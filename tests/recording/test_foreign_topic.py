"""Serial bytes that other programs recorded: every encoding they use, and what is refused."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from fte_sniff.errors import FileError
from fte_sniff.protocol.items import Chunk
from fte_sniff.recording.foreign_topic import topic_chunks
from fte_sniff.recording.schema import message_class
from tests.examples import examples

STREAM = bytes.fromhex("AA010103E800000000EE550101000400000000EE") * 3
PARTS = [STREAM[:7], STREAM[7:20], b"", STREAM[20:]]
MULTI = ("std_msgs/msg/UInt8MultiArray", "ros2msg", b"")


def written(
    path: Path, encoding: str, schema: tuple[str, str, bytes] | None, data: list[bytes]
) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start()
        id_ = 0 if schema is None else writer.register_schema(*schema)
        other = writer.register_channel("/tf", "json", 0)
        channel = writer.register_channel("/serial", encoding, id_)
        for at, message in enumerate(data):
            writer.add_message(channel, at * 1000, message, at * 1000)
            writer.add_message(other, at * 1000, b"{}", at * 1000)
        writer.finish()
    return path


def multi(data: bytes, order: str = "<") -> bytes:
    head = b"\0\1\0\0" if order == "<" else b"\0\0\0\0"
    label = b"bytes\0"
    dim = struct.pack(f"{order}II", 1, len(label)) + label + b"\0\0"
    return head + dim + struct.pack(f"{order}IIII", len(data), 1, 0, len(data)) + data


def protobuf_schema(*kinds: int) -> bytes:
    file = FileDescriptorProto(name="x.proto", package="x", syntax="proto3")
    message = file.message_type.add(name="Bytes")
    for number, kind in enumerate(kinds, 1):
        message.field.add(name=f"f{number}", number=number, type=kind, label=1)
    return FileDescriptorSet(file=[file]).SerializeToString()


BYTES, INT = FieldDescriptorProto.TYPE_BYTES, FieldDescriptorProto.TYPE_INT32
PROTOBUF = protobuf_schema(INT, BYTES)


def protobuf(data: bytes) -> bytes:
    return message_class("x.Bytes", PROTOBUF)(f1=7, f2=data).SerializeToString()


@pytest.mark.parametrize(
    ("encoding", "schema", "pack"),
    [
        ("", None, bytes),
        ("application/octet-stream", None, bytes),
        ("cdr", MULTI, multi),
        ("cdr", MULTI, lambda data: multi(data, ">")),
        ("protobuf", ("x.Bytes", "protobuf", PROTOBUF), protobuf),
    ],
)
def test_the_bytes_are_extracted_with_their_times(
    tmp_path: Path,
    encoding: str,
    schema: tuple[str, str, bytes] | None,
    pack: Callable[[bytes], bytes],
) -> None:
    path = written(tmp_path / "other.mcap", encoding, schema, [pack(part) for part in PARTS])
    assert list(topic_chunks(path, ["/serial"])) == [
        Chunk("/serial", at * 1000, part) for at, part in enumerate(PARTS)
    ]


@pytest.mark.parametrize(
    ("encoding", "schema", "data", "says"),
    [
        ("protobuf", ("x.Bytes", "protobuf", protobuf_schema(BYTES, BYTES)), b"", "it has f1, f2"),
        ("protobuf", ("x.Bytes", "protobuf", protobuf_schema(INT)), b"", "it has none"),
        ("protobuf", ("x.Bytes", "protobuf", b"junk"), b"", "no usable protobuf schema"),
        ("protobuf", ("x.Bytes", "protobuf", PROTOBUF), b"\xff", "does not fit its schema"),
        ("cdr", ("a/msg/B", "ros2msg", b"uint8[] d\n"), b"", "its messages are a/msg/B, which is"),
        ("cdr", MULTI, b"\0", "shorter than it says"),
        ("cdr", MULTI, b"\0\1\0\0" + b"\xff" * 4 + bytes(90), "shorter than it says"),
        ("cdr", MULTI, multi(b"123")[:-1], "shorter than it says"),
        ("json", None, b"[1]", "its messages are json"),
    ],
)
def test_a_message_without_bytes_is_an_error(
    tmp_path: Path, encoding: str, schema: tuple[str, str, bytes] | None, data: bytes, says: str
) -> None:
    path = written(tmp_path / "other.mcap", encoding, schema, [data])
    with pytest.raises(FileError) as caught:
        list(topic_chunks(path, ["/serial"]))
    assert says in str(caught.value)


def test_a_missing_topic_is_an_error_that_lists_the_others(tmp_path: Path) -> None:
    path = written(tmp_path / "other.mcap", "", None, [b"x"])
    with pytest.raises(FileError, match=r"has no topic '/uart': it has '/serial', '/tf'"):
        list(topic_chunks(path, ["/uart"]))


def test_a_truncated_file_gives_its_messages_and_an_error(tmp_path: Path) -> None:
    path = written(tmp_path / "other.mcap", "", None, [b"x"])
    path.write_bytes(path.read_bytes()[:-20])
    found = []
    with pytest.raises(FileError, match="damaged or cut off there"):
        found.extend(topic_chunks(path, ["/serial"]))
    assert found == [Chunk("/serial", 0, b"x")]


@examples(60)
@given(
    st.lists(st.tuples(st.integers(0, 30), st.integers(0, 2)), min_size=1, max_size=40),
    st.sampled_from([1, 100, 10_000]),
    st.booleans(),
)
def test_messages_are_read_in_the_order_of_log_times(
    tmp_path_factory: pytest.TempPathFactory,
    messages: list[tuple[int, int]],
    chunk_size: int,
    chunked: bool,
) -> None:
    path = tmp_path_factory.mktemp("order") / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size, use_chunking=chunked)
        writer.start()
        channels = [writer.register_channel(topic, "", 0) for topic in ("/rx", "/tx", "/tf")]
        for number, (time, channel) in enumerate(messages):
            writer.add_message(channels[channel], time, bytes([number]), time)
        writer.finish()
    present = {("/rx", "/tx", "/tf")[channel] for _, channel in messages} - {"/tf"}
    for topics in (present, *([one] for one in present)):
        expected = [
            (time, bytes([number]))
            for number, (time, channel) in enumerate(messages)
            if ("/rx", "/tx", "/tf")[channel] in topics
        ]
        found = [(chunk.t_ns, chunk.data) for chunk in topic_chunks(path, topics)]
        assert found == sorted(expected, key=lambda one: one[0])
