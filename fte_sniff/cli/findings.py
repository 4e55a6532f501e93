"""`fte-sniff findings`: the spans of time in which something is wrong, best first."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import tzinfo
from typing import TYPE_CHECKING

import click

from fte_sniff.analysis.relations import DEADLINE_NS
from fte_sniff.cli.input_files import STDIN, InputQuery, input_options
from fte_sniff.cli.measuring import finish, headline, measure, print_json, text_or_json_option
from fte_sniff.cli.options import grouped_command
from fte_sniff.errors import printable
from fte_sniff.i18n import _
from fte_sniff.session.stats_json import findings_json

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Report


@grouped_command(name="findings", short_help="What is wrong in files: cause, motor, span, rows.")
@input_options(filters=False, many=True)
@text_or_json_option
def command(query: InputQuery, form: str) -> None:
    """Find the spans of time in which something is wrong, all files together, best first.

    Unanswered and late commands, damage, silence, ERROR and ONLINE flags, motors that do not follow
    their targets, irregular commands, jumps of values, lost ports. Each finding names the command
    that shows its rows. All rows are needed to see what is missing, so there is no --filter.

    \b
    fte-sniff findings samples/motor3.mcap
    fte-sniff findings logs/ --from -10m
    fte-sniff findings samples/motor3.mcap --format json
    """
    from fte_sniff.analysis.events import ANALYSIS
    from fte_sniff.analysis.findings import find

    counts, reading = measure(query, ANALYSIS)
    report = find(counts)
    if form == "json":
        print_json(findings_json(report))
    else:
        for line in _lines(report, query, reading.zone):
            click.echo(printable(line))
    finish(reading)


def _lines(report: Report, query: InputQuery, zone: tzinfo) -> Iterator[str]:
    for number, one in enumerate(report.found, 1):
        yield f"{number}. {headline(one, report.found, zone)}"
        yield f"   {_(one.text)}"
        if STDIN not in query.files:
            # The time after it decides whether its last commands are answered.
            span = one.first_ns, one.last_ns + DEADLINE_NS
            yield f"   {query.view_command(span, one.filter)}"
    yield from (_(one) for one in report.coverage())
