"""`fte-sniff findings`: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import tzinfo
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.input_files import STDIN, InputQuery, check_inputs, input_options
from fte_sniff.cli.measuring import measure, pair_option, print_json, text_or_json_option
from fte_sniff.cli.options import grouped_command
from fte_sniff.errors import printable
from fte_sniff.protocol import iso_time
from fte_sniff.session.stats_json import finding_json

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Finding, Findings


@grouped_command(name="findings", short_help="What is wrong in files: cause, motor, span, rows.")
@input_options(filters=False)
@text_or_json_option
@pair_option
def command(query: InputQuery, form: str, pair: bool) -> None:
    """Find the spans of time in which something is wrong, all files together, best first.

    Unanswered and late commands, damage, silence, ERROR and ONLINE flags, motors that do not follow
    their targets, irregular commands, jumps of values, lost ports. Each finding names the command
    that shows its rows. All rows are needed to see what is missing, so there is no --filter.

    \b
    fte-sniff findings samples/motor3.mcap
    fte-sniff findings logs/ --from -10m
    fte-sniff findings samples/motor3.mcap --format json
    """
    from fte_sniff.analysis.findings import Findings

    check_inputs(query.files)
    findings = Findings()
    measured = measure(query, findings, pair=pair)
    found = findings.found()
    if form == "json":
        print_json(findings_json(findings, found))
    else:
        for line in _lines(findings, found, query, measured.reading.source.zone):
            click.echo(printable(line))
    measured.finish()


def findings_json(findings: Findings, found: Sequence[Finding]) -> dict[str, Any]:
    """The findings as an object; what could not be examined is in it, with the reason."""
    total, missing = findings.total, findings.not_covered()
    return {
        "findings": [finding_json(one) for one in found],
        "examined": {
            "rows": total.rows,
            "first": None if total.first_ns is None else iso_time(total.first_ns),
            "last": None if total.last_ns is None else iso_time(total.last_ns),
            "causes": [cause for cause in findings.CAUSES if cause not in missing],
            "events": {} if len(missing) == len(findings.CAUSES) else findings.counts(),
            "not_covered": [{"cause": cause, "reason": why} for cause, why in missing.items()],
        },
    }


def _lines(
    findings: Findings, found: Sequence[Finding], query: InputQuery, zone: tzinfo
) -> Iterator[str]:
    days = {iso_time(t_ns, zone)[:10] for one in found for t_ns in (one.first_ns, one.last_ns)}
    for number, one in enumerate(found, 1):
        first, last = (iso_time(t_ns, zone)[:19] for t_ns in (one.first_ns, one.last_ns))
        if len(days) == 1:
            first, last = first[11:], last[11:]
        yield f"{number}. {one.about}, {first} to {last}"
        yield f"   {one.text}"
        if STDIN not in query.files:
            yield f"   {query.view_command(one.decided_ns, one.filter)}"
    yield from findings.coverage(found)
