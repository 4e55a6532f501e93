"""What every reader is to print of a recording: a line a message, made from the rows that went in.

    topic|log time|publish time|field=value|field=value...

Fields stand in order of their names, enum values by name, bytes and text as hex; what is absent is
left out. This must not use the code that writes messages, since it is what that is held against.
"""

from collections.abc import Iterable
from hashlib import sha256

from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Row
from fte_sniff.recording.schema import EVENTS, MALFORMED, topic_of


def expected_lines(rows: Iterable[Row], events: Iterable[PortEvent]) -> list[str]:
    """The lines of a recording in which every row keeps its own time as log time."""
    return sorted([*map(_row_line, rows), *map(_event_line, events)])


def digest(lines: Iterable[str]) -> str:
    """One number for all lines together."""
    return sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()


def _row_line(row: Row) -> str:
    fields = {"offset": str(row.offset), "raw": row.raw.hex()}
    if row.delay_ns is not None:
        fields["read_delay_ns"] = str(row.delay_ns)
    if row.unordered:
        fields["order_uncertain"] = "true"
    if row.faults:
        fields["faults"] = ",".join(f"FAULT_{fault}".upper() for fault in row.faults)
    kind = row.kind if row.framed else None
    fields["status"] = f"STATUS_{row.status}".upper()
    fields["kind"] = f"KIND_{kind.name if kind else 'none'}".upper()
    topic = topic_of(row)
    if topic is MALFORMED:
        fields["framed"] = str(row.framed).lower()
        fields["length"] = str(len(row.raw))
    elif row.framed:
        fields["cmd"] = str(row.cmd)
        names = {field.name for kind in topic.kinds for field in kind.fields}
        fields |= {name: str(row.values.get(name, "nan")) for name in names}
    return _line(topic.name, row.t_ns, fields)


def _event_line(event: PortEvent) -> str:
    kind = f"PORT_EVENT_KIND_{event.kind}".upper()
    detail = event.detail.encode().hex()
    return _line(
        EVENTS.name, event.t_ns, {"kind": kind, "detail": detail, "count": str(event.count)}
    )


def _line(topic: str, t_ns: int | None, fields: dict[str, str]) -> str:
    parts = (f"{name}={value}" for name, value in sorted(fields.items()))
    return "|".join((topic, str(t_ns), str(t_ns), *parts))
