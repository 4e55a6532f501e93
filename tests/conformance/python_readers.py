"""The Python readers: `mcap` with its protobuf support, and the loader of rerun's viewer."""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def mcap_lines(path: Path) -> list[str]:
    """As `mcap.reader` reads it by its index, with every CRC checked."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        lines = [
            _line(channel.topic, message.log_time, message.publish_time, _fields(decoded))
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(lines)
    return sorted(lines)


def _fields(message: Any) -> Iterator[str]:
    for field, value in message.ListFields():
        values = value if field.is_repeated else [value]
        names = field.enum_type.values_by_number if field.enum_type else None
        words = [names[one].name if names else _text(one) for one in values]
        yield f"{field.name}={','.join(words)}"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "nan" if math.isnan(value) else f"{value:g}" if value % 1 else str(int(value))
    if isinstance(value, str | bytes):
        return (value.encode() if isinstance(value, str) else value).hex()
    return str(value)


def _line(topic: str, logged: int, published: int, fields: Iterable[str]) -> str:
    return "|".join((topic, str(logged), str(published), *sorted(fields)))


def rerun_lines(path: Path) -> list[str]:
    """As rerun loads it into its viewer."""
    from rerun.chunk import McapReader

    lines: list[str] = []
    for chunk in McapReader(path, decoders=["protobuf"]).stream():
        batch = chunk.to_record_batch()
        at = batch.schema.names.index
        times = (batch[at(f"message_{which}_time")].cast("int64") for which in ("log", "publish"))
        (column,) = (name for name in batch.schema.names if name.endswith(":message"))
        reported = (message[0] for message in batch[column].to_pylist())
        lines += (
            _line(chunk.entity_path, logged.as_py(), published.as_py(), _rerun_fields(message))
            for logged, published, message in zip(*times, reported, strict=True)
        )
    return sorted(lines)


def _rerun_fields(message: dict[str, Any]) -> Iterator[str]:
    for name, value in message.items():
        if value is None or value == []:
            continue
        values = value if isinstance(value, list) else [value]
        words = [one["name"] if isinstance(one, dict) else _text(one) for one in values]
        yield f"{name}={','.join(words)}"
