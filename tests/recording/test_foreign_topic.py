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
MULTI = b"""MultiArrayLayout  layout   # specification of data layout
uint8[]           data

================================================================================
MSG: std_msgs/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset

================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
STAMPED = b"""std_msgs/Header header
uint8 NONE=0
uint16[2] version
uint8[<=4] more
string port
uint8[] data
float64 after
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
ITSELF = b"a/B b\nuint8[] d\n===\nMSG: a/B\na/B b\n"


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


def cdr_text(text: bytes) -> bytes:
    return struct.pack("<I", len(text) + 1) + text + b"\0"


def multi(data: bytes, order: str = "<") -> bytes:
    head = b"\0\1\0\0" if order == "<" else b"\0\0\0\0"
    label = b"bytes\0"
    dim = struct.pack(f"{order}II", 1, len(label)) + label + b"\0\0"
    return head + dim + struct.pack(f"{order}IIII", len(data), 1, 0, len(data)) + data


def stamped(data: bytes) -> bytes:
    body = struct.pack("<iI", 5, 6) + cdr_text(b"base")
    body += b"\0" * (-len(body) % 2) + struct.pack("<HH", 1, 2)
    body += b"\0" * (-len(body) % 4) + struct.pack("<I", 3) + b"abc"
    body += b"\0" * (-len(body) % 4) + cdr_text(b"/dev/ttyUSB0")
    body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(data)) + data
    return b"\0\1\0\0" + body + b"\0" * (-len(body) % 8) + struct.pack("<d", 1.5)


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
        ("cdr", ("std_msgs/msg/UInt8MultiArray", "ros2msg", MULTI), multi),
        ("cdr", ("std_msgs/msg/UInt8MultiArray", "ros2msg", MULTI), lambda data: multi(data, ">")),
        ("cdr", ("driver/Bytes", "ros2msg", STAMPED), stamped),
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
        ("cdr", ("a/B", "ros2msg", b"string text\n"), b"", "it has none"),
        ("cdr", ("a/B", "ros2msg", b"a/C c\nuint8[] d\n"), bytes(4), "type a/C before its bytes"),
        ("cdr", ("a/B", "ros2msg", ITSELF), bytes(9), "has itself as a field"),
        ("cdr", ("a/B", "ros2msg", b"uint8[] d\n"), b"\0\1\0\0\xff\xff\xff\xff", "shorter than it"),
        ("cdr", ("a/B", "ros2msg", b"uint8[] d\n"), b"\0", "without its header"),
        ("json", None, b"[1]", "/serial: its messages are JSON"),
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
