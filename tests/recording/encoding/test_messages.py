"""One message alone: what makes no row is refused, whatever its checksum says."""

import pytest

from fte_sniff.protocol import KIND_BY_NAME, Frame, encode
from fte_sniff.recording.messages.codec import MessageReader, encode_row
from fte_sniff.recording.messages.schema import schema_data, schema_name, topic_of

RAW = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 77})
ROW = Frame("p", 10, RAW, 1_000, (), 5)
TOPIC = topic_of(ROW)


def reader() -> MessageReader:
    return MessageReader(TOPIC.name, "p", schema_name(TOPIC), schema_data(TOPIC.schema))


def test_a_message_comes_back_as_its_row() -> None:
    assert reader().row(encode_row(TOPIC, ROW, 1_000), 1_000) == ROW


@pytest.mark.parametrize(
    "raw", [b"\x00" + RAW[1:], RAW[:-1] + b"\x00"], ids=["no header", "no tail"]
)
def test_bytes_that_are_not_framed_make_no_frame(raw: bytes) -> None:
    data = encode_row(TOPIC, ROW, 1_000).replace(RAW, raw)
    with pytest.raises(ValueError, match="no frame in its 10 bytes"):
        reader().row(data, 1_000)


def test_times_and_offsets_that_no_column_can_hold() -> None:
    with pytest.raises(ValueError, match="2262"):
        reader().row(encode_row(TOPIC, ROW, 1_000), 2**63)
    far = Frame("p", 2**63, RAW, 1_000, (), 5)
    with pytest.raises(ValueError, match="offset"):
        reader().row(encode_row(TOPIC, far, 1_000), 1_000)
