"""Statistics and findings as JSON objects (docs/stats.md, docs/findings.md).

Names end in their unit. A value that is unknown or does not apply is null. Keys may be added, but
the meaning of a key never changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fte_sniff.protocol import Direction, Fault, PortEventKind, Status, iso_time, status_of
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role

if TYPE_CHECKING:
    from fte_sniff.analysis.counters import Durations
    from fte_sniff.analysis.findings import Finding
    from fte_sniff.analysis.model import RowCount
    from fte_sniff.analysis.motors import AnswerStats, FlagStats
    from fte_sniff.analysis.statistics import EventStats, PortStats, StatisticsSummary, StreamStats
    from fte_sniff.session.inputs import InputReading


VERSION = 1

MOTOR = NAME_OF_ROLE[Role.MOTOR]
"""The key of a motor's number."""

COUNTED = (PortEventKind.LINE_ERROR, PortEventKind.OVERRUN, PortEventKind.NOT_PASSED_ON)
"""Port events whose count means errors or bytes."""

Json = dict[str, Any]


def statistics_json(summary: StatisticsSummary, reading: InputReading) -> Json:
    """All statistics as one object."""
    total = summary.total
    return {
        "version": VERSION,
        "filter": reading.row_filter and reading.row_filter.text,
        "rows_read": reading.tally.rows,
        "notes": reading.notes,
        "left_out": [
            {
                "rows": gap.rows,
                "first_time": _time(gap.start_ns),
                "last_time": _time(gap.end_ns),
                "reason": gap.reason,
            }
            for gap in reading.reported_gaps
        ],
        "selections": [
            {"filter": one.filter_text, "rows_read": one.rows} for one in reading.selections
        ],
        **_extent(total),
        "duration_s": _seconds(total.duration_ns),
        "status": _statuses(summary.statistics.tally.by_status()),
        "files": [{"name": source.name, **_extent(source.count)} for source in summary.sources],
        "ports": [_port(port, summary) for port in summary.statistics.ports()],
        "motors": [
            _motor(answers, flags, in_order=summary.in_order)
            for answers, flags in zip(summary.answers.stats(), summary.flags.stats(), strict=True)
        ],
    }


def _extent(count: RowCount) -> Json:
    return {"rows": count.rows, "bytes": count.bytes, **_times(count)}


def _times(when: RowCount | EventStats | PortStats) -> Json:
    return {"first_time": _time(when.first_ns), "last_time": _time(when.last_ns)}


def _statuses(counts: Mapping[Status, RowCount]) -> Json:
    return {
        str(status): {"rows": count.rows, "bytes": count.bytes} for status, count in counts.items()
    }


def _port(port: PortStats, summary: StatisticsSummary) -> Json:
    faults = summary.statistics.tally.by_fault(port.port)
    return {
        "port": port.port,
        "baud": port.baud,
        "rows": port.rows,
        "bytes": port.bytes,
        **_times(port),
        "rows_per_s": port.per_s,
        "line_use": port.share,
        "status": _statuses(summary.statistics.tally.by_status(port.port)),
        "frames": {str(direction): port.frames[direction] for direction in Direction},
        "faults": [_fault(fault, count, port) for fault, count in faults.items()],
        "silences": {"count": port.silences.count, **_durations(port.silences)},
        "events": [_event(event) for event in port.events],
        "streams": [
            _stream(one) for one in summary.statistics.streams(None) if one.port == port.port
        ],
    }


def _fault(fault: Fault, count: RowCount, port: PortStats) -> Json:
    return {
        "fault": str(fault),
        "status": str(status_of((fault,))),
        "rows": count.rows,
        "rows_share": count.rows / port.rows,
        "bytes": count.bytes,
        "bytes_share": count.bytes / port.bytes if port.bytes else 0.0,
        **_times(count),
    }


def _event(event: EventStats) -> Json:
    total = event.total if event.kind in COUNTED else None
    return {"event": str(event.kind), "count": event.count, "total": total, **_times(event)}


def _stream(stream: StreamStats) -> Json:
    return {
        "kind": stream.kind.name,
        MOTOR: stream.motor,
        "frames": stream.count,
        "frames_per_s": stream.per_s,
        "period": _durations(stream.periods),
        "jitter_s": _seconds(stream.jitter_ns),
        "values": {
            name: {"least": least, "greatest": greatest}
            for name, (least, greatest) in stream.ranges.items()
        },
    }


def _motor(answers: AnswerStats, flags: FlagStats, *, in_order: bool) -> Json:
    def known(number: int | None) -> int | None:
        return number if in_order else None

    return {
        MOTOR: answers.motor,
        "commands": answers.commands,
        "feedback": answers.feedback,
        "answered": known(answers.pairing.answered),
        "unanswered": known(answers.unanswered),
        "neither": known(answers.neither),
        "delay": _durations(answers.delays if in_order else type(answers.delays)()),
        "error_bits": [
            {"bit": bit, "frames": seen.rows, **_times(seen)}
            for bit, seen in flags.error_bits.items()
        ],
        "offline": {
            "frames": flags.offline.rows,
            "times_lost": known(flags.times_lost),
            **_times(flags.offline),
        },
    }


def _durations(durations: Durations) -> Json:
    return {
        **{f"p{percent}_s": _seconds(durations.percentile_ns(percent)) for percent in (50, 95, 99)},
        "longest_s": _seconds(durations.longest_ns),
        "longest_until": _time(durations.longest_at_ns),
    }


def _seconds(ns: float | None) -> float | None:
    return None if ns is None else ns / 1e9


def _time(t_ns: int | None) -> str | None:
    return None if t_ns is None else iso_time(t_ns)


def finding_json(one: Finding) -> dict[str, Any]:
    """One finding as an object."""
    return {
        "cause": one.cause,
        "port": one.port,
        MOTOR: one.motor,
        "kind": one.kind,
        "first": iso_time(one.first_ns),
        "last": iso_time(one.last_ns),
        "events": one.events,
        "rows": one.rows,
        "usual": one.usual,
        "text": one.text,
        "filter": one.filter,
    }
