"""Statistics, findings and comparisons as JSON objects (docs/stats.md, findings.md, compare.md).

Names end in their unit. A value that is unknown or does not apply is null. Keys may be added, but
the meaning of a key never changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fte_sniff.analysis.compare import Comparison, Number
from fte_sniff.analysis.findings import Cause, Finding, Report
from fte_sniff.analysis.statistics import statistics
from fte_sniff.analysis.table import MOTOR
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.spec import DEFAULT_BAUD

if TYPE_CHECKING:
    from fte_sniff.analysis.segments import Counts
    from fte_sniff.session.inputs import InputReading


VERSION = 1

Json = dict[str, Any]


def statistics_json(
    counts: Counts, reading: InputReading, filter_text: str | None = None, baud: int | None = None
) -> Json:
    """All statistics as one object; `filter_text` selected the rows that were counted."""
    return {
        "version": VERSION,
        "filter": filter_text,
        "rows_read": reading.tally.rows,
        "notes": reading.notes,
        "left_out": [
            {
                **fields_json(gap, "rows", "reason"),
                "first_time": time_json(gap.start_ns),
                "last_time": time_json(gap.end_ns),
            }
            for gap in reading.reported_gaps
        ],
        "selections": [
            {"filter": one.filter_text, "rows_read": one.rows} for one in reading.selections
        ],
        **statistics(counts, baud or DEFAULT_BAUD),
    }


def time_json(t_ns: int | None) -> str | None:
    """A time in UTC, or None."""
    return None if t_ns is None else iso_time(t_ns)


def findings_json(report: Report) -> Json:
    """The findings as an object; what could not be examined is in it, with the reason."""
    missing = report.not_covered
    return {
        "findings": [finding_json(one) for one in report.found],
        "examined": {
            **_extent_json(report.extent),
            "causes": [str(cause) for cause in Cause if cause not in missing],
            "not_covered": [{"cause": cause, "reason": why} for cause, why in missing.items()],
        },
    }


def _extent_json(extent: Mapping[str, Any]) -> Json:
    return {
        "rows": extent["sum rows"],
        "first": time_json(extent["least t"]),
        "last": time_json(extent["greatest t"]),
    }


def finding_json(one: Finding) -> Json:
    """One finding as an object."""
    return {
        **fields_json(one, "cause", "port", MOTOR, "kind"),
        "first": iso_time(one.first_ns),
        "last": iso_time(one.last_ns),
        **fields_json(one, "events", "rows", "usual", "text", "filter"),
    }


def fields_json(one: object, *names: str) -> Json:
    """Attributes by their names."""
    return {name: getattr(one, name) for name in names}


def comparison_json(found: Comparison, before: Counts, after: Counts) -> Json:
    """What changed, best first, and what was and was not compared."""
    return {
        "version": VERSION,
        "changes": [*map(_number_json, found.changes)],
        "not_compared": [str(one) for one in found.not_compared],
        "numbers": [*map(_number_json, found.numbers)],
        "before": _extent_json(before["extent"].row(0, named=True)),
        "after": _extent_json(after["extent"].row(0, named=True)),
    }


def _number_json(one: Number) -> Json:
    values = fields_json(one, "measure", MOTOR, "kind", "before", "after", "text")
    return {**values, "port": one.port or None}
